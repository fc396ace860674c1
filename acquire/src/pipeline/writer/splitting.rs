//! Dividing a recording into takes that follow each other, with each frame in exactly one of them.
//!
//! The reader decides where: at a row, or, for a limit of bytes, at the first end of a stretch after the writer has
//! found the take long enough. It sends a boundary behind the last row of the take, and the next stretch is a key. When
//! the writer reaches the boundary, it ends the take and begins the next one.
//!
//! That costs the disk a new file and a few syncs, and no frame: meanwhile up to 64 encoded stretches wait
//! (`ENCODED_STRETCHES` in `plan.rs`), as when a disk stalls. At two stretches a second that is 32 s. Each take adds a
//! boundary and a short stretch, so with takes of one second it is 16 s.

use std::{fmt, sync::atomic::Ordering};

use anyhow::anyhow;
use crossbeam_channel::Sender;
use mocapd_take::record::{EndingKind, Event, TakeEnding};

use super::{LiveTake, TakePlace, Writer};
use crate::{
    files::FileState,
    pipeline::{
        NewTake, TakeFailed, TakeResult,
        messages::{Reply, StretchEnd},
        plan::CONTROL_MAX,
    },
};

/// Events that wait for the next take: as many as may wait for the writer. More go into the open take.
const HELD_EVENTS_MAX: usize = CONTROL_MAX;

/// How a recording is divided, and where the writer is.
#[derive(Debug)]
pub(super) struct SplitState {
    at: SplitAt,
    takes: Box<dyn TakeSeries>,
    /// The row at which the open take ends, if it ends at a row and no frames are lost there.
    end_row: u64,
    /// The length at which the open take ends, if it ends at a length.
    end_bytes: u64,
    /// Whether the reader was asked to end it.
    is_asked: bool,
    /// Events from `end_row` on. They came before the boundary, but belong to the next take.
    held_events: Vec<Event>,
}

impl SplitState {
    pub(super) fn new(split: Split) -> Self {
        let (at, takes) = (split.at, split.takes);
        let mut new =
            Self { at, takes, end_row: 0, end_bytes: 0, is_asked: false, held_events: Vec::new() };
        new.begin(0, 0);
        new
    }

    /// The open take begins, or continues, at this row and byte.
    fn begin(&mut self, row: u64, byte: u64) {
        self.is_asked = false;
        (self.end_row, self.end_bytes) = match self.at {
            SplitAt::Rows { rows, .. } => (row.saturating_add(rows), u64::MAX),
            SplitAt::Bytes(bytes) => (u64::MAX, byte.saturating_add(bytes)),
        };
    }
}

impl Writer {
    /// Asks the reader to end the take that was just written to, if it is long enough.
    pub(super) fn ask_for_split(&mut self) {
        let Some(split) = &mut self.split else { return };
        let written = self.progress.file_bytes.load(Ordering::Relaxed);
        if written >= split.end_bytes && !split.is_asked {
            split.is_asked = true;
            self.progress.split_is_due.store(true, Ordering::Relaxed);
        }
    }

    /// Keeps an event that belongs to the next take, or returns it.
    pub(super) fn hold_event(&mut self, event: Event, end: &StretchEnd) -> Option<Event> {
        let Some(split) = &mut self.split else { return Some(event) };
        let is_at_boundary = end.splits && event.row >= end.span.first_row;
        let is_next = event.row >= split.end_row || is_at_boundary;
        if !is_next || split.held_events.len() >= HELD_EVENTS_MAX {
            return Some(event);
        }
        split.held_events.push(event);
        None
    }

    /// Writes the events that were kept, up to a row, to the open take.
    pub(super) fn apply_held_events(&mut self, end_row: u64) {
        let Some(split) = &mut self.split else { return };
        let (now, later) = std::mem::take(&mut split.held_events)
            .into_iter()
            .partition::<Vec<_>, _>(|event| event.row < end_row);
        split.held_events = later;
        for event in now {
            self.with_take(|take, _| take.event(&event));
        }
    }

    /// Divides the recording before `first_row`. If the next take cannot begin, the open one continues; it then gets
    /// the channels behind the first `n_channels`, which appeared at this boundary.
    pub(super) fn split(&mut self, first_row: u64, n_channels: usize) {
        self.apply_held_events(first_row);
        if !self.begin_next(first_row) {
            let written = self.progress.file_bytes.load(Ordering::Relaxed);
            if let Some(split) = &mut self.split {
                split.begin(first_row, written);
            }
            let appeared: Vec<_> = self.table.iter().skip(n_channels).cloned().collect();
            for (_, channel) in appeared {
                self.with_take(|take, _| take.channel(&channel));
            }
        }
        self.apply_held_events(u64::MAX);
    }

    /// Begins the next take, then closes the open one: the header shows whether the disk still takes a new file, and
    /// what was reserved for the open take is released before the next one reserves. Returns `false` if the open take
    /// continues.
    fn begin_next(&mut self, first_row: u64) -> bool {
        let progress = &self.progress;
        // The reader is ending the recording.
        let ends = progress.disk_full.load(Ordering::Relaxed) || progress.file_state().ends_take();
        let (Some(split), Some(_), false) = (&mut self.split, &self.live, ends) else {
            return false;
        };
        let goes_on = "the recording continues in the previous take";
        let NextTake { mut take, name, ended, notice } = match split.takes.next_take(first_row) {
            Ok(next) => next,
            Err(error) => {
                progress.add_notice(format!("{error:#}; {goes_on}"));
                return false;
            }
        };
        take.header.channels = self.table.iter().map(|(_, channel)| channel.clone()).collect();
        let (reply, base) = (Reply::of_series(ended), self.counts.in_rows());
        let place = TakePlace { base, rows_before: first_row };
        let begun = LiveTake::begin(take, &reply, place, &self.samples.groups, self.sync_every);
        let mut next = match begun {
            Ok(next) => next,
            Err(error) => {
                progress.add_notice(format!("{name}: {error:#}; {goes_on}"));
                reply.ended.try_send(Err(TakeFailed::without_output(error))).ok();
                return false;
            }
        };
        next.reserve(self.payload.capacity(), self.samples.block_bytes_max());
        let Some(open) = self.live.take() else { return false };
        let ending = TakeEnding::new(EndingKind::Length, format!("continued in {name}"));
        let is_closed = open.end(&base, &mut self.clocks, ending);
        split.begin(first_row, 0);
        self.clocks.begin();
        progress.set_file_state(FileState::InPlace, None);
        progress.takes_begun.fetch_add(1, Ordering::Relaxed);
        notice.into_iter().for_each(|notice| progress.add_notice(notice));
        if is_closed {
            next.poll_disk(progress);
            next.publish(progress);
            self.live = Some(next);
        } else {
            // As for any write that fails.
            progress.failed.store(true, Ordering::Relaxed);
            next.fail(anyhow!("the previous take could not be closed"));
        }
        true
    }
}

/// When a take of a divided recording is long enough.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SplitAt {
    /// At each multiple of a number of rows, lost ones included. If no frame came between two of them, the take
    /// continues to the next: no take is without a frame.
    Rows {
        /// Rows of a take, at least those of a stretch.
        rows: u64,
        /// From this row on, nothing is divided: the recording ends there, and frames that come until the device has
        /// stopped belong to the last take.
        end_row: Option<u64>,
    },
    /// At the first end of a stretch at which the file has this many bytes. Stretches that are being encoded at that
    /// moment still belong to it: usually one.
    Bytes(u64),
}

/// A take of a divided recording.
#[derive(Debug)]
pub struct NextTake {
    /// The take.
    pub take: NewTake,
    /// Its name, which the ending of the take before it states.
    pub name: String,
    /// Receives its result; has room for it.
    pub ended: Sender<TakeResult>,
    /// A message for the user about it.
    pub notice: Option<String>,
}

/// Creates the takes of a divided recording, in order.
pub trait TakeSeries: Send {
    /// Creates the take that begins at this row of the recording. Runs on the writer's thread: it may wait for the
    /// disk, but for nothing else.
    ///
    /// # Errors
    /// When its file cannot be created. The take before it then continues, and the next one is tried when that is due.
    fn next_take(&mut self, first_row: u64) -> anyhow::Result<NextTake>;
}

impl fmt::Debug for dyn TakeSeries {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TakeSeries")
    }
}

/// How to divide a recording.
#[derive(Debug)]
pub struct Split {
    /// When a take is long enough.
    pub at: SplitAt,
    /// Creates the takes.
    pub takes: Box<dyn TakeSeries>,
}

/// The next place at which the recording is divided.
#[derive(Debug, Clone, Copy)]
pub(in crate::pipeline) enum SplitSchedule {
    Never,
    /// At row `next`, and every `every` rows after it, as long as that is before `end`.
    Rows {
        every: u64,
        next: u64,
        end: u64,
    },
    /// Whenever the writer asks.
    OnRequest,
}

impl SplitSchedule {
    pub(in crate::pipeline) fn new(at: SplitAt) -> Self {
        match at {
            SplitAt::Rows { rows, end_row } => {
                let every = rows.max(1);
                Self::Rows { every, next: every, end: end_row.unwrap_or(u64::MAX) }
            }
            SplitAt::Bytes(_) => Self::OnRequest,
        }
    }

    /// Whether a division is due at or before this row; by size, the writer decides.
    pub(in crate::pipeline) fn is_due(self, row: u64) -> bool {
        matches!(self, Self::Rows { next, end, .. } if row >= next && next < end)
    }

    /// If a frame of this row begins a new take: that take's first row, which lies before `row` if lost frames lie
    /// between. `is_asked`: the writer has asked for a new take.
    pub(in crate::pipeline) fn take_due(&mut self, row: u64, is_asked: bool) -> Option<u64> {
        let is_due = self.is_due(row);
        match self {
            Self::Never => None,
            Self::Rows { every, next, .. } => is_due.then(|| {
                let first_row = *next;
                // Skips divisions that lie within a loss: a take without a frame would be empty.
                *next = (row / *every).saturating_add(1).saturating_mul(*every);
                first_row
            }),
            Self::OnRequest => is_asked.then_some(row),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_end_at_multiples_and_are_never_empty() {
        let mut splits = SplitSchedule::new(SplitAt::Rows { rows: 10, end_row: Some(60) });
        let firsts = |splits: &mut SplitSchedule, rows: &[u64]| -> Vec<Option<u64>> {
            rows.iter().map(|&row| splits.take_due(row, true)).collect()
        };
        assert_eq!(firsts(&mut splits, &[0, 9, 10, 11]), [None, None, Some(10), None]);
        // Three places lie in a gap: the first counts, and the next is after the frame.
        assert_eq!(firsts(&mut splits, &[19, 47, 49, 50]), [None, Some(20), None, Some(50)]);
        assert_eq!(firsts(&mut splits, &[60, 75]), [None, None], "the recording ends there");
        let mut never = SplitSchedule::Never;
        assert_eq!(firsts(&mut never, &[0, 10]), [None, None]);
        let mut asked = SplitSchedule::new(SplitAt::Bytes(1));
        assert_eq!([asked.take_due(7, false), asked.take_due(8, true)], [None, Some(8)]);
    }
}
