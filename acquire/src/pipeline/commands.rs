//! What is asked of a pipeline that runs: takes begun, ended, and saved from its pre-roll, and marks.
//!
//! A command goes one way. It waits in a bounded mailbox, at which the reader looks between two frames: one load when
//! there is nothing. A mark becomes an event there, and never waits for the writer. For a take the reader closes the open stretch and sends a boundary,
//! a stretch without rows, the way that stretches go; the command goes to the writer beside it, with the boundary's
//! number, and is carried out when the writer meets that: exactly between two frames.

use std::{
    fmt,
    sync::{
        Arc, Weak,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use anyhow::ensure;
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use mocapd_take::record::{
    ClockLine, EndingKind, Event, EventKind, Header, Ledger, Subject, TakeEnding,
};

use super::{DiskState, TakeOutput};
use crate::clock::ClockStatus;

/// So many commands for takes wait in the mailbox, and so many for the writer, and its disk. One at a time is asked for.
pub(super) const TAKE_COMMANDS_MAX: usize = 4;

/// A mark is refused where so much waits for the reader, which looks every 20 ms: that is a client that hammers.
const MARKS_MAX: usize = 16;

/// A take to be written.
#[derive(Debug)]
pub struct NewTake {
    /// What it is written to: empty.
    pub output: Box<dyn TakeOutput>,
    /// Its header; the channel table is the pipeline's.
    pub header: Header,
    /// Who is captured.
    pub subject: Option<Arc<Subject>>,
    /// How much from before the request belongs to it, as far as it is held.
    pub pre_roll: Duration,
    /// When it was asked for, by the host's monotonic clock.
    pub asked_ns: u64,
    /// Stands in it as its first event.
    pub notes: Option<Event>,
    /// Bytes of the disk that stay free.
    pub keep_free_bytes: u64,
}

impl NewTake {
    /// One of nobody, that begins when it is asked for.
    pub fn new(output: impl TakeOutput, header: Header) -> Self {
        Self {
            output: Box::new(output),
            header,
            subject: None,
            pre_roll: Duration::ZERO,
            asked_ns: 0,
            notes: None,
            keep_free_bytes: 0,
        }
    }
}

/// The first recorded row of a take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FirstRow {
    /// By the device's clock.
    pub device_ticks: u64,
    /// When it arrived, by the host's monotonic clock.
    pub arrival_ns: u64,
    /// The row of the pipeline that is the take's row 0.
    pub row: u64,
}

/// Stands in the chain of errors of a take that failed before a frame was in it: its file helps nobody.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("nothing was recorded")]
pub struct NothingRecorded;

/// What a take came to: itself, closed, or why it ends early.
pub type TakeEnd = Result<(Written, Box<dyn TakeOutput>), TakeFailed>;

/// A take that ends early: what was written before stays, and is worth nothing where that is [`NothingRecorded`].
pub struct TakeFailed {
    /// Why.
    pub error: anyhow::Error,
    /// What was written to, as it is; `None` where nothing of a take is in it.
    pub output: Option<Box<dyn TakeOutput>>,
}

impl TakeFailed {
    /// A take that failed before anything of it was written.
    pub fn without_output(error: anyhow::Error) -> Self {
        Self { error, output: None }
    }
}

impl fmt::Debug for TakeFailed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&self.error, f)
    }
}

impl fmt::Display for TakeFailed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.error, f)
    }
}

/// What was written in the end.
#[derive(Debug, Clone, Default)]
pub struct Written {
    /// The ledger as it stands in the take.
    pub ledger: Ledger,
    /// How it ended, as it stands in the take.
    pub ending: TakeEnding,
    /// How the clocks ran in the end.
    pub clock: ClockStatus,
    /// By segment, the line of each that had one.
    pub clock_lines: Vec<(u32, ClockLine)>,
    /// What was left of the disk.
    pub disk: DiskState,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Samples in it.
    pub samples: u64,
    /// Of these, kept ones.
    pub kept: u64,
    /// The largest error that an encoder measured, in millimetres.
    pub max_error_mm: f64,
}

/// A take that is being written.
#[derive(Debug)]
pub struct TakeHandle {
    /// Told when its first row would survive a power cut.
    pub first: Receiver<FirstRow>,
    /// Told when it is closed.
    pub ended: Receiver<TakeEnd>,
}

/// Where somebody waits for a take.
#[derive(Debug, Clone)]
pub(super) struct Reply {
    pub(super) first: Sender<FirstRow>,
    pub(super) ended: Sender<TakeEnd>,
}

pub(super) fn reply() -> (Reply, TakeHandle) {
    // One answer each.
    let ((first, first_out), (ended, ended_out)) = (bounded(1), bounded(1));
    (Reply { first, ended }, TakeHandle { first: first_out, ended: ended_out })
}

/// A mark that was asked for. Dropped before it was placed, it is none.
#[derive(Debug)]
pub struct AskedMark {
    /// Told the pipeline's row that it stands at.
    pub row: Receiver<u64>,
    _asked: Arc<()>,
}

/// A mark, and where its row is told.
#[derive(Debug)]
pub(super) struct NewMark {
    pub(super) event: Event,
    pub(super) row: Sender<u64>,
    asked: Weak<()>,
}

impl NewMark {
    /// Whether somebody still waits for it: else it is no mark.
    pub(super) fn is_wanted(&self) -> bool {
        self.asked.strong_count() > 0
    }
}

/// What happens between two stretches.
#[derive(Debug)]
pub(super) enum TakeCommand {
    /// The take that is open ends, and this one begins.
    Begin(Box<NewTake>, Reply),
    End(EndingKind),
    /// A take of all that is held, which is closed at once.
    Save(Box<NewTake>, Reply),
}

/// The reader's end of the mailbox.
#[derive(Debug)]
pub(super) struct Mailbox {
    waiting: Arc<AtomicUsize>,
    marks: Receiver<NewMark>,
    commands: Receiver<TakeCommand>,
}

impl Mailbox {
    /// One load: it is asked with every frame.
    pub(super) fn is_empty(&self) -> bool {
        self.waiting.load(Ordering::Acquire) == 0
    }

    /// The oldest mark.
    pub(super) fn next_mark(&self) -> Option<NewMark> {
        self.next(&self.marks)
    }

    /// The oldest command for a take.
    pub(super) fn next_command(&self) -> Option<TakeCommand> {
        self.next(&self.commands)
    }

    fn next<T>(&self, queue: &Receiver<T>) -> Option<T> {
        let next = queue.try_recv().ok()?;
        self.waiting.fetch_sub(1, Ordering::AcqRel);
        Some(next)
    }
}

/// Asks for takes. One at a time: a take is ended before the next is begun.
#[derive(Debug)]
pub struct Takes {
    waiting: Arc<AtomicUsize>,
    marks: Sender<NewMark>,
    commands: Sender<TakeCommand>,
}

pub(super) fn mailbox() -> (Takes, Mailbox) {
    let (marks_in, marks) = bounded(MARKS_MAX);
    let (commands_in, commands) = bounded(TAKE_COMMANDS_MAX);
    let waiting = Arc::new(AtomicUsize::new(0));
    let takes = Takes { waiting: Arc::clone(&waiting), marks: marks_in, commands: commands_in };
    (takes, Mailbox { waiting, marks, commands })
}

impl Takes {
    /// Begins a take at the frame that comes next, or at one before it that is held.
    ///
    /// # Errors
    /// When the reader and the writer have not yet done what they were asked before.
    pub fn begin(&mut self, take: NewTake) -> anyhow::Result<TakeHandle> {
        let (reply, handle) = reply();
        self.send_for_take(TakeCommand::Begin(Box::new(take), reply))?;
        Ok(handle)
    }

    /// Ends the take with the frame that came last: [`TakeHandle::ended`] tells when it is closed.
    ///
    /// # Errors
    /// As [`begin`](Self::begin).
    pub fn end(&mut self, ending: EndingKind) -> anyhow::Result<()> {
        self.send_for_take(TakeCommand::End(ending))
    }

    /// Writes a take of what is held, and closes it.
    ///
    /// # Errors
    /// As [`begin`](Self::begin).
    pub fn save(&mut self, take: NewTake) -> anyhow::Result<TakeHandle> {
        let (reply, handle) = reply();
        self.send_for_take(TakeCommand::Save(Box::new(take), reply))?;
        Ok(handle)
    }

    /// Puts a mark at the frame that comes next, unless what is returned is dropped before.
    ///
    /// # Errors
    /// When too many wait.
    pub fn mark(&self, text: &str, host_ns: u64) -> anyhow::Result<AskedMark> {
        let ((row, row_out), asked) = (bounded(1), Arc::new(()));
        let event = Event::new(EventKind::Mark, host_ns, text);
        let mark = NewMark { event, row, asked: Arc::downgrade(&asked) };
        ensure!(self.send(&self.marks, mark), "too many marks wait: wait a moment");
        Ok(AskedMark { row: row_out, _asked: asked })
    }

    fn send_for_take(&self, command: TakeCommand) -> anyhow::Result<()> {
        let is_sent = self.send(&self.commands, command);
        ensure!(is_sent, "the writer is still busy with what it was asked before");
        Ok(())
    }

    /// `false` when the queue is full. Where the reader is gone the take has ended with it: who waits for an answer
    /// finds that nobody gives one.
    fn send<T>(&self, queue: &Sender<T>, command: T) -> bool {
        // Counted before it is there: the reader looks again with the next frame.
        self.waiting.fetch_add(1, Ordering::AcqRel);
        let sent = queue.try_send(command);
        if sent.is_err() {
            self.waiting.fetch_sub(1, Ordering::AcqRel);
        }
        !matches!(sent, Err(TrySendError::Full(_)))
    }
}
