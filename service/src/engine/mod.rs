//! The engine: supervises one rig, and records one take at a time.
//!
//! ```text
//! mocapd-rig     opens the device, arms the pipeline, reads frames; waits for a device that has disconnected
//! mocapd-hub     passes frames to viewers and to the marker statistics
//! mocapd-watch   ends takes at their maximum length or when the disk or device fails; publishes events
//! mocapd-recover recovers the takes that a killed service left, then ends
//! mocapd-upload  uploads finished takes to an archive; it may wait for the network, and nothing waits for it
//! mocapd-start   starts takes at a time of day
//! mocapd-trash   removes takes whose time in the trash is over
//! callers        start, stop, mark: one command at a time
//! ```
//!
//! The state is a value behind a lock that is held only briefly: never while waiting for a disk or a device.

mod commands;
mod finish;
mod folder;
mod hub;
mod scheduled;
mod session;
mod supervisor;
mod trial_names;
mod uploads;
mod watcher;

use std::{
    any::Any,
    collections::VecDeque,
    path::PathBuf,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, TryLockError,
        atomic::{AtomicBool, AtomicU64},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::{Context, anyhow};
use jiff::Zoned;
use mocapd_acquire::{
    files::FileId,
    pipeline::lock,
    threads::{self, Heartbeat},
};
use mocapd_drivers::{registry, uri::DeviceUri};
use mocapd_take::record::{EndingKind, Subject};

pub(crate) use self::folder::summarise;
use self::{
    folder::{SummaryCache, TakeClaims},
    hub::{Hub, MarkerStatistics, Viewers},
    session::{Core, Rates},
    uploads::Uploads,
    watcher::EventPublisher,
};
use super::{
    control::{
        Control, EventFeed, Mark, Marked, Refusal, RefusalKind, Request, SaveLast, Start, Started,
        Stopped,
    },
    finished::{EditNotes, MovedTake, Rename, Restore, TakeNotes, Trash, TrashedTake},
    live::LiveFeed,
    publish::{self, Publications, PublishedFeed, PublisherName},
    status::{
        MarkerQuality, PendingStart, Presence, ServiceEventKind, State, Status, TakeStatus,
        TakeSummary,
    },
};
use crate::config::{
    ArchiveConfig, ArmConfig, Config, DeviceChoice, DeviceConfig, NameParts, TakeConfig,
    auto_device,
};

/// Longest wait for the previous command, which may be waiting for a stalled disk.
const COMMAND_TIMEOUT: Duration = Duration::from_secs(60);

/// Longest time for the service to stop: systemd kills it later.
const STOP_TIMEOUT: Duration = Duration::from_secs(5);

/// The service without its interfaces.
#[derive(Debug)]
pub struct Engine {
    inner: Arc<Inner>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

/// State shared by the engine's threads.
#[derive(Debug)]
struct Inner {
    core: Mutex<Core>,
    /// Notified when `core` has changed in a way that others may wait for.
    changed: Condvar,
    /// Held while a command is executed.
    command: Mutex<()>,
    replies: Mutex<IdempotentReplies>,
    events: EventPublisher,
    viewers: Viewers,
    statistics: Mutex<MarkerStatistics>,
    /// Summaries of the takes in the folder.
    summaries: Mutex<SummaryCache>,
    uploads: Uploads,
    publications: Publications,
    claims: TakeClaims,
    rates: Rates,
    stopping: AtomicBool,
    began: Instant,
    heartbeat: Heartbeat,
    sessions: AtomicU64,
}

impl Engine {
    /// Starts the engine's threads. The device is opened when the engine is armed.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn start(options: EngineOptions, heartbeat: &Heartbeat) -> anyhow::Result<Self> {
        let arm_at_start = options.arm.at_start;
        let publications = Publications::new(&options.publishers);
        let inner = Arc::new(Inner {
            core: Mutex::new(Core::new(options)),
            changed: Condvar::new(),
            command: Mutex::new(()),
            replies: Mutex::new(IdempotentReplies::default()),
            events: EventPublisher::default(),
            viewers: Viewers::default(),
            statistics: Mutex::new(MarkerStatistics::default()),
            summaries: Mutex::default(),
            uploads: Uploads::default(),
            publications,
            claims: TakeClaims::default(),
            rates: Rates::default(),
            stopping: AtomicBool::new(false),
            began: Instant::now(),
            heartbeat: heartbeat.clone(),
            sessions: AtomicU64::new(0),
        });
        lock(&inner.core).arm_requested = arm_at_start;
        // Whether or not there is an archive now.
        let directory = inner.core().options.take.directory.clone();
        uploads::restore_set_aside(&inner, &directory);
        folder::repair(&inner);
        let cut_off = folder::cut_off(&inner);
        let (hub, sessions) = Hub::new(&inner);
        let supervised = Arc::clone(&inner);
        let watched = Arc::clone(&inner);
        if !cut_off.is_empty() {
            let inner = Arc::clone(&inner);
            let run = move || folder::recover_takes(&inner, cut_off);
            // It ends when it is done, or with the service.
            drop(threads::spawn("mocapd-recover", run)?);
        }
        let uploading = Arc::clone(&inner);
        // It may wait for a store that does not answer, so the end of the service does not wait for it.
        drop(threads::spawn("mocapd-upload", move || uploads::run(&uploading))?);
        let emptying = Arc::clone(&inner);
        // It may wait for a slow disk, but removes what nobody needs.
        drop(threads::spawn("mocapd-trash", move || folder::empty_trash(&emptying))?);
        let scheduling = Arc::clone(&inner);
        let threads = vec![
            threads::spawn("mocapd-hub", move || hub.run())?,
            threads::spawn("mocapd-rig", move || supervisor::run(&supervised, &sessions))?,
            threads::spawn("mocapd-start", move || scheduled::run(&scheduling))?,
            threads::spawn("mocapd-watch", move || watcher::run(&watched))?,
        ];
        Ok(Self { inner, threads: Mutex::new(threads) })
    }

    /// Applies other options: with the next take, or when next armed.
    pub fn reload(&self, options: EngineOptions) {
        self.inner.core().options = Arc::new(options);
        self.inner.changed.notify_all();
        self.inner.publish(ServiceEventKind::State, "configuration reloaded", None);
    }

    /// What is received, for a publisher that the engine was started with.
    #[must_use]
    pub fn published(&self, name: PublisherName) -> Option<PublishedFeed> {
        self.inner.publications.feed(name)
    }

    /// Finishes the take, stops the device and ends the threads.
    pub fn stop_service(&self) {
        self.inner.shut_down();
        let until = Instant::now() + STOP_TIMEOUT;
        for thread in lock(&self.threads).drain(..) {
            while !thread.is_finished() && Instant::now() < until {
                std::thread::sleep(Duration::from_millis(5));
            }
            if thread.is_finished() {
                // A thread that panicked has reported it already.
                drop(thread.join());
            }
        }
    }

    /// Whether a thread has ended without being stopped: the engine is unusable then.
    #[must_use]
    pub fn has_died(&self) -> bool {
        let stopping = self.inner.is_stopping();
        !stopping && lock(&self.threads).iter().any(JoinHandle::is_finished)
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        self.stop_service();
    }
}

impl Inner {
    fn core(&self) -> MutexGuard<'_, Core> {
        lock(&self.core)
    }

    /// Takes the command lock.
    fn command(&self) -> Result<MutexGuard<'_, ()>, Refusal> {
        self.command_within(COMMAND_TIMEOUT)
    }

    fn command_within(&self, at_most: Duration) -> Result<MutexGuard<'_, ()>, Refusal> {
        let until = Instant::now() + at_most;
        loop {
            match self.command.try_lock() {
                Ok(guard) => return Ok(guard),
                Err(TryLockError::Poisoned(poisoned)) => return Ok(poisoned.into_inner()),
                Err(TryLockError::WouldBlock) if Instant::now() < until => {
                    std::thread::sleep(Duration::from_millis(2));
                }
                Err(TryLockError::WouldBlock) => {
                    return Err(Refusal::unavailable(
                        "another command is still being executed: wait, and check the status",
                    ));
                }
            }
        }
    }
}

impl Control for Engine {
    fn status(&self) -> Status {
        self.inner.status()
    }

    fn quality(&self) -> Vec<MarkerQuality> {
        self.inner.quality()
    }

    fn arm(&self, request: &Request) -> Result<Status, Refusal> {
        self.inner.once("arm", request.request_id.as_deref(), |inner| {
            inner.arm(&inner.command()?)?;
            Ok(inner.status())
        })
    }

    fn disarm(&self, request: &Request) -> Result<Status, Refusal> {
        self.inner.once("disarm", request.request_id.as_deref(), |inner| {
            inner.disarm(&inner.command()?)?;
            Ok(inner.status())
        })
    }

    fn start(&self, start: &Start) -> Result<Started, Refusal> {
        if start.at.is_some() {
            let message = "a start at a time of day is scheduled, not executed";
            return Err(Refusal::new(RefusalKind::Invalid, message));
        }
        self.inner.once("start", start.request_id.as_deref(), |inner| {
            inner.start_take(&inner.command()?, start)
        })
    }

    fn schedule(&self, start: &Start) -> Result<PendingStart, Refusal> {
        self.inner.once("schedule", start.request_id.as_deref(), |inner| {
            let _command = inner.command()?;
            inner.schedule_start(start)
        })
    }

    fn cancel(&self, request: &Request) -> Result<PendingStart, Refusal> {
        // Not behind another command: a start whose time comes meanwhile is cancelled as well.
        self.inner
            .once("cancel", request.request_id.as_deref(), |inner| inner.cancel_start(request))
    }

    fn stop(&self, request: &Request) -> Result<Stopped, Refusal> {
        self.inner.once("stop", request.request_id.as_deref(), |inner| {
            inner.stop_take(&inner.command()?, EndingKind::Stopped)
        })
    }

    fn mark(&self, mark: &Mark) -> Result<Marked, Refusal> {
        self.inner.once("mark", mark.request_id.as_deref(), |inner| inner.mark_take(&mark.text))
    }

    fn save_last(&self, save: &SaveLast) -> Result<Stopped, Refusal> {
        self.inner.once("save_last", save.request_id.as_deref(), |inner| {
            inner.save_pre_roll(&inner.command()?, save)
        })
    }

    fn takes(&self, limit: usize) -> Result<Vec<TakeSummary>, Refusal> {
        self.inner.list_takes(limit)
    }

    fn take_path(&self, name: &str) -> Result<PathBuf, Refusal> {
        self.inner.path_of(name)
    }

    fn edit_notes(&self, name: &str, edit: &EditNotes) -> Result<TakeNotes, Refusal> {
        self.inner.once_about(("edit_notes", name), edit.request_id.as_deref(), |inner| {
            inner.edit_notes(name, edit)
        })
    }

    fn rename(&self, name: &str, rename: &Rename) -> Result<MovedTake, Refusal> {
        self.inner.once_about(("rename", name), rename.request_id.as_deref(), |inner| {
            inner.rename_take(name, rename)
        })
    }

    fn trash(&self, name: &str, trash: &Trash) -> Result<TrashedTake, Refusal> {
        self.inner.once_about(("trash", name), trash.request_id.as_deref(), |inner| {
            inner.trash_take(name, trash)
        })
    }

    fn trashed(&self, limit: usize) -> Vec<TrashedTake> {
        self.inner.list_trash(limit)
    }

    fn restore(&self, id: &str, restore: &Restore) -> Result<MovedTake, Refusal> {
        self.inner.once_about(("restore", id), restore.request_id.as_deref(), |inner| {
            inner.restore_take(id, restore)
        })
    }

    fn live_take(&self, file: FileId) -> Option<TakeStatus> {
        let core = self.inner.core();
        let id = core.take.as_ref().filter(|take| take.named.file == file)?.named.id.clone();
        drop(core);
        self.inner.status().take.filter(|take| take.take_id == id)
    }

    fn notify(&self, kind: ServiceEventKind, message: &str) {
        self.inner.publish(kind, message, None);
    }

    fn events(&self) -> EventFeed {
        self.inner.events.subscribe()
    }

    fn live(&self) -> LiveFeed {
        self.inner.viewers.add()
    }
}

impl Status {
    /// The status in one line, as systemd shows it.
    #[must_use]
    pub fn summary(&self) -> String {
        let outage = self.device.outage.map(|outage| {
            let what = if self.device.presence == Presence::Silent { "frames" } else { "device" };
            format!("no {what} for {:.0} s", outage.seconds)
        });
        match (self.state, outage, &self.take, &self.failure) {
            (State::Failed, _, _, Some(failure)) => format!("failed: {failure}"),
            (State::Recording, Some(outage), Some(take), _) => {
                format!("{outage}: recording of {} paused", take.name)
            }
            (State::Armed, Some(outage), ..) => format!("{outage}: armed, but no frames arrive"),
            (State::Recording, None, Some(take), _) => {
                format!("recording {}: {:.0} s", take.name, take.seconds)
            }
            (State::Armed, ..) => format!(
                "armed: {} {}, {} markers at {} Hz",
                self.device.model, self.device.serial, self.device.markers, self.device.rate_hz
            ),
            _ => match &self.device.obstacle {
                Some(obstacle) => format!("idle: {obstacle}"),
                None => format!("idle: the device is {}", self.device.presence),
            },
        }
    }
}

/// The engine's part of a configuration.
#[derive(Debug, Clone)]
pub struct EngineOptions {
    /// Name of the rig.
    pub rig: String,
    /// The device to record, and its settings.
    pub device: DeviceConfig,
    /// Where takes are written, and how.
    pub take: TakeConfig,
    /// The subject, stored in every take.
    pub subject: Option<Arc<Subject>>,
    /// What is kept in memory between takes.
    pub arm: ArmConfig,
    /// Where finished takes are uploaded to.
    pub archive: ArchiveConfig,
    /// The publishers that everything is passed on to. Others in a configuration that is reloaded wait for a restart.
    pub publishers: Vec<PublisherName>,
}

impl EngineOptions {
    /// Takes the options from a configuration, and reads the subject's files.
    ///
    /// # Errors
    /// If a file of the subject is missing or invalid, or this build cannot use the archive's store.
    pub fn load(config: &Config) -> anyhow::Result<Self> {
        if let Some(problem) = config.archive_problem() {
            return Err(anyhow!(problem));
        }
        Ok(Self {
            rig: config.rig_name.clone(),
            device: config.device.clone(),
            take: config.take.clone(),
            subject: config.subject.load().context("[subject]")?.map(Arc::new),
            arm: config.arm.clone(),
            archive: config.archive.clone(),
            publishers: publish::names(config),
        })
    }

    /// The device to open: the configured one, or the one found automatically.
    fn find_device(&self) -> anyhow::Result<DeviceUri> {
        match &self.device.uri {
            DeviceChoice::At(uri) => Ok(uri.clone()),
            auto @ DeviceChoice::Auto => {
                auto_device(auto, &registry::devices()?).map_err(|error| anyhow!(error))
            }
        }
    }

    /// A name for a take that was started without one; if it exists, the caller tries the next `count`.
    fn name_take(&self, count: u32) -> String {
        let (begin, count) = (Zoned::now().datetime(), u64::from(count));
        self.take.name.fill(&NameParts { begin, rig: &self.rig, count })
    }
}

/// Maximum number of replies that are remembered: clients repeat a request within seconds, and none sends hundreds per
/// second.
const REPLIES_MAX: usize = 256;

/// Longest request id in bytes.
const ID_BYTES_MAX: usize = 64;

/// Replies by request id, oldest first.
#[derive(Debug, Default)]
struct IdempotentReplies(VecDeque<(String, KnownRequest)>);

/// A request that has been received: its kind and its reply.
#[derive(Debug, Clone)]
struct KnownRequest {
    what: &'static str,
    /// The take that the request is about, if its path names one.
    about: String,
    reply: Reply,
}

#[derive(Debug, Clone)]
enum Reply {
    /// The request is being executed.
    Pending,
    Done(Arc<dyn Any + Send + Sync>),
}

impl Inner {
    /// Executes a request, unless one with its id was received before.
    fn once<T: Clone + Send + Sync + 'static>(
        &self,
        what: &'static str,
        id: Option<&str>,
        execute: impl FnOnce(&Self) -> Result<T, Refusal>,
    ) -> Result<T, Refusal> {
        self.once_about((what, ""), id, execute)
    }

    /// Executes a request about a take, unless one with its id was received before.
    fn once_about<T: Clone + Send + Sync + 'static>(
        &self,
        (what, about): (&'static str, &str),
        id: Option<&str>,
        execute: impl FnOnce(&Self) -> Result<T, Refusal>,
    ) -> Result<T, Refusal> {
        let Some(id) = id else { return execute(self) };
        let invalid = |message: &str| Refusal::new(RefusalKind::Invalid, message);
        if id.is_empty() || id.len() > ID_BYTES_MAX || id.chars().any(char::is_control) {
            return Err(invalid("a request_id has 1 to 64 bytes and no control characters"));
        }
        if let Some(known) = self.claim((what, about), id) {
            let other = "this request_id was used for a different kind of request";
            if known.what != what || known.about != about {
                return Err(invalid(other));
            }
            let Reply::Done(answer) = known.reply else {
                let message = "this request is still being executed: ask again in a moment";
                return Err(Refusal::unavailable(message));
            };
            let answer = answer.downcast_ref::<Result<T, Refusal>>();
            return answer.cloned().unwrap_or_else(|| Err(invalid(other)));
        }
        let answer = execute(self);
        let mut replies = lock(&self.replies);
        if let Some(at) = replies.0.iter().rposition(|(known, _)| known == id) {
            match &answer {
                // A request that was not executed may be tried again.
                Err(refusal) if refusal.kind == RefusalKind::Unavailable => {
                    replies.0.remove(at);
                }
                _ => replies.0[at].1.reply = Reply::Done(Arc::new(answer.clone())),
            }
        }
        answer
    }

    /// The known request with this id; otherwise registers it as being executed.
    fn claim(&self, (what, about): (&'static str, &str), id: &str) -> Option<KnownRequest> {
        let mut replies = lock(&self.replies);
        if let Some((_, known)) = replies.0.iter().find(|(known, _)| known == id) {
            return Some(known.clone());
        }
        if replies.0.len() == REPLIES_MAX {
            replies.0.pop_front();
        }
        replies.0.push_back((
            id.to_owned(),
            KnownRequest { what, about: about.to_owned(), reply: Reply::Pending },
        ));
        None
    }
}
