//! What was seen of the clocks, into the take: seldom, because each record costs some fifty bytes.

use std::{
    io::Write,
    time::{Duration, Instant},
};

use anyhow::Context;
use crossbeam_channel::Receiver;
use mocapd_take::{
    TakeWriter,
    record::{Clock, ClockPoint, ClockProbe},
};

use crate::clock::{ClockItem, ClockStatus};

/// Round trips, or points, that wait for a record at most: those of a minute are sixteen and twelve.
const HELD_MAX: usize = 256;

/// Until the first record: before, little is known. A recording that is killed by then has the line in its ledger.
const FIRST_AFTER: Duration = Duration::from_secs(8);

/// Holds what comes until a record is written.
#[derive(Debug)]
pub(super) struct ClockWriter {
    items: Receiver<ClockItem>,
    segment: u32,
    begun: Instant,
    probes: Vec<ClockProbe>,
    points: Vec<ClockPoint>,
}

impl ClockWriter {
    pub(super) fn new(items: Receiver<ClockItem>) -> Self {
        let (probes, points) = (Vec::with_capacity(HELD_MAX), Vec::with_capacity(HELD_MAX));
        Self { items, segment: 0, begun: Instant::now(), probes, points }
    }

    /// Takes in what came, and writes it when a record is due, the segment is another one, or enough is held.
    pub(super) fn write<W: Write>(
        &mut self,
        take: &mut TakeWriter<W>,
        status: &ClockStatus,
        is_due: bool,
    ) -> anyhow::Result<()> {
        while let Ok(item) = self.items.try_recv() {
            let (ClockItem::Point(segment, _) | ClockItem::Probe(segment, _)) = item;
            if segment != self.segment {
                self.record(take, status)?;
                self.segment = segment;
            }
            match item {
                ClockItem::Point(_, point) => self.points.push(point),
                ClockItem::Probe(_, probe) => self.probes.push(probe),
            }
            if self.points.len().max(self.probes.len()) >= HELD_MAX {
                self.record(take, status)?;
            }
        }
        if is_due && self.begun.elapsed() >= FIRST_AFTER {
            self.record(take, status)?;
        }
        Ok(())
    }

    /// Writes what is left.
    pub(super) fn finish<W: Write>(
        &mut self,
        take: &mut TakeWriter<W>,
        status: &ClockStatus,
    ) -> anyhow::Result<()> {
        self.write(take, status, false)?;
        self.record(take, status)
    }

    fn record<W: Write>(
        &mut self,
        take: &mut TakeWriter<W>,
        status: &ClockStatus,
    ) -> anyhow::Result<()> {
        if self.probes.is_empty() && self.points.is_empty() {
            return Ok(());
        }
        let mut clock = Clock {
            segment: self.segment,
            tick_hz: status.tick_hz,
            // The line is that of the segment that runs.
            line: status.line.filter(|_| status.segment == self.segment),
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
