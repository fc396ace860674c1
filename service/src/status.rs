//! The status of the service as the API, the dashboard and `ctl` report it. Field names include the units.

use std::fmt;

use mocapd_acquire::{
    files::FileState,
    ledger::{LedgerDocument, SampleLedgerDocument, TakeHealth},
};
use mocapd_take::record::EndingKind;
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;

use crate::finished::TakeNotes;

/// What the service is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// The device is not running, or is missing.
    #[default]
    Idle,
    /// The device is running, and its frames are kept for the pre-roll.
    Armed,
    /// A take is being written.
    Recording,
    /// A take could not be completed, or the recording pipeline failed: see `failure`.
    Failed,
}

/// Whether the device is connected and sending.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Presence {
    /// It is missing, or has disconnected.
    #[default]
    Absent,
    /// It is connected.
    Present,
    /// It is sending frames.
    Streaming,
    /// It should be sending frames, but sends none.
    Silent,
    /// A value from a later version.
    #[serde(other)]
    Other,
}

impl fmt::Display for Presence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// The whole status at one moment.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Status {
    /// Name of the rig, from its configuration.
    pub rig: String,
    /// What the service is doing.
    pub state: State,
    /// Why it failed, and what to do.
    pub failure: Option<String>,
    /// Name and version of the program.
    pub software: String,
    /// Time since the service was started, in seconds.
    pub uptime_s: f64,
    /// The device.
    pub device: DeviceStatus,
    /// What has arrived since the device was armed.
    pub input: InputStatus,
    /// The pre-roll.
    pub pre_roll: PreRollStatus,
    /// The take being recorded.
    pub take: Option<TakeStatus>,
    /// A start that was requested for a time of day, and waits for it.
    #[serde(default)]
    pub pending_start: Option<PendingStart>,
    /// Why the last start that was requested for a time of day did not take place; null once another start takes place,
    /// waits, or is cancelled.
    #[serde(default)]
    pub missed_start: Option<String>,
    /// The subject, session and trial of the last start that had any.
    #[serde(default)]
    pub names: Option<TrialNames>,
    /// The previous take; null while it is being closed.
    pub last_take: Option<TakeSummary>,
    /// The disk that holds the takes' folder.
    pub disk: DiskStatus,
    /// The upload of finished takes; null without `archive.url`.
    #[serde(default)]
    pub archive: Option<ArchiveStatus>,
    /// What is published live, by protocol; empty if nothing is.
    #[serde(default, deserialize_with = "none_or_all")]
    pub publish: Vec<PublishStatus>,
}

/// Reads a list that earlier versions left out, or wrote as null.
fn none_or_all<'de, D: Deserializer<'de>>(input: D) -> Result<Vec<PublishStatus>, D::Error> {
    Ok(Option::deserialize(input)?.unwrap_or_default())
}

/// A server that publishes live what is received.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct PublishStatus {
    /// Its protocol: `qtm`, `natnet`, `lsl` or `foxglove`.
    pub protocol: String,
    /// The address at which it listens.
    pub listen: String,
    /// Limit on simultaneous clients.
    pub clients_max: usize,
    /// Connections that were refused: too many, from an address or a web page that is not allowed, or without the protocol.
    pub clients_refused: u64,
    /// Frames that clients were sent since the service was started, also those that have left.
    #[serde(default)]
    pub frames_sent: u64,
    /// Frames that clients missed since then, also those that have left.
    pub frames_missed: u64,
    /// Batches of sampled channels that clients missed since then, also those that have left, where they are not parts of
    /// frames.
    #[serde(default)]
    pub batches_missed: u64,
    /// Frames of those that all clients missed because the server was too slow.
    #[serde(default)]
    pub frames_left_out: u64,
    /// Frames whose poses of rigid bodies all clients missed because the server was too slow, or because they came without
    /// their frame or long after it.
    #[serde(default)]
    pub poses_left_out: u64,
    /// Batches of sampled channels that all clients missed because the server was too slow.
    #[serde(default)]
    pub batches_left_out: u64,
    /// The clients.
    pub clients: Vec<PublishedClient>,
}

/// A client of such a server.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct PublishedClient {
    /// Its address.
    pub address: String,
    /// The version of the protocol that it chose; empty until it has.
    pub version: String,
    /// How it gets frames: `tcp`, `udp` or `multicast`.
    pub transport: String,
    /// Which of several streams it reads; empty where there is one.
    #[serde(default)]
    pub stream: String,
    /// Whether it requests frames.
    pub is_streaming: bool,
    /// Whether it may start and stop takes.
    pub is_in_control: bool,
    /// Frames that it was sent; of LSL's other streams batches of samples, or events.
    pub frames_sent: u64,
    /// Frames that it requested and missed, because it read too slowly or the network took no more.
    pub frames_missed: u64,
    /// Batches of sampled channels that it missed for the same reason, where they are not parts of frames.
    #[serde(default)]
    pub batches_missed: u64,
}

/// A start that waits for its time. A restart of the service forgets it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct PendingStart {
    /// When the take will be started, in milliseconds since 1970.
    pub at_unix_ms: i64,
    /// The same in the time zone of the service's machine, such as `2026-11-23T14:05:09+01:00`.
    pub at: String,
    /// Name that was requested for the take, without `.take`; null if it gets its name when it starts.
    pub name: Option<String>,
    /// Remarks, such as that the rig is not armed yet.
    #[serde(default)]
    pub remarks: Vec<String>,
}

/// From what takes are named: `SUBJECT_SESSION_TRIAL_COUNT`, without the parts that are empty.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct TrialNames {
    /// The subject; may be empty.
    pub subject: String,
    /// The session; may be empty.
    pub session: String,
    /// The trial, such as the movement; may be empty.
    pub trial: String,
}

/// The upload of finished takes to object storage.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct ArchiveStatus {
    /// Where takes are uploaded to.
    pub url: String,
    /// Takes that wait to be uploaded, or are being uploaded.
    pub waiting: u64,
    /// Takes in the folder that were uploaded.
    pub uploaded: u64,
    /// Takes that cannot be uploaded; the list of takes has the reasons.
    pub failed: u64,
    /// Bytes sent since the service was started.
    pub sent_bytes: u64,
    /// Failed attempts since the service was started.
    pub retries: u64,
    /// Why nothing can be uploaded at present; null if the last attempt succeeded.
    pub error: Option<String>,
}

/// How far the upload of a take is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum UploadState {
    /// It has not begun, or is repeated later.
    Waiting,
    /// It is in progress.
    Uploading,
    /// The take is in the archive.
    Uploaded,
    /// It cannot be uploaded, for a reason that concerns it alone; the service tries again.
    Failed,
    /// A state of a later version.
    #[default]
    #[serde(other)]
    Unknown,
}

/// The upload of a take.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct TakeUpload {
    /// `waiting`, `uploading`, `uploaded` or `failed`.
    pub state: UploadState,
    /// Where it is uploaded to.
    pub url: String,
    /// Why the last attempt failed; empty if it did not.
    pub message: String,
}

/// The device.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct DeviceStatus {
    /// Where it is expected.
    pub uri: String,
    /// `absent`, `present` (connected), `streaming` or `silent` (should be sending frames, but sends none).
    #[schema(value_type = String)]
    pub presence: Presence,
    /// Its model. This and the following are empty until the device has reported them.
    pub model: String,
    /// Its serial number.
    pub serial: String,
    /// Its firmware.
    pub firmware: String,
    /// Driver family.
    pub driver: String,
    /// Frame rate in Hz.
    pub rate_hz: f64,
    /// Number of markers: those it announced, and those that appeared since.
    pub markers: usize,
    /// Why the device cannot be used, and what to do.
    pub obstacle: Option<String>,
    /// How often it has disconnected and come back since it was armed.
    pub outages: u32,
    /// Whether the service waits for an absent device: once it is back, the service arms or the take continues.
    #[serde(default)]
    pub is_awaited: bool,
    /// The current time without frames, if the device is armed or recorded and is `absent` or `silent`.
    #[serde(default)]
    pub outage: Option<OutageStatus>,
}

/// A device that should send frames and sends none: nothing is being recorded.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct OutageStatus {
    /// Seconds since the last frame, or since the device was armed if none has arrived.
    pub seconds: f64,
    /// Frames due in that time at the device's rate. A take in progress misses them; its ledger counts them once the
    /// device is back or the take ends.
    pub frames: u64,
    /// Seconds until the service stops waiting for the device and ends the take; `None` if it is `silent`, because then the
    /// service waits without a limit.
    pub ends_in_s: Option<f64>,
}

/// What has arrived from the device since it was armed.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct InputStatus {
    /// Frames received.
    pub frames: u64,
    /// Frames lost, for any reason.
    pub lost: u64,
    /// Frame rate over the last seconds, by arrival, in Hz.
    pub measured_hz: f64,
    /// Fill level of the fullest ring, 0 to 1.
    pub ring_fill: f64,
    /// 99th percentile of the time from a frame's last byte to its place in every ring, in microseconds.
    pub ring_latency_p99_us: u64,
    /// 99th percentile of the delay of frames against the clock line, in microseconds; 0 while unknown.
    pub jitter_p99_us: u64,
    /// How much faster the host's clock runs than the device's, in parts per million.
    pub drift_ppm: f64,
    /// Processor time of all the service's threads over the last seconds, in cores.
    pub cpu_cores: f64,
}

/// The pre-roll.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct PreRollStatus {
    /// Configured length in seconds.
    pub wanted_s: f64,
    /// Length held, in seconds.
    pub held_s: f64,
    /// Memory used, in bytes.
    pub held_bytes: u64,
    /// Whether the memory limit keeps it shorter than configured.
    pub is_cut: bool,
}

/// The take being recorded.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct TakeStatus {
    /// Id of the take, 32 hexadecimal digits.
    pub take_id: String,
    /// Name without `.take`.
    pub name: String,
    /// Path of the file.
    pub path: String,
    /// When its start was requested, in milliseconds since 1970.
    pub started_unix_ms: i64,
    /// Rows so far, including lost frames.
    pub rows: u64,
    /// Length in seconds.
    pub seconds: f64,
    /// Length in seconds from its start on at which it ends by itself; null if it was started without one.
    #[serde(default)]
    pub wanted_s: Option<f64>,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// Bytes of it that would survive a power cut.
    pub durable_bytes: u64,
    /// Compression ratio: 12 bytes per present sample, divided by the size of the file; 0 before there are samples.
    pub ratio: f64,
    /// Largest error of any sample so far, in millimetres.
    pub max_error_mm: f64,
    /// Its ledger so far.
    pub ledger: LedgerDocument,
    /// Its ledger of sampled channels so far, by group; null without sampled channels.
    #[serde(default)]
    pub sample_ledger: Option<SampleLedgerDocument>,
    /// What other programs did to its file.
    #[serde(default)]
    pub file: FileState,
    /// What happened to the file and what to do, as a message; `None` while the file is in its place.
    #[serde(default)]
    pub file_notice: Option<String>,
}

/// A take in the folder.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct TakeSummary {
    /// Name without `.take`.
    pub name: String,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// Last modification of the file, in milliseconds since 1970.
    pub modified_unix_ms: i64,
    /// Whether it is being written.
    pub is_open: bool,
    /// Its condition, from its header, last ledger and ending.
    pub health: TakeHealth,
    /// Length in seconds; 0 while unknown.
    pub seconds: f64,
    /// Number of markers; 0 while unknown.
    pub markers: usize,
    /// Id, 32 hexadecimal digits; empty while unknown.
    pub take_id: String,
    /// Why it ended, as in the reply to `stop`; empty if the take does not say.
    #[serde(default, with = "ending_word")]
    #[schema(value_type = String)]
    pub ending: Option<EndingKind>,
    /// Details of the ending; mostly empty.
    #[serde(default)]
    pub ending_detail: String,
    /// Its upload; null without `archive.url`, and for a take that is not finished.
    #[serde(default)]
    pub upload: Option<TakeUpload>,
    /// Its rating and notes; null if it has none.
    #[serde(default)]
    pub notes: Option<TakeNotes>,
}

/// The disk that holds the takes' folder.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct DiskStatus {
    /// Path of the folder.
    pub directory: String,
    /// Free space in bytes; `None` while unknown.
    pub free_bytes: Option<u64>,
    /// Space to keep free in bytes: a take that reaches it is closed, and none is started.
    pub keep_free_bytes: u64,
    /// How long a take can continue at the rate of the last half minute, in seconds; 0 if none can start; `None` while
    /// unknown.
    pub left_s: Option<u64>,
}

/// How well a marker has been seen since the device was armed.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct MarkerQuality {
    /// Label, or `u001` by slot.
    pub label: String,
    /// Whether the device identifies the marker.
    pub labelled: bool,
    /// Share of frames with a position, since the marker has a channel.
    pub visible: f64,
    /// Number of gaps.
    pub gaps: u64,
    /// Longest gap in seconds.
    pub longest_gap_s: f64,
    /// Standard deviation of the noise on one axis in millimetres, from fourth differences over the last seconds, as in
    /// `mocapd plot quality`. `None` if it cannot be distinguished from motion or rounding, or while too little is
    /// known.
    #[serde(default)]
    pub noise_mm: Option<f64>,
    /// The same as `noise_mm`, under its former name.
    pub still_sigma_mm: Option<f64>,
    /// How often it jumped to the position of another marker.
    pub swaps_suspected: u64,
}

/// Kind of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ServiceEventKind {
    /// The state of the service changed.
    State,
    /// A message from the device, or about it.
    Device,
    /// A take has started.
    TakeStarted,
    /// A take has ended.
    TakeStopped,
    /// The pre-roll was saved as a take.
    TakeSaved,
    /// A finished take was rated, renamed, moved to the trash or back, or removed from it.
    TakeChanged,
    /// A mark was put into the take.
    Mark,
    /// Something may need attention.
    Warning,
    /// A take could not be completed, or the recording pipeline failed.
    Failure,
    /// A capture trigger was received.
    Trigger,
    /// A kind from a later version.
    #[serde(other)]
    Other,
}

impl fmt::Display for ServiceEventKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// An event of the service.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ServiceEvent {
    /// Number, counted from 1 since the service was started.
    pub number: u64,
    /// Time in milliseconds since 1970.
    pub unix_ms: i64,
    /// `state`, `device`, `take-started`, `take-stopped`, `take-saved`, `take-changed`, `mark`, `warning`, `failure`, `trigger`.
    #[schema(value_type = String)]
    pub kind: ServiceEventKind,
    /// The message, one line.
    pub message: String,
    /// The state after the event.
    pub state: State,
    /// Name of the take concerned.
    pub take: Option<String>,
    /// Notes of a take that has started.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub notes: Option<String>,
}

/// Serialises an ending as its word, or as an empty text if it is unknown.
pub(crate) mod ending_word {
    use mocapd_take::record::EndingKind;
    use serde::{Deserialize, Deserializer, Serializer};

    pub(crate) fn serialize<S: Serializer>(
        ending: &Option<EndingKind>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(ending.map_or("", EndingKind::name))
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<EndingKind>, D::Error> {
        let word = String::deserialize(deserializer)?;
        Ok((!word.is_empty()).then(|| EndingKind::from_name(&word)))
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
