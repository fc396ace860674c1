//! What people and programs can ask the service for, however they ask.

use std::{path::PathBuf, sync::Arc, time::Duration};

use mocapd_acquire::{
    files::{FileId, FileState, path_as_text},
    ledger::LedgerDocument,
};
use mocapd_take::record::EndingKind;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    live::LiveFeed,
    status::{
        MarkerQuality, ServiceEvent, ServiceEventKind, Status, TakeStatus, TakeSummary, ending_word,
    },
};

/// The service as the HTTP API, the triggers and the signals see it.
///
/// Calls that change something wait until it is true, at most some seconds: they are made from threads that may wait.
/// A request with the id of an earlier one is not carried out again: it gets the answer of the first.
pub trait Control: Send + Sync + std::fmt::Debug + 'static {
    /// How things stand. Never waits.
    fn status(&self) -> Status;

    /// By marker, how well it is seen. Never waits.
    fn quality(&self) -> Vec<MarkerQuality>;

    /// Starts the device, and keeps what it sends for the pre-roll. Armed already: nothing to do.
    ///
    /// # Errors
    /// The device is absent or refuses; the service is stopping.
    fn arm(&self, request: &Request) -> Result<Status, Refusal>;

    /// Stops the device and forgets the pre-roll.
    ///
    /// # Errors
    /// A take is being recorded: stop it first.
    fn disarm(&self, request: &Request) -> Result<Status, Refusal>;

    /// Begins a take, and answers when its first frame would survive a power cut. An idle service is armed first.
    ///
    /// # Errors
    /// A take is being recorded; a name that exists or is none; no frame within the time; the disk is full.
    fn start(&self, start: &Start) -> Result<Started, Refusal>;

    /// Ends the take, and answers when its ledger would survive a power cut.
    ///
    /// # Errors
    /// No take is being recorded; the take could not be closed.
    fn stop(&self, request: &Request) -> Result<Stopped, Refusal>;

    /// Puts a mark into the take at the frame that comes next.
    ///
    /// # Errors
    /// No take is being recorded; a text that is too long.
    fn mark(&self, mark: &Mark) -> Result<Marked, Refusal>;

    /// Writes a take of what the pre-roll holds, and goes on.
    ///
    /// # Errors
    /// Not armed; nothing is held; a name that exists or is none; the disk is full.
    fn save_last(&self, save: &SaveLast) -> Result<Stopped, Refusal>;

    /// The takes in the service's folder, newest first, at most so many.
    ///
    /// # Errors
    /// The folder cannot be read.
    fn takes(&self, limit: usize) -> Result<Vec<TakeSummary>, Refusal>;

    /// The file of a take by its name. A name that could lead out of the folder is none.
    ///
    /// # Errors
    /// There is no such take.
    fn take_path(&self, name: &str) -> Result<PathBuf, Refusal>;

    /// The take that is being recorded, where it is this file, whatever that is called. Never waits.
    fn live_take(&self, file: FileId) -> Option<TakeStatus>;

    /// Says something to everybody who listens: an event of this kind.
    fn tell(&self, _kind: ServiceEventKind, _message: &str) {}

    /// What happens from now on.
    fn events(&self) -> EventFeed;

    /// Frames from now on, some thirty a second.
    fn live(&self) -> LiveFeed;
}

/// What every request may carry.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Chosen by the client, at most 64 characters: the same request again gets the same answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
}

/// Begin a take.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// As in [`Request`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
    /// Name of the take, without `.take`; without one it is named by the configuration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Goes into the take as its first event.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub notes: Option<String>,
    /// Seconds before the request that the take includes, as far as they are held; without it as configured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pre_roll_s: Option<f64>,
}

/// Put a mark into the take.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Mark {
    /// As in [`Request`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
    /// What it says, at most 1024 bytes; may be empty.
    #[serde(default)]
    pub text: String,
}

/// Write what the pre-roll holds.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SaveLast {
    /// As in [`Request`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
    /// As in [`Start`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// How much of it; more than is held is what is held.
    pub seconds: f64,
}

/// A take has begun.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Started {
    /// Of the take, 32 hexadecimal digits.
    pub take_id: String,
    /// Its name, without `.take`.
    pub name: String,
    /// Its file.
    #[schema(value_type = String)]
    #[serde(serialize_with = "path_as_text")]
    pub path: PathBuf,
    /// Its first frame, which is on disk.
    pub first_frame: FirstFrame,
    /// What is said beside it: a name that was changed, a pre-roll that is shorter than asked for.
    #[serde(default)]
    pub remarks: Vec<String>,
}

/// The frame that a take begins with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FirstFrame {
    /// By the device's clock.
    pub device_ticks: u64,
    /// When it arrived, in nanoseconds of the host's monotonic clock.
    pub arrival_ns: u64,
    /// Seconds before the request that it arrived: the pre-roll that the take has.
    pub before_request_s: f64,
}

/// A take has ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Stopped {
    /// Of the take, 32 hexadecimal digits.
    pub take_id: String,
    /// Its name, without `.take`.
    pub name: String,
    /// Its file, where it is now: another program may have renamed it, or removed it, and what was recorded was saved
    /// beside it.
    #[schema(value_type = String)]
    #[serde(serialize_with = "path_as_text")]
    pub path: PathBuf,
    /// What others did to the file while it was recorded.
    #[serde(default)]
    pub file: FileState,
    /// Rows: the frames recorded and those lost between them.
    pub rows: u64,
    /// Seconds that they make.
    pub seconds: f64,
    /// Bytes of the file.
    pub bytes: u64,
    /// Why it ended, as it stands in the take: `stopped`, `disk full`, `device gone`, `device ended`, `length`,
    /// `service stopped`, `truncated` or `unmounted` by somebody else, and `saved` of what the pre-roll held.
    #[serde(with = "ending_word")]
    #[schema(value_type = String)]
    pub ending: Option<EndingKind>,
    /// What became of every frame.
    pub ledger: LedgerDocument,
    /// Of `save-last`: seconds that were asked for and were not held; 0 where all of them were.
    #[serde(default)]
    pub short_by_s: f64,
    /// What is said beside it: that less was held than asked for, or that the file is not where it was begun.
    #[serde(default)]
    pub remarks: Vec<String>,
}

/// A mark is in the take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Marked {
    /// The row of the take that it stands at.
    pub row: u64,
}

/// Why something was not done, and what to do.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{message}")]
pub struct Refusal {
    /// What kind of thing stands in the way.
    pub kind: RefusalKind,
    /// One line for people: what was found, and what to do.
    pub message: String,
}

impl Refusal {
    /// Of a kind, in words.
    #[must_use]
    pub fn new(kind: RefusalKind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into() }
    }
}

/// Kinds of refusals, by remedy: those of the service, and those of HTTP.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = ProblemKind)]
pub enum RefusalKind {
    /// The request makes no sense: change it.
    Invalid,
    /// There is no such thing.
    NotFound,
    /// Not in this state: do something else first.
    Conflict,
    /// A take of that name exists: choose another.
    Exists,
    /// The device is not there, or does not answer.
    Device,
    /// The disk is full, or failed.
    Disk,
    /// The take has ended, and no name leads to its file any more: the message says where it can be copied from.
    Vanished,
    /// The take has ended by itself, and data was lost: its file was cut short or its file system unmounted.
    DataLost,
    /// The service is stopping, or too busy: try again.
    Unavailable,
    /// A fault of this program.
    Internal,
    /// A token is needed.
    Unauthorized,
    /// From another site, or under a name that is not the service's.
    Forbidden,
    /// Something is there, but not with this method.
    MethodNotAllowed,
    /// The client took too long.
    Timeout,
    /// More bytes than are taken.
    TooLarge,
    /// Not in a form that is understood here.
    UnsupportedMediaType,
    /// The bytes asked for are not there.
    Range,
}

/// What happens, in order, for one listener. One that does not listen loses the oldest and is told how many.
#[derive(Debug)]
pub struct EventFeed {
    pub(crate) events: crossbeam_channel::Receiver<Arc<ServiceEvent>>,
    pub(crate) missed: Arc<std::sync::atomic::AtomicU64>,
}

impl EventFeed {
    /// What comes from `events`; `missed` counts what did not.
    #[must_use]
    pub fn new(
        events: crossbeam_channel::Receiver<Arc<ServiceEvent>>,
        missed: Arc<std::sync::atomic::AtomicU64>,
    ) -> Self {
        Self { events, missed }
    }

    /// The next event, waited for at most so long. `None`: none came.
    #[must_use]
    pub fn next(&self, wait: Duration) -> Option<Arc<ServiceEvent>> {
        self.events.recv_timeout(wait).ok()
    }

    /// Events that this listener has missed since this was asked last, because it did not listen.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.missed.swap(0, std::sync::atomic::Ordering::Relaxed)
    }
}
