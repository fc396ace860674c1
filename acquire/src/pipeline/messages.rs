//! Messages between the threads of the pipeline.

use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_codec::{BlockReport, poses::PoseErrors};
use mocapd_take::{
    record::{Channel, Event},
    statistics::{BlockTally, StretchTally},
    stretch::Span,
    timeline::LossCauses,
};

use super::{
    Counts,
    commands::{TAKE_COMMANDS_MAX, TakeCommand},
    plan::{CLOCK_ITEMS_MAX, CONTROL_MAX},
};
use crate::clock::ClockItem;

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
    Block { n: u32, key: bool, time: BlockTime, errors: PoseErrors, block: Vec<u8> },
    Lost { n: u64, causes: LossCauses, buffer: Vec<u8> },
    Boundary,
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
