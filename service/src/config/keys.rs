//! The table of keys, and what people read of it: the example file, and the rows of docs/config.md.

use std::{
    fmt::Write,
    net::{IpAddr, SocketAddr},
    path::PathBuf,
    time::Duration,
};

use mocapd_acquire::pipeline::{STRETCH_LENGTHS, SYNC_MAX};
use mocapd_codec::{ResamplerKind, Tolerance};
use serde_json::json;

use super::{
    DeviceChoice, NameTemplate,
    key::{Field, Key, Preset, Read, Setting, Takes, When, address, field, path},
    problem::suggestion,
};
use crate::{
    http::CONNECTIONS_MAX, log::Level, subject::NAME_BYTES_MAX, trigger::DELAY_MAX, units,
};

/// Sections, in the order of the example, and what each is about.
pub const SECTIONS: &[(&str, &str)] = &[
    ("rig", "What the rig is called."),
    ("device", "Which device is recorded."),
    ("take", "Where takes go, and how they are written."),
    ("subject", "Who is captured; takes carry what is known of them."),
    ("arm", "What is kept while no take is recorded, so that a start can reach into the past."),
    ("http", "Who may ask and command the service, and where."),
    ("trigger", "Capture triggers over UDP, in and out."),
    ("log", "How much is said."),
];

const TEN_MINUTES: Duration = Duration::from_secs(600);

/// Of names and networks: more is a mistake, and each is compared with every caller.
const ITEMS_MAX: usize = 32;

/// Of machines that are told of starts and stops, one datagram each.
const SEND_TO_MAX: usize = 16;

/// Each key with what it does and why it is there, what it takes, its default, when a new value holds, and its field.
macro_rules! keys {
    ($(
        #[doc = $what:literal]
        #[doc = $why:literal]
        $section:ident.$name:ident: $takes:expr, $preset:expr, $when:expr, $field:expr;
    )*) => {
        /// Every key, in the order of the example.
        pub static KEYS: &[Key] = &[$(Key {
            path: concat!(stringify!($section), ".", stringify!($name)),
            what: $what.trim_ascii(),
            why: $why.trim_ascii(),
            takes: $takes,
            preset: $preset,
            when: $when,
            field: $field,
        }),*];
    };
}

keys! {
    /// What the rig is called: in names of takes, in the status, in triggers.
    /// One service records one rig, and /etc/mocapd/left.toml needs no second name.
    rig.name: Takes::Text(
            "letters, digits, '-', '_' and '.', 1 to 64 of them, a letter or digit first"
        ),
        Preset::Told {
            words: "the file's name without .toml; `rig` for mocapd.toml",
            example: "\"left\"",
        }, When::Now, field!(rig_name, rig_name);
    /// Which device; `auto` is the only one attached that a driver claims, as `mocapd devices` lists them.
    /// A path under /dev/serial/by-id or a USB serial number stays the same when something else is plugged in.
    device.uri: Takes::Text(
            "auto, serial:PATH[@BAUD] or usb:VID:PID[:SERIAL], with ?driver=NAME where needed"
        ),
        Preset::Text("auto"), When::NextArm, field!(device.uri, device_choice);
    /// The frame rate that the device is set to; left out, it keeps its own.
    /// A device that somebody set to another rate yesterday records at this one today.
    device.rate_hz: Takes::Rate,
        Preset::Absent("240"), When::NextArm, field!(device.rate_hz);
    /// Keep every byte of the line beside the takes, from when it is armed until it is not, in a log that `mocapd-sim serve` replays.
    /// It is for finding faults of a rig: a log is many times as large as its take.
    device.raw_log: Takes::Flag,
        Preset::Flag(false), When::NextArm, field!(device.raw_log);
    /// The folder that takes are created in; where there is none at the start, it is made.
    /// Under systemd it is the one folder that the service may write to.
    take.directory: Takes::Text("a folder"),
        Preset::Told {
            words: "`$STATE_DIRECTORY` where it is set, as systemd does; else `\".\"`",
            example: "\"/var/lib/mocapd\"",
        }, When::NextTake, field!(take.directory);
    /// How a take is called that was started without a name.
    /// Names that begin with the date sort by time; where a name exists a number is put behind it, since no take is overwritten.
    take.name: Takes::Text(
            "a file name without .take, in which {date}, {time}, {rig} and {count} are filled in"
        ),
        Preset::Text("{date}_{time}_{rig}"), When::NextTake,
        field!(take.name, |text| NameTemplate::parse(text).map_err(Some));
    /// The largest distance between a sample and its reconstruction; not beside `lossless = true`.
    /// Half a millimetre is five to fifteen times the noise of a good rig, and what `mocapd record` takes.
    take.tolerance: Takes::Length,
        Preset::Text("0.5mm"), When::NextArm,
        Field {
            read: |config, given| given.quantity(tolerance).map(|mm| config.take.codec.tolerance = mm),
            written: |config| {
                let codec = &config.take.codec;
                (!codec.kind.is_lossless()).then(|| json!(format!("{}mm", codec.tolerance.mm())))
            },
        };
    /// Keep every bit; the same as `resampler = "lossless"`.
    /// For archives that must not change: takes are several times as large.
    take.lossless: Takes::Flag,
        Preset::Flag(false), When::NextArm,
        Field {
            // What it comes to depends on the resampler's key.
            read: |_, given| bool::read(given).map(drop),
            written: |config| Some(json!(config.take.codec.kind.is_lossless())),
        };
    /// How samples are coded.
    /// `dense` makes the smallest takes, `fast` suits weak hosts; spline and sync work on whole takes only.
    take.resampler: Takes::Text("dense, fast or lossless"),
        Preset::Text("dense"), When::NextArm, field!(take.codec.kind, resampler);
    /// What is written at once: a killed process loses no more.
    /// Shorter stretches lose less and take more room.
    take.stretch: Takes::Time(STRETCH_LENGTHS),
        Preset::Text("500ms"), When::NextArm, field!(take.stretch);
    /// How often what is written is forced onto the disk: a power cut loses no more than this and a stretch.
    /// Together with a stretch it is a second; `0s` is a sync with each stretch.
    take.sync: Takes::Time(Duration::ZERO..=SYNC_MAX),
        Preset::Text("500ms"), When::NextArm, field!(take.sync);
    /// What stays free of the disk: a take that comes there is closed, and no other one starts.
    /// A system that has nothing left does not even log why; `0B` uses all of it.
    take.keep_free: Takes::Size(0..=1 << 50),
        Preset::Text("256MiB"), When::NextTake, field!(take.keep_free_bytes);
    /// How long a take waits for a device that went away; `0s` closes it at once.
    /// A minute is enough for a cable that was pulled by a foot, and for a device that starts again.
    take.reconnect: Takes::Time(Duration::ZERO..=Duration::from_secs(86_400)),
        Preset::Text("60s"), When::NextArm, field!(take.reconnect);
    /// The longest take: it is closed then, and says so; left out, none is too long.
    /// It is for a start that nobody stops.
    // A month: beyond it the counter of a device of 1000 Hz comes round.
    take.max_length: Takes::Time(Duration::from_secs(1)..=Duration::from_secs(744 * 3600)),
        Preset::Absent("\"1h\""), When::Now, field!(take.max_length);
    /// What the subject is called; every take of the service has it.
    /// Where labels name several subjects, `S01:LKNE`, it says whose skeleton it is.
    subject.name: Takes::Text("a name of at most 128 bytes"),
        Preset::Absent("\"S01\""), When::NextTake,
        Field {
            read: |config, given| given.text(subject_name).map(|name| config.subject.name = Some(name)),
            written: |config| config.subject.name.as_deref().map(|name| json!(name)),
        };
    /// The skeleton.json that `mocapd subject body` made of a scan; every take carries it, and the dashboard draws it.
    /// Limbs whose lengths are known show markers that changed places, also years later.
    subject.skeleton: Takes::Text("the path of a file"),
        Preset::Absent("\"/srv/subjects/s01-skeleton.json\""), When::NextTake,
        field!(subject.skeleton);
    /// The face.json that `mocapd subject face` made of a photograph; every take carries it.
    /// Markers of a face are told apart by where they sit on it.
    subject.face: Takes::Text("the path of a file"),
        Preset::Absent("\"/srv/subjects/s01-face.json\""), When::NextTake, field!(subject.face);
    /// Which marker sits where on the `face`: labels, and the vertices of the wireframe; every take carries it, and the dashboard draws the face under the markers by it.
    /// Sets of markers on faces have no names that everybody knows.
    subject.face_markers: Takes::Text("the path of a file"),
        Preset::Absent("\"/srv/subjects/face-markers.json\""), When::NextTake,
        field!(subject.face_markers);
    /// Whether the service opens the device and arms itself when it starts.
    /// A rig that is switched on is ready to be started; with `false` the device stays free for others.
    arm.at_start: Takes::Flag,
        Preset::Flag(true), When::Restart, field!(arm.at_start);
    /// How much of the past is kept while it is armed.
    /// What happened before anybody pressed start can still be saved.
    arm.pre_roll: Takes::Time(Duration::ZERO..=TEN_MINUTES),
        Preset::Text("10s"), When::NextArm, field!(arm.pre_roll);
    /// How much of the past a plain start puts into its take; no more than `pre_roll`.
    /// A take begins when it was started, unless somebody wants it otherwise.
    arm.include_pre_roll: Takes::Time(Duration::ZERO..=TEN_MINUTES),
        Preset::Text("0s"), When::NextTake, field!(arm.include_pre_roll);
    /// The memory that the pre-roll may need: when it is used up, the oldest is given up first.
    /// Ten minutes of two hundred markers at 1000 Hz, every bit of them, would need more than a gigabyte.
    arm.memory_max: Takes::Size(1 << 20..=64 << 30),
        Preset::Text("256MiB"), When::NextArm, field!(arm.memory_max_bytes);
    /// The Unix socket of the HTTP interface; `""` for none.
    /// Who may use it is said by the permissions of its folder, so that it needs no token.
    http.socket: Takes::Text("the path of a Unix socket of at most 107 bytes, or \"\" for none"),
        Preset::Told {
            words: "`$RUNTIME_DIRECTORY/mocapd.sock` where that is set, as systemd does; else `\"/run/mocapd/mocapd.sock\"`",
            example: "\"/run/mocapd/mocapd.sock\"",
        }, When::Restart,
        Field {
            read: |config, given| given.text(socket).map(|socket| config.http.socket = socket),
            written: |config| config.http.socket.written().or_else(|| Some(json!(""))),
        };
    /// The TCP address of the HTTP interface; `""` for none.
    /// This machine alone reaches 127.0.0.1; an address that others reach needs a `token_file`.
    http.listen: Takes::Text("an address and a port, or \"\" for none"),
        Preset::Text("127.0.0.1:7060"), When::Restart, field!(http.listen);
    /// A file with the token that callers over TCP must send: mode 0600 or stricter, of the service's own user.
    /// Whoever reaches the address could otherwise stop a take.
    http.token_file: Takes::Text("the path of a file"),
        Preset::Absent("\"/etc/mocapd/token\""), When::Restart, field!(http.token_file);
    /// Names under which callers may reach the service over TCP, beside its address and localhost.
    /// A page in a browser that calls it under any other name is refused.
    http.allowed_hosts: Takes::List {
            of: "a host's name or address without a port",
            max: ITEMS_MAX,
        },
        Preset::NoItems("rig.lab.example"), When::Now, field!(http.allowed_hosts, each host);
    /// Connections at once, each on the socket and over TCP; beyond it, the next one takes the place of one that asks nothing, or is refused.
    /// A dashboard needs a few. With 256, connections and their downloads use 889 of the 1024 descriptors that a process has unless it is given more, and takes keep the others.
    http.connections_max: Takes::Whole(1..=CONNECTIONS_MAX as u64),
        Preset::Whole(64), When::Restart, field!(http.connections_max);
    /// The UDP address on which capture triggers of other programs are heard; `""` for none.
    /// No trigger can start a take unless this is set.
    trigger.listen: Takes::Text(
            "an address and a port, such as \"0.0.0.0:8989\", or \"\" for none"
        ),
        Preset::Text(""), When::Now, field!(trigger.listen);
    /// Who is told of our starts and stops, with the same triggers.
    /// Other systems of the laboratory then record the same take under the same name.
    trigger.send_to: Takes::List {
            of: "an address and a port; a broadcast address is one, too",
            max: SEND_TO_MAX,
        },
        Preset::NoItems("192.168.10.255:8989"), When::Now, field!(trigger.send_to, each receiver);
    /// Who is listened to; empty, everybody is, and `mocapd config check` says so.
    /// Triggers carry no proof of who sent them: the address is all there is to go by.
    trigger.allow_from: Takes::List { of: "an address or a network in CIDR form", max: ITEMS_MAX },
        Preset::NoItems("192.168.10.0/24"), When::Now, field!(trigger.allow_from, each str::parse);
    /// The longest delay that a trigger may ask for; one with a longer delay is refused and logged.
    /// Programs delay a start by fractions of a second, so that several begin together; a minute serves nobody but who wants to disturb.
    trigger.delay_max: Takes::Time(Duration::ZERO..=DELAY_MAX),
        Preset::Text("5s"), When::Now, field!(trigger.delay_max);
    /// How much is said on standard error, and so in the journal.
    /// `info` says each arm, start, stop and outage, and nothing for each frame.
    log.level: Takes::Text("error, warn, info, debug or trace"),
        Preset::Text("info"), When::Now, field!(log_level, level);
}

/// Bytes of a rig's name: it is a part of each take's.
const RIG_NAME_BYTES_MAX: usize = 64;

/// Bytes of a Unix socket's path, without the 0 behind it: `sun_path` has 108 on Linux.
pub(super) const SOCKET_BYTES_MAX: usize = 107;

/// A name that can be a part of each take's name, and of a path.
pub(super) fn rig_name(text: &str) -> Read<String> {
    let is_part = |c: char| c.is_alphanumeric() || "-_.".contains(c);
    let is_name = (1..=RIG_NAME_BYTES_MAX).contains(&text.len())
        && text.starts_with(char::is_alphanumeric)
        && text.chars().all(is_part);
    if is_name { Ok(text.to_owned()) } else { Err(None) }
}

fn device_choice(text: &str) -> Read<DeviceChoice> {
    match text {
        "auto" => Ok(DeviceChoice::Auto),
        _ if text.contains(char::is_control) => Err(None),
        _ => text.parse().map(DeviceChoice::At).map_err(|why| Some(format!("{why}"))),
    }
}

fn tolerance(text: &str) -> Read<Tolerance> {
    units::tolerance(text, "lossless = true").map_err(Some)
}

fn resampler(text: &str) -> Read<ResamplerKind> {
    match text.parse::<ResamplerKind>() {
        Ok(kind) if kind.is_live() => Ok(kind),
        Ok(_) => Err(Some(
            "it works on whole takes: record with dense, fast or lossless, then export and import with it"
                .to_owned(),
        )),
        Err(_) => Err(suggestion(text, ["dense", "fast", "lossless"].into_iter())),
    }
}

fn subject_name(text: &str) -> Read<String> {
    let is_name = (1..=NAME_BYTES_MAX).contains(&text.len()) && !text.contains(char::is_control);
    if is_name { Ok(text.to_owned()) } else { Err(None) }
}

fn socket(text: &str) -> Read<Option<PathBuf>> {
    match text {
        "" => Ok(None),
        _ => path(text, SOCKET_BYTES_MAX).map(Some).map_err(Some),
    }
}

fn level(text: &str) -> Read<Level> {
    text.parse().map_err(|_| suggestion(text, Level::NAMES.into_iter()))
}

/// A name as browsers send it in `Host`, in small letters, without its port.
fn host(text: &str) -> Result<String, String> {
    if let Ok(address) = text.parse::<IpAddr>() {
        return Ok(address.to_string());
    }
    let is_label = |label: &str| {
        (1..=63).contains(&label.len())
            && label
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_')
    };
    if text.len() <= 253 && text.split('.').all(is_label) {
        return Ok(text.to_ascii_lowercase());
    }
    Err("it is no host's name".to_owned())
}

/// Who can be sent triggers.
fn receiver(text: &str) -> Result<SocketAddr, String> {
    match address(text)? {
        address if address.port() == 0 => Err("its port is 0".to_owned()),
        address if address.ip().is_unspecified() => Err("it is nobody's address".to_owned()),
        address => Ok(address),
    }
}

/// Letters of a line of the example.
const LINE_MAX: usize = 100;

/// mocapd.toml with every key and its default, all of them commented out.
#[must_use]
pub fn example() -> String {
    let mut out = String::new();
    // Writing into a String does not fail.
    comment(
        &mut out,
        "mocapd.toml: what `mocapd run` does with one rig. Every key stands here with its default: \
         take the `#` away before a key and give it your value. `mocapd config check FILE` says whether it can be \
         meant. docs/config.md has the same as a table.",
    );
    for (section, about) in SECTIONS {
        writeln!(out, "\n# {about}\n[{section}]").ok();
        for key in KEYS.iter().filter(|key| key.section() == *section) {
            out.push('\n');
            comment(&mut out, &format!("{} {}", key.what, key.why));
            comment(&mut out, &format!("It takes {}.", key.takes.words()));
            match key.preset {
                Preset::Absent(_) => comment(&mut out, "There is none by default."),
                Preset::Told { words, .. } => {
                    comment(&mut out, &format!("By default {}.", words.replace('`', "")));
                }
                Preset::NoItems(item) => {
                    comment(&mut out, &format!("An item may be \"{item}\"."));
                }
                Preset::Text(_) | Preset::Flag(_) | Preset::Whole(_) => {}
            }
            writeln!(out, "# {} = {}", key.name(), key.example()).ok();
        }
    }
    out
}

/// A sentence in lines of a file.
fn comment(out: &mut String, words: &str) {
    let mut line = "#".to_owned();
    for word in words.split(' ').filter(|word| !word.is_empty()) {
        if line.chars().count() + 1 + word.chars().count() > LINE_MAX {
            writeln!(out, "{line}").ok();
            line = "#".to_owned();
        }
        line.push(' ');
        line.push_str(word);
    }
    writeln!(out, "{line}").ok();
}

/// The table of a section in docs/config.md.
#[must_use]
pub fn table(section: &str) -> String {
    let mut out =
        "| key | takes | default | what and why | a reload takes it over |\n|---|---|---|---|---|\n"
            .to_owned();
    for key in KEYS.iter().filter(|key| key.section() == section) {
        // A bar would be a column's end.
        let [takes, default] =
            [key.takes.words(), key.default_words()].map(|text| text.replace('|', "\\|"));
        let (name, what, why, when) = (key.name(), key.what, key.why, key.when.words());
        // Writing into a String does not fail.
        writeln!(out, "| `{name}` | {takes} | {default} | {what} {why} | {when} |").ok();
    }
    out
}
