//! A dataset of one recording after the Brain Imaging Data Structure, motion
//! (bids-specification.readthedocs.io, "Motion").
//!
//! ```text
//! dataset_description.json  README.md  participants.tsv  participants.json
//! sub-01/motion/sub-01_task-walk_tracksys-optical_motion.tsv    a column a coordinate, no head
//!                                                 _motion.json
//!                                                 _channels.tsv what each column is
//!                                                 _channels.json
//!                                                 _events.tsv   where there are events
//!                                                 _events.json
//! ```

use std::io::{self, Write};

use serde::Serializer;
use serde_json::{Value, json};

use super::{
    InterchangeError, Result, expect_frames, put_position,
    text::{column_labels, plain},
    write_frames,
};
use crate::motion::{FrameSource, MotionInfo};

/// The version of the specification that the dataset follows.
const BIDS_VERSION: &str = "1.10.0";
/// What stands in a table where nothing does.
const MISSING: &str = "n/a";

/// Subject and task, as file names have them: letters and digits alone.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Names {
    subject: String,
    task: String,
}

impl Names {
    /// Checks both.
    ///
    /// # Errors
    /// `Unsupported` when one is empty or has anything but letters and digits of ASCII.
    pub fn new(subject: &str, task: &str) -> Result<Self> {
        for (what, name) in [("subject", subject), ("task", task)] {
            if name.is_empty() || !name.bytes().all(|b| b.is_ascii_alphanumeric()) {
                return Err(InterchangeError::Unsupported(format!(
                    "the {what} `{name}` does not fit into a file name of bids: use letters a to z and digits"
                )));
            }
        }
        Ok(Self { subject: subject.to_owned(), task: task.to_owned() })
    }

    /// The task that a take's name gives: its letters and digits, or `recording` where it has none.
    #[must_use]
    pub fn task_of(name: &str) -> String {
        let task: String = name.chars().filter(char::is_ascii_alphanumeric).take(64).collect();
        if task.is_empty() { "recording".to_owned() } else { task }
    }

    /// The subject's label.
    #[must_use]
    pub fn subject(&self) -> &str {
        &self.subject
    }

    /// The task's label.
    #[must_use]
    pub fn task(&self) -> &str {
        &self.task
    }

    /// The path of a file of the recording.
    fn path(&self, suffix: &str) -> String {
        let Self { subject, task } = self;
        format!("sub-{subject}/motion/sub-{subject}_task-{task}_tracksys-optical_{suffix}")
    }
}

/// Where the files of a format that is a folder go.
pub trait Folder {
    /// Begins a file that is not there yet, `/` between the folders on the way to it.
    ///
    /// # Errors
    /// Whatever creating it meets.
    fn file(&mut self, path: &str) -> io::Result<Box<dyn Write + '_>>;
}

/// Writes a whole dataset. Positions are millimetres, a missing sample three times `n/a`; events count from the first
/// frame, in seconds.
///
/// # Errors
/// `Unsupported` for no markers at all; `Io`.
pub fn write(frames: &mut dyn FrameSource, names: &Names, folder: &mut dyn Folder) -> Result<()> {
    let info = frames.info().clone();
    if info.markers.is_empty() {
        return Err(InterchangeError::Unsupported(
            "bids needs a channel at least: the take has no markers".to_owned(),
        ));
    }
    let mut put = |path: &str, content: &[u8]| {
        let mut file = folder.file(path)?;
        file.write_all(content)?;
        file.flush()
    };
    put("dataset_description.json", &dataset(names)?)?;
    put("README.md", readme(names, &info).as_bytes())?;
    put("participants.tsv", format!("participant_id\nsub-{}\n", names.subject()).as_bytes())?;
    put("participants.json", &participants()?)?;
    put(&names.path("motion.json"), &motion(names, &info)?)?;
    put(&names.path("channels.tsv"), channels(&info).as_bytes())?;
    put(&names.path("channels.json"), &about_channels(&info)?)?;
    if !info.events.is_empty() {
        put(&names.path("events.tsv"), events(&info).as_bytes())?;
        put(&names.path("events.json"), &about_events()?)?;
    }
    let mut out = folder.file(&names.path("motion.tsv"))?;
    // One line a frame, without a line of names.
    let n_written = write_frames(frames, &mut *out, Vec::new(), |line, _, row| {
        for (column, &position) in row.iter().enumerate() {
            line.extend((column > 0).then_some(b'\t'));
            put_position(line, position, b'\t', MISSING)?;
        }
        line.push(b'\n');
        Ok(())
    })?;
    Ok(expect_frames(info.n_frames, n_written)?)
}

/// What each column of the motion is.
fn channels(info: &MotionInfo) -> String {
    let mut table = "name\tcomponent\ttype\ttracked_point\tunits\treference_frame\n".to_owned();
    for label in column_labels(info) {
        let label = cell(&label);
        for axis in ["x", "y", "z"] {
            table.push_str(&format!("{label}_{axis}\t{axis}\tPOS\t{label}\tmm\tglobal\n"));
        }
    }
    table
}

fn events(info: &MotionInfo) -> String {
    let mut table = "onset\tduration\ttrial_type\tkind\n".to_owned();
    for event in &info.events {
        let onset = event.frame as f64 / info.rate_hz;
        let (label, kind) = (cell(event.label()), event.kind.word());
        table.push_str(&format!("{onset}\t0\t{label}\t{kind}\n"));
    }
    table
}

/// A text as a cell of a table: never empty, and without spaces at its ends.
fn cell(text: &str) -> String {
    let text = plain(text);
    let text = text.trim();
    if text.is_empty() { MISSING.to_owned() } else { text.to_owned() }
}
/// A JSON document of these members, in this order.
fn json(members: impl IntoIterator<Item = (&'static str, Value)>) -> io::Result<Vec<u8>> {
    let mut document = Vec::new();
    serde_json::Serializer::pretty(&mut document).collect_map(members)?;
    document.push(b'\n');
    Ok(document)
}

/// A number as short as it can be: 100 Hz are not 100.0 Hz.
fn number(value: f64) -> Value {
    if value.fract() == 0.0 { json!(value as u64) } else { json!(value) }
}

fn dataset(names: &Names) -> io::Result<Vec<u8>> {
    let generator = json!({
        "Name": "mocapd",
        "Version": env!("CARGO_PKG_VERSION"),
        "Description": "mocapd export",
    });
    json([
        ("Name", format!("Optical motion capture: {}", names.task()).into()),
        ("BIDSVersion", BIDS_VERSION.into()),
        ("DatasetType", "raw".into()),
        ("GeneratedBy", json!([generator])),
    ])
}

fn readme(names: &Names, info: &MotionInfo) -> String {
    format!(
        "# Optical motion capture: {}\n\n\
         One recording of subject {}: {} markers, {} frames at {} Hz.\n\
         Positions are millimetres; `{MISSING}` stands where a marker was not seen.\n\n\
         Made by mocapd {} from a take.\n\
         Whose motion it is, how it was recorded, and on what terms it may be used belongs here: please add it, \
         and in `dataset_description.json` its authors and licence.\n",
        names.task(),
        names.subject(),
        info.markers.len(),
        info.n_frames,
        info.rate_hz,
        env!("CARGO_PKG_VERSION"),
    )
}

fn participants() -> io::Result<Vec<u8>> {
    json([("participant_id", json!({ "Description": "Unique label of the participant" }))])
}

fn motion(names: &Names, info: &MotionInfo) -> io::Result<Vec<u8>> {
    let n_markers = info.markers.len();
    // Channels that there are none of: the specification recommends to say so.
    let none = [
        "ACCELChannelCount",
        "ANGACCELChannelCount",
        "GYROChannelCount",
        "JNTANGChannelCount",
        "LATENCYChannelCount",
        "MAGNChannelCount",
        "MISCChannelCount",
        "ORNTChannelCount",
        "VELChannelCount",
    ];
    let about = [
        ("TaskName", names.task().into()),
        ("SamplingFrequency", number(info.rate_hz)),
        ("TrackingSystemName", "optical".into()),
        ("RecordingType", "continuous".into()),
        ("RecordingDuration", number(info.n_frames as f64 / info.rate_hz)),
        ("MotionChannelCount", (3 * n_markers).into()),
        ("POSChannelCount", (3 * n_markers).into()),
        ("TrackedPointsCount", n_markers.into()),
        ("MissingValues", MISSING.into()),
    ];
    json(none.map(|name| (name, 0.into())).into_iter().chain(about))
}

fn about_channels(info: &MotionInfo) -> io::Result<Vec<u8>> {
    let up = match info.up.name() {
        Some(axis) => format!("{axis} points up"),
        None => "which axis points up is not known".to_owned(),
    };
    let global = json!({
        "RotationRule": "right-hand",
        "Description": format!("The axes of the tracking system, right-handed; {up}"),
    });
    let frame = json!({
        "Description": "What the coordinates are relative to",
        "Levels": { "global": global },
    });
    json([("reference_frame", frame)])
}

fn about_events() -> io::Result<Vec<u8>> {
    let levels = json!({
        "mark": "Marked by an operator, or by the file that was imported",
        "trigger": "A trigger input of the device",
        "sync pulse": "A sync pulse of the device",
        "device": "Said by the device",
        "host": "Noticed by the recorder",
    });
    json([
        ("trial_type", json!({ "Description": "What happened, in words" })),
        ("kind", json!({ "Description": "Who noticed it", "Levels": levels })),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_letters_and_digits() {
        let names = Names::new("01", "walk2").unwrap();
        assert_eq!(
            names.path("motion.tsv"),
            "sub-01/motion/sub-01_task-walk2_tracksys-optical_motion.tsv"
        );
        for (subject, task) in
            [("", "a"), ("a", ""), ("a b", "c"), ("../a", "c"), ("a", "gehen_\u{e4}")]
        {
            assert!(Names::new(subject, task).is_err(), "{subject} {task}");
        }
        assert_eq!(Names::task_of("squat_jump-47m 120hz"), "squatjump47m120hz");
        assert_eq!(Names::task_of("\u{e4}"), "recording");
    }

    #[test]
    fn documents_are_in_order_and_escaped() {
        let inner = json!({ "a\"b": "c\\d\n\u{1}" });
        let document = json([("n", 3.into()), ("o", inner), ("x", number(f64::NAN))]).unwrap();
        let expected = "{\n  \"n\": 3,\n  \"o\": {\n    \"a\\\"b\": \"c\\\\d\\n\\u0001\"\n  },\n  \"x\": null\n}\n";
        assert_eq!(String::from_utf8(document).unwrap(), expected);
        assert_eq!([number(120.0), number(59.94)].map(|n| n.to_string()), ["120", "59.94"]);
    }
}
