//! The interface of the service for people and programs, independent of how they reach it.

use std::{path::PathBuf, sync::Arc, time::Duration};

use mocapd_acquire::{
    files::{FileId, FileState, path_as_text},
    ledger::LedgerDocument,
};
use mocapd_take::record::EndingKind;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    finished::{EditNotes, MovedTake, Rename, Restore, TakeNotes, Trash, TrashedTake},
    live::LiveFeed,
    status::{
        MarkerQuality, PendingStart, ServiceEvent, ServiceEventKind, Status, TakeStatus,
        TakeSummary, ending_word,
    },
};

/// Longest text of a mark or of notes, in bytes: a line of the take's events.
pub const TEXT_BYTES_MAX: usize = 1024;

/// Longest pre-roll of a request, in seconds: more than `arm.pre_roll` can hold; larger numbers are typing errors.
pub const SECONDS_MAX: f64 = 3600.0;

/// Longest subject, session or trial in the name of a take, in bytes: three of them and a count stay below the longest
/// name.
pub const NAME_PART_BYTES_MAX: usize = 60;

/// Longest take of a start with a length, in seconds: a day, as for one with a time.
pub const LENGTH_SECONDS_MAX: f64 = 86_400.0;

/// The service as the HTTP API, the triggers and the signal handlers see it.
///
/// Calls that change something wait for their effect, at most some seconds, and must be made from threads that may
/// wait. A request with the id of an earlier one is not executed again: it gets the reply to the first.
pub trait Control: Send + Sync + std::fmt::Debug + 'static {
    /// The current status. Never waits.
    fn status(&self) -> Status;

    /// The tracking quality of each marker. Never waits.
    fn quality(&self) -> Vec<MarkerQuality>;

    /// Starts the device and keeps its frames for the pre-roll. Does nothing if armed already.
    ///
    /// # Errors
    /// The device is absent or refuses, or the service is stopping.
    fn arm(&self, request: &Request) -> Result<Status, Refusal>;

    /// Stops the device and discards the pre-roll.
    ///
    /// # Errors
    /// A take is being recorded.
    fn disarm(&self, request: &Request) -> Result<Status, Refusal>;

    /// Starts a take, and returns when its first frame would survive a power cut. An idle service is armed first.
    ///
    /// # Errors
    /// A take is being recorded; the name exists or is invalid; no frame arrives in time; the disk is full; `at` is set.
    fn start(&self, start: &Start) -> Result<Started, Refusal>;

    /// Has a take started at a time of day, `start.at`, if the rig is armed then. Replaces no start that already waits.
    ///
    /// # Errors
    /// The time is not one, is ambiguous, or more than a day away; another start waits; the request is invalid.
    fn schedule(&self, start: &Start) -> Result<PendingStart, Refusal>;

    /// Cancels the start that waits for its time.
    ///
    /// # Errors
    /// None waits.
    fn cancel(&self, request: &Request) -> Result<PendingStart, Refusal>;

    /// Stops the take, and returns when its ledger would survive a power cut.
    ///
    /// # Errors
    /// No take is being recorded, or the take could not be closed.
    fn stop(&self, request: &Request) -> Result<Stopped, Refusal>;

    /// Puts a mark into the take at the next frame.
    ///
    /// # Errors
    /// No take is being recorded, or the text is too long.
    fn mark(&self, mark: &Mark) -> Result<Marked, Refusal>;

    /// Writes the pre-roll, or its last seconds, as a take, and continues.
    ///
    /// # Errors
    /// Not armed; nothing is held; the name exists or is invalid; the disk is full.
    fn save_last(&self, save: &SaveLast) -> Result<Stopped, Refusal>;

    /// The takes in the service's folder, newest first, at most `limit`.
    ///
    /// # Errors
    /// The folder cannot be read.
    fn takes(&self, limit: usize) -> Result<Vec<TakeSummary>, Refusal>;

    /// The path of a take by its name. A name that could lead out of the folder is invalid.
    ///
    /// # Errors
    /// No take of that name exists.
    fn take_path(&self, name: &str) -> Result<PathBuf, Refusal>;

    /// Changes the rating or the notes of a finished take.
    ///
    /// # Errors
    /// There is no such take, it is in use, or a file of notes that cannot be read lies beside it.
    fn edit_notes(&self, name: &str, edit: &EditNotes) -> Result<TakeNotes, Refusal>;

    /// Renames a finished take and its notes.
    ///
    /// # Errors
    /// There is no such take, it is in use, or the new name is invalid or taken.
    fn rename(&self, name: &str, rename: &Rename) -> Result<MovedTake, Refusal>;

    /// Moves a finished take and its notes to the trash.
    ///
    /// # Errors
    /// There is no such take, or it is in use.
    fn trash(&self, name: &str, trash: &Trash) -> Result<TrashedTake, Refusal>;

    /// The takes in the trash, newest first, at most `limit`.
    fn trashed(&self, limit: usize) -> Vec<TrashedTake>;

    /// Moves a take back from the trash: the one with this id, or else the newest of this name.
    ///
    /// # Errors
    /// There is no such take in the trash, or its name is taken.
    fn restore(&self, id: &str, restore: &Restore) -> Result<MovedTake, Refusal>;

    /// The status of the take being recorded, if it is this file, regardless of the file's current name. Never waits.
    fn live_take(&self, file: FileId) -> Option<TakeStatus>;

    /// Publishes an event of this kind to all subscribers.
    fn notify(&self, _kind: ServiceEventKind, _message: &str) {}

    /// A feed of the events from now on.
    fn events(&self) -> EventFeed;

    /// A feed of live frames from now on, about 30 per second.
    fn live(&self) -> LiveFeed;
}

/// Fields that every request may have.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Chosen by the client, at most 64 characters: the same request again gets the same reply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
}

/// A request to start a take.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// Chosen by the client, at most 64 characters: the same request again gets the same reply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
    /// Name of the take, without `.take`; by default the configuration names it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Stored in the take as its first event, at most 1024 bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub notes: Option<String>,
    /// Seconds of pre-roll to include, at most 3600, or as many as are held; by default as configured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pre_roll_s: Option<f64>,
    /// Seconds after which the take ends by itself, at exactly so many frames from its start on, at most 86 400; the
    /// pre-roll comes in addition.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// A time of day, `HH:MM` or `HH:MM:SS` in the time zone of the service's machine: the take is started when it comes
    /// next, and the rig has to be armed then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at: Option<String>,
    /// Subject, at most 60 bytes: takes without a name are named after subject, session and trial if any of these is
    /// given, with a count that continues. Stored in the take. By default the configured one, if session or trial is
    /// given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subject: Option<String>,
    /// Session, at most 60 bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// Trial, at most 60 bytes, such as the movement.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trial: Option<String>,
}

/// A request to put a mark into the take.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Mark {
    /// Chosen by the client, at most 64 characters: the same request again gets the same reply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
    /// Text of the mark, at most 1024 bytes; may be empty.
    #[serde(default)]
    pub text: String,
}

/// A request to save the pre-roll as a take.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SaveLast {
    /// Chosen by the client, at most 64 characters: the same request again gets the same reply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
    /// Name of the take, without `.take`; by default the configuration names it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Seconds to save, at most 3600; all that is held if absent, or if that is less.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
}

/// Reply to a start: the take has begun.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Started {
    /// Id of the take, 32 hexadecimal digits.
    pub take_id: String,
    /// Name of the take, without `.take`.
    pub name: String,
    /// Path of its file.
    #[schema(value_type = String)]
    #[serde(serialize_with = "path_as_text")]
    pub path: PathBuf,
    /// Its first frame, which is on disk.
    pub first_frame: FirstFrame,
    /// Remarks, such as a changed name or a pre-roll that is shorter than requested.
    #[serde(default)]
    pub remarks: Vec<String>,
}

/// The first frame of a take.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FirstFrame {
    /// Time by the device's clock, in ticks.
    pub device_ticks: u64,
    /// Arrival in nanoseconds of the host's monotonic clock.
    pub arrival_ns: u64,
    /// Seconds between its arrival and the request: the pre-roll in the take.
    pub before_request_s: f64,
}

/// Reply to a stop: the take has ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Stopped {
    /// Id of the take, 32 hexadecimal digits.
    pub take_id: String,
    /// Name of the take, without `.take`.
    pub name: String,
    /// Present path of its file, which another program may have renamed; if one removed it, the path of the saved copy.
    #[schema(value_type = String)]
    #[serde(serialize_with = "path_as_text")]
    pub path: PathBuf,
    /// What other programs did to the file during the recording.
    #[serde(default)]
    pub file: FileState,
    /// Rows: frames recorded, and frames lost between them.
    pub rows: u64,
    /// Length in seconds.
    pub seconds: f64,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// Why it ended, as stored in the take: `stopped`, `disk full`, `device gone`, `device ended`, `length`,
    /// `service stopped`, `truncated` or `unmounted` by another program, or `saved` from the pre-roll.
    #[serde(with = "ending_word")]
    #[schema(value_type = String)]
    pub ending: Option<EndingKind>,
    /// The ledger: what became of every frame.
    pub ledger: LedgerDocument,
    /// For `save-last`: seconds that were requested but not held; 0 if all were held.
    #[serde(default)]
    pub short_by_s: f64,
    /// Remarks, such as that less was held than requested, or that the file has moved.
    #[serde(default)]
    pub remarks: Vec<String>,
}

/// Reply to a mark: it is in the take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Marked {
    /// The row of the take that is marked.
    pub row: u64,
}

/// Why a request was not executed, and what to do.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{message}")]
pub struct Refusal {
    /// The kind of the reason.
    pub kind: RefusalKind,
    /// One line for people: what was found, and what to do.
    pub message: String,
}

impl Refusal {
    /// A refusal with its message.
    #[must_use]
    pub fn new(kind: RefusalKind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into() }
    }

    pub(crate) fn conflict(message: impl Into<String>) -> Self {
        Self::new(RefusalKind::Conflict, message)
    }

    pub(crate) fn device(message: impl Into<String>) -> Self {
        Self::new(RefusalKind::Device, message)
    }

    pub(crate) fn unavailable(message: impl Into<String>) -> Self {
        Self::new(RefusalKind::Unavailable, message)
    }
}

/// Kinds of refusals by remedy, including those of HTTP.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = ProblemKind)]
pub enum RefusalKind {
    /// The request is invalid: change it.
    Invalid,
    /// It does not exist.
    NotFound,
    /// Not possible in this state: do something else first.
    Conflict,
    /// A take of that name exists: choose another name.
    Exists,
    /// The device is missing or does not respond.
    Device,
    /// The disk is full or has failed.
    Disk,
    /// The take has ended, but its file has no name any more: the message says where to copy it from.
    Vanished,
    /// The take has already ended, and data was lost: its file was truncated or its file system unmounted.
    DataLost,
    /// The service is stopping or busy: try again.
    Unavailable,
    /// An error in mocapd.
    Internal,
    /// A token is required.
    Unauthorized,
    /// The request comes from another site, or under a host name that is not the service's.
    Forbidden,
    /// The resource does not support this method.
    MethodNotAllowed,
    /// The client was too slow.
    Timeout,
    /// The request is too large.
    TooLarge,
    /// The body has an unsupported media type.
    UnsupportedMediaType,
    /// The requested range is not satisfiable.
    Range,
}

/// Events for one subscriber, in order. A subscriber that does not keep up loses the oldest, and learns how many.
#[derive(Debug)]
pub struct EventFeed {
    pub(crate) events: crossbeam_channel::Receiver<Arc<ServiceEvent>>,
    pub(crate) missed: Arc<std::sync::atomic::AtomicU64>,
}

impl EventFeed {
    /// A feed that receives from `events`; `missed` counts what it lost.
    #[must_use]
    pub fn new(
        events: crossbeam_channel::Receiver<Arc<ServiceEvent>>,
        missed: Arc<std::sync::atomic::AtomicU64>,
    ) -> Self {
        Self { events, missed }
    }

    /// Waits at most `wait` for the next event.
    #[must_use]
    pub fn next(&self, wait: Duration) -> Option<Arc<ServiceEvent>> {
        self.events.recv_timeout(wait).ok()
    }

    /// The number of events lost since the last call, because the subscriber did not keep up.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.missed.swap(0, std::sync::atomic::Ordering::Relaxed)
    }
}
