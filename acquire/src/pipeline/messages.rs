//! Messages between the threads of the pipeline, and commands to it: begin, end and save takes, and set marks.
//!
//! A command goes into a bounded queue that the reader polls between two frames, at the cost of one load when it is
//! empty. A mark becomes an event there and never waits for the writer. To begin or end a take, the reader closes the
//! open stretch and sends a boundary, a stretch without rows, through the queues of stretches. The command goes to the
//! writer through a separate queue, with the boundary's number, and takes effect when the writer reaches the boundary:
//! exactly between two frames.

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
use mocapd_codec::{BlockReport, poses::PoseErrors};
use mocapd_take::{
    record::{
        Channel, ClockLine, EndingKind, Event, EventKind, Header, Ledger, SampleLedger, Subject,
        TakeEnding,
    },
    statistics::{BlockTally, StretchTally},
    stretch::Span,
    timeline::LossCauses,
};

use super::{
    Counts, DiskSpace, TakeOutput,
    plan::{CLOCK_ITEMS_MAX, CONTROL_MAX},
};
use crate::clock::{ClockItem, ClockStatus};

/// The times of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct FrameTimes {
    pub(super) device_ticks: u64,
    pub(super) arrival_ns: u64,
}

/// A closed stretch.
#[derive(Debug, Clone, Copy)]
pub(super) struct StretchEnd {
    pub(super) span: Span,
    /// Its first recorded row, and the arrival of its last.
    pub(super) first: FrameTimes,
    pub(super) last_arrival_ns: u64,
    /// Number of channels with rows in it: they have the first slots.
    pub(super) n_channels: usize,
    /// Whether residuals are recorded, and those of some of these channels are not.
    pub(super) lacks_residuals: bool,
    /// Whether it is the last one.
    pub(super) last: bool,
    /// Whether the recording is divided at this boundary: the next take begins with the row after it.
    pub(super) splits: bool,
}

/// Work for a group. The timeline's group also gets the counters at the end of the stretch.
#[derive(Debug, Clone, Copy)]
pub(super) struct EncodeJob {
    pub(super) stretch: u64,
    pub(super) end: StretchEnd,
    pub(super) counts: Option<Counts>,
}

/// The output of one group for one stretch.
#[derive(Debug)]
pub(super) struct Part {
    pub(super) stretch: u64,
    pub(super) end: StretchEnd,
    /// The group's index; the timeline's group is the last.
    pub(super) group: usize,
    /// It returns to the group when it has been written.
    pub(super) buffer: PartBuffer,
    pub(super) report: PartReport,
    /// Only from the timeline's group.
    pub(super) counts: Option<Counts>,
}

/// The time of the first sample of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct BlockTime {
    pub(super) device_ticks: u64,
    /// The sample at which its last batch began, counted in the block, and its time.
    pub(super) last_batch: (u32, u64),
    /// Number of the first sample of its run since the pipeline began.
    pub(super) run_start: u64,
    pub(super) segment: u32,
}

/// Samples of a group for the writer.
#[derive(Debug)]
pub(super) struct SamplePart {
    /// Index of the group.
    pub(super) group: usize,
    pub(super) stretch: u64,
    pub(super) first: u64,
    pub(super) duplicates: u64,
    pub(super) jumps: u32,
    pub(super) content: PartContent,
}

/// What the part has. Buffers return to the group.
#[derive(Debug)]
pub(super) enum PartContent {
    Block {
        n: u32,
        key: bool,
        time: BlockTime,
        errors: PoseErrors,
        block: Vec<u8>,
    },
    Lost {
        n: u64,
        causes: LossCauses,
        buffer: Vec<u8>,
    },
    Boundary,
    /// The group has the residuals of `n` markers from this one on.
    Opens {
        first_marker: usize,
        n: usize,
    },
}

/// What the threads that encode send to the writer.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "a box would allocate")]
pub(super) enum WriterInput {
    Part(Part),
    Samples(SamplePart),
}

/// The memory of a part.
#[derive(Debug)]
pub(super) struct PartBuffer {
    /// The group's block with its length, or the stretch's header with its timeline.
    pub(super) bytes: Vec<u8>,
    /// What the block holds; empty for the timeline's group.
    pub(super) tally: BlockTally,
}

impl PartBuffer {
    pub(super) fn clear(&mut self) {
        self.bytes.clear();
        self.tally.restart(0);
    }
}

/// What the encoders of a part measured.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct PartReport {
    pub(super) samples: u64,
    pub(super) kept: u64,
    pub(super) max_error_mm: f64,
    /// Blocks refused by the encoder: a bug in this program, reported in the ledger.
    pub(super) refused: u64,
}

impl PartReport {
    pub(super) fn add_channel(&mut self, channel: &BlockReport) {
        self.samples += u64::from(channel.samples);
        self.kept += u64::from(channel.kept);
        self.max_error_mm = self.max_error_mm.max(channel.max_error_mm);
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.samples += other.samples;
        self.kept += other.kept;
        self.max_error_mm = self.max_error_mm.max(other.max_error_mm);
        self.refused += other.refused;
    }
}

/// What a whole stretch holds.
#[derive(Debug, Clone, Default)]
pub(super) struct StretchReport {
    pub(super) parts: PartReport,
    pub(super) tally: StretchTally,
    /// Whether residuals are recorded, and those of some channels are not.
    pub(super) lacks_residuals: bool,
}

/// A message from the reader to the writer, other than samples.
#[derive(Debug)]
pub(super) enum Control {
    Channel(NewChannel),
    Event(Event),
}

/// The reader's ends of the queues to the writer.
#[derive(Debug)]
pub(super) struct ToWriter {
    /// With the number of the stretch that was open: the message precedes that stretch.
    pub(super) control: Sender<(u64, Control)>,
    pub(super) clock: Sender<ClockItem>,
    /// With the number of the boundary at which they are executed.
    pub(super) commands: Sender<(u64, TakeCommand)>,
}

/// The writer's ends of the queues from the reader.
#[derive(Debug)]
pub(super) struct FromReader {
    pub(super) control: Receiver<(u64, Control)>,
    pub(super) clock: Receiver<ClockItem>,
    pub(super) commands: Receiver<(u64, TakeCommand)>,
}

/// Creates the bounded queues from the reader to the writer.
pub(super) fn reader_to_writer() -> (ToWriter, FromReader) {
    let (control_in, control) = bounded(CONTROL_MAX);
    let (clock_in, clock) = bounded(CLOCK_ITEMS_MAX);
    // Two more than to the reader: for a take that waited for its device, beside the command that overtook it, and for
    // the end of a take that has its requested length.
    let (commands_in, commands) = bounded(TAKE_COMMANDS_MAX + 2);
    let to_writer = ToWriter { control: control_in, clock: clock_in, commands: commands_in };
    (to_writer, FromReader { control, clock, commands })
}

/// A marker that appeared.
#[derive(Debug)]
pub(super) struct NewChannel {
    pub(super) slot: usize,
    pub(super) marker_id: u16,
    /// Its label, and whether the device gave it; without a label it is named after its slot.
    pub(super) named: Option<(String, bool)>,
}

impl NewChannel {
    pub(super) fn into_channel(self) -> Channel {
        let (label, labelled) = self.named.unwrap_or_default();
        let label = if label.is_empty() { Channel::unlabelled_name(self.slot) } else { label };
        Channel { marker_id: self.marker_id, label, labelled }
    }
}

/// Length of the command queues to the reader and to the writer. Callers send one command at a time.
pub(super) const TAKE_COMMANDS_MAX: usize = 4;

/// Length of the queue of marks. The reader polls it every 20 ms: only a client that floods it fills it.
const MARKS_MAX: usize = 16;

/// A take to write.
#[derive(Debug)]
pub struct NewTake {
    /// The output, which is empty.
    pub output: Box<dyn TakeOutput>,
    /// The header; its channel table is set by the pipeline.
    pub header: Header,
    /// The captured subject.
    pub subject: Option<Arc<Subject>>,
    /// How much from before the request to include, as far as the pre-roll buffer holds it.
    pub pre_roll: Duration,
    /// When the take was requested, by the host's monotonic clock.
    pub requested_ns: u64,
    /// The take ends automatically after this many rows, lost ones included, with the ending
    /// [`Length`](EndingKind::Length). They are counted from its request: those of the pre-roll come in addition.
    pub length_rows: Option<u64>,
    /// The notes of the request, which become the first event of the take.
    pub notes: Option<Event>,
    /// Bytes of the disk to leave free.
    pub keep_free_bytes: u64,
}

impl NewTake {
    /// A take without subject and pre-roll.
    pub fn new(output: impl TakeOutput, header: Header) -> Self {
        Self {
            output: Box::new(output),
            header,
            subject: None,
            pre_roll: Duration::ZERO,
            requested_ns: 0,
            length_rows: None,
            notes: None,
            keep_free_bytes: 0,
        }
    }
}

/// The first recorded row of a take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FirstRow {
    /// Time by the device's clock.
    pub device_ticks: u64,
    /// Time of arrival by the host's monotonic clock.
    pub arrival_ns: u64,
    /// The pipeline's row that is row 0 of the take.
    pub row: u64,
}

/// Marks the error of a take that failed before its first frame: its file is useless.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("nothing was recorded")]
pub struct NothingRecorded;

/// The result of a take: its account and its closed output, or why it ended early.
pub type TakeResult = Result<(TakeAccount, Box<dyn TakeOutput>), TakeFailed>;

/// A take that ended early. What was written before stays, unless the error is [`NothingRecorded`].
pub struct TakeFailed {
    /// Why it ended.
    pub error: anyhow::Error,
    /// The output as it was left; `None` when nothing of the take was written.
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

/// The account of a take that was written.
#[derive(Debug, Clone, Default)]
pub struct TakeAccount {
    /// The ledger in the take.
    pub ledger: Ledger,
    /// The ledger of sampled channels in the take, if there are some.
    pub sample_ledger: Option<SampleLedger>,
    /// The ending in the take.
    pub ending: TakeEnding,
    /// The final state of the clocks.
    pub clock: ClockStatus,
    /// The clock line of each segment that has one, with the segment's number.
    pub clock_lines: Vec<(u32, ClockLine)>,
    /// The disk space left.
    pub disk: DiskSpace,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Samples in the take.
    pub samples: u64,
    /// Samples kept as knots.
    pub kept: u64,
    /// The largest error that an encoder measured, in millimetres.
    pub max_error_mm: f64,
}

/// A take that is being written.
#[derive(Debug)]
pub struct TakeHandle {
    /// Receives the first row when it would survive a power cut.
    pub first: Receiver<FirstRow>,
    /// Receives the result when the take is closed.
    pub ended: Receiver<TakeResult>,
}

/// The sending ends of a [`TakeHandle`].
#[derive(Debug, Clone)]
pub(super) struct Reply {
    pub(super) first: Sender<FirstRow>,
    pub(super) ended: Sender<TakeResult>,
}

impl Reply {
    /// For a take of a series: no caller waits for its first row.
    pub(super) fn of_series(ended: Sender<TakeResult>) -> Self {
        Self { first: bounded(1).0, ended }
    }
}

pub(super) fn reply_channel() -> (Reply, TakeHandle) {
    // One message each.
    let ((first, first_out), (ended, ended_out)) = (bounded(1), bounded(1));
    (Reply { first, ended }, TakeHandle { first: first_out, ended: ended_out })
}

/// A requested mark. Dropping it before the mark is placed cancels the mark.
#[derive(Debug)]
pub struct PendingMark {
    /// Receives the pipeline's row of the mark.
    pub row: Receiver<u64>,
    _request: Arc<()>,
}

/// A request for a mark, with the channel for its row.
#[derive(Debug)]
pub(super) struct MarkRequest {
    pub(super) event: Event,
    pub(super) row: Sender<u64>,
    request: Weak<()>,
}

impl MarkRequest {
    /// Whether the requester still waits: otherwise the mark is cancelled.
    pub(super) fn is_awaited(&self) -> bool {
        self.request.strong_count() > 0
    }
}

/// A command for a take, executed between two stretches.
#[derive(Debug)]
pub(super) enum TakeCommand {
    /// Ends the open take and begins this one.
    Begin(Box<NewTake>, Reply),
    End(EndingKind),
    /// Writes a take of the whole pre-roll and closes it.
    Save(Box<NewTake>, Reply),
}

/// The reader's end of the command queues.
#[derive(Debug)]
pub(super) struct CommandReceiver {
    n_queued: Arc<AtomicUsize>,
    marks: Receiver<MarkRequest>,
    commands: Receiver<TakeCommand>,
}

impl CommandReceiver {
    /// One load, since the reader calls it for every frame.
    pub(super) fn is_empty(&self) -> bool {
        self.n_queued.load(Ordering::Acquire) == 0
    }

    /// The oldest mark.
    pub(super) fn next_mark(&self) -> Option<MarkRequest> {
        self.next(&self.marks)
    }

    /// The oldest command for a take.
    pub(super) fn next_command(&self) -> Option<TakeCommand> {
        self.next(&self.commands)
    }

    fn next<T>(&self, queue: &Receiver<T>) -> Option<T> {
        let next = queue.try_recv().ok()?;
        self.n_queued.fetch_sub(1, Ordering::AcqRel);
        Some(next)
    }
}

/// Sends commands for takes. One take at a time: each is ended before the next is begun.
#[derive(Debug)]
pub struct CommandSender {
    n_queued: Arc<AtomicUsize>,
    marks: Sender<MarkRequest>,
    commands: Sender<TakeCommand>,
}

pub(super) fn command_channel() -> (CommandSender, CommandReceiver) {
    let (marks, marks_out) = bounded(MARKS_MAX);
    let (commands, commands_out) = bounded(TAKE_COMMANDS_MAX);
    let n_queued = Arc::new(AtomicUsize::new(0));
    let takes = CommandSender { n_queued: Arc::clone(&n_queued), marks, commands };
    (takes, CommandReceiver { n_queued, marks: marks_out, commands: commands_out })
}

impl CommandSender {
    /// Begins a take at the next frame, or at an earlier one from the pre-roll.
    ///
    /// # Errors
    /// When earlier commands are still waiting.
    pub fn begin(&mut self, take: NewTake) -> anyhow::Result<TakeHandle> {
        let (reply, handle) = reply_channel();
        self.send_for_take(TakeCommand::Begin(Box::new(take), reply))?;
        Ok(handle)
    }

    /// Ends the take with the last frame that came. [`TakeHandle::ended`] receives the result.
    ///
    /// # Errors
    /// When earlier commands are still waiting.
    pub fn end(&mut self, ending: EndingKind) -> anyhow::Result<()> {
        self.send_for_take(TakeCommand::End(ending))
    }

    /// Writes the pre-roll to a take and closes it.
    ///
    /// # Errors
    /// When earlier commands are still waiting.
    pub fn save(&mut self, take: NewTake) -> anyhow::Result<TakeHandle> {
        let (reply, handle) = reply_channel();
        self.send_for_take(TakeCommand::Save(Box::new(take), reply))?;
        Ok(handle)
    }

    /// Sets a mark at the next frame. Dropping the returned handle before cancels it.
    ///
    /// # Errors
    /// When too many marks wait.
    pub fn mark(&self, text: &str, host_ns: u64) -> anyhow::Result<PendingMark> {
        let ((row, row_out), request) = (bounded(1), Arc::new(()));
        let event = Event::new(EventKind::Mark, host_ns, text);
        let mark = MarkRequest { event, row, request: Arc::downgrade(&request) };
        ensure!(self.send(&self.marks, mark), "too many marks are waiting: try again in a moment");
        Ok(PendingMark { row: row_out, _request: request })
    }

    fn send_for_take(&self, command: TakeCommand) -> anyhow::Result<()> {
        let is_sent = self.send(&self.commands, command);
        ensure!(is_sent, "the writer is still busy with earlier commands: try again");
        Ok(())
    }

    /// Returns `false` when the queue is full. When the reader is gone, the take has ended with it: the closed reply
    /// channel tells the caller.
    fn send<T>(&self, queue: &Sender<T>, command: T) -> bool {
        // Counted before it is in the queue: then the reader polls again at the next frame.
        self.n_queued.fetch_add(1, Ordering::AcqRel);
        let sent = queue.try_send(command);
        if sent.is_err() {
            self.n_queued.fetch_sub(1, Ordering::AcqRel);
        }
        !matches!(sent, Err(TrySendError::Full(_)))
    }
}
