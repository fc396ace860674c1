//! A dataset of one recording in the Brain Imaging Data Structure (bids-specification.readthedocs.io, "Motion").
//!
//! ```text
//! dataset_description.json  README.md  participants.tsv  participants.json
//! sub-01/motion/sub-01_task-walk_tracksys-optical_motion.tsv    one column a coordinate, no header
//!                                                 _motion.json
//!                                                 _channels.tsv description of each column
//!                                                 _channels.json
//!                                                 _events.tsv   if there are events
//!                                                 _events.json
//! ```

use std::io::{self, Write};

use serde::Serializer;
use serde_json::{Value, json};

use super::{
    InterchangeError, Result, check_frame_count, put_position,
    text::{column_labels, without_tabs},
    unsupported, write_frames,
};
use crate::motion::{FrameSource, MotionInfo};

/// The version of the specification that the dataset follows.
const BIDS_VERSION: &str = "1.10.0";
/// The mark for a missing value.
const MISSING: &str = "n/a";

/// The labels of subject and task in file names: ASCII letters and digits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BidsLabels {
    subject: String,
    task: String,
}

impl BidsLabels {
    /// Checks both labels.
    ///
    /// # Errors
    /// `Unsupported` if a label is empty or has characters other than ASCII letters and digits.
    pub fn new(subject: &str, task: &str) -> Result<Self> {
        for (what, name) in [("subject", subject), ("task", task)] {
            if name.is_empty() || !name.bytes().all(|b| b.is_ascii_alphanumeric()) {
                return Err(InterchangeError::Unsupported(format!(
                    "the {what} `{name}` cannot be part of a BIDS file name: use letters a to z and digits"
                )));
            }
        }
        Ok(Self { subject: subject.to_owned(), task: task.to_owned() })
    }

    /// A task label from a take's name: its ASCII letters and digits, at most 64, or `recording` if it has none.
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

/// Creates the files of a dataset.
pub trait DatasetFolder {
    /// Creates a new file; `path` is relative, with `/` between folders.
    ///
    /// # Errors
    /// Those of creating the file.
    fn file(&mut self, path: &str) -> io::Result<Box<dyn Write + '_>>;
}

/// Writes a dataset. Positions are in millimetres, a missing sample is three `n/a`, and the onsets of events are in
/// seconds from the first frame.
///
/// # Errors
/// `Unsupported` for a take without markers; `Io` if reading or writing fails.
pub fn write(
    frames: &mut dyn FrameSource,
    names: &BidsLabels,
    folder: &mut dyn DatasetFolder,
) -> Result<()> {
    let info = frames.info().clone();
    if info.markers.is_empty() {
        return unsupported("BIDS needs at least one channel, but the take has no markers");
    }
    let mut put = |path: &str, content: &[u8]| {
        let mut file = folder.file(path)?;
        file.write_all(content)?;
        file.flush()
    };
    put("dataset_description.json", &dataset_json(names)?)?;
    put("README.md", readme(names, &info).as_bytes())?;
    put("participants.tsv", format!("participant_id\nsub-{}\n", names.subject()).as_bytes())?;
    put("participants.json", &participants_json()?)?;
    put(&names.path("motion.json"), &motion_json(names, &info)?)?;
    put(&names.path("channels.tsv"), channels_tsv(&info).as_bytes())?;
    put(&names.path("channels.json"), &channels_json(&info)?)?;
    if !info.events.is_empty() {
        put(&names.path("events.tsv"), events_tsv(&info).as_bytes())?;
        put(&names.path("events.json"), &events_json()?)?;
    }
    let mut out = folder.file(&names.path("motion.tsv"))?;
    // BIDS wants no column names in this file: channels.tsv has them.
    let n_written = write_frames(frames, &mut *out, Vec::new(), |line, _, row| {
        for (column, &position) in row.iter().enumerate() {
            line.extend((column > 0).then_some(b'\t'));
            put_position(line, position, b'\t', MISSING)?;
        }
        line.push(b'\n');
        Ok(())
    })?;
    Ok(check_frame_count(info.n_frames, n_written)?)
}

/// The table of the columns of motion.tsv.
fn channels_tsv(info: &MotionInfo) -> String {
    let mut table = "name\tcomponent\ttype\ttracked_point\tunits\treference_frame\n".to_owned();
    for label in column_labels(info) {
        let label = cell(&label);
        for axis in ["x", "y", "z"] {
            table.push_str(&format!("{label}_{axis}\t{axis}\tPOS\t{label}\tmm\tglobal\n"));
        }
    }
    table
}

fn events_tsv(info: &MotionInfo) -> String {
    let mut table = "onset\tduration\ttrial_type\tkind\n".to_owned();
    for event in &info.events {
        let onset = event.frame as f64 / info.rate_hz;
        let (label, kind) = (cell(event.label()), event.kind.name());
        table.push_str(&format!("{onset}\t0\t{label}\t{kind}\n"));
    }
    table
}

/// A text as a table cell: without spaces at its ends, and `n/a` if empty.
fn cell(text: &str) -> String {
    let text = without_tabs(text);
    let text = text.trim();
    if text.is_empty() { MISSING.to_owned() } else { text.to_owned() }
}

/// A JSON document with these members, in this order.
fn json(members: impl IntoIterator<Item = (&'static str, Value)>) -> io::Result<Vec<u8>> {
    let mut document = Vec::new();
    serde_json::Serializer::pretty(&mut document).collect_map(members)?;
    document.push(b'\n');
    Ok(document)
}

/// A number as JSON, without decimals if it is whole: 100, not 100.0.
fn number(value: f64) -> Value {
    if value.fract() == 0.0 { json!(value as u64) } else { json!(value) }
}

fn dataset_json(names: &BidsLabels) -> io::Result<Vec<u8>> {
    let version = env!("CARGO_PKG_VERSION");
    let generator = json!({ "Name": "mocapd", "Version": version, "Description": "mocapd export" });
    json([
        ("Name", format!("Optical motion capture: {}", names.task()).into()),
        ("BIDSVersion", BIDS_VERSION.into()),
        ("DatasetType", "raw".into()),
        ("GeneratedBy", json!([generator])),
    ])
}

fn readme(names: &BidsLabels, info: &MotionInfo) -> String {
    format!(
        "# Optical motion capture: {}\n\n\
         One recording of subject {}: {} markers, {} frames at {} Hz.\n\
         Positions are in millimetres; `{MISSING}` marks samples in which a marker was not seen.\n\n\
         Exported by mocapd {} from a take.\n\
         Please add here who was recorded, how, and on what terms the data may be used, \
         and add the authors and the licence to `dataset_description.json`.\n",
        names.task(),
        names.subject(),
        info.markers.len(),
        info.n_frames,
        info.rate_hz,
        env!("CARGO_PKG_VERSION"),
    )
}

fn participants_json() -> io::Result<Vec<u8>> {
    json([("participant_id", json!({ "Description": "Unique label of the participant" }))])
}

fn motion_json(names: &BidsLabels, info: &MotionInfo) -> io::Result<Vec<u8>> {
    let n_markers = info.markers.len();
    // The specification recommends stating a count of 0 for channel types that are absent.
    let absent = [
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
    let fields = [
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
    json(absent.map(|name| (name, 0.into())).into_iter().chain(fields))
}

fn channels_json(info: &MotionInfo) -> io::Result<Vec<u8>> {
    let up = match info.up.name() {
        Some(axis) => format!("{axis} points up"),
        None => "the axis that points up is not known".to_owned(),
    };
    let axes = format!("The axes of the tracking system, right-handed; {up}");
    let frame = json!({
        "Description": "The coordinate system of the positions",
        "Levels": { "global": { "RotationRule": "right-hand", "Description": axes } },
    });
    json([("reference_frame", frame)])
}

fn events_json() -> io::Result<Vec<u8>> {
    let levels = json!({
        "mark": "Marked by an operator, or an event of the imported file",
        "trigger": "A trigger input of the device",
        "sync pulse": "A sync pulse of the device",
        "device": "Reported by the device",
        "host": "Detected by the recorder",
    });
    json([
        ("trial_type", json!({ "Description": "Label of the event" })),
        ("kind", json!({ "Description": "Origin of the event", "Levels": levels })),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_letters_and_digits() {
        let names = BidsLabels::new("01", "walk2").unwrap();
        assert_eq!(
            names.path("motion.tsv"),
            "sub-01/motion/sub-01_task-walk2_tracksys-optical_motion.tsv"
        );
        for (subject, task) in
            [("", "a"), ("a", ""), ("a b", "c"), ("../a", "c"), ("a", "gehen_\u{e4}")]
        {
            assert!(BidsLabels::new(subject, task).is_err(), "{subject} {task}");
        }
        assert_eq!(BidsLabels::task_of("squat_jump-47m 120hz"), "squatjump47m120hz");
        assert_eq!(BidsLabels::task_of("\u{e4}"), "recording");
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
