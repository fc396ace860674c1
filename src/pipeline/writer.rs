//! The writer thread: parts become stretches, stretches go to disk.

mod assembly;
mod clocks;
mod ledgers;
mod output;
mod room;

use std::{
    io::Write,
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use anyhow::{Context, anyhow, bail};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use mocapd_take::TakeWriter;

pub(crate) use self::room::HELD_MIN_BYTES;
use self::{assembly::Assemblies, clocks::ClockWriter, ledgers::Ledgers, room::Room};
pub use self::{
    output::{TakeOutput, Written},
    room::DiskState,
};
use super::{
    Counts, Progress,
    messages::{Control, FromReader, Part, PartReport},
    plan::Plan,
    pool::Wakes,
};

/// How long to wait for parts after a worker failed.
const GIVE_UP_AFTER: Duration = Duration::from_secs(2);

/// Owns the take file.
#[derive(Debug)]
pub(super) struct Writer<W> {
    take: TakeWriter<W>,
    parts: Receiver<Part>,
    control: Receiver<Control>,
    clocks: ClockWriter,
    /// Read from `control`, but its stretch is not written yet.
    held: Option<Control>,
    buffers_back: Vec<Sender<Vec<u8>>>,
    wakes: Wakes,
    progress: Arc<Progress>,
    assemblies: Assemblies,
    payload: Vec<u8>,
    report: PartReport,
    counts: Counts,
    sync_every: Duration,
    synced_bytes: u64,
    last_sync: Option<Instant>,
    ledgers: Ledgers,
    room: Room,
}

impl<W: TakeOutput> Writer<W> {
    pub(super) fn new(
        take: TakeWriter<W>,
        plan: &Plan,
        parts: Receiver<Part>,
        from_reader: FromReader,
        buffers_back: Vec<Sender<Vec<u8>>>,
        wakes: Wakes,
        progress: &Arc<Progress>,
    ) -> Self {
        Self {
            take,
            parts,
            control: from_reader.control,
            clocks: ClockWriter::new(from_reader.clock),
            held: None,
            buffers_back,
            wakes,
            progress: Arc::clone(progress),
            assemblies: Assemblies::new(plan),
            payload: Vec::with_capacity(plan.stretch_bytes_max()),
            report: PartReport::default(),
            counts: Counts::default(),
            sync_every: plan.sync_every,
            synced_bytes: 0,
            last_sync: None,
            ledgers: Ledgers::default(),
            room: Room::new(plan.keep_free_bytes),
        }
    }

    /// Writes until the last stretch. After an error the parts are still taken, so that the reader
    /// and the workers come to their end; what was written before stays.
    pub(super) fn run(mut self) -> anyhow::Result<(Written, W)> {
        let mut error = None;
        let mut silent_since = Instant::now();
        self.look_at_disk();
        loop {
            match self.parts.recv_timeout(self.sync_every.min(GIVE_UP_AFTER)) {
                Ok(part) => {
                    silent_since = Instant::now();
                    self.assemblies.add(part);
                }
                Err(RecvTimeoutError::Timeout) => {
                    if error.is_none() {
                        error = self.sync_what_waits().err();
                        self.look_at_disk();
                    }
                    let failed = self.progress.failed.load(Ordering::Relaxed);
                    if failed && silent_since.elapsed() > GIVE_UP_AFTER {
                        return Err(error.unwrap_or_else(|| anyhow!("a resampler thread failed")));
                    }
                }
                // The groups hold the senders, and the writer holds the groups' wakes.
                Err(RecvTimeoutError::Disconnected) => bail!("the resampler threads are gone"),
            }
            while let Some(last) = self.assemblies.front_last() {
                if error.is_none() {
                    error = self.write_front().err();
                    if error.is_some() {
                        self.progress.failed.store(true, Ordering::Relaxed);
                    }
                }
                self.give_back();
                if last {
                    return match error {
                        None => self.finish(),
                        Some(error) => Err(self.give_up(error)),
                    };
                }
            }
        }
    }

    fn write_front(&mut self) -> anyhow::Result<()> {
        let Some(front) = self.assemblies.front() else { return Ok(()) };
        let Some((timeline, blocks)) = front.parts() else { return Ok(()) };
        self.payload.clear();
        self.payload.extend_from_slice(&timeline.bytes);
        for part in blocks {
            self.payload.extend_from_slice(&part.bytes);
            self.report.add(&part.report);
        }
        self.counts = timeline.counts.unwrap_or(self.counts);
        write_control(&mut self.take, &self.control, &mut self.held, front.stretch)?;
        // The last one has neither rows nor, when nothing was lost at the end, a front.
        if !timeline.bytes.is_empty() {
            self.take.stretch(front.end.span, &self.payload).context("cannot write a stretch")?;
        }
        if !front.end.last {
            self.write_ledger_and_sync()?;
        }
        self.progress.file_bytes.store(self.take.bytes(), Ordering::Relaxed);
        self.progress.samples.store(self.report.samples, Ordering::Relaxed);
        if let Some(line) = self.counts.clock.line {
            self.progress.drift_ppb.store(line.drift_ppb, Ordering::Relaxed);
            let p99_us = self.counts.clock.jitter.p99_us;
            self.progress.jitter_p99_us.store(p99_us, Ordering::Relaxed);
        }
        Ok(())
    }

    fn look_at_disk(&mut self) {
        let written = self.take.bytes();
        self.room.look(self.take.get_mut(), written, &self.progress, Instant::now());
    }

    fn write_ledger_and_sync(&mut self) -> anyhow::Result<()> {
        let ledger_is_due = self.ledgers.are_due(&self.counts, Instant::now());
        self.clocks.write(&mut self.take, &self.counts.clock, ledger_is_due)?;
        if ledger_is_due {
            self.take.ledger(&self.counts.ledger(false)).context("cannot write the ledger")?;
        }
        self.look_at_disk();
        if self.last_sync.is_none_or(|last| last.elapsed() >= self.sync_every) {
            self.sync_what_waits()?;
        }
        Ok(())
    }

    fn sync_what_waits(&mut self) -> anyhow::Result<()> {
        if self.synced_bytes < self.take.bytes() {
            self.take.get_mut().sync().context("cannot sync the take to disk")?;
            self.synced_bytes = self.take.bytes();
            self.last_sync = Some(Instant::now());
        }
        Ok(())
    }

    /// The front's buffers go back to their groups, which may have waited for them.
    fn give_back(&mut self) {
        let Self { assemblies, buffers_back, wakes, .. } = self;
        assemblies.pop_front(|part| {
            drop(buffers_back[part.group].try_send(part.bytes));
            wakes.wake(part.group);
        });
    }

    /// What was held for the rest is nobody's: the part that was written stays.
    fn give_up(&mut self, error: anyhow::Error) -> anyhow::Error {
        let written = self.take.bytes();
        // A disk that failed may fail here, too.
        self.take.get_mut().release(written).ok();
        error
    }

    fn finish(mut self) -> anyhow::Result<(Written, W)> {
        let clock_lines = self.clocks.finish(&mut self.take, &self.counts.clock)?;
        let mut ledger = self.counts.ledger(true);
        if self.report.refused > 0 {
            ledger.contradictions.push(format!(
                "{} blocks were refused by the codec: this is a bug in mocapd",
                self.report.refused
            ));
        }
        let closing = "cannot close the take";
        let mut output = self.take.finish(&ledger).context(closing)?;
        output.0.release(output.1).context(closing)?;
        output.0.sync().context(closing)?;
        let written = Written {
            ledger,
            clock: self.counts.clock,
            clock_lines,
            disk: self.room.close(&output.0),
            file_bytes: output.1,
            samples: self.report.samples,
            kept: self.report.kept,
            max_error_mm: self.report.max_error_mm,
        };
        Ok((written, output.0))
    }
}

/// What must stand in the take before stretch `stretch`, and every event so far.
fn write_control<W: Write>(
    take: &mut TakeWriter<W>,
    control: &Receiver<Control>,
    held: &mut Option<Control>,
    stretch: u64,
) -> anyhow::Result<()> {
    while let Some(message) = held.take().or_else(|| control.try_recv().ok()) {
        match message {
            Control::Channel(new) if new.stretch > stretch => {
                *held = Some(Control::Channel(new));
                return Ok(());
            }
            Control::Channel(new) => {
                take.channels(&[new.into_channel()]).context("cannot write a new channel")?;
            }
            Control::Event(event) => take.event(&event).context("cannot write an event")?,
        }
    }
    Ok(())
}
