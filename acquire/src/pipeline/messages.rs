//! What the threads of the pipeline hand to each other.

use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_codec::BlockReport;
use mocapd_take::{
    record::{Channel, Event},
    stretch::Span,
};

use super::{
    Counts,
    commands::{TAKE_COMMANDS_MAX, TakeCommand},
    plan::{CLOCK_ITEMS_MAX, CONTROL_MAX},
};
use crate::clock::ClockItem;

/// A frame, by when it was.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Moment {
    pub(super) device_ticks: u64,
    pub(super) arrival_ns: u64,
}

/// A closed stretch.
#[derive(Debug, Clone, Copy)]
pub(super) struct StretchEnd {
    pub(super) span: Span,
    /// Its first recorded row, and when the last one arrived.
    pub(super) first: Moment,
    pub(super) last_arrival_ns: u64,
    /// Channels that have rows in it: the first so many slots.
    pub(super) n_channels: usize,
    /// No other follows.
    pub(super) last: bool,
}

/// What a group is told: the time line's group also gets the counters as they were.
#[derive(Debug, Clone, Copy)]
pub(super) struct Job {
    pub(super) stretch: u64,
    pub(super) end: StretchEnd,
    pub(super) counts: Option<Counts>,
}

/// What one group made of one stretch.
#[derive(Debug)]
pub(super) struct Part {
    pub(super) stretch: u64,
    pub(super) end: StretchEnd,
    /// Which group; the time line's is the last.
    pub(super) group: usize,
    /// The group's block with its length, or the front with its time line. Goes back to the group when written.
    pub(super) bytes: Vec<u8>,
    pub(super) report: PartReport,
    /// From the time line's group.
    pub(super) counts: Option<Counts>,
}

/// What the encoders of a part proved.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct PartReport {
    pub(super) samples: u64,
    pub(super) kept: u64,
    pub(super) max_error_mm: f64,
    /// Blocks that the encoder refused: a fault of this program, told in the ledger.
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

/// What the reader tells the writer beside the samples.
#[derive(Debug)]
pub(super) enum Control {
    Channel(NewChannel),
    Event(Event),
}

/// The reader's ends of its queues to the writer.
#[derive(Debug)]
pub(super) struct ToWriter {
    /// With the stretch that was open then: it stands before that one.
    pub(super) control: Sender<(u64, Control)>,
    pub(super) clock: Sender<ClockItem>,
    /// With the number of the boundary that they are carried out at.
    pub(super) commands: Sender<(u64, TakeCommand)>,
}

/// The writer's ends of them.
#[derive(Debug)]
pub(super) struct FromReader {
    pub(super) control: Receiver<(u64, Control)>,
    pub(super) clock: Receiver<ClockItem>,
    pub(super) commands: Receiver<(u64, TakeCommand)>,
}

/// Bounded queues from the reader to the writer.
pub(super) fn reader_to_writer() -> (ToWriter, FromReader) {
    let (control_in, control) = bounded(CONTROL_MAX);
    let (clock_in, clock) = bounded(CLOCK_ITEMS_MAX);
    // One more: a take that waited for its device, and the command that overtook it.
    let (commands_in, commands) = bounded(TAKE_COMMANDS_MAX + 1);
    let to_writer = ToWriter { control: control_in, clock: clock_in, commands: commands_in };
    (to_writer, FromReader { control, clock, commands })
}

/// A marker that appeared.
#[derive(Debug)]
pub(super) struct NewChannel {
    pub(super) slot: usize,
    pub(super) marker_id: u16,
    /// Label, and whether the device knows the marker; without one it is named by its slot.
    pub(super) named: Option<(String, bool)>,
}

impl NewChannel {
    pub(super) fn into_channel(self) -> Channel {
        let (label, labelled) = self.named.unwrap_or_default();
        let label = if label.is_empty() { Channel::unlabelled_name(self.slot) } else { label };
        Channel { marker_id: self.marker_id, label, labelled }
    }
}
