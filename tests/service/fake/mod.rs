//! A fake of the service: it records nothing, but has the states, refusals, files, events and frames of the service.

mod feeds;

use std::{
    collections::HashMap,
    fs,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, MutexGuard,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use mocapd_acquire::{
    files::{FileId, FileState},
    ledger::LedgerDocument,
};
use mocapd_service::{
    control::{
        Control, EventFeed, FirstFrame, Mark, Marked, Refusal, RefusalKind, Request, SaveLast,
        Start, Started, Stopped,
    },
    finished::{EditNotes, MovedTake, Rename, Restore, TakeNotes, Trash, TrashedTake},
    live::LiveFeed,
    status::{
        MarkerQuality, PendingStart, Presence, ServiceEventKind, State, Status, TakeStatus,
        TakeSummary,
    },
    take_files::{self, notes, trash},
};

use mocapd_take::record::EndingKind;

use self::feeds::Feeds;

const ROWS: u64 = 120;

#[derive(Debug)]
pub(crate) struct Fake {
    folder: PathBuf,
    take: Vec<u8>,
    started: Instant,
    inner: Mutex<Inner>,
    pub(crate) feeds: Feeds,
    /// Duration of every command in milliseconds.
    pub(crate) command_ms: AtomicU64,
    /// Frames lost on the link in the ledger of the next take.
    lost: AtomicU64,
    /// Number of commands executed, without repeated requests.
    pub(crate) executed: AtomicU64,
    /// Kind and message of the events passed to `Control::tell`.
    pub(crate) told: Mutex<Vec<(String, String)>>,
    /// How long takes stay in the trash.
    pub(crate) trash_keep: Duration,
}

#[derive(Debug, Default)]
struct Inner {
    state: State,
    failure: Option<String>,
    take: Option<TakeStatus>,
    n_takes: u64,
    pending_start: Option<PendingStart>,
    replies: HashMap<String, CachedReply>,
}

#[derive(Debug, Clone)]
enum CachedReply {
    Status(Box<Result<Status, Refusal>>),
    Started(Result<Started, Refusal>),
    Stopped(Box<Result<Stopped, Refusal>>),
    Marked(Result<Marked, Refusal>),
}

fn refuse<T>(kind: RefusalKind, message: &str) -> Result<T, Refusal> {
    Err(Refusal::new(kind, message))
}

/// Whether a text is a valid take name: no path, no hidden file.
fn is_name(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "-_. ".contains(c);
    !name.is_empty()
        && name.len() <= 100
        && !name.starts_with(['.', ' '])
        && name.chars().all(allowed)
}

impl Fake {
    /// A fake whose takes are written to `folder`, each with the content `take`.
    pub(crate) fn new(folder: &Path, take: Vec<u8>) -> Arc<Self> {
        Arc::new(Self {
            folder: folder.to_owned(),
            take,
            started: Instant::now(),
            inner: Mutex::default(),
            feeds: Feeds::default(),
            command_ms: AtomicU64::new(0),
            lost: AtomicU64::new(0),
            executed: AtomicU64::new(0),
            told: Mutex::default(),
            trash_keep: Duration::from_secs(3600),
        })
    }

    pub(crate) fn fail(&self, why: &str) {
        let mut inner = self.lock();
        inner.state = State::Failed;
        inner.failure = Some(why.to_owned());
    }

    pub(crate) fn lose(&self, frames: u64) {
        self.lost.store(frames, Ordering::Relaxed);
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap()
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.take"))
    }

    fn new_path(&self, name: &str) -> Result<PathBuf, Refusal> {
        if !is_name(name) {
            return refuse(RefusalKind::Invalid, "not a valid take name");
        }
        let path = self.path(name);
        if path.exists() {
            return refuse(RefusalKind::Exists, "a take of that name exists: choose another name");
        }
        Ok(path)
    }

    /// Executes a command, or returns the reply to the same request.
    fn once<T>(
        &self,
        id: Option<&String>,
        wrap: impl Fn(Result<T, Refusal>) -> CachedReply,
        unwrap: impl Fn(CachedReply) -> Option<Result<T, Refusal>>,
        command: impl FnOnce(&mut Inner) -> Result<T, Refusal>,
    ) -> Result<T, Refusal>
    where
        Result<T, Refusal>: Clone,
    {
        std::thread::sleep(Duration::from_millis(self.command_ms.load(Ordering::Relaxed)));
        let mut inner = self.lock();
        if let Some(id) = id {
            if id.chars().count() > 64 {
                return refuse(RefusalKind::Invalid, "request_id is longer than 64 characters");
            }
            if let Some(known) = inner.replies.get(id) {
                return unwrap(known.clone()).unwrap_or_else(|| {
                    refuse(RefusalKind::Invalid, "request_id belongs to a different request")
                });
            }
        }
        self.executed.fetch_add(1, Ordering::Relaxed);
        let reply = command(&mut inner);
        if let Some(id) = id {
            inner.replies.insert(id.clone(), wrap(reply.clone()));
        }
        reply
    }

    fn status_of(&self, inner: &Inner) -> Status {
        let mut status = Status {
            rig: "fake".to_owned(),
            state: inner.state,
            failure: inner.failure.clone(),
            software: "mocapd 0.0.0".to_owned(),
            uptime_s: self.started.elapsed().as_secs_f64(),
            take: inner.take.clone(),
            pending_start: inner.pending_start.clone(),
            ..Status::default()
        };
        status.device.uri = "serial:/dev/fake".to_owned();
        status.device.presence = Presence::Streaming;
        status.device.rate_hz = 120.0;
        status.device.markers = 15;
        status.input.frames = 12_345;
        status.input.ring_latency_p99_us = 45;
        status.disk.directory = self.folder.display().to_string();
        status.disk.free_bytes = Some(1 << 40);
        status.disk.left_s = Some(86_400);
        status
    }

    fn publish(&self, kind: ServiceEventKind, message: String, state: State, take: Option<&str>) {
        self.feeds.publish(kind, message, state, take);
    }

    fn finish(&self, name: &str, path: PathBuf, ending: EndingKind) -> Result<Stopped, Refusal> {
        if let Err(error) = fs::write(&path, &self.take) {
            return refuse(RefusalKind::Disk, &format!("the disk: {error}"));
        }
        Ok(Stopped {
            take_id: "0".repeat(32),
            name: name.to_owned(),
            path,
            rows: ROWS,
            seconds: 1.0,
            bytes: self.take.len() as u64,
            ending: Some(ending),
            ledger: ledger(self.lost.swap(0, Ordering::Relaxed)),
            file: FileState::InPlace,
            short_by_s: 0.0,
            remarks: Vec::new(),
        })
    }
}

fn ledger(lost_on_link: u64) -> LedgerDocument {
    LedgerDocument {
        finished: true,
        closes: true,
        frames_sent: ROWS + lost_on_link,
        recorded: ROWS,
        lost_on_link,
        ..LedgerDocument::default()
    }
}

impl Control for Fake {
    fn notify(&self, kind: ServiceEventKind, message: &str) {
        self.told.lock().unwrap().push((kind.to_string(), message.to_owned()));
    }

    fn status(&self) -> Status {
        self.status_of(&self.lock())
    }

    fn quality(&self) -> Vec<MarkerQuality> {
        let marker = |label: &str| MarkerQuality {
            label: label.to_owned(),
            labelled: true,
            visible: 0.98,
            noise_mm: Some(0.05),
            still_sigma_mm: Some(0.05),
            ..MarkerQuality::default()
        };
        vec![marker("head"), marker("l_knee")]
    }

    fn arm(&self, request: &Request) -> Result<Status, Refusal> {
        let wrap = |answer| CachedReply::Status(Box::new(answer));
        let unwrap = |known| match known {
            CachedReply::Status(answer) => Some(*answer),
            _ => None,
        };
        self.once(request.request_id.as_ref(), wrap, unwrap, |inner| {
            if inner.state == State::Idle {
                inner.state = State::Armed;
                self.publish(ServiceEventKind::State, "armed".to_owned(), State::Armed, None);
            }
            Ok(self.status_of(inner))
        })
    }

    fn disarm(&self, request: &Request) -> Result<Status, Refusal> {
        let wrap = |answer| CachedReply::Status(Box::new(answer));
        let unwrap = |known| match known {
            CachedReply::Status(answer) => Some(*answer),
            _ => None,
        };
        self.once(request.request_id.as_ref(), wrap, unwrap, |inner| {
            if inner.state == State::Recording {
                return refuse(RefusalKind::Conflict, "a take is being recorded: stop it first");
            }
            inner.state = State::Idle;
            self.publish(ServiceEventKind::State, "idle".to_owned(), State::Idle, None);
            Ok(self.status_of(inner))
        })
    }

    fn start(&self, start: &Start) -> Result<Started, Refusal> {
        let unwrap = |known| match known {
            CachedReply::Started(answer) => Some(answer),
            _ => None,
        };
        self.once(start.request_id.as_ref(), CachedReply::Started, unwrap, |inner| {
            if inner.state == State::Recording {
                return refuse(RefusalKind::Conflict, "a take is being recorded: stop it first");
            }
            if start.pre_roll_s.is_some_and(|seconds| !(0.0..=3600.0).contains(&seconds)) {
                return refuse(RefusalKind::Invalid, "pre_roll_s must be 0 to 3600");
            }
            inner.n_takes += 1;
            let name = start.name.clone().unwrap_or_else(|| format!("take-{:03}", inner.n_takes));
            let path = self.new_path(&name)?;
            let durable = &self.take[..self.take.len() / 2];
            if let Err(error) = fs::write(&path, durable) {
                return refuse(RefusalKind::Disk, &format!("the disk: {error}"));
            }
            inner.state = State::Recording;
            let take_id = format!("{:032x}", inner.n_takes);
            inner.take = Some(TakeStatus {
                take_id: take_id.clone(),
                name: name.clone(),
                path: path.display().to_string(),
                rows: ROWS / 2,
                bytes: durable.len() as u64,
                durable_bytes: durable.len() as u64,
                ..TakeStatus::default()
            });
            self.publish(
                ServiceEventKind::TakeStarted,
                format!("{name} began"),
                State::Recording,
                Some(&name),
            );
            let first_frame = FirstFrame { device_ticks: 0, arrival_ns: 1, before_request_s: 0.0 };
            Ok(Started { take_id, name, path, first_frame, remarks: Vec::new() })
        })
    }

    fn schedule(&self, start: &Start) -> Result<PendingStart, Refusal> {
        let mut inner = self.lock();
        if inner.pending_start.is_some() {
            return refuse(RefusalKind::Conflict, "a start already waits");
        }
        if start.at.as_deref().is_none_or(|at| at.len() != 8) {
            return refuse(RefusalKind::Invalid, "not a time");
        }
        let pending = PendingStart {
            at_unix_ms: 1,
            at: start.at.clone().unwrap(),
            name: start.name.clone(),
            remarks: vec!["the rig is not armed yet".to_owned()],
        };
        inner.pending_start = Some(pending.clone());
        Ok(pending)
    }

    fn cancel(&self, _request: &Request) -> Result<PendingStart, Refusal> {
        let pending = self.lock().pending_start.take();
        pending.ok_or_else(|| Refusal::new(RefusalKind::Conflict, "no start is waiting"))
    }

    fn stop(&self, request: &Request) -> Result<Stopped, Refusal> {
        let unwrap = |known| match known {
            CachedReply::Stopped(answer) => Some(*answer),
            _ => None,
        };
        let wrap = |answer| CachedReply::Stopped(Box::new(answer));
        self.once(request.request_id.as_ref(), wrap, unwrap, |inner| {
            let Some(take) = inner.take.take() else {
                return refuse(RefusalKind::Conflict, "no take is being recorded");
            };
            inner.state = State::Armed;
            self.publish(
                ServiceEventKind::TakeStopped,
                format!("{} ended", take.name),
                State::Armed,
                Some(&take.name),
            );
            self.finish(&take.name, PathBuf::from(take.path), EndingKind::Stopped)
        })
    }

    fn mark(&self, mark: &Mark) -> Result<Marked, Refusal> {
        let unwrap = |known| match known {
            CachedReply::Marked(answer) => Some(answer),
            _ => None,
        };
        self.once(mark.request_id.as_ref(), CachedReply::Marked, unwrap, |inner| {
            if mark.text.len() > 1024 {
                return refuse(RefusalKind::Invalid, "the text of a mark has at most 1024 bytes");
            }
            let Some(take) = &inner.take else {
                return refuse(RefusalKind::Conflict, "no take is being recorded");
            };
            self.publish(ServiceEventKind::Mark, mark.text.clone(), inner.state, Some(&take.name));
            Ok(Marked { row: take.rows })
        })
    }

    fn save_last(&self, save: &SaveLast) -> Result<Stopped, Refusal> {
        let unwrap = |known| match known {
            CachedReply::Stopped(answer) => Some(*answer),
            _ => None,
        };
        let wrap = |answer| CachedReply::Stopped(Box::new(answer));
        self.once(save.request_id.as_ref(), wrap, unwrap, |inner| {
            if save.seconds.is_some_and(|seconds| !(seconds > 0.0 && seconds <= 3600.0)) {
                return refuse(RefusalKind::Invalid, "seconds must be above 0 and at most 3600");
            }
            if inner.state != State::Armed {
                return refuse(RefusalKind::Conflict, "not armed: the pre-roll is empty");
            }
            inner.n_takes += 1;
            let name = save.name.clone().unwrap_or_else(|| format!("last-{:03}", inner.n_takes));
            self.finish(&name, self.new_path(&name)?, EndingKind::Length)
        })
    }

    fn takes(&self, limit: usize) -> Result<Vec<TakeSummary>, Refusal> {
        let open = self.lock().take.as_ref().map(|take| take.name.clone());
        let entries = fs::read_dir(&self.folder)
            .map_err(|error| Refusal::new(RefusalKind::Disk, error.to_string()))?;
        let mut takes = Vec::with_capacity(16);
        for entry in entries.flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let Some(name) = name.strip_suffix(".take") else { continue };
            takes.push(TakeSummary {
                name: name.to_owned(),
                bytes: entry.metadata().map_or(0, |found| found.len()),
                notes: notes::listed(&entry.path()),
                modified_unix_ms: 1,
                is_open: open.as_deref() == Some(name),
                ..TakeSummary::default()
            });
        }
        takes.sort_by(|a, b| b.name.cmp(&a.name));
        takes.truncate(limit);
        Ok(takes)
    }

    fn edit_notes(&self, name: &str, edit: &EditNotes) -> Result<TakeNotes, Refusal> {
        let path = take_files::path_of(&self.folder, name)?;
        notes::edit(&path, edit.rating, edit.text.as_deref(), 1)
    }

    fn rename(&self, name: &str, rename: &Rename) -> Result<MovedTake, Refusal> {
        take_files::rename(&self.folder, name, &rename.to)
    }

    fn trash(&self, name: &str, _request: &Trash) -> Result<TrashedTake, Refusal> {
        trash::trash(&self.folder, name, 1_796_000_000_000, self.trash_keep)
    }

    fn trashed(&self, limit: usize) -> Vec<TrashedTake> {
        trash::trashed(&self.folder, self.trash_keep, limit)
    }

    fn restore(&self, id: &str, restore: &Restore) -> Result<MovedTake, Refusal> {
        take_files::restore(&self.folder, id, restore.to.as_deref())
    }

    fn live_take(&self, file: FileId) -> Option<TakeStatus> {
        let take = self.status().take?;
        file.is_at(Path::new(&take.path)).unwrap().then_some(take)
    }

    fn take_path(&self, name: &str) -> Result<PathBuf, Refusal> {
        let path = self.path(name);
        if !is_name(name) || !path.exists() {
            return refuse(RefusalKind::NotFound, "no take of that name exists");
        }
        Ok(path)
    }

    fn events(&self) -> EventFeed {
        self.feeds.events()
    }

    fn live(&self) -> LiveFeed {
        self.feeds.live()
    }
}
