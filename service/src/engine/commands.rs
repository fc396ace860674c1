//! Executes the commands of clients, one at a time.

use std::{
    path::PathBuf,
    sync::{MutexGuard, atomic::Ordering},
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, RecvTimeoutError};
use mocapd_acquire::{
    files::TakeFile,
    header,
    host_clock::monotonic_ns,
    pipeline::{FirstRow, NewTake, check_disk_space},
    threads,
};
use mocapd_take::{
    motion::frame_at,
    record::{EndingKind, Event, EventKind},
};

use super::{
    Inner,
    session::{NamedTake, OpenTake},
};
use crate::{
    config::message_with_keys,
    control::{
        FirstFrame, LENGTH_SECONDS_MAX, Marked, Refusal, RefusalKind, SECONDS_MAX, SaveLast, Start,
        Started, Stopped, TEXT_BYTES_MAX,
    },
    notify,
    status::{ServiceEventKind, TrialNames},
    take_files::notes::notes_path,
    take_name,
};

/// Longest time to open and start a device.
const ARM_TIMEOUT: Duration = Duration::from_secs(10);

/// Longest wait until the first frame is on disk.
const FIRST_FRAME_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest wait until a take is closed: a disk may stall for half a minute.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(40);

/// Longest wait, when the service stops, until a removed take is copied: 30 GB at 50 MB a second.
const COPY_TIMEOUT: Duration = Duration::from_secs(600);

/// Time between two requests to systemd for more time to stop.
const EXTEND_INTERVAL: Duration = Duration::from_secs(10);

/// Longest wait until the reader has placed a mark.
const MARK_TIMEOUT: Duration = Duration::from_secs(1);

/// Names to try for a take without a name.
const NAMES_MAX: u32 = 10_000;

/// Proof that the caller holds the command lock.
type CommandGuard<'a> = MutexGuard<'a, ()>;

impl Inner {
    /// Arms the service: starts the device.
    pub(super) fn arm(&self, _command: &CommandGuard<'_>) -> Result<(), Refusal> {
        let until = Instant::now() + ARM_TIMEOUT;
        let mut core = self.core();
        core.failure = None;
        core.arm_requested = true;
        core.device.obstacle = None;
        self.changed.notify_all();
        loop {
            if self.is_stopping() {
                return Err(stopping());
            }
            // A session that is being ended does not count.
            let runs = |s: &super::session::Session| !s.stop.load(Ordering::Relaxed);
            if core.session.as_ref().is_some_and(runs) {
                return Ok(());
            }
            if let Some(obstacle) = &core.device.obstacle {
                let message =
                    format!("{obstacle}; the service arms as soon as the device is available");
                return Err(Refusal::device(message));
            }
            if Instant::now() >= until {
                let message = "the device did not start: check the status, and try again";
                return Err(Refusal::device(message));
            }
            let waited = self.changed.wait_timeout(core, Duration::from_millis(50));
            core = waited.unwrap_or_else(std::sync::PoisonError::into_inner).0;
        }
    }

    pub(super) fn disarm(&self, _command: &CommandGuard<'_>) -> Result<(), Refusal> {
        let until = Instant::now() + ARM_TIMEOUT;
        let mut core = self.core();
        if let Some(take) = &core.take {
            return Err(already_recording(take));
        }
        core.arm_requested = false;
        core.failure = None;
        while let Some(session) = &core.session {
            session.stop.store(true, Ordering::Relaxed);
            if Instant::now() >= until {
                return Err(Refusal::device("the device did not stop: check the status"));
            }
            let waited = self.changed.wait_timeout(core, Duration::from_millis(50));
            core = waited.unwrap_or_else(std::sync::PoisonError::into_inner).0;
        }
        Ok(())
    }

    pub(super) fn start_take(
        &self,
        command: &CommandGuard<'_>,
        start: &Start,
    ) -> Result<Started, Refusal> {
        let requested_ns = monotonic_ns();
        let core = self.core();
        if let Some(take) = &core.take {
            return Err(already_recording(take));
        }
        let (options, away) = (std::sync::Arc::clone(&core.options), core.away());
        drop(core);
        let checked = CheckedStart::of(start, &options)?;
        if let Some(message) = away {
            return Err(Refusal::device(message));
        }
        let CheckedStart { pre_roll, length, ref names } = checked;
        let notes = start.notes.as_deref();
        let request = TakeRequest {
            name: start.name.as_deref(),
            names: names.as_ref(),
            notes,
            pre_roll,
            requested_ns,
        };
        let (named, mut take) = self.new_take(&request)?;
        let mut remarks = Vec::new();
        if let Some(names) = names {
            let (subject, remark) = names.subject(options.subject.as_deref());
            take.subject = subject.map(std::sync::Arc::new);
            remarks.extend(remark);
        }
        let begun = self.arm(command).and_then(|()| self.begin_take(&named, take, length));
        let first = begun.inspect_err(|_| named.discard())?;
        let Ok(first) = first.recv_timeout(FIRST_FRAME_TIMEOUT) else {
            return Err(self.no_first_frame(command));
        };
        if let Some(names) = names {
            self.core().names = Some(names.clone());
            // A name that the request has chosen is no count.
            if start.name.is_none() {
                remarks.extend(note_count(names, &named));
            }
        }
        let mut core = self.core();
        if let Some(take) = &mut core.take {
            take.first = Some(first);
        }
        core.missed_start = None;
        let kept_open = std::mem::take(&mut core.kept_open);
        drop(core);
        // Closing a large file without a name takes time.
        drop(kept_open);
        let NamedTake { id, name, path, .. } = named;
        let notes = notes.filter(|notes| !notes.is_empty());
        let kind = ServiceEventKind::TakeStarted;
        self.publish_with_notes(kind, &format!("recording {name}"), Some(&name), notes);
        let before_request_s = requested_ns.saturating_sub(first.arrival_ns) as f64 * 1e-9;
        remarks.extend(pre_roll_remark(pre_roll, before_request_s));
        let FirstRow { device_ticks, arrival_ns, .. } = first;
        let first_frame = FirstFrame { device_ticks, arrival_ns, before_request_s };
        Ok(Started { take_id: id, name, path, first_frame, remarks })
    }

    /// Makes the take the current one. Returns the channel that delivers its first row.
    fn begin_take(
        &self,
        named: &NamedTake,
        mut take: NewTake,
        length: Option<Duration>,
    ) -> Result<Receiver<FirstRow>, Refusal> {
        let mut core = self.core();
        let Some(session) = &mut core.session else { return Err(device_gone()) };
        take.length_rows = length.map(|length| frame_at(length, session.header.rate_hz).max(1));
        let begun = session.takes.begin(session.with_header(take)).map_err(|e| busy(&e))?;
        let take = OpenTake {
            named: named.clone(),
            changes_reported: session.progress.file_changes(),
            requested_unix_ms: super::session::unix_ms(),
            begun: Instant::now(),
            rate_hz: session.header.rate_hz,
            length,
            first: None,
            ended: begun.ended,
            ending: None,
        };
        core.failure = None;
        core.data_lost = None;
        core.take = Some(take);
        Ok(begun.first)
    }

    /// No frame arrived in time: ends the take and its file.
    fn no_first_frame(&self, command: &CommandGuard<'_>) -> Refusal {
        let away = self.core().away();
        let refused = self.stop_take(command, EndingKind::Stopped);
        match refused {
            // A frame arrived after all, a moment too late.
            Ok(stopped) => Refusal::device(format!(
                "no frame was on disk within {} s: is the device capturing? Frames that arrived later are in {}",
                FIRST_FRAME_TIMEOUT.as_secs(),
                stopped.path.display()
            )),
            Err(refusal) => away.map_or(refusal, Refusal::device),
        }
    }

    /// Stops the current take. The caller holds the command lock.
    pub(super) fn stop_take(
        &self,
        _command: &CommandGuard<'_>,
        ending: EndingKind,
    ) -> Result<Stopped, Refusal> {
        let mut core = self.core();
        let Some(take) = &mut core.take else {
            if let Some(message) = &core.data_lost {
                let message = format!("no take is being recorded: {message}");
                return Err(Refusal::new(RefusalKind::DataLost, message));
            }
            // A take that failed is over: the reply says why.
            if let Some(failure) = &core.failure {
                return Err(Refusal::conflict(format!("no take is being recorded: {failure}")));
            }
            let before = core.last_take.as_ref().and_then(|take| Some((&take.name, take.ending?)));
            let message = before.map_or_else(
                || "no take is being recorded".to_owned(),
                |(name, ending)| format!("no take is being recorded: {name} has ended ({ending})"),
            );
            return Err(Refusal::conflict(message));
        };
        let is_first = take.ending.is_none();
        take.ending.get_or_insert(ending);
        let ended = take.ended.clone();
        // Without a session the take is already being ended.
        if let Some(session) = &mut core.session
            && is_first
            && let Err(error) = session.takes.end(ending)
        {
            if let Some(take) = &mut core.take {
                take.ending = None;
            }
            return Err(busy(&error));
        }
        drop(core);
        match ended.recv_timeout(CLOSE_TIMEOUT) {
            Ok(end) => self.finish_take(end),
            Err(RecvTimeoutError::Disconnected) => self.finish_unanswered(),
            Err(RecvTimeoutError::Timeout) => Err(Refusal::unavailable(
                "the disk is stalled and the take is not closed yet: it will be closed once the disk responds; check the status",
            )),
        }
    }

    pub(super) fn mark_take(&self, text: &str) -> Result<Marked, Refusal> {
        check_text(text, "a mark")?;
        let core = self.core();
        let (Some(session), Some(take)) = (&core.session, &core.take) else {
            return Err(Refusal::conflict("no take is being recorded: there is nothing to mark"));
        };
        if take.ending.is_some() {
            let message = "the take is being stopped: the mark would come after its end";
            return Err(Refusal::conflict(message));
        }
        let name = take.named.name.clone();
        let Some(rows_before) = take.first.map(|first| first.row) else {
            let message = "the take has no frame yet: set the mark once it has begun";
            return Err(Refusal::conflict(message));
        };
        let row = session.takes.mark(text, monotonic_ns());
        drop(core);
        let row = row.map_err(|error| busy(&error))?;
        let row = row.row.recv_timeout(MARK_TIMEOUT).map_err(|_| {
            let message = "the mark was not placed in time: check that the device sends frames, and set it again";
            Refusal::unavailable(message)
        })?;
        let message = if text.is_empty() { "a mark" } else { text };
        self.publish(ServiceEventKind::Mark, message, Some(&name));
        Ok(Marked { row: row.saturating_sub(rows_before) })
    }

    pub(super) fn save_pre_roll(
        &self,
        _command: &CommandGuard<'_>,
        save: &SaveLast,
    ) -> Result<Stopped, Refusal> {
        let requested_ns = monotonic_ns();
        // Without a time, all that is held, which is less than the longest time.
        let last = seconds(save.seconds.unwrap_or(SECONDS_MAX), "seconds")?;
        if last.is_zero() {
            let message = "seconds is 0: there is nothing to save";
            return Err(Refusal::new(RefusalKind::Invalid, message));
        }
        if self.core().session.is_none() {
            return Err(Refusal::conflict("not armed: the pre-roll is empty"));
        }
        let request = TakeRequest {
            name: save.name.as_deref(),
            names: None,
            notes: None,
            pre_roll: last,
            requested_ns,
        };
        let (named, take) = self.new_take(&request)?;
        let mut core = self.core();
        let saved = match &mut core.session {
            Some(session) => {
                let saved = session.takes.save(session.with_header(take));
                saved.map(|saved| (saved.ended, session.header.rate_hz)).map_err(|e| busy(&e))
            }
            None => Err(device_gone()),
        };
        let _closing = self.closing(&mut core);
        drop(core);
        let late = |_| Refusal::unavailable("the disk is stalled: still writing the take");
        let end = saved.and_then(|(ended, rate_hz)| {
            Ok((ended.recv_timeout(CLOSE_TIMEOUT).map_err(late)?, rate_hz))
        });
        let (end, rate_hz) = end.inspect_err(|_| named.discard())?;
        let saved = self.closed(end, &named, rate_hz)?;
        Ok(if save.seconds.is_some() { with_shortfall(saved, last) } else { saved })
    }

    /// Creates the file of a new take under a free name.
    fn new_take(&self, request: &TakeRequest<'_>) -> Result<(NamedTake, NewTake), Refusal> {
        let TakeRequest { notes, pre_roll, requested_ns, .. } = *request;
        if self.is_stopping() {
            return Err(stopping());
        }
        let options = std::sync::Arc::clone(&self.core().options);
        let refused = |kind| move |error| Refusal::new(kind, message_with_keys(&error));
        let (name, path) = free_name(request, &options)?;
        check_disk_space(&path, options.take.keep_free_bytes)
            .map_err(refused(RefusalKind::Disk))?;
        let notes = notes.filter(|notes| !notes.is_empty());
        let header =
            header::new(&options.take.codec, 1.0).map_err(refused(RefusalKind::Internal))?;
        let output = TakeFile::create(&path).map_err(refused(RefusalKind::Disk))?;
        let file = output.id();
        let notes = notes.map(|text| Event::new(EventKind::Mark, requested_ns, text));
        let id = header.take_id_text();
        let take = NewTake {
            subject: options.subject.clone(),
            pre_roll,
            requested_ns,
            notes,
            keep_free_bytes: options.take.keep_free_bytes,
            ..NewTake::new(output, header)
        };
        Ok((NamedTake { id, name, path, file }, take))
    }

    /// Waits until no take is being closed by another thread: longer if a removed take is being copied.
    fn wait_until_closed(&self) {
        let begun = Instant::now();
        let mut extended: Option<Instant> = None;
        loop {
            let core = self.core();
            let (is_open, is_closing) = (core.take.is_some(), core.closing > 0);
            drop(core);
            let within = if is_closing { COPY_TIMEOUT } else { CLOSE_TIMEOUT };
            if !(is_open || is_closing) || begun.elapsed() >= within {
                return;
            }
            if extended.is_none_or(|last| last.elapsed() >= EXTEND_INTERVAL) {
                notify::extend_stop(2 * EXTEND_INTERVAL + super::STOP_TIMEOUT);
                extended = Some(Instant::now());
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Finishes the take in progress, and tells all threads and viewers that the service is ending.
    pub(super) fn shut_down(&self) {
        if self.stopping.swap(true, Ordering::SeqCst) {
            return;
        }
        self.drop_scheduled();
        // If a client's stop is under way, that one closes the take.
        let command = self.command_within(super::STOP_TIMEOUT);
        let is_mine = command.as_ref().ok().filter(|_| self.core().take.is_some());
        let close = || {
            if let Some(command) = is_mine {
                drop(self.stop_take(command, EndingKind::ServiceStopped));
            }
        };
        threads::run_alongside("mocapd-close", close, || self.wait_until_closed());
        drop(command);
        if let Some(session) = &self.core().session {
            session.stop.store(true, Ordering::Relaxed);
        }
        self.core().arm_requested = false;
        self.viewers.close();
        self.changed.notify_all();
    }
}

/// What a new take is made from.
#[derive(Debug, Clone, Copy)]
struct TakeRequest<'a> {
    name: Option<&'a str>,
    names: Option<&'a TrialNames>,
    notes: Option<&'a str>,
    pre_roll: Duration,
    requested_ns: u64,
}

/// The checked fields of a start.
#[derive(Debug)]
struct CheckedStart {
    pre_roll: Duration,
    length: Option<Duration>,
    names: Option<TrialNames>,
}

impl CheckedStart {
    fn of(start: &Start, options: &super::EngineOptions) -> Result<Self, Refusal> {
        let pre_roll = match start.pre_roll_s {
            None => options.arm.include_pre_roll,
            Some(s) => seconds(s, "pre_roll_s")?,
        };
        let length = start.seconds.map(length).transpose()?;
        if let (Some(length), Some(max)) = (length, options.take.max_length)
            && length > max
        {
            let message = format!(
                "seconds is {}, but take.max_length ends every take after {} s: ask for less",
                length.as_secs_f64(),
                max.as_secs_f64()
            );
            return Err(Refusal::new(RefusalKind::Invalid, message));
        }
        let names = TrialNames::of_start(start, options)?;
        if let Some(notes) = &start.notes {
            check_text(notes, "notes")?;
        }
        Ok(Self { pre_roll, length, names })
    }
}

impl Inner {
    /// Checks a start that will be executed later.
    pub(super) fn check_start(&self, start: &Start) -> Result<(), Refusal> {
        let options = std::sync::Arc::clone(&self.core().options);
        let CheckedStart { pre_roll, names, .. } = CheckedStart::of(start, &options)?;
        let (name, names) = (start.name.as_deref(), names.as_ref());
        let request = TakeRequest { name, names, notes: None, pre_roll, requested_ns: 0 };
        free_name(&request, &options).map(drop)
    }
}

/// Notes the count of a take that has begun. Returns a remark if it is not stored.
fn note_count(names: &TrialNames, take: &NamedTake) -> Option<String> {
    let noted = names.note(&take.name, take.path.parent()?, super::session::unix_ms());
    noted.err().map(|error| {
        format!("its count is not stored, and may be used again if the take is moved: {error:#}")
    })
}

/// A name that no take has, and the path of its file.
fn free_name(
    request: &TakeRequest<'_>,
    options: &super::EngineOptions,
) -> Result<(String, PathBuf), Refusal> {
    let path = |name: &str| options.take.directory.join(format!("{name}.take"));
    // Notes that lie beside no take belong to another one.
    let is_free = |path: &PathBuf| {
        path.symlink_metadata().is_err() && notes_path(path).symlink_metadata().is_err()
    };
    if let Some(name) = request.name {
        let name = take_name::normalised(name)?;
        let path = path(name);
        if !is_free(&path) {
            let message =
                format!("a take called {name}, or notes for it, exist: choose another name");
            return Err(Refusal::new(RefusalKind::Exists, message));
        }
        return Ok((name.to_owned(), path));
    }
    if let Some(names) = request.names {
        let name = names.next_name(&options.take.directory)?;
        let path = path(take_name::normalised(&name)?);
        return Ok((name, path));
    }
    for count in 1..NAMES_MAX {
        let name = options.name_take(count);
        let name = take_name::normalised(&name)?.to_owned();
        // A template without `{count}` gets a number appended if needed.
        let counted = format!("{name}-{count}");
        let name = if count == 1 || is_free(&path(&name)) { name } else { counted };
        let path = path(&name);
        if is_free(&path) {
            return Ok((name, path));
        }
    }
    let message = "all names that take.name can give exist already: give the take a name";
    Err(Refusal::new(RefusalKind::Exists, message))
}

/// Adds how much less was held than requested.
fn with_shortfall(mut saved: Stopped, requested: Duration) -> Stopped {
    /// A take ends at the latest frame, and frames are rounded to rows.
    const MARGIN_S: f64 = 0.1;
    let (requested_s, held_s) = (requested.as_secs_f64(), saved.seconds);
    if requested_s <= held_s + MARGIN_S {
        return saved;
    }
    saved.short_by_s = requested_s - held_s;
    saved.remarks.push(format!("only {held_s:.1} s of the requested {requested_s:.1} s were held"));
    saved
}

/// Takes begin at key stretches: remarks on a pre-roll that differs noticeably from the requested one.
fn pre_roll_remark(requested: Duration, before_request_s: f64) -> Option<String> {
    /// Keys are a second apart while armed.
    const USUAL_S: f64 = 1.6;
    let requested_s = requested.as_secs_f64();
    if requested_s > before_request_s + 0.1 {
        return Some(format!(
            "only {before_request_s:.1} s of the requested {requested_s:.1} s of pre-roll were held"
        ));
    }
    (requested_s > 0.0 && before_request_s > requested_s + USUAL_S).then(|| {
        format!(
            "the take begins {before_request_s:.1} s before the request, not {requested_s:.1} s: takes begin at key stretches, which are up to 10 s apart while a take is recorded"
        )
    })
}

fn seconds(value: f64, what: &str) -> Result<Duration, Refusal> {
    if (0.0..=SECONDS_MAX).contains(&value) {
        return Ok(Duration::from_secs_f64(value));
    }
    let message = format!("{what} is {value}: it must be 0 to {SECONDS_MAX} s");
    Err(Refusal::new(RefusalKind::Invalid, message))
}

/// The length of a take that ends by itself.
fn length(value: f64) -> Result<Duration, Refusal> {
    if value > 0.0 && value <= LENGTH_SECONDS_MAX {
        return Ok(Duration::from_secs_f64(value));
    }
    let message =
        format!("seconds is {value}: it must be above 0 and at most {LENGTH_SECONDS_MAX} s");
    Err(Refusal::new(RefusalKind::Invalid, message))
}

fn check_text(text: &str, what: &str) -> Result<(), Refusal> {
    if text.len() <= TEXT_BYTES_MAX && !text.contains('\0') {
        return Ok(());
    }
    let message = format!("{what} may have at most {TEXT_BYTES_MAX} bytes and no NUL");
    Err(Refusal::new(RefusalKind::Invalid, message))
}

fn already_recording(take: &OpenTake) -> Refusal {
    Refusal::conflict(format!("the take {} is being recorded: stop it first", take.named.name))
}

/// The pipeline has not executed the previous command yet.
fn busy(error: &anyhow::Error) -> Refusal {
    Refusal::unavailable(format!("{error:#}"))
}

fn stopping() -> Refusal {
    Refusal::unavailable("the service is stopping")
}

fn device_gone() -> Refusal {
    Refusal::device("the device has just disconnected: try again")
}
