//! What was seen of the clocks, into the take: seldom, because each record costs some fifty bytes.

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

/// Round trips, or points, that a record is written for, though none is due: those of a minute are sixteen and twelve.
/// With all that can wait in the queue ([`CLOCK_ITEMS_MAX`](crate::pipeline::plan::CLOCK_ITEMS_MAX)) they are fewer than
/// a record may hold.
const HELD_MAX: usize = 256;

/// Observations of each kind that a line is laid through, at most: 16 bursts of 8 round trips, and 48 points. A take
/// that begins later has them, too.
const RECENT_MAX: usize = 128;

/// Segments that are told of one by one at the end: a device is plugged in again so often in a long day. The take
/// has each one's line.
const LINES_MAX: usize = 256;

/// Until the first record: before, little is known. A recording that is killed by then has the line in its ledger.
const FIRST_AFTER: Duration = Duration::from_secs(8);

/// Holds what comes until a record is written.
///
/// Observations come on a queue of their own, and are many seconds ahead of the stretches when the disk stalled. A status
/// says how many of them it knows: with it no more than these are taken, so that a record has the line that its
/// observations give.
#[derive(Debug)]
pub(super) struct ClockWriter {
    items: Receiver<ClockItem>,
    /// How many were taken from there.
    taken: u64,
    /// As of the last of these.
    status: ClockStatus,
    segment: u32,
    begun: Instant,
    probes: Vec<ClockProbe>,
    points: Vec<ClockPoint>,
    /// Of the segment, whether they are in a take or not.
    recent_probes: VecDeque<ClockProbe>,
    recent_points: VecDeque<ClockPoint>,
    /// Of the segment, when that is over.
    line: Option<ClockLine>,
    lines: Vec<(u32, ClockLine)>,
}

impl ClockWriter {
    pub(super) fn new(items: Receiver<ClockItem>) -> Self {
        let (probes, points) = (Vec::with_capacity(HELD_MAX), Vec::with_capacity(HELD_MAX));
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

    /// A take begins where the observations were taken up to: what the line is laid through belongs into it, though it
    /// was seen before.
    pub(super) fn begin(&mut self) {
        self.enter(self.status.segment);
        self.begun = Instant::now();
        self.probes.clear();
        self.points.clear();
        self.probes.extend(&self.recent_probes);
        self.points.extend(&self.recent_points);
        self.line = None;
        self.lines.clear();
    }

    /// One that nothing comes to.
    pub(super) fn idle() -> Self {
        Self::new(never())
    }

    /// For a take beside the one that is written, which ends where the observations were taken up to.
    pub(super) fn beside(&self) -> Self {
        let mut beside = Self::idle();
        (beside.taken, beside.status) = (self.taken, self.status);
        beside.segment = self.status.segment;
        // Of the one before, nothing is to be said of this one.
        if self.segment == beside.segment {
            beside.probes.extend(&self.recent_probes);
            beside.points.extend(&self.recent_points);
        }
        beside
    }

    fn enter(&mut self, segment: u32) {
        if segment != self.segment {
            self.segment = segment;
            self.recent_probes.clear();
            self.recent_points.clear();
        }
    }

    /// Takes in what came up to the moment of `status`, and writes it when a record is due, the segment is another one, or
    /// enough is held; without a take, it keeps what the next one needs. An older status than the last one says nothing.
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
            // What a status knows was sent before it.
            let Ok(item) = self.items.try_recv() else { break };
            self.taken += 1;
            let (ClockItem::Point(segment, _)
            | ClockItem::Probe(segment, _)
            | ClockItem::Line(segment, _)) = item;
            if segment != self.segment {
                self.record(take.as_deref_mut())?;
                self.enter(segment);
            }
            match item {
                ClockItem::Point(_, point) => {
                    self.points.push(point);
                    keep(&mut self.recent_points, point);
                }
                ClockItem::Probe(_, probe) => {
                    self.probes.push(probe);
                    keep(&mut self.recent_probes, probe);
                }
                ClockItem::Line(_, line) => self.line = Some(line),
            }
        }
        let is_full = self.points.len().max(self.probes.len()) >= HELD_MAX;
        if is_full || (is_due && self.begun.elapsed() >= FIRST_AFTER) {
            self.record(take)?;
        }
        Ok(())
    }

    /// Writes what is left. The line of each segment that had one.
    pub(super) fn finish<W: Write>(
        &mut self,
        take: &mut TakeWriter<W>,
        status: &ClockStatus,
    ) -> anyhow::Result<Vec<(u32, ClockLine)>> {
        self.write(Some(&mut *take), status, false)?;
        self.record(Some(take))?;
        let last = status.line.map(|line| (status.segment, line));
        self.lines.extend(last);
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
        // Of the segment that runs, the line is the newest.
        let running = status.line.filter(|_| status.segment == self.segment);
        let mut clock = Clock {
            segment: self.segment,
            tick_hz: status.tick_hz,
            line: ended.or(running),
            jitter: status.jitter,
            probes: std::mem::take(&mut self.probes),
            points: std::mem::take(&mut self.points),
        };
        take.clock(&clock).context("cannot write what was seen of the clocks")?;
        clock.probes.clear();
        clock.points.clear();
        (self.probes, self.points) = (clock.probes, clock.points);
        Ok(())
    }
}

/// The newest few.
fn keep<T>(recent: &mut VecDeque<T>, item: T) {
    if recent.len() == RECENT_MAX {
        recent.pop_front();
    }
    recent.push_back(item);
}
