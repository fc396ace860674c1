//! The files that say what the tables are.

use super::{MISSING, Names, json::Object};
use crate::motion::{MotionInfo, UpAxis};

/// The version of the specification that the dataset follows.
const BIDS_VERSION: &str = "1.10.0";

pub(super) fn dataset(names: &Names) -> String {
    let generator = Object::default()
        .text("Name", "mocapd")
        .text("Version", env!("CARGO_PKG_VERSION"))
        .text("Description", "mocapd export");
    Object::default()
        .text("Name", &format!("Optical motion capture: {}", names.task()))
        .text("BIDSVersion", BIDS_VERSION)
        .text("DatasetType", "raw")
        .list_of("GeneratedBy", &generator)
        .document()
}

pub(super) fn readme(names: &Names, info: &MotionInfo) -> String {
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

pub(super) fn participants() -> String {
    let id = Object::default().text("Description", "Unique label of the participant");
    Object::default().object("participant_id", &id).document()
}

pub(super) fn motion(names: &Names, info: &MotionInfo) -> String {
    let n_markers = info.markers.len() as u64;
    // Channels that there are none of: the specification recommends to say so.
    let others = ["ACCEL", "ANGACCEL", "GYRO", "JNTANG", "LATENCY", "MAGN", "MISC", "ORNT", "VEL"];
    let none = others
        .iter()
        .fold(Object::default(), |about, kind| about.count(&format!("{kind}ChannelCount"), 0));
    none.text("TaskName", names.task())
        .number("SamplingFrequency", info.rate_hz)
        .text("TrackingSystemName", "optical")
        .text("RecordingType", "continuous")
        .number("RecordingDuration", info.n_frames as f64 / info.rate_hz)
        .count("MotionChannelCount", 3 * n_markers)
        .count("POSChannelCount", 3 * n_markers)
        .count("TrackedPointsCount", n_markers)
        .text("MissingValues", MISSING)
        .document()
}

pub(super) fn channels(info: &MotionInfo) -> String {
    let up = match info.up {
        UpAxis::Unknown => "which axis points up is not known",
        UpAxis::X => "x points up",
        UpAxis::Y => "y points up",
        UpAxis::Z => "z points up",
    };
    let about = format!("The axes of the tracking system, right-handed; {up}");
    let global = Object::default().text("RotationRule", "right-hand").text("Description", &about);
    let levels = Object::default().object("global", &global);
    let frame = Object::default()
        .text("Description", "What the coordinates are relative to")
        .object("Levels", &levels);
    Object::default().object("reference_frame", &frame).document()
}

pub(super) fn events() -> String {
    let text = |what: &str| Object::default().text("Description", what);
    let levels = Object::default()
        .text("mark", "Marked by an operator, or by the file that was imported")
        .text("trigger", "A trigger input of the device")
        .text("sync pulse", "A sync pulse of the device")
        .text("device", "Said by the device")
        .text("host", "Noticed by the recorder");
    Object::default()
        .object("trial_type", &text("What happened, in words"))
        .object("kind", &text("Who noticed it").object("Levels", &levels))
        .document()
}
