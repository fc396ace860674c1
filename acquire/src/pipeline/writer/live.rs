//! The take that is being written.

use std::{
    path::PathBuf,
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use anyhow::Context;
use mocapd_codec::GROUP_CHANNELS;
use mocapd_take::{
    TakeWriter,
    record::{
        Channel, ClockLine, EndingKind, Event, EventKind, Ledger, SampleLedger, SampledGroup,
        TakeEnding,
    },
    sampled::RESIDUAL_GROUPS,
    stretch::{NUMBERS, Span, put_renumbered},
};

use super::{clocks::ClockWriter, samples::TakeSamples};
use crate::{
    clock::ClockStatus,
    files::FileState,
    pipeline::{
        Counts, FirstRow, NewTake, NothingRecorded, PipelineProgress, TakeAccount, TakeFailed,
        TakeOutput, TakeResult,
        disk::DiskReserve,
        lock,
        messages::{FrameTimes, PartReport, Reply, SamplePart, StretchReport},
        sampled::LATE_GROUPS,
    },
};

/// Where a take begins.
#[derive(Debug, Clone, Copy)]
pub(in crate::pipeline) struct TakePlace {
    /// The pipeline's counters before it.
    pub(in crate::pipeline) base: Counts,
    /// The pipeline's row that is its row 0.
    pub(in crate::pipeline) rows_before: u64,
}

impl TakePlace {
    /// That of the first take of a pipeline that is not armed.
    pub(in crate::pipeline) fn at_start() -> Self {
        Self { base: Counts::default(), rows_before: 0 }
    }
}

/// An open take, from its header to its footer.
#[derive(Debug)]
pub(in crate::pipeline) struct LiveTake {
    take: TakeWriter<Box<dyn TakeOutput>>,
    reply: Reply,
    /// The pipeline's counters before the take, and the pipeline's row that is its row 0.
    base: Counts,
    rows_before: u64,
    /// Whether an event says that the residuals of some markers are not recorded.
    states_missing_residuals: bool,
    next_number: u8,
    has_stretches: bool,
    first: Option<FirstRow>,
    first_reported: bool,
    shifted: Vec<u8>,
    report: PartReport,
    samples: TakeSamples,
    /// Whether it was closed before all its samples were encoded.
    misses_samples: bool,
    /// The last ledger of its samples, once it is closed.
    sample_ledger: Option<SampleLedger>,
    counts: Counts,
    sync_every: Duration,
    synced_bytes: u64,
    last_sync: Option<Instant>,
    ledgers: LedgerSchedule,
    disk: DiskReserve,
    /// The state of the file, and its present name if that changed.
    file_state: FileState,
    file_path: Option<PathBuf>,
}

impl LiveTake {
    /// Begins a take with these groups of sampled channels.
    pub(in crate::pipeline) fn begin(
        new: NewTake,
        reply: &Reply,
        place: TakePlace,
        groups: &[SampledGroup],
        sync_every: Duration,
    ) -> anyhow::Result<Self> {
        let started = TakeWriter::new(new.output, &new.header).and_then(|mut take| {
            new.subject.map_or(Ok(()), |subject| take.subject(&subject))?;
            let samples = TakeSamples::begin(groups, &mut take)?;
            Ok((take, samples))
        });
        let TakePlace { base, rows_before } = place;
        let (take, samples) =
            started.context("cannot write the take's header").context(NothingRecorded)?;
        let mut take = Self {
            take,
            reply: reply.clone(),
            base,
            rows_before,
            states_missing_residuals: false,
            next_number: 0,
            has_stretches: false,
            first: None,
            first_reported: false,
            shifted: Vec::new(),
            report: PartReport::default(),
            samples,
            misses_samples: false,
            sample_ledger: None,
            counts: Counts::default(),
            sync_every,
            synced_bytes: 0,
            last_sync: None,
            ledgers: LedgerSchedule::default(),
            disk: DiskReserve::new(new.keep_free_bytes),
            file_state: FileState::InPlace,
            file_path: None,
        };
        new.notes.map_or(Ok(()), |event| take.event(&event)).context(NothingRecorded)?;
        Ok(take)
    }

    /// Allocates the buffers, for stretches and blocks of samples of up to these sizes.
    pub(super) fn reserve(&mut self, stretch_bytes: usize, block_bytes: usize) {
        self.shifted.reserve(stretch_bytes);
        self.take.reserve_samples(block_bytes);
    }

    pub(super) fn channel(&mut self, channel: &Channel) -> anyhow::Result<()> {
        self.take.channels(std::slice::from_ref(channel)).context("cannot write a new channel")
    }

    /// Writes an event at a row of the pipeline.
    pub(super) fn event(&mut self, event: &Event) -> anyhow::Result<()> {
        let row = event.row.saturating_sub(self.rows_before);
        self.take.event(&Event { row, ..event.clone() }).context("cannot write an event")
    }

    /// States once, where a stretch begins, that there are channels whose residuals are not recorded.
    fn state_missing_residuals(&mut self, row: u64, first: FrameTimes) -> anyhow::Result<()> {
        if std::mem::replace(&mut self.states_missing_residuals, true) {
            return Ok(());
        }
        let residuals_max = RESIDUAL_GROUPS.len() * GROUP_CHANNELS;
        let text = format!(
            "there are markers whose residuals are not recorded: a recording has room for {residuals_max} markers, and \
             for those that appear after its start {LATE_GROUPS} times; start again to record the residuals of all"
        );
        self.event(&Event { row, ..Event::new(EventKind::Host, first.arrival_ns, text) })
    }

    /// Marks the pipeline's row at the time of the request, if there are rows before it.
    pub(super) fn mark_request(&mut self, row: u64, requested_ns: u64) -> anyhow::Result<()> {
        if !self.has_stretches {
            return Ok(());
        }
        let text = "the take was requested here: earlier rows are pre-roll";
        self.event(&Event { row, ..Event::new(EventKind::Host, requested_ns, text) })
    }

    /// Writes a stretch of the pipeline; `counts` are the counters at its end.
    pub(super) fn stretch(
        &mut self,
        span: Span,
        first: FrameTimes,
        payload: &[u8],
        report: &StretchReport,
        counts: &Counts,
    ) -> anyhow::Result<()> {
        if !self.has_stretches && !span.key {
            self.skip_to_key(span, counts);
            return Ok(());
        }
        self.report.add(&report.parts);
        self.counts = counts.since(&self.base);
        // The last stretch has no rows, and no header either if nothing was lost at the end.
        if payload.is_empty() {
            return Ok(());
        }
        if span.n_rows > 0 && report.lacks_residuals {
            self.state_missing_residuals(span.first_row, first)?;
        }
        let failure = "cannot write a stretch";
        self.has_stretches = true;
        let number = self.next_number;
        self.next_number = (number + 1) % NUMBERS;
        self.shifted.clear();
        put_renumbered(payload, self.rows_before, number, &mut self.shifted).context(failure)?;
        let first_row = span.first_row.saturating_sub(self.rows_before);
        let span = Span { first_row, number, ..span };
        self.take.stretch(span, &self.shifted, &report.tally).context(failure)?;
        if span.n_rows > 0 {
            let FrameTimes { device_ticks, arrival_ns } = first;
            let row = self.rows_before;
            self.first.get_or_insert(FirstRow { device_ticks, arrival_ns, row });
        }
        Ok(())
    }

    /// Writes samples of a group of sampled channels.
    pub(super) fn samples(&mut self, part: &SamplePart) -> anyhow::Result<()> {
        self.samples.write(part, &mut self.take).context("cannot write samples")
    }

    /// Describes a group that the take did not have.
    pub(super) fn open_samples(
        &mut self,
        index: usize,
        group: &SampledGroup,
    ) -> anyhow::Result<()> {
        let opened = self.samples.open(index, group, &mut self.take);
        opened.context("cannot describe the residuals of new markers")
    }

    /// Its last samples were not encoded in time.
    pub(super) fn miss_samples(&mut self) {
        self.misses_samples = true;
    }

    /// Skips rows lost before the first key, which no reader could use: a take requested while nothing came begins with
    /// what came next. The absence of the device is not the take's loss, but frames that arrived and found the rings
    /// full are.
    fn skip_to_key(&mut self, span: Span, counts: &Counts) {
        self.base = Counts { ring_full: self.base.ring_full, ..*counts };
        self.rows_before = span.first_row;
        self.counts = counts.since(&self.base);
    }

    /// Writes the clock observations up to this moment.
    pub(super) fn observe(
        &mut self,
        clocks: &mut ClockWriter,
        status: &ClockStatus,
    ) -> anyhow::Result<()> {
        clocks.write(Some(&mut self.take), status, false)
    }

    pub(super) fn ledger_and_sync(
        &mut self,
        clocks: &mut ClockWriter,
        progress: &PipelineProgress,
    ) -> anyhow::Result<()> {
        let ledger_is_due = self.ledgers.is_due(&self.counts, Instant::now());
        clocks.write(Some(&mut self.take), &self.counts.clock, ledger_is_due)?;
        if ledger_is_due {
            self.write_sample_ledger(false)?;
            self.take.ledger(&self.counts.ledger(false)).context("cannot write the ledger")?;
        }
        self.poll_disk(progress);
        self.check_file(progress);
        let is_due = self.last_sync.is_none_or(|last| last.elapsed() >= self.sync_every);
        // The requester waits for the first row.
        if is_due || (self.first.is_some() && !self.first_reported) {
            self.sync_pending()?;
        }
        Ok(())
    }

    fn write_sample_ledger(&mut self, finished: bool) -> anyhow::Result<Option<SampleLedger>> {
        let ledger = self.samples.ledger(finished, self.counts.batches_refused);
        if let Some(ledger) = &ledger {
            self.take.sample_ledger(ledger).context("cannot write the ledger of samples")?;
        }
        Ok(ledger)
    }

    pub(super) fn poll_disk(&mut self, progress: &PipelineProgress) {
        let written = self.take.bytes();
        self.disk.poll(&mut **self.take.get_mut(), written, progress, Instant::now());
    }

    /// Publishes the file's state when it has changed.
    pub(super) fn check_file(&mut self, progress: &PipelineProgress) {
        let state = self.take.get_mut().poll_state();
        if state == FileState::InPlace && state == self.file_state {
            return;
        }
        let displaced = self.take.get_mut().displaced();
        let at = displaced.as_ref().and_then(|displaced| displaced.now_at.clone());
        // It may be renamed more than once.
        if state != self.file_state || at != self.file_path {
            (self.file_state, self.file_path) = (state, at);
            progress.set_file_state(state, displaced);
        }
    }

    /// Whether another program truncated the file: further data would follow a hole.
    pub(super) fn is_cut_short(&self) -> bool {
        self.file_state == FileState::Truncated
    }

    pub(super) fn sync_pending(&mut self) -> anyhow::Result<()> {
        if self.synced_bytes < self.take.bytes() {
            self.take.get_mut().sync().context("cannot sync the take to disk")?;
            self.synced_bytes = self.take.bytes();
            self.last_sync = Some(Instant::now());
        }
        if let Some(first) = self.first
            && !std::mem::replace(&mut self.first_reported, true)
        {
            // The requester may be gone.
            self.reply.first.try_send(first).ok();
        }
        Ok(())
    }

    /// Publishes the take's progress for observers.
    pub(super) fn publish(&self, progress: &PipelineProgress) {
        progress.file_bytes.store(self.take.bytes(), Ordering::Relaxed);
        progress.samples.store(self.report.samples, Ordering::Relaxed);
        let mut now = lock(&progress.take);
        let now = now.get_or_insert_default();
        now.rows = self.counts.seen();
        now.bytes = self.take.bytes();
        now.durable_bytes = self.synced_bytes;
        now.samples = self.report.samples;
        now.max_error_mm = self.report.max_error_mm;
        now.ledger = self.counts.ledger(false);
        self.samples.state_ledger(&mut now.sample_ledger, self.counts.batches_refused);
    }

    /// Ends the take after an error: its unused reserve is released, and what was written stays.
    pub(super) fn fail(self, error: anyhow::Error) {
        let ended = self.reply.ended.clone();
        ended.try_send(Err(self.failed(error))).ok();
    }

    fn failed(mut self, error: anyhow::Error) -> TakeFailed {
        let written = self.take.bytes();
        // On a failed disk this may fail too.
        self.take.get_mut().release(written).ok();
        // Without a frame the take is useless.
        let error = if self.first.is_none() { error.context(NothingRecorded) } else { error };
        TakeFailed { error, output: Some(self.take.abandon()) }
    }

    /// Closes the take with the counters at its end. Returns whether that succeeded.
    pub(super) fn end(
        mut self,
        counts: &Counts,
        clocks: &mut ClockWriter,
        ending: TakeEnding,
    ) -> bool {
        self.counts = counts.since(&self.base);
        let ended = self.reply.ended.clone();
        let result = self.finish(clocks, ending);
        let is_closed = result.is_ok();
        ended.try_send(result).ok();
        is_closed
    }

    fn finish(mut self, clocks: &mut ClockWriter, mut ending: TakeEnding) -> TakeResult {
        self.file_state = self.take.get_mut().check_state();
        match self.file_state {
            FileState::Truncated => return Ok(self.finish_cut_short()),
            FileState::Removed if ending.detail.is_empty() => {
                "its file was removed during the recording".clone_into(&mut ending.detail);
            }
            FileState::Renamed if ending.detail.is_empty() => {
                "its file was renamed during the recording".clone_into(&mut ending.detail);
            }
            _ => {}
        }
        let (ledger, clock_lines) = match self.close(clocks, &ending) {
            Ok(closed) => closed,
            Err(error) => return Err(self.failed(error)),
        };
        let file_bytes = self.take.bytes();
        let written = TakeAccount { ending, clock_lines, file_bytes, ..self.written(ledger) };
        let output = self.take.abandon();
        Ok((TakeAccount { disk: self.disk.close(&*output), ..written }, output))
    }

    fn written(&self, ledger: Ledger) -> TakeAccount {
        TakeAccount {
            ledger,
            clock: self.counts.clock,
            sample_ledger: self.sample_ledger.clone(),
            samples: self.report.samples,
            kept: self.report.kept,
            max_error_mm: self.report.max_error_mm,
            ..TakeAccount::default()
        }
    }

    /// Writes the end of the take.
    fn close(
        &mut self,
        clocks: &mut ClockWriter,
        ending: &TakeEnding,
    ) -> anyhow::Result<(Ledger, Vec<(u32, ClockLine)>)> {
        let clock_lines = clocks.finish(&mut self.take, &self.counts.clock)?;
        let mut ledger = self.counts.ledger(true);
        if self.report.refused > 0 {
            ledger.contradictions.push(format!(
                "{} blocks were refused by the codec: please report this bug",
                self.report.refused
            ));
        }
        if self.misses_samples {
            let text = "the last samples of sampled channels are missing: the processor was too slow to encode them in time";
            ledger.contradictions.push(text.to_owned());
        }
        let closing = "cannot close the take";
        self.sample_ledger = self.write_sample_ledger(true)?;
        self.take.close(&ledger, Some(ending.clone())).context(closing)?;
        let file_bytes = self.take.bytes();
        self.take.get_mut().release(file_bytes).context(closing)?;
        self.take.get_mut().sync().context(closing)?;
        Ok((ledger, clock_lines))
    }

    /// Ends a truncated take without writing more: the file is a take that was cut off.
    fn finish_cut_short(mut self) -> (TakeAccount, Box<dyn TakeOutput>) {
        let displaced = self.take.get_mut().displaced();
        let (found, written) = displaced.map_or((0, self.take.bytes()), |file| file.bytes);
        let detail = format!("cut short from {written} to {found} bytes by another program");
        let mut ledger = self.counts.ledger(false);
        // The file does not contain what was recorded.
        ledger.contradictions.push(format!("the file was {detail}"));
        let ending = TakeEnding::new(EndingKind::Truncated, detail);
        let written = TakeAccount { ending, file_bytes: found, ..self.written(ledger) };
        let mut output = self.take.abandon();
        // A file system that does not release the reserve now does so when the file is closed.
        output.release(found).ok();
        (TakeAccount { disk: self.disk.close(&*output), ..written }, output)
    }
}

/// Shortest time between two ledgers.
const LEDGER_INTERVAL_MIN: Duration = Duration::from_secs(5);

/// Longest time between two ledgers: the last ledger of a killed take can be this much older than its
/// last frame, in the counters that change while all goes well.
const LEDGER_INTERVAL_MAX: Duration = Duration::from_secs(60);

/// Decides when to write a ledger: with the first stretch; then, while all goes well, whenever the recording is
/// twice as old as at the last ledger. A problem is recorded within five seconds.
#[derive(Debug, Default)]
pub(super) struct LedgerSchedule {
    started: Option<Instant>,
    last: Option<(Instant, ProblemCounters)>,
}

/// The counters that do not change while all goes well.
type ProblemCounters = [u64; 13];

impl LedgerSchedule {
    /// Whether a ledger is due; if so, it counts as written.
    pub(super) fn is_due(&mut self, counts: &Counts, now: Instant) -> bool {
        let started = *self.started.get_or_insert(now);
        let problem_counters = problem_counters(counts);
        let due = self.last.is_none_or(|(last, known)| {
            let wait = if known == problem_counters {
                last.duration_since(started).clamp(LEDGER_INTERVAL_MIN, LEDGER_INTERVAL_MAX)
            } else {
                LEDGER_INTERVAL_MIN
            };
            now.duration_since(last) >= wait
        });
        if due {
            self.last = Some((now, problem_counters));
        }
        due
    }
}

fn problem_counters(counts: &Counts) -> ProblemCounters {
    [
        counts.not_received,
        counts.ring_full,
        counts.lost_in_outages,
        counts.duplicates,
        counts.samples_not_finite + counts.link.samples_not_finite,
        counts.markers_dropped,
        counts.counter_jumps,
        counts.clock_jumps,
        counts.events_dropped,
        counts.link.bytes_skipped,
        counts.link.messages_damaged,
        counts.link.messages_unknown + counts.batches_refused,
        counts.status.map_or(0, |status| status.frames_dropped),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ledgers_are_rare_while_all_goes_well_and_soon_after_a_problem() {
        let (mut ledgers, start) = (LedgerSchedule::default(), Instant::now());
        let mut counts = Counts::default();
        let mut written = Vec::new();
        for half_second in 0..600 {
            counts.recorded += 30;
            counts.duplicates += u64::from([250, 251, 252].contains(&half_second));
            if ledgers.is_due(&counts, start + Duration::from_millis(500 * half_second)) {
                written.push(half_second / 2);
            }
        }
        assert_eq!(written, [0, 5, 10, 20, 40, 80, 125, 130, 190, 250]);
    }
}
