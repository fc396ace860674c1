//! Writes clock observations to the take: rarely, because each record costs some fifty bytes.

use std::{
    collections::VecDeque,
    io::Write,
    time::{Duration, Instant},
};

use anyhow::Context;
use crossbeam_channel::{Receiver, never};
use mocapd_take::{
    TakeWriter,
    record::{Clock, ClockLine, ClockPoint, ClockProbe},
};

use crate::clock::{ClockItem, ClockStatus};

/// Round trips, or points, that force a record when none is due: a minute has sixteen and twelve.
/// With all that can wait in the queue ([`CLOCK_ITEMS_MAX`](crate::pipeline::plan::CLOCK_ITEMS_MAX)) they are fewer
/// than a record may hold.
const BUFFERED_MAX: usize = 256;

/// Maximum number of observations of each kind that a line is fitted to: 16 bursts of 8 round trips, and 48 points.
/// They are copied to a take that begins later.
const RECENT_MAX: usize = 128;

/// Segments listed one by one at the end: more than a device's reconnections in a long day. The
/// take has the line of every segment.
const LINES_MAX: usize = 256;

/// Time until the first record: earlier, little is known. A recording killed before has the line in its ledger.
const FIRST_AFTER: Duration = Duration::from_secs(8);

/// Buffers clock observations until a record is written.
///
/// Observations arrive on their own queue, many seconds ahead of the stretches when the disk stalls. A status states
/// how many of them it includes; no more than these are taken with it, so that the line in a record is the one that its
/// observations give.
#[derive(Debug)]
pub(super) struct ClockWriter {
    items: Receiver<ClockItem>,
    /// Number of items taken from the queue.
    taken: u64,
    /// The status at the last of these.
    status: ClockStatus,
    segment: u32,
    begun: Instant,
    probes: Vec<ClockProbe>,
    points: Vec<ClockPoint>,
    /// Recent observations of the segment, stored in a take or not.
    recent_probes: VecDeque<ClockProbe>,
    recent_points: VecDeque<ClockPoint>,
    /// The segment's line, once the segment is over.
    line: Option<ClockLine>,
    lines: Vec<(u32, ClockLine)>,
}

impl ClockWriter {
    pub(super) fn new(items: Receiver<ClockItem>) -> Self {
        let (probes, points) = (Vec::with_capacity(BUFFERED_MAX), Vec::with_capacity(BUFFERED_MAX));
        Self {
            items,
            taken: 0,
            status: ClockStatus::default(),
            segment: 0,
            begun: Instant::now(),
            probes,
            points,
            recent_probes: VecDeque::with_capacity(RECENT_MAX),
            recent_points: VecDeque::with_capacity(RECENT_MAX),
            line: None,
            lines: Vec::new(),
        }
    }

    /// Begins a take. The observations that the current line is fitted to belong to it, though they were made
    /// before.
    pub(super) fn begin(&mut self) {
        self.enter_segment(self.status.segment);
        self.begun = Instant::now();
        self.probes.clear();
        self.points.clear();
        self.probes.extend(&self.recent_probes);
        self.points.extend(&self.recent_points);
        self.line = None;
        self.lines.clear();
    }

    /// A writer without a source.
    pub(super) fn idle() -> Self {
        Self::new(never())
    }

    /// A writer for a take that is saved while another one is open; it ends with the observations taken so far.
    pub(super) fn for_saved_take(&self) -> Self {
        let mut saved = Self::idle();
        (saved.taken, saved.status) = (self.taken, self.status);
        saved.segment = self.status.segment;
        // Observations of the earlier segment do not belong to this one.
        if self.segment == saved.segment {
            saved.probes.extend(&self.recent_probes);
            saved.points.extend(&self.recent_points);
        }
        saved
    }

    fn enter_segment(&mut self, segment: u32) {
        if segment != self.segment {
            self.segment = segment;
            self.recent_probes.clear();
            self.recent_points.clear();
        }
    }

    /// Takes the items up to `status`, and writes them when a record is due, the segment changes, or the buffer is
    /// full. Without a take, it keeps what the next one needs. A status older than the last one is ignored.
    pub(super) fn write<W: Write>(
        &mut self,
        mut take: Option<&mut TakeWriter<W>>,
        status: &ClockStatus,
        is_due: bool,
    ) -> anyhow::Result<()> {
        if status.stored >= self.taken {
            self.status = *status;
        }
        while self.taken < status.stored {
            // The items that a status includes were sent before it.
            let Ok(item) = self.items.try_recv() else { break };
            self.taken += 1;
            let (ClockItem::Point(segment, _)
            | ClockItem::Probe(segment, _)
            | ClockItem::Line(segment, _)) = item;
            if segment != self.segment {
                self.record(take.as_deref_mut())?;
                self.enter_segment(segment);
            }
            match item {
                ClockItem::Point(_, point) => {
                    self.points.push(point);
                    push_recent(&mut self.recent_points, point);
                }
                ClockItem::Probe(_, probe) => {
                    self.probes.push(probe);
                    push_recent(&mut self.recent_probes, probe);
                }
                ClockItem::Line(_, line) => self.line = Some(line),
            }
        }
        let is_full = self.points.len().max(self.probes.len()) >= BUFFERED_MAX;
        if is_full || (is_due && self.begun.elapsed() >= FIRST_AFTER) {
            self.record(take)?;
        }
        Ok(())
    }

    /// Writes what is left, and returns the line of each segment that had one.
    pub(super) fn finish<W: Write>(
        &mut self,
        take: &mut TakeWriter<W>,
        status: &ClockStatus,
    ) -> anyhow::Result<Vec<(u32, ClockLine)>> {
        self.write(Some(&mut *take), status, false)?;
        self.record(Some(take))?;
        self.lines.extend(status.line.map(|line| (status.segment, line)));
        Ok(std::mem::take(&mut self.lines))
    }

    fn record<W: Write>(&mut self, take: Option<&mut TakeWriter<W>>) -> anyhow::Result<()> {
        let (ended, status) = (self.line.take(), self.status);
        let Some(take) = take else {
            self.probes.clear();
            self.points.clear();
            return Ok(());
        };
        if self.probes.is_empty() && self.points.is_empty() && ended.is_none() {
            return Ok(());
        }
        if self.lines.len() < LINES_MAX {
            self.lines.extend(ended.map(|line| (self.segment, line)));
        }
        // The running segment has the newest line.
        let running = status.line.filter(|_| status.segment == self.segment);
        let mut clock = Clock {
            segment: self.segment,
            tick_hz: status.tick_hz,
            line: ended.or(running),
            jitter: status.jitter,
            probes: std::mem::take(&mut self.probes),
            points: std::mem::take(&mut self.points),
        };
        take.clock(&clock).context("cannot write the clock observations")?;
        clock.probes.clear();
        clock.points.clear();
        (self.probes, self.points) = (clock.probes, clock.points);
        Ok(())
    }
}

/// Keeps the newest items.
fn push_recent<T>(recent: &mut VecDeque<T>, item: T) {
    if recent.len() == RECENT_MAX {
        recent.pop_front();
    }
    recent.push_back(item);
}
