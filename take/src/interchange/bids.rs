//! A recording in a dataset of the Brain Imaging Data Structure (bids-specification.readthedocs.io, "Motion").
//!
//! ```text
//! dataset_description.json  README.md  participants.tsv  participants.json      of the whole dataset
//! sub-01/motion/sub-01_task-walk_tracksys-optical_motion.tsv    one column per coordinate, and eight per rigid body
//!                                                 _motion.json
//!                                                 _channels.tsv description of each column
//!                                                 _channels.json
//!                                                 _events.tsv   if there are events
//!                                                 _events.json
//!                                                 _recording-analog_physio.tsv.gz       analog channels, no header
//!                                                 _recording-analog_physio.json
//!                                                 _recording-forceplates_physio.tsv.gz  loads of force plates
//!                                                 _recording-forceplates_physio.json
//!                                                 _recording-sampled0_physio...         groups of a recording
//! sub-01/ses-2/motion/sub-01_ses-2_task-walk_tracksys-optical_run-1_motion.tsv  with a session and a run
//! ```

use std::io::{self, Write};

use flate2::{Compression, write::GzEncoder};
use serde::Serializer;
use serde_json::{Value, json};

use super::{
    InterchangeError, Result, check_frame_count, put_position,
    recorded_rows::{FramePoses, body_names},
    sampled_table::{SampledKind, SampledTable, TIME_COLUMN},
    text::{column_labels, unique_names, without_tabs},
    unsupported, write_frames,
};
use crate::{
    motion::{FrameSource, MotionInfo},
    poses::Pose,
    sampled::RESIDUAL_GROUPS,
};

/// The version of the specification that the dataset follows.
const BIDS_VERSION: &str = "1.10.0";
/// The mark for a missing value.
const MISSING: &str = "n/a";

/// The parts of the names of a recording's files.
const SUFFIXES: [&str; 6] =
    ["motion.tsv", "motion.json", "channels.tsv", "channels.json", "events.tsv", "events.json"];

/// Most groups of sampled channels of a recording: behind those of the device have their numbers those of residuals.
const GROUPS_MAX: u32 = RESIDUAL_GROUPS.end;

/// The labels of continuous recordings: those of an imported file, and those of the groups of a recording.
fn recordings() -> impl Iterator<Item = String> {
    let of_group = |number| [format!("sampled{number}"), format!("forceplates{number}")];
    let of_file = ["analog", "forceplates"].map(str::to_owned);
    of_file.into_iter().chain((0..GROUPS_MAX).flat_map(of_group))
}

/// Members of the document of a continuous recording that are not columns.
const RECORDING_MEMBERS: [&str; 5] =
    ["TaskName", "PhysioType", "SamplingFrequency", "StartTime", "Columns"];

/// The labels in the names of a recording's files: ASCII letters and digits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BidsLabels {
    subject: String,
    session: Option<String>,
    task: String,
    run: Option<String>,
}

impl BidsLabels {
    /// Checks the labels. A session and a run are needed only if the subject has several.
    ///
    /// # Errors
    /// `Unsupported` if a label is empty or has characters other than ASCII letters and digits, or a run is not a
    /// number.
    pub fn new(
        subject: &str,
        session: Option<&str>,
        task: &str,
        run: Option<&str>,
    ) -> Result<Self> {
        let all = [("subject", Some(subject)), ("session", session), ("task", Some(task))];
        for (what, name) in all {
            let Some(name) = name else { continue };
            if name.is_empty() || !name.bytes().all(|b| b.is_ascii_alphanumeric()) {
                return Err(InterchangeError::Unsupported(format!(
                    "the {what} `{name}` cannot be part of a BIDS file name: use letters a to z and digits"
                )));
            }
        }
        if let Some(run) =
            run.filter(|run| run.is_empty() || !run.bytes().all(|b| b.is_ascii_digit()))
        {
            return Err(InterchangeError::Unsupported(format!(
                "the run `{run}` is not a number: use digits, such as 1 or 01"
            )));
        }
        Ok(Self {
            subject: subject.to_owned(),
            session: session.map(str::to_owned),
            task: task.to_owned(),
            run: run.map(str::to_owned),
        })
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

    /// The paths that the files of a recording with these labels have in a dataset.
    pub fn paths(&self) -> impl Iterator<Item = String> {
        let sampled = recordings().flat_map(|recording| {
            ["tsv.gz", "json"].map(|ending| format!("recording-{recording}_physio.{ending}"))
        });
        SUFFIXES.into_iter().map(str::to_owned).chain(sampled).map(|suffix| self.path(&suffix))
    }

    /// The path of a file of the recording.
    fn path(&self, suffix: &str) -> String {
        let Self { subject, session, task, run } = self;
        let (folder, session) = match session {
            Some(session) => (format!("ses-{session}/"), format!("_ses-{session}")),
            None => (String::new(), String::new()),
        };
        let run = run.as_ref().map_or_else(String::new, |run| format!("_run-{run}"));
        format!(
            "sub-{subject}/{folder}motion/sub-{subject}{session}_task-{task}_tracksys-optical{run}_{suffix}"
        )
    }
}

/// Creates the files of a recording in a dataset.
pub trait DatasetFolder {
    /// Creates a new file; `path` is relative, with `/` between folders.
    ///
    /// # Errors
    /// Those of creating the file.
    fn file(&mut self, path: &str) -> io::Result<Box<dyn Write + '_>>;

    /// Creates a file that describes the whole dataset. A dataset that exists keeps its own files; its
    /// `participants.tsv` gets a [row](participant_row).
    ///
    /// # Errors
    /// Those of creating the file.
    fn common_file(&mut self, path: &str) -> io::Result<Box<dyn Write + '_>>;
}

/// Checks that the content of `dataset_description.json` is that of a dataset of recordings.
///
/// # Errors
/// Why it is not.
pub fn check_description(content: &[u8]) -> Result<(), String> {
    let document: Value = serde_json::from_slice(content).map_err(|error| error.to_string())?;
    if !document.get("BIDSVersion").is_some_and(Value::is_string) {
        return Err("it states no BIDSVersion".to_owned());
    }
    match document.get("DatasetType").and_then(Value::as_str) {
        None | Some("raw") => Ok(()),
        Some(other) => Err(format!("its DatasetType is `{other}`, expected `raw`")),
    }
}

/// What to append to a `participants.tsv` for a subject, in the table's own columns and line ends; `None` if the subject
/// has a row.
///
/// # Errors
/// `Unsupported` if the table has no column `participant_id`.
pub fn participant_row(table: &str, subject: &str) -> Result<Option<String>> {
    let id = format!("sub-{subject}");
    let mut lines = table.strip_prefix('\u{feff}').unwrap_or(table).lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split('\t').map(str::trim).collect();
    let Some(column) = names.iter().position(|&name| name == "participant_id") else {
        return unsupported("expected a table with a column participant_id, found none");
    };
    if lines.any(|line| line.split('\t').nth(column).is_some_and(|cell| cell.trim() == id)) {
        return Ok(None);
    }
    let end = if table.contains("\r\n") { "\r\n" } else { "\n" };
    let cells: Vec<&str> =
        (0..names.len()).map(|i| if i == column { id.as_str() } else { MISSING }).collect();
    let before = if table.ends_with('\n') { "" } else { end };
    Ok(Some(format!("{before}{}{end}", cells.join("\t"))))
}

/// Writes a recording, and the files of a new dataset around it. Positions are in millimetres, a missing sample is three
/// `n/a`, and the onsets of events are in seconds from the first frame.
///
/// # Errors
/// `Unsupported` for a take without markers; `Io` if reading or writing fails.
pub fn write(
    frames: &mut dyn FrameSource,
    names: &BidsLabels,
    folder: &mut dyn DatasetFolder,
) -> Result<()> {
    let info = frames.info().clone();
    if info.markers.is_empty() && body_names(&info).is_empty() {
        return unsupported("BIDS needs at least one channel, but the take has no markers");
    }
    let participants = format!("participant_id\nsub-{}\n", names.subject());
    for (path, content) in [
        ("dataset_description.json", dataset_json()?),
        ("README.md", readme().into_bytes()),
        ("participants.tsv", participants.into_bytes()),
        ("participants.json", participants_json()?),
    ] {
        let mut file = folder.common_file(path)?;
        file.write_all(&content)?;
        file.flush()?;
    }
    let mut put = |path: &str, content: &[u8]| {
        let mut file = folder.file(path)?;
        file.write_all(content)?;
        file.flush()
    };
    put(&names.path("motion.json"), &motion_json(names, &info)?)?;
    put(&names.path("channels.tsv"), channels_tsv(&info).as_bytes())?;
    put(&names.path("channels.json"), &channels_json(&info)?)?;
    if !info.events.is_empty() {
        put(&names.path("events.tsv"), events_tsv(&info).as_bytes())?;
        put(&names.path("events.json"), &events_json()?)?;
    }
    write_sampled(&info, frames, names, folder)?;
    let mut out = folder.file(&names.path("motion.tsv"))?;
    let mut poses = FramePoses::open(&info);
    // BIDS wants no column names in this file: channels.tsv has them.
    let n_written = write_frames(frames, &mut *out, Vec::new(), |line, _, row| {
        for (column, &position) in row.iter().enumerate() {
            line.extend((column > 0).then_some(b'\t'));
            put_position(line, position, b'\t', MISSING)?;
        }
        if let Some(poses) = &mut poses {
            put_poses(line, poses.next_frame()?, row.is_empty())?;
        }
        line.push(b'\n');
        Ok(())
    })?;
    Ok(check_frame_count(info.n_frames, n_written)?)
}

/// Writes analog channels and the loads of force plates as continuous recordings: a gzipped table, which has no line of
/// names, and its document ("Physiological and other continuous recordings").
fn write_sampled(
    info: &MotionInfo,
    frames: &dyn FrameSource,
    names: &BidsLabels,
    folder: &mut dyn DatasetFolder,
) -> Result<()> {
    // Poses are columns of motion.tsv.
    let tables = SampledTable::all(info)?.into_iter();
    for mut table in tables.filter(|table| table.kind() != SampledKind::Poses) {
        table.rename(|name| {
            if RECORDING_MEMBERS.contains(&name.as_str()) {
                name.push_str(" channel");
            }
        });
        // Labels are letters and digits.
        let recording = table.kind().name().replace('_', "");
        if !recordings().any(|known| known == recording) {
            return unsupported(&format!(
                "BIDS: expected groups with numbers up to {}, but the take has {}",
                GROUPS_MAX - 1,
                table.kind().description()
            ));
        }
        let path = |ending: &str| names.path(&format!("recording-{recording}_physio.{ending}"));
        let mut file = folder.file(&path("json"))?;
        file.write_all(&sampled_json(names, &table)?)?;
        file.flush()?;
        drop(file);
        // Without a date, so that the bytes are always the same.
        let mut out = GzEncoder::new(folder.file(&path("tsv.gz"))?, Compression::default());
        let is_recorded = table.is_recorded();
        table.write_text(frames, &mut out, (MISSING, b'\t'), |line, time_s| {
            if is_recorded { write!(line, "{time_s}\t") } else { Ok(()) }
        })?;
        out.finish()?.flush()?;
    }
    Ok(())
}

/// The document of a continuous recording.
fn sampled_json(labels: &BidsLabels, table: &SampledTable<'_>) -> io::Result<Vec<u8>> {
    let names: Vec<&str> = table.columns().iter().map(|column| column.name.as_str()).collect();
    let time = TIME_COLUMN;
    let own_time = table.is_recorded().then_some(time);
    let names: Vec<&str> = own_time.into_iter().chain(names).collect();
    let values = [
        labels.task().into(),
        "generic".into(),
        number(table.measured_rate_hz()),
        // From the start of the motion.
        number(table.times_s().next().unwrap_or(0.0)),
        json!(names),
    ];
    let about_time =
        json!({ "Description": "Time from the first frame of the motion", "Units": "s" });
    let own_time = own_time.map(|name| (name, about_time));
    let common = RECORDING_MEMBERS.into_iter().zip(values).chain(own_time);
    let columns = table.columns().iter().map(|column| {
        let about = [("Description", &column.description), ("Units", &column.unit)];
        let about = about.into_iter().filter(|(_, text)| !text.is_empty());
        let about = about.map(|(key, text)| (key.to_owned(), json!(text))).collect();
        (column.name.as_str(), Value::Object(about))
    });
    json(common.chain(columns))
}

/// The columns of a body in motion.tsv: component, type and unit. Components of quaternions have no unit.
const BODY_CHANNELS: [(&str, &str, &str); 8] = [
    ("x", "POS", "mm"),
    ("y", "POS", "mm"),
    ("z", "POS", "mm"),
    ("quat_w", "ORNT", MISSING),
    ("quat_x", "ORNT", MISSING),
    ("quat_y", "ORNT", MISSING),
    ("quat_z", "ORNT", MISSING),
    ("residual", "MISC", "mm"),
];

/// Appends the cells of the bodies, each after a tab, unless they are the first ones of the line.
fn put_poses(line: &mut Vec<u8>, poses: &[Pose], are_first: bool) -> io::Result<()> {
    for (body, pose) in poses.iter().enumerate() {
        let numbers = pose.position_mm.iter().chain(&pose.quaternion).chain([&pose.residual_mm]);
        for (column, number) in numbers.enumerate() {
            line.extend((!are_first || body + column > 0).then_some(b'\t'));
            if number.is_finite() { write!(line, "{number}")? } else { write!(line, "{MISSING}")? }
        }
    }
    Ok(())
}

/// The table of the columns of motion.tsv: those of the markers, then those of rigid bodies.
fn channels_tsv(info: &MotionInfo) -> String {
    let mut table = "name\tcomponent\ttype\ttracked_point\tunits\treference_frame\n".to_owned();
    let labels = column_labels(info);
    let n_markers = labels.len();
    // A body may have the name of a marker.
    let points = unique_names(labels.into_iter().chain(body_names(info)));
    let of_point = |(index, point): (usize, &String)| {
        let channels = if index < n_markers { &BODY_CHANNELS[..3] } else { &BODY_CHANNELS[..] };
        channels.iter().map(|channel| (cell(point), channel)).collect::<Vec<_>>()
    };
    let channels: Vec<_> = points.iter().enumerate().flat_map(of_point).collect();
    // So has the channel of a body, perhaps.
    let names = channels.iter().map(|(point, (component, ..))| format!("{point}_{component}"));
    for (name, (point, (component, kind, unit))) in unique_names(names).iter().zip(&channels) {
        let is_in_space = *kind != "MISC";
        let component = if is_in_space { component } else { MISSING };
        let frame = if is_in_space { "global" } else { MISSING };
        table.push_str(&format!("{name}\t{component}\t{kind}\t{point}\t{unit}\t{frame}\n"));
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
fn json(members: impl IntoIterator<Item = (impl serde::Serialize, Value)>) -> io::Result<Vec<u8>> {
    let mut document = Vec::new();
    serde_json::Serializer::pretty(&mut document).collect_map(members)?;
    document.push(b'\n');
    Ok(document)
}

/// A number as JSON, without decimals if it is whole: 100, not 100.0.
fn number(value: f64) -> Value {
    if value.fract() == 0.0 { json!(value as i64) } else { json!(value) }
}

fn dataset_json() -> io::Result<Vec<u8>> {
    let version = env!("CARGO_PKG_VERSION");
    let generator = json!({ "Name": "mocapd", "Version": version, "Description": "mocapd export" });
    json([
        ("Name", "Optical motion capture".into()),
        ("BIDSVersion", BIDS_VERSION.into()),
        ("DatasetType", "raw".into()),
        ("GeneratedBy", json!([generator])),
    ])
}

/// Nothing of a single recording: others are added to the dataset.
fn readme() -> String {
    format!(
        "# Optical motion capture\n\n\
         Trajectories of markers, a recording in each `motion` folder.\n\
         Positions are in millimetres; `{MISSING}` marks samples in which a marker was not seen.\n\n\
         Exported by mocapd {} from takes.\n\
         Please add here who was recorded, how, and on what terms the data may be used, \
         and add the authors and the licence to `dataset_description.json`.\n",
        env!("CARGO_PKG_VERSION"),
    )
}

fn participants_json() -> io::Result<Vec<u8>> {
    json([("participant_id", json!({ "Description": "Unique label of the participant" }))])
}

fn motion_json(names: &BidsLabels, info: &MotionInfo) -> io::Result<Vec<u8>> {
    let n_markers = info.markers.len();
    let n_bodies = info.recording.as_ref().map_or(0, |recording| recording.bodies().len());
    // The specification recommends stating a count of 0 for channel types that are absent.
    let absent = [
        "ACCELChannelCount",
        "ANGACCELChannelCount",
        "GYROChannelCount",
        "JNTANGChannelCount",
        "LATENCYChannelCount",
        "MAGNChannelCount",
        "VELChannelCount",
    ];
    let fields = [
        ("TaskName", names.task().into()),
        ("SamplingFrequency", number(info.rate_hz)),
        ("TrackingSystemName", "optical".into()),
        ("RecordingType", "continuous".into()),
        ("RecordingDuration", number(info.n_frames as f64 / info.rate_hz)),
        ("MotionChannelCount", (3 * n_markers + BODY_CHANNELS.len() * n_bodies).into()),
        ("POSChannelCount", (3 * (n_markers + n_bodies)).into()),
        ("ORNTChannelCount", (4 * n_bodies).into()),
        ("MISCChannelCount", n_bodies.into()),
        ("TrackedPointsCount", (n_markers + n_bodies).into()),
        ("MissingValues", MISSING.into()),
    ];
    json(absent.map(|name| (name, 0.into())).into_iter().chain(fields))
}

fn channels_json(info: &MotionInfo) -> io::Result<Vec<u8>> {
    let up = match info.up.name() {
        Some(axis) => format!("{axis} points up"),
        None => "the up axis is unknown".to_owned(),
    };
    let axes = format!("The axes of the tracking system, right-handed; {up}");
    let frame = json!({
        "Description": "The coordinate system of the positions and orientations",
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
        let path =
            |session, run| BidsLabels::new("01", session, "walk2", run).unwrap().path("motion.tsv");
        assert_eq!(path(None, None), "sub-01/motion/sub-01_task-walk2_tracksys-optical_motion.tsv");
        assert_eq!(
            path(Some("pre"), Some("02")),
            "sub-01/ses-pre/motion/sub-01_ses-pre_task-walk2_tracksys-optical_run-02_motion.tsv"
        );
        for (subject, session, task, run) in [
            ("", None, "a", None),
            ("a", None, "", None),
            ("a b", None, "c", None),
            ("../a", None, "c", None),
            ("a", None, "gehen_\u{e4}", None),
            ("a", Some(""), "b", None),
            ("a", Some("1/2"), "b", None),
            ("a", None, "b", Some("")),
            ("a", None, "b", Some("one")),
        ] {
            let labels = BidsLabels::new(subject, session, task, run);
            assert!(labels.is_err(), "{subject} {session:?} {task} {run:?}");
        }
        assert_eq!(BidsLabels::task_of("squat_jump-47m 120hz"), "squatjump47m120hz");
        assert_eq!(BidsLabels::task_of("\u{e4}"), "recording");
    }

    #[test]
    fn a_new_subject_gets_a_row_in_the_tables_own_form() {
        for (table, row) in [
            ("participant_id\nsub-01\n", Some("sub-02\n")),
            ("participant_id\nsub-02\n", None),
            ("participant_id\tage\nsub-02\t33", None),
            ("participant_id\tage\r\nsub-01\t33\r\n", Some("sub-02\tn/a\r\n")),
            ("\u{feff}age\tparticipant_id\n7\tsub-021", Some("\nn/a\tsub-02\n")),
            ("participant_id\n", Some("sub-02\n")),
        ] {
            assert_eq!(participant_row(table, "02").unwrap().as_deref(), row, "{table:?}");
        }
        for table in ["", "id\nsub-01\n"] {
            assert!(participant_row(table, "02").is_err(), "{table:?}");
        }
    }

    #[test]
    fn a_description_is_that_of_recordings() {
        let is_ok = |text: &str| check_description(text.as_bytes()).is_ok();
        assert!(is_ok(r#"{"Name": "a", "BIDSVersion": "1.8.0"}"#));
        assert!(is_ok(r#"{"BIDSVersion": "1.8.0", "DatasetType": "raw"}"#));
        for text in ["", "[]", "{}", r#"{"BIDSVersion": 1}"#] {
            assert!(!is_ok(text), "{text}");
        }
        assert!(!is_ok(r#"{"BIDSVersion": "1.8.0", "DatasetType": "derivative"}"#));
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
