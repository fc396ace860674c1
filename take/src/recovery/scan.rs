//! The first pass over the file: which chunks can be kept, and what is lost; and the ledger that follows, from the last
//! ledger of the damaged file and from the stretches after it.

use super::{ChunkKind, ChunkKindCount, KINDS, KeptSamples, OutputChunk};
use crate::{
    ChannelOrder, NotATake, TakeError, TakeEvent,
    chunk::types,
    damage::{DamageOrigin, LedgerTotals, LostRows, Problem},
    reader::TakeInput,
    record::{Channel, EndingKind, Header, Ledger, SampleLedger, TakeEnding},
    statistics::{ChannelStatistics, StretchTally, TakeStatistics, TakeTally},
    stretch::{NUMBERS, Span, Stretch},
    timeline::{LossCauses, RowRun},
    traversal::{Decode, LocatedEvent, LostEntries, Progress, TakeTraversal},
};

/// Maximum number of chunks that a recovery copies; each takes up to 64 bytes of memory. The limit is four days of the
/// shortest stretches, 50 ms, and half a gigabyte. Only a crafted file has more. Chunks of samples and of their times that
/// belong to a group are not counted, so that they never cost the markers: the map of the take, which the recovery reads,
/// holds each of them too, and its limits by group are theirs.
const CHUNKS_MAX: usize = 1 << 23;

/// Counts of one channel, over the whole take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ChannelCount {
    /// Samples that are kept.
    pub samples: u64,
    /// Rows lost to damage since the channel was announced.
    pub rows_damaged: u64,
}

/// What a recovery keeps of a file and what is lost.
#[derive(Debug)]
pub struct RecoveryScan {
    /// The header, as the file has it.
    pub header: Header,
    /// The complete channel table, in column order.
    pub channels: Vec<Channel>,
    /// How the table is ordered in the source: as the take has it, or its summary if that is lost.
    pub(super) order: ChannelOrder,
    /// Counts by channel, in column order.
    pub per_channel: Vec<ChannelCount>,
    /// Chunk counts by kind.
    pub kinds: [ChunkKindCount; KINDS.len()],
    /// Everything missing or damaged.
    pub problems: Vec<Problem>,
    /// Rows lost to damage, in order, including those of an earlier recovery.
    pub damage: Vec<LostRows>,
    /// Rows of the new take, including lost ones.
    pub rows: u64,
    /// Recorded frames of the new take.
    pub recorded: u64,
    /// The ledger of the new take.
    pub ledger: Ledger,
    /// The ledger of the samples of the new take, if it is of a recording that has some.
    pub sample_ledger: Option<SampleLedger>,
    /// The ending that the new take states: the ending of the old take, or that it was cut off.
    pub ending: Option<TakeEnding>,
    /// Whether the old take was closed: its last ledger exists, if not its footer.
    pub finished: bool,
    /// Bytes that are damaged or depend on damaged ones.
    pub discarded_bytes: u64,
    /// The statistics of the new take, in the order of its table.
    pub statistics: TakeStatistics,
    pub(super) output: Vec<OutputChunk>,
    names_lost: bool,
    /// The kinds of the foreign parts that lost samples.
    pub(super) samples_lost_of: Vec<String>,
    /// Whether a ledger is missing or contradicts the frames and samples found, although nothing is damaged.
    pub(super) contradicted: bool,
}

impl RecoveryScan {
    /// Reads and decodes everything that is valid. It holds one chunk at a time, and up to 64 bytes for each chunk that
    /// is kept.
    ///
    /// # Errors
    /// `NotATake` without a header, `Unsupported`, `Io`. Damage is not an error.
    pub fn read(input: impl TakeInput) -> Result<Self, TakeError> {
        let mut input = input.input();
        let mut scanner = RecoveryScanner::default();
        let traversal = TakeTraversal::new(&mut input, Decode::All);
        let progress = traversal.run(|found, progress| scanner.visit(found, progress));
        let progress = progress.map_err(without_recovery_advice)?;
        let samples = KeptSamples::find(&progress.take, &mut input)?;
        scanner.apply_samples(&samples);
        Ok(scanner.finish(progress, samples))
    }

    /// Rows lost to damage in this file.
    #[must_use]
    pub fn rows_damaged(&self) -> u64 {
        let here = self.damage.iter().filter(|lost| lost.origin == DamageOrigin::Damaged);
        here.fold(0, |sum, lost| sum.saturating_add(lost.rows))
    }

    /// Whether the new take lacks anything that the file had, or may have had.
    #[must_use]
    pub fn lost_anything(&self) -> bool {
        let lost = |count: &ChunkKindCount| count.discarded > 0 && !count.kind.is_rebuilt();
        !self.finished
            || self.names_lost
            || !self.samples_lost_of.is_empty()
            || self.contradicted
            || self.rows_damaged() > 0
            || self.kinds.iter().any(lost)
    }
}

/// An error of a recovery does not advise running one.
fn without_recovery_advice(error: TakeError) -> TakeError {
    match error {
        TakeError::NotATake(NotATake::HeaderDamaged) => TakeError::NotATake(NotATake::HeaderLost),
        other => other,
    }
}

/// What happens to a chunk.
#[derive(Debug, Clone, Copy)]
enum ChunkAction {
    /// Copy it; a stretch with its span.
    Copy(Option<Span>),
    /// Write a new one in its place.
    Rewrite,
    /// Discard it.
    Discard,
}

/// The state of the first pass.
#[derive(Debug, Default)]
struct RecoveryScanner {
    /// Counts of chunks by kind.
    recovered: [u64; KINDS.len()],
    discarded: [u64; KINDS.len()],
    output: Vec<OutputChunk>,
    ledger: LedgerTally,
    tally: TakeTally,
    /// Position in `output` at which channel table entries may be missing.
    missing_at: Option<usize>,
    end_row: u64,
    next_number: u8,
    discarded_bytes: u64,
    names_lost: bool,
    closed: bool,
    /// A ledger before the last that contradicts the stretches before it.
    contradiction: Option<Problem>,
    /// Chunks of samples and their times in `output`.
    n_sample_chunks: usize,
    /// File offsets of the chunks of sampled channels of later versions, which are copied; in order.
    later_samples_at: Vec<u64>,
    /// The order of the markers according to the summary.
    stated_order: Option<ChannelOrder>,
}

impl RecoveryScanner {
    fn visit(&mut self, found: &LocatedEvent<'_>, progress: &Progress) -> Result<(), TakeError> {
        if let Some(lost_entries) = found.lost_entries {
            self.name_channels(lost_entries, progress.channels());
        }
        self.tally.follow_table(found.lost_entries, progress.channels().len());
        let (kind, action) = match &found.event {
            TakeEvent::Header(_) => (types::HEADER, ChunkAction::Rewrite),
            TakeEvent::Channels(_) => (types::CHANNELS, ChunkAction::Copy(None)),
            TakeEvent::Stretch(_) if found.is_refused => (types::STRETCH, ChunkAction::Discard),
            TakeEvent::Stretch(stretch) => {
                if stretch.stated_channels() >= progress.channels().len() {
                    // No channel table entry is missing.
                    self.missing_at = None;
                }
                self.add_stretch(stretch, progress);
                (types::STRETCH, ChunkAction::Copy(Some(stretch.span)))
            }
            TakeEvent::Unplaced { .. } => (types::STRETCH, ChunkAction::Discard),
            TakeEvent::Event(_) => (types::EVENT, ChunkAction::Copy(None)),
            TakeEvent::Clock(_) => (types::CLOCK, ChunkAction::Copy(None)),
            TakeEvent::Subject(_) => (types::SUBJECT, ChunkAction::Copy(None)),
            TakeEvent::Foreign(_) => (types::FOREIGN, ChunkAction::Copy(None)),
            // Which samples can be kept is known when all were read.
            TakeEvent::SampledGroup(_) => (types::SAMPLED_GROUP, ChunkAction::Copy(None)),
            TakeEvent::Samples(_) => (types::SAMPLES, ChunkAction::Copy(None)),
            TakeEvent::SampleTimes(_) => (types::SAMPLE_TIMES, ChunkAction::Copy(None)),
            TakeEvent::SampleLedger(_) => (types::SAMPLE_LEDGER, ChunkAction::Rewrite),
            TakeEvent::Ledger(ledger) => {
                self.closed |= ledger.finished;
                self.ledger.mark_ledger();
                let (frames, samples) = (self.ledger.recorded(), self.tally.samples());
                let (stated, found) =
                    (LedgerTotals::from_ledger(ledger), LedgerTotals { frames, samples });
                if stated != found && !ledger.finished && !progress.take.damaged {
                    self.contradiction = Some(Problem::LedgerCounts { stated, found });
                }
                // A ledger after damage counts more than is kept; its counts go into the new last ledger.
                let is_stale = ledger.finished || progress.take.damaged || stated != found;
                let action = if is_stale { ChunkAction::Rewrite } else { ChunkAction::Copy(None) };
                (types::LEDGER, action)
            }
            TakeEvent::Order(_) => (types::ORDER, ChunkAction::Rewrite),
            TakeEvent::Summary(summary) => {
                self.stated_order.clone_from(&summary.order);
                (types::SUMMARY, ChunkAction::Rewrite)
            }
            // An index that is too long to hold has the old offsets, too.
            TakeEvent::Index(_) | TakeEvent::Skipped { kind: types::INDEX } => {
                (types::INDEX, ChunkAction::Rewrite)
            }
            TakeEvent::Footer(_) => {
                self.closed = true;
                (types::FOOTER, ChunkAction::Rewrite)
            }
            TakeEvent::Skipped { kind } => {
                self.remember_skipped(*kind, found.offset);
                (*kind, ChunkAction::Copy(None))
            }
            TakeEvent::Damaged { kind, .. } => {
                if self.recovered[ChunkKind::Header as usize] > 0 {
                    self.missing_at.get_or_insert(self.output.len());
                }
                // Only summary, index and footer follow the last ledger.
                let is_expected = ChunkKind::of(*kind).follows_last_ledger();
                let kind = if self.closed && !is_expected { Some(types::INDEX) } else { *kind };
                (kind.unwrap_or_default(), ChunkAction::Discard)
            }
            TakeEvent::Repaired { .. } | TakeEvent::End { .. } => return Ok(()),
        };
        self.add_chunk(found, kind, action);
        self.end_row = progress.end_row();
        self.check_limit(progress.take.samples_orphaned)
    }

    fn check_limit(&self, samples_orphaned: u64) -> Result<(), TakeError> {
        let of_groups = self.n_sample_chunks.saturating_sub(samples_orphaned as usize);
        if self.output.len().saturating_sub(of_groups) > CHUNKS_MAX {
            return Err(TakeError::InvalidArgument(format!(
                "the file has more than {CHUNKS_MAX} chunks besides those of samples, the most that a recovery can hold"
            )));
        }
        Ok(())
    }

    fn remember_skipped(&mut self, kind: u8, offset: u64) {
        if matches!(kind, types::SAMPLED_GROUP | types::SAMPLE_TIMES) {
            self.later_samples_at.push(offset);
        }
    }

    fn add_chunk(&mut self, found: &LocatedEvent<'_>, kind: u8, action: ChunkAction) {
        let (offset, len) = (found.offset, found.len);
        let index = ChunkKind::of(Some(kind)) as usize;
        match action {
            ChunkAction::Discard => {
                self.discarded[index] += 1;
                self.discarded_bytes += len;
            }
            ChunkAction::Rewrite => self.recovered[index] += 1,
            ChunkAction::Copy(span) => {
                self.recovered[index] += 1;
                self.n_sample_chunks +=
                    usize::from(matches!(kind, types::SAMPLES | types::SAMPLE_TIMES));
                self.output.push(OutputChunk::Copied { offset, len, kind, span });
            }
        }
    }

    /// Counts a stretch that is kept.
    fn add_stretch(&mut self, stretch: &Stretch<'_>, progress: &Progress) {
        let span = stretch.span;
        let from_row = stretch.from_row();
        let skips_number = span.number != self.next_number && !stretch.replaces_damaged();
        if span.key && (from_row > self.end_row || skips_number) {
            let number = (span.number + NUMBERS - 1) % NUMBERS;
            let rows = from_row - self.end_row;
            self.output.push(OutputChunk::Lost { first_row: self.end_row, rows, number });
        }
        self.next_number = (span.number + 1) % NUMBERS;
        let before = self.tally.samples();
        if span.n_rows > 0 {
            self.tally.add(span, &StretchTally::of_decoded(stretch, progress.coded_rows()));
        }
        let samples = self.tally.samples() - before;
        self.ledger.add_stretch(stretch, progress.channels().len(), samples);
    }

    /// Inserts entries for the lost ones at the same place in the new take.
    fn name_channels(&mut self, lost_entries: LostEntries, channels: &[Channel]) {
        self.names_lost = true;
        let at = self.missing_at.take().unwrap_or(self.output.len());
        if lost_entries.nameless > lost_entries.inserted {
            // Entries whose columns are unknown.
            let mut seen = 0;
            self.output.retain(|chunk| {
                seen += 1;
                let uncertain = matches!(chunk, OutputChunk::Copied { kind: types::CHANNELS, .. });
                !(uncertain && seen > at)
            });
        }
        let nameless = lost_entries.first..lost_entries.first + lost_entries.nameless;
        let nameless = channels.get(nameless).unwrap_or_default();
        self.output.insert(at.min(self.output.len()), OutputChunk::Channels(nameless.to_vec()));
    }

    /// Leaves out the samples that no reader of the new take could decode, and records them as lost.
    fn apply_samples(&mut self, samples: &KeptSamples) {
        let mut left_out = Vec::new();
        self.output = std::mem::take(&mut self.output)
            .into_iter()
            .flat_map(|chunk| match chunk {
                OutputChunk::Copied {
                    offset,
                    len,
                    kind: kind @ (types::SAMPLED_GROUP | types::SAMPLES | types::SAMPLE_TIMES),
                    ..
                } => {
                    let is_later = self.later_samples_at.binary_search(&offset).is_ok();
                    if !is_later && !samples.keeps(offset) {
                        left_out.push((kind, len));
                        return Vec::new();
                    }
                    [samples.lost_at(offset), vec![chunk]].concat()
                }
                chunk => vec![chunk],
            })
            .chain(samples.lost_at_end.iter().cloned())
            .collect();
        for (kind, len) in left_out {
            let index = ChunkKind::of(Some(kind)) as usize;
            self.recovered[index] -= 1;
            self.discarded[index] += 1;
            self.discarded_bytes += len;
        }
    }

    fn finish(mut self, progress: Progress, samples: KeptSamples) -> RecoveryScan {
        let Progress { mut take, rows_damaged, .. } = progress;
        let stated = self.stated_order.filter(|stated| stated.check(&take.header, 0).is_ok());
        if let Some(stated) = stated.filter(|_| take.order.n_channels() == 0) {
            take.order = stated;
            take.restore_order();
            // Nothing of it is lost.
            let order = ChunkKind::Order as usize;
            self.recovered[order] += std::mem::take(&mut self.discarded[order]);
        }
        let rows = take.n_rows - self.end_row;
        if rows > 0 {
            let (first_row, number) = (self.end_row, self.next_number);
            self.output.push(OutputChunk::Lost { first_row, rows, number });
        }
        let mut problems = take.problems;
        problems.extend(samples.undecodable);
        let lacks_ledger = problems.contains(&Problem::NoLedger);
        // A file that was cut off states no ending; the recovered take states that it was cut off.
        let cut_off = || Some(TakeEnding::from(EndingKind::CutOff)).filter(|_| !self.closed);
        let ending = take.ending.or_else(cut_off);
        if self.closed {
            problems.pop_if(|last| *last == Problem::CutOff);
        }
        let here = take.damage.iter().filter(|lost| lost.origin == DamageOrigin::Damaged);
        let here: Vec<_> = here.copied().collect();
        let count = |(kind, ..): (ChunkKind, Option<u8>, &str)| {
            let i = kind as usize;
            ChunkKindCount { kind, recovered: self.recovered[i], discarded: self.discarded[i] }
        };
        let kinds = KINDS.map(count);
        let statistics = self.tally.finish(take.n_rows);
        let per_channel = statistics.channels.iter().zip(rows_damaged);
        let count = |(channel, rows_damaged): (&ChannelStatistics, u64)| ChannelCount {
            samples: channel.samples,
            rows_damaged,
        };
        let mut per_channel: Vec<_> = per_channel.map(count).collect();
        take.order.restore(&mut per_channel);
        let mut scan = RecoveryScan {
            header: take.header,
            ledger: self.ledger.close(take.ledger.as_ref(), &here),
            ending,
            kinds,
            channels: take.channels,
            order: take.order,
            per_channel,
            statistics,
            problems,
            damage: take.damage,
            rows: take.n_rows,
            recorded: self.ledger.recorded(),
            finished: self.closed,
            discarded_bytes: self.discarded_bytes,
            output: self.output,
            names_lost: self.names_lost,
            samples_lost_of: samples.kinds,
            sample_ledger: samples.ledger,
            contradicted: self.contradiction.is_some() || lacks_ledger,
        };
        scan.problems.extend(self.contradiction);
        // Without loss, the original ledger stands.
        let is_complete = !scan.lost_anything();
        if is_complete && let Some(ledger) = take.ledger.filter(|ledger| ledger.finished) {
            let [stated, found] = [&ledger, &scan.ledger].map(LedgerTotals::from_ledger);
            if stated == found {
                scan.ledger = ledger;
            } else {
                scan.contradicted = true;
                scan.problems.push(Problem::LedgerCounts { stated, found });
            }
        }
        scan
    }
}

/// Rows by outcome, counted from the stretches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct RowCounts {
    recorded: u64,
    not_received: u64,
    ring_full: u64,
    disconnected: u64,
    /// Damaged in a file that this one was recovered from.
    damaged: u64,
}

impl RowCounts {
    fn add(&mut self, run: &RowRun) {
        let counter = match run.lost {
            None => &mut self.recorded,
            Some(causes) if causes.contains(LossCauses::DAMAGED) => &mut self.damaged,
            // A run with several causes does not say how many rows each cause has. It counts for the first cause here
            // that it names. The counters of a ledger are exact and are used where a ledger exists.
            Some(causes) if causes.contains(LossCauses::NOT_RECEIVED) => &mut self.not_received,
            Some(causes) if causes.contains(LossCauses::RING_FULL) => &mut self.ring_full,
            Some(_) => &mut self.disconnected,
        };
        *counter = counter.saturating_add(run.rows);
    }

    fn since(self, before: Self) -> Self {
        Self {
            recorded: self.recorded - before.recorded,
            not_received: self.not_received - before.not_received,
            ring_full: self.ring_full - before.ring_full,
            disconnected: self.disconnected - before.disconnected,
            damaged: self.damaged - before.damaged,
        }
    }

    fn sum(self) -> u64 {
        let lost = [self.not_received, self.ring_full, self.disconnected, self.damaged];
        lost.iter().fold(self.recorded, |sum, &n| sum.saturating_add(n))
    }
}

/// Counts rows and samples while the file is read.
#[derive(Debug, Clone, Default)]
pub(crate) struct LedgerTally {
    rows: RowCounts,
    announced: u64,
    present: u64,
    /// The counts at the last ledger.
    at_ledger: RowCounts,
}

impl LedgerTally {
    /// Adds a stretch that is kept, with the number of channels announced and of samples decoded.
    pub(super) fn add_stretch(&mut self, stretch: &Stretch<'_>, n_channels: usize, samples: u64) {
        let recorded = [RowRun { rows: stretch.span.n_rows.into(), lost: None }];
        let runs = stretch.timeline.as_ref().map_or(&recorded[..], |timeline| &timeline.runs);
        self.add_runs(runs, n_channels, samples);
    }

    /// Adds runs of rows in which `n_channels` channels are announced and have `samples` samples.
    pub(crate) fn add_runs(&mut self, runs: &[RowRun], n_channels: usize, samples: u64) {
        let before = self.rows.recorded;
        runs.iter().for_each(|run| self.rows.add(run));
        let recorded = self.rows.recorded - before;
        self.announced = self.announced.saturating_add(recorded.saturating_mul(n_channels as u64));
        self.present = self.present.saturating_add(samples);
    }

    /// Remembers the counts at a ledger.
    pub(super) fn mark_ledger(&mut self) {
        self.at_ledger = self.rows;
    }

    /// Recorded frames in the stretches that are kept.
    pub(super) fn recorded(&self) -> u64 {
        self.rows.recorded
    }

    /// The ledger of what is kept, given the `last` ledger of the file and the rows `lost` to damage in it.
    ///
    /// The last ledger's counts are kept, except that frames it counts as recorded but that are not kept count as
    /// lost. Damaged rows after it count as lost, too.
    pub(crate) fn close(&self, last: Option<&Ledger>, lost: &[LostRows]) -> Ledger {
        let (mut ledger, before) = (last.cloned().unwrap_or_default(), self.at_ledger);
        let rows_then = ledger.frames_sent;
        let since = self.rows.since(before);
        let lost_then = ledger.recorded.saturating_sub(before.recorded);
        let rows_after_ledger = |lost: &LostRows| {
            let end = lost.first_row.saturating_add(lost.rows);
            end.saturating_sub(lost.first_row.max(rows_then))
        };
        let lost_since = if ledger.finished { 0 } else { lost.iter().map(rows_after_ledger).sum() };

        let add = |counter: &mut u64, by: u64| *counter = counter.saturating_add(by);
        add(&mut ledger.frames_sent, since.sum());
        add(&mut ledger.frames_sent, lost_since);
        add(&mut ledger.lost_on_link, since.not_received);
        add(&mut ledger.lost_ring_full, since.ring_full);
        add(&mut ledger.unknown_after_disconnect, since.disconnected);
        add(&mut ledger.lost_other, since.damaged);
        add(&mut ledger.lost_other, lost_then);
        add(&mut ledger.lost_other, lost_since);
        ledger.recorded = self.rows.recorded;
        ledger.samples_announced = self.announced.max(self.present);
        ledger.samples_present = self.present;
        ledger.samples_occluded = ledger.samples_announced - self.present;
        ledger.samples_not_finite = ledger.samples_not_finite.min(ledger.samples_occluded);
        ledger.finished = true;
        ledger
    }
}
