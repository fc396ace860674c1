//! Takes of a pipeline that runs: begun, ended, and saved from its pre-roll, without the device noticing.

use std::{fmt, sync::Arc, time::Duration};

use anyhow::{Context, ensure};
use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_take::record::{
    ClockLine, EndingKind, Event, EventKind, Header, Ledger, Subject, TakeEnding,
};

use super::{
    DiskState,
    desk::{Boundary, Desk, MarkOrder},
};
use crate::clock::ClockStatus;

/// Orders that wait for the writer: one at a time is asked for, and may wait for a disk.
const ORDERS_MAX: usize = 4;

/// A take to be written.
#[derive(Debug)]
pub struct NewTake<W> {
    /// What it is written to: empty.
    pub output: W,
    /// Its header, but for the channel table.
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

/// What a take came to: itself, closed, or why it ends early.
pub type TakeEnd<W> = Result<(Written, W), TakeFailed<W>>;

/// A take that ends early: what was written before stays, and is worth nothing where that is [`NothingRecorded`].
pub struct TakeFailed<W> {
    /// Why.
    pub error: anyhow::Error,
    /// What was written to, as it is; `None` where nothing of a take is in it.
    pub output: Option<Box<W>>,
}

impl<W> TakeFailed<W> {
    /// A take that failed before anything of it was written.
    pub fn without_output(error: anyhow::Error) -> Self {
        Self { error, output: None }
    }
}

impl<W> fmt::Debug for TakeFailed<W> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&self.error, f)
    }
}

impl<W> fmt::Display for TakeFailed<W> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.error, f)
    }
}

impl<W> std::error::Error for TakeFailed<W> {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.error.source()
    }
}

/// A take that is being written.
#[derive(Debug)]
pub struct Begun<W> {
    /// Told when its first row would survive a power cut.
    pub first: Receiver<FirstRow>,
    /// Told when it is closed.
    pub ended: Receiver<TakeEnd<W>>,
}

/// A mark that was asked for. Dropped before it was placed, it is none.
#[derive(Debug)]
pub struct AskedMark {
    /// Told the pipeline's row that it stands at.
    pub row: Receiver<u64>,
    _asked: Arc<()>,
}

/// What the writer is to do at a boundary.
#[derive(Debug)]
pub(super) struct Order<W> {
    pub(super) boundary: u64,
    pub(super) what: What<W>,
}

#[derive(Debug)]
pub(super) enum What<W> {
    Begin(Box<NewTake<W>>, Answers<W>),
    End(EndingKind),
    /// A take of all that is held, which is closed at once.
    Save(Box<NewTake<W>>, Answers<W>),
}

/// Where somebody waits.
#[derive(Debug)]
pub(super) struct Answers<W> {
    pub(super) first: Sender<FirstRow>,
    pub(super) ended: Sender<TakeEnd<W>>,
}

/// Asks for takes. One at a time: a take is ended before the next is begun.
#[derive(Debug)]
pub struct Takes<W> {
    desk: Desk,
    orders: Sender<Order<W>>,
    next_boundary: u64,
    recording: bool,
}

pub(super) fn answers<W>() -> (Answers<W>, Begun<W>) {
    // One answer each.
    let ((first, first_out), (ended, ended_out)) = (bounded(1), bounded(1));
    (Answers { first, ended }, Begun { first: first_out, ended: ended_out })
}

pub(super) fn takes<W>(desk: Desk) -> (Takes<W>, Receiver<Order<W>>) {
    let (orders, orders_out) = bounded(ORDERS_MAX);
    (Takes { desk, orders, next_boundary: 1, recording: false }, orders_out)
}

impl<W> Takes<W> {
    /// Begins a take at the frame that comes next, or at one before it that is held.
    ///
    /// # Errors
    /// When the writer has not yet done what it was asked before.
    pub fn begin(&mut self, take: NewTake<W>) -> anyhow::Result<Begun<W>> {
        let (answers, begun) = answers();
        self.order(What::Begin(Box::new(take), answers), true)?;
        Ok(begun)
    }

    /// Ends the take with the frame that came last: [`Begun::ended`] tells when it is closed.
    ///
    /// # Errors
    /// As [`begin`](Self::begin).
    pub fn end(&mut self, ending: EndingKind) -> anyhow::Result<()> {
        self.order(What::End(ending), false)
    }

    /// Writes a take of what is held, and closes it.
    ///
    /// # Errors
    /// As [`begin`](Self::begin).
    pub fn save(&mut self, take: NewTake<W>) -> anyhow::Result<Begun<W>> {
        let (answers, begun) = answers();
        let recording = self.recording;
        self.order(What::Save(Box::new(take), answers), recording)?;
        Ok(begun)
    }

    /// Puts a mark at the frame that comes next, unless what is returned is dropped before.
    ///
    /// # Errors
    /// When too many wait.
    pub fn mark(&self, text: &str, host_ns: u64) -> anyhow::Result<AskedMark> {
        let ((row, row_out), asked) = (bounded(1), Arc::new(()));
        let event = Event {
            kind: EventKind::Mark,
            row: 0,
            device_ticks: 0,
            host_ns,
            input: 0,
            text: text.to_owned(),
        };
        let taken = self.desk.mark(MarkOrder { event, row, asked: Arc::downgrade(&asked) });
        ensure!(taken, "too many marks wait: wait a moment");
        Ok(AskedMark { row: row_out, _asked: asked })
    }

    fn order(&mut self, what: What<W>, recording: bool) -> anyhow::Result<()> {
        let boundary = self.next_boundary;
        let begins = matches!(what, What::Begin(..));
        let sent = self.orders.try_send(Order { boundary, what });
        // The channel's error would carry the whole order.
        sent.ok().context("the writer is still busy with what it was asked before")?;
        self.next_boundary += 1;
        self.recording = recording;
        self.desk.want(Boundary { number: boundary, recording, begins });
        Ok(())
    }
}
