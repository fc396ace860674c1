//! How things stand, as the API, the dashboard and `ctl` tell it. Units stand in the names.

use std::fmt;

use mocapd_acquire::{files::FileState, health::TakeHealth, ledger::LedgerDocument};
use mocapd_take::record::EndingKind;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What the service is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// The device does not run, or is not there.
    #[default]
    Idle,
    /// The device runs, and what it sends is kept for the pre-roll.
    Armed,
    /// A take is being written.
    Recording,
    /// A take could not be written to its end, or the data plane failed: `failure` says why.
    Failed,
}

/// Whether the device is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Presence {
    /// It is not there, or away.
    #[default]
    Absent,
    /// It is attached.
    Present,
    /// It sends frames.
    Streaming,
    /// It should stream and sends nothing.
    Silent,
    /// What a later version tells.
    #[serde(other)]
    Other,
}

impl fmt::Display for Presence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Everything at one time.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Status {
    /// Name of the rig, from its configuration.
    pub rig: String,
    /// What the service is doing.
    pub state: State,
    /// Why it failed, and what to do.
    pub failure: Option<String>,
    /// Program and version.
    pub software: String,
    /// Seconds since the service was started.
    pub uptime_s: f64,
    /// The device.
    pub device: DeviceStatus,
    /// What came from it since it was armed.
    pub input: InputStatus,
    /// What is kept while armed.
    pub pre_roll: PreRollStatus,
    /// The take being written.
    pub take: Option<TakeStatus>,
    /// The one before: null while it is being closed.
    pub last_take: Option<TakeSummary>,
    /// The disk of the takes' folder.
    pub disk: DiskStatus,
}

/// The device.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct DeviceStatus {
    /// Where it is looked for.
    pub uri: String,
    /// `absent`, `present` (attached), `streaming`, `silent` (it should stream and sends nothing).
    #[schema(value_type = String)]
    pub presence: Presence,
    /// Its model; empty before it said so, and so are the following.
    pub model: String,
    /// Its serial number.
    pub serial: String,
    /// Its firmware.
    pub firmware: String,
    /// Driver family.
    pub driver: String,
    /// Frames a second.
    pub rate_hz: f64,
    /// Markers that it announced, and those that appeared since.
    pub markers: usize,
    /// What keeps it away, in words.
    pub obstacle: Option<String>,
    /// Times that it went away and came back since it was armed.
    pub outages: u32,
    /// Whether it is absent and waited for: it is armed, or its take goes on, as soon as it is there.
    #[serde(default)]
    pub is_awaited: bool,
    /// The time without frames, while it is armed or recorded and is `absent` or `silent`.
    #[serde(default)]
    pub outage: Option<OutageStatus>,
}

/// A device that should send frames and sends none: nothing that happens now is recorded.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct OutageStatus {
    /// Seconds since its last frame, or since it was armed where none came.
    pub seconds: f64,
    /// Frames that were due in that time, by the device's rate. A take that is being written misses them; its ledger
    /// counts them when the device is back, or when the take ends.
    pub frames: u64,
    /// Seconds until the device is given up and the take ends; `None` while it is `silent`, which is waited for without
    /// a limit.
    pub ends_in_s: Option<f64>,
}

/// What came from the device since it was armed.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct InputStatus {
    /// Frames taken in.
    pub frames: u64,
    /// Frames lost, for whatever reason.
    pub lost: u64,
    /// Frames a second over the last seconds, as they arrived.
    pub measured_hz: f64,
    /// How full the fullest ring is, 0 to 1.
    pub ring_fill: f64,
    /// From a frame's last byte to its place in every ring: what 99 of 100 frames took at most, in microseconds.
    pub ring_latency_p99_us: u64,
    /// What 99 of 100 frames were no later than after the clock's line, in microseconds; 0 while unknown.
    pub jitter_p99_us: u64,
    /// How much faster the host's clock runs than the device's, in parts per million.
    pub drift_ppm: f64,
    /// Processor time of all of the service's threads over the last seconds, in cores.
    pub cpu_cores: f64,
}

/// What is kept while armed.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct PreRollStatus {
    /// Seconds that are to be held.
    pub wanted_s: f64,
    /// Seconds that are.
    pub held_s: f64,
    /// Bytes that they take.
    pub held_bytes: u64,
    /// Whether less is held than wanted because of the bound on memory.
    pub is_cut: bool,
}

/// The take being written.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct TakeStatus {
    /// 32 hexadecimal digits.
    pub take_id: String,
    /// Without `.take`.
    pub name: String,
    /// Its file.
    pub path: String,
    /// When it was asked for, in milliseconds since 1970.
    pub started_unix_ms: i64,
    /// Rows so far, lost ones included.
    pub rows: u64,
    /// Seconds that they make.
    pub seconds: f64,
    /// Bytes of the file.
    pub bytes: u64,
    /// Of these, bytes that would survive a power cut.
    pub durable_bytes: u64,
    /// 12 bytes a present sample, over the bytes of the file; 0 before there are any.
    pub ratio: f64,
    /// Largest error of a sample so far, in millimetres.
    pub max_error_mm: f64,
    /// What became of its frames so far.
    pub ledger: LedgerDocument,
    /// What others did to its file.
    #[serde(default)]
    pub file: FileState,
    /// The same in words, and what to do; `None` while it is in its place.
    #[serde(default)]
    pub file_notice: Option<String>,
}

/// A take that is there.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct TakeSummary {
    /// Without `.take`.
    pub name: String,
    /// Bytes of the file.
    pub bytes: u64,
    /// When the file was last written, in milliseconds since 1970.
    pub modified_unix_ms: i64,
    /// Whether it is being written.
    pub is_open: bool,
    /// What its two ends tell of its content: its header, its last ledger, and how it ended.
    pub health: TakeHealth,
    /// Seconds; 0 while unknown.
    pub seconds: f64,
    /// Markers; 0 while unknown.
    pub markers: usize,
    /// 32 hexadecimal digits; empty while unknown.
    pub take_id: String,
    /// Why it ended, as `stop` tells it; empty where the take does not say.
    #[serde(default, with = "ending_word")]
    #[schema(value_type = String)]
    pub ending: Option<EndingKind>,
    /// More about that; mostly empty.
    #[serde(default)]
    pub ending_detail: String,
}

/// The disk of the takes' folder.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct DiskStatus {
    /// The folder.
    pub directory: String,
    /// Bytes that are free; `None` where nobody can tell.
    pub free_bytes: Option<u64>,
    /// Bytes that stay free: a take that comes there is closed, and none is begun.
    pub keep_free_bytes: u64,
    /// How long a take can go on at the rate of the last half a minute, in seconds; 0 where none can begin; `None` while
    /// unknown.
    pub left_s: Option<u64>,
}

/// How well a marker is seen since the device was armed.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct MarkerQuality {
    /// Its label, or `u001` by slot.
    pub label: String,
    /// Whether the device knows it.
    pub labelled: bool,
    /// Frames with a position, of all frames since the marker has a channel.
    pub visible: f64,
    /// Times that it vanished.
    pub gaps: u64,
    /// The longest, in seconds.
    pub longest_gap_s: f64,
    /// Standard deviation of its noise on one axis, in millimetres: of fourth differences over the last seconds, as
    /// `mocapd plot quality` has it. `None` where it cannot be told from motion or rounding, or while too little is known.
    #[serde(default)]
    pub noise_mm: Option<f64>,
    /// The same as `noise_mm`, under its former name.
    pub still_sigma_mm: Option<f64>,
    /// Times that it jumped to where another marker was.
    pub swaps_suspected: u64,
}

/// What kind of thing happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ServiceEventKind {
    /// The service does something else now.
    State,
    /// The device said something, or something happened to it.
    Device,
    /// A take has begun.
    TakeStarted,
    /// It has ended.
    TakeStopped,
    /// What the pre-roll held was saved.
    TakeSaved,
    /// A mark was put into the take.
    Mark,
    /// Something that somebody may have to look at.
    Warning,
    /// A take could not be written to its end, or the data plane failed.
    Failure,
    /// A trigger came.
    Trigger,
    /// What a later version tells.
    #[serde(other)]
    Other,
}

impl fmt::Display for ServiceEventKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Something happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ServiceEvent {
    /// Counted from 1 since the service was started.
    pub number: u64,
    /// Milliseconds since 1970.
    pub unix_ms: i64,
    /// `state`, `device`, `take-started`, `take-stopped`, `take-saved`, `mark`, `warning`, `failure`, `trigger`.
    #[schema(value_type = String)]
    pub kind: ServiceEventKind,
    /// One line for people.
    pub message: String,
    /// The state after it.
    pub state: State,
    /// Name of the take that it is about.
    pub take: Option<String>,
    /// The notes of a take that has started.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub notes: Option<String>,
}

/// An ending by its word; empty where it is not known.
pub(crate) mod ending_word {
    use mocapd_take::record::EndingKind;
    use serde::{Deserialize, Deserializer, Serializer};

    pub(crate) fn serialize<S: Serializer>(
        ending: &Option<EndingKind>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(ending.map_or("", EndingKind::word))
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<EndingKind>, D::Error> {
        let word = String::deserialize(deserializer)?;
        Ok((!word.is_empty()).then(|| EndingKind::from_word(&word)))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{from_value, json, to_value};

    use super::*;

    #[test]
    fn a_status_of_a_later_version_is_read() {
        let mut status = to_value(Status::default()).unwrap();
        status["device"]["presence"] = json!("calibrating");
        let read: Status = from_value(status).unwrap();
        assert_eq!(read.device.presence, Presence::Other);
        for known in [Presence::Absent, Presence::Present, Presence::Streaming, Presence::Silent] {
            assert_eq!(from_value::<Presence>(json!(known.to_string())).unwrap(), known);
        }
    }
}
