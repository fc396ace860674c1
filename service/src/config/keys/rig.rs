//! Keys of what is recorded: the rig, its device, its takes, their subject.

use std::time::Duration;

use serde_json::json;

use super::{Key, Preset, Takes, When};
use crate::config::{
    DeviceChoice,
    render::{duration, path, size},
};

/// `rig.name`.
pub static RIG_NAME: Key = Key {
    path: "rig.name",
    takes: Takes::Text(
        "letters, digits, '-', '_' and '.', 1 to 64 of them, a letter or digit first",
    ),
    preset: Preset::Told {
        words: "the file's name without .toml; `rig` for mocapd.toml",
        example: "\"left\"",
    },
    what: "What the rig is called: in names of takes, in the status, in triggers.",
    why: "One service records one rig, and /etc/mocapd/left.toml needs no second name.",
    when: When::Now,
    written: |config| Some(json!(config.rig_name)),
};

/// `device.uri`.
pub static DEVICE_URI: Key = Key {
    path: "device.uri",
    takes: Takes::Text(
        "auto, serial:PATH[@BAUD] or usb:VID:PID[:SERIAL], with ?driver=NAME where needed",
    ),
    preset: Preset::Text("auto"),
    what: "Which device; `auto` is the only one attached that a driver claims, as `mocapd devices` lists them.",
    why: "A path under /dev/serial/by-id or a USB serial number stays the same when something else is plugged in.",
    when: When::NextArm,
    written: |config| {
        Some(match &config.device.uri {
            DeviceChoice::Auto => json!("auto"),
            DeviceChoice::At(uri) => json!(uri.to_string()),
        })
    },
};

/// `device.rate_hz`.
pub static DEVICE_RATE_HZ: Key = Key {
    path: "device.rate_hz",
    takes: Takes::Rate,
    preset: Preset::Absent("240"),
    what: "The frame rate that the device is set to; left out, it keeps its own.",
    why: "A device that somebody set to another rate yesterday records at this one today.",
    when: When::NextArm,
    written: |config| config.device.rate_hz.map(|hz| json!(hz)),
};

/// `device.raw_log`.
pub static DEVICE_RAW_LOG: Key = Key {
    path: "device.raw_log",
    takes: Takes::Flag,
    preset: Preset::Flag(false),
    what: "Keep every byte of the line beside the takes, from when it is armed until it is not, in a log that `mocapd-sim serve` replays.",
    why: "It is for finding faults of a rig: a log is many times as large as its take.",
    when: When::NextArm,
    written: |config| Some(json!(config.device.raw_log)),
};

/// `take.directory`.
pub static TAKE_DIRECTORY: Key = Key {
    path: "take.directory",
    takes: Takes::Text("a folder"),
    preset: Preset::Told {
        words: "`$STATE_DIRECTORY` where it is set, as systemd does; else `\".\"`",
        example: "\"/var/lib/mocapd\"",
    },
    what: "The folder that takes are created in; where there is none at the start, it is made.",
    why: "Under systemd it is the one folder that the service may write to.",
    when: When::NextTake,
    written: |config| path(&config.take.directory),
};

/// `take.name`.
pub static TAKE_NAME: Key = Key {
    path: "take.name",
    takes: Takes::Text(
        "a file name without .take, in which {date}, {time}, {rig} and {count} are filled in",
    ),
    preset: Preset::Text("{date}_{time}_{rig}"),
    what: "How a take is called that was started without a name.",
    why: "Names that begin with the date sort by time; where a name exists a number is put behind it, since no take is overwritten.",
    when: When::NextTake,
    written: |config| Some(json!(config.take.name.text())),
};

/// `take.tolerance`.
pub static TAKE_TOLERANCE: Key = Key {
    path: "take.tolerance",
    takes: Takes::Length,
    preset: Preset::Text("0.5mm"),
    what: "The largest distance between a sample and its reconstruction; not beside `lossless = true`.",
    why: "Half a millimetre is five to fifteen times the noise of a good rig, and what `mocapd record` takes.",
    when: When::NextArm,
    written: |config| {
        let codec = &config.take.codec;
        (!codec.kind.is_lossless()).then(|| json!(format!("{}mm", codec.tolerance.mm())))
    },
};

/// `take.lossless`.
pub static TAKE_LOSSLESS: Key = Key {
    path: "take.lossless",
    takes: Takes::Flag,
    preset: Preset::Flag(false),
    what: "Keep every bit; the same as `resampler = \"lossless\"`.",
    why: "For archives that must not change: takes are several times as large.",
    when: When::NextArm,
    written: |config| Some(json!(config.take.codec.kind.is_lossless())),
};

/// `take.resampler`.
pub static TAKE_RESAMPLER: Key = Key {
    path: "take.resampler",
    takes: Takes::Text("dense, fast or lossless"),
    preset: Preset::Text("dense"),
    what: "How samples are coded.",
    why: "`dense` makes the smallest takes, `fast` suits weak hosts; spline and sync work on whole takes only.",
    when: When::NextArm,
    written: |config| Some(json!(config.take.codec.kind.to_string())),
};

/// `take.stretch`.
pub static TAKE_STRETCH: Key = Key {
    path: "take.stretch",
    takes: Takes::Time { min: Duration::from_millis(50), max: Duration::from_secs(10) },
    preset: Preset::Text("500ms"),
    what: "What is written at once: a killed process loses no more.",
    why: "Shorter stretches lose less and take more room.",
    when: When::NextArm,
    written: |config| duration(config.take.stretch),
};

/// `take.sync`.
pub static TAKE_SYNC: Key = Key {
    path: "take.sync",
    takes: Takes::Time { min: Duration::ZERO, max: Duration::from_secs(60) },
    preset: Preset::Text("500ms"),
    what: "How often what is written is forced onto the disk: a power cut loses no more than this and a stretch.",
    why: "Together with a stretch it is a second; `0s` is a sync with each stretch.",
    when: When::NextArm,
    written: |config| duration(config.take.sync),
};

/// `take.keep_free`.
pub static TAKE_KEEP_FREE: Key = Key {
    path: "take.keep_free",
    takes: Takes::Size { min: 0, max: 1 << 50 },
    preset: Preset::Text("256MiB"),
    what: "What stays free of the disk: a take that comes there is closed, and no other one starts.",
    why: "A system that has nothing left does not even log why; `0B` uses all of it.",
    when: When::NextTake,
    written: |config| size(config.take.keep_free_bytes),
};

/// `take.reconnect`.
pub static TAKE_RECONNECT: Key = Key {
    path: "take.reconnect",
    takes: Takes::Time { min: Duration::ZERO, max: Duration::from_secs(86_400) },
    preset: Preset::Text("60s"),
    what: "How long a take waits for a device that went away; `0s` closes it at once.",
    why: "A minute is enough for a cable that was pulled by a foot, and for a device that starts again.",
    when: When::NextArm,
    written: |config| duration(config.take.reconnect),
};

/// `take.max_length`.
pub static TAKE_MAX_LENGTH: Key = Key {
    path: "take.max_length",
    // A month: beyond it the counter of a device of 1000 Hz comes round.
    takes: Takes::Time { min: Duration::from_secs(1), max: Duration::from_secs(744 * 3600) },
    preset: Preset::Absent("\"1h\""),
    what: "The longest take: it is closed then, and says so; left out, none is too long.",
    why: "It is for a start that nobody stops.",
    when: When::Now,
    written: |config| config.take.max_length.and_then(duration),
};

/// `subject.name`.
pub static SUBJECT_NAME: Key = Key {
    path: "subject.name",
    takes: Takes::Text("a name of at most 128 bytes"),
    preset: Preset::Absent("\"S01\""),
    what: "What the subject is called; every take of the service has it.",
    why: "Where labels name several subjects, `S01:LKNE`, it says whose skeleton it is.",
    when: When::NextTake,
    written: |config| config.subject.name.as_deref().map(|name| json!(name)),
};

/// `subject.skeleton`.
pub static SUBJECT_SKELETON: Key = Key {
    path: "subject.skeleton",
    takes: Takes::Text("the path of a file"),
    preset: Preset::Absent("\"/srv/subjects/s01-skeleton.json\""),
    what: "The skeleton.json that `mocapd subject body` made of a scan; every take carries it, and the dashboard draws it.",
    why: "Limbs whose lengths are known show markers that changed places, also years later.",
    when: When::NextTake,
    written: |config| config.subject.skeleton.as_deref().and_then(path),
};

/// `subject.face`.
pub static SUBJECT_FACE: Key = Key {
    path: "subject.face",
    takes: Takes::Text("the path of a file"),
    preset: Preset::Absent("\"/srv/subjects/s01-face.json\""),
    what: "The face.json that `mocapd subject face` made of a photograph; every take carries it.",
    why: "Markers of a face are told apart by where they sit on it.",
    when: When::NextTake,
    written: |config| config.subject.face.as_deref().and_then(path),
};

/// `subject.face_markers`.
pub static SUBJECT_FACE_MARKERS: Key = Key {
    path: "subject.face_markers",
    takes: Takes::Text("the path of a file"),
    preset: Preset::Absent("\"/srv/subjects/face-markers.json\""),
    what: "Which marker sits where on the `face`: labels, and the vertices of the wireframe; every take carries it, and the dashboard draws the face under the markers by it.",
    why: "Sets of markers on faces have no names that everybody knows.",
    when: When::NextTake,
    written: |config| config.subject.face_markers.as_deref().and_then(path),
};
