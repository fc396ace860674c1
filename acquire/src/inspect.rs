//! Reads a whole take and summarises it: the numbers of `info` and `verify`.

use mocapd_take::{
    TakeError, TakeEvent, TakeMap, TakeTraversal,
    index::{Footer, IndexEntry},
    reader::{TakeBytes, TakeInput},
    record::Ledger,
    stretch::Stretch,
    timeline::{LossCauses, Timeline},
    traversal::{Decode, LocatedEvent, Progress},
};

use crate::{
    clock::{ClockStatus, LineDeviation, LineRefit},
    health::TakeHealth,
};

/// Summary of one channel over the whole take.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ChannelSummary {
    /// Samples present.
    pub samples: u64,
    /// Runs of rows without a sample, including those at the ends.
    pub gaps: u64,
    /// Samples kept as knots.
    pub knots: u64,
    /// The largest error stated by any block that has samples of the channel, over all channels of that block, in
    /// millimetres.
    pub max_error_mm: f64,
    /// Rows lost because the take is damaged, or was when it was recovered: the marker was announced, but it is
    /// unknown whether it was visible.
    pub rows_damaged: u64,
    in_gap: bool,
}

/// Summary of a whole take.
#[derive(Debug, Default)]
pub struct Summary {
    /// The take without its samples.
    pub take: TakeMap,
    /// By channel.
    pub per_channel: Vec<ChannelSummary>,
    /// The final state of the clocks, as stored in the take.
    pub clock: ClockStatus,
    /// Disconnections of the device, and the rows missing for them.
    pub outages: (u32, u64),
    /// Stretches decoded.
    pub stretches: u64,
    /// Bytes by purpose.
    pub bytes: TakeBytes,
    /// Rows with at least one sample: T of (Shi et al. 2012).
    pub rows_with_samples: u64,
    /// Rows with at least one kept sample: K.
    pub key_rows: u64,
    /// Samples present in those rows: the sum of |K in `P_i`|.
    pub samples_in_key_rows: u64,
    in_outage: bool,
    line_refit: LineRefit,
    claims: ClaimChecker,
    /// Rows up to the last event, including lost ones, and up to the last stretch with rows.
    rows: u64,
    end_of_stretches: u64,
}

impl Summary {
    /// Reads and decodes the whole take.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`. Damage is a problem, not an error.
    pub fn read(input: impl TakeInput) -> Result<Self, TakeError> {
        let mut summary = Self::default();
        let Progress { take, rows_damaged, .. } =
            TakeTraversal::new(input, Decode::All).run(|found, progress| {
                summary.on_event(found, progress);
                Ok(())
            })?;
        summary.skip_rows_to(take.n_rows);
        for (channel, rows) in summary.per_channel.iter_mut().zip(rows_damaged) {
            channel.rows_damaged = rows;
        }
        summary.take = take;
        Ok(summary)
    }

    /// Statements of the take about itself that its own data contradicts, one sentence each, in bytes that are intact.
    #[must_use]
    pub fn contradictions(&self) -> &[String] {
        &self.claims.contradictions
    }

    /// The health of the take.
    #[must_use]
    pub fn health(&self) -> TakeHealth {
        let clock_is_off = self.clock_deviation().is_some_and(|found| !found.agrees);
        if !self.contradictions().is_empty() || clock_is_off {
            TakeHealth::Damaged
        } else if !self.take.finished && self.take.damage.is_empty() {
            // Only the end is missing, and perhaps half a chunk before it.
            TakeHealth::CutOff
        } else if self.take.damaged || !self.take.problems.is_empty() {
            TakeHealth::Damaged
        } else {
            let (ledger, ending) = (self.take.ledger.as_ref(), self.take.ending.as_ref());
            ledger.map_or(TakeHealth::Damaged, |ledger| TakeHealth::of_closed(ledger, ending))
        }
    }

    /// How far the clock line is from the line fitted to the stored observations; `None` if there is no line, or
    /// observations are missing.
    #[must_use]
    pub fn clock_deviation(&self) -> Option<LineDeviation> {
        // A recovered take may lack some observations.
        let recovered = |(name, _): &(String, String)| name == mocapd_take::recovery::RECOVERED;
        let lacks_some = self.take.damaged || self.take.header.settings.iter().any(recovered);
        if lacks_some { None } else { self.line_refit.deviation() }
    }

    /// Samples present.
    #[must_use]
    pub fn samples(&self) -> u64 {
        self.per_channel.iter().map(|channel| channel.samples).sum()
    }

    /// Samples kept as knots.
    #[must_use]
    pub fn knots(&self) -> u64 {
        self.per_channel.iter().map(|channel| channel.knots).sum()
    }

    /// The largest error that any block states, in millimetres.
    #[must_use]
    pub fn max_error_mm(&self) -> f64 {
        self.per_channel.iter().map(|channel| channel.max_error_mm).fold(0.0, f64::max)
    }

    /// Float32 bytes of the samples: 12 each.
    #[must_use]
    pub fn raw_bytes(&self) -> u64 {
        12 * self.samples()
    }

    /// SR1 of (Shi et al. 2012, eq. 7), counted over samples present; without gaps |T| / |K|.
    #[must_use]
    pub fn sr1(&self) -> Option<f64> {
        ratio(self.samples() + self.rows_with_samples, self.samples_in_key_rows + self.key_rows)
    }

    /// SR2 of (Shi et al. 2012, eq. 8), counted over samples present.
    #[must_use]
    pub fn sr2(&self) -> Option<f64> {
        ratio(self.samples() + self.rows_with_samples, 2 * self.knots())
    }

    fn on_event(&mut self, found: &LocatedEvent<'_>, progress: &Progress) {
        let is_damaged = progress.take.damaged;
        // A marker that appears later had a gap until then.
        let in_gap = self.rows > 0;
        let unseen = ChannelSummary { in_gap, gaps: in_gap.into(), ..ChannelSummary::default() };
        if let Some(lost_entries) = found.lost_entries {
            let at = lost_entries.first.min(self.per_channel.len());
            let new = std::iter::repeat_n(unseen.clone(), lost_entries.inserted);
            self.per_channel.splice(at..at, new);
        }
        self.per_channel.resize(progress.channels().len(), unseen);
        match &found.event {
            TakeEvent::Header(header) => self.claims.tolerance_mm = header.tolerance_mm,
            TakeEvent::Stretch(stretch) => {
                if let Some(timeline) = &stretch.timeline {
                    self.add_outages(timeline);
                }
                if !found.is_refused && stretch.span.n_rows > 0 {
                    self.add_stretch(stretch, progress);
                }
            }
            TakeEvent::Ledger(ledger) => {
                self.claims.ledger_offset = found.offset;
                if !is_damaged {
                    self.claims.ledger(ledger, self.samples());
                }
            }
            TakeEvent::Clock(clock) => {
                let probes = self.clock.probes + clock.probes.len() as u64;
                let points = self.clock.points + clock.points.len() as u64;
                self.line_refit.add(clock);
                self.clock = ClockStatus {
                    segment: clock.segment,
                    tick_hz: clock.tick_hz,
                    line: clock.line,
                    jitter: clock.jitter,
                    probes,
                    points,
                    residual_us: clock.jitter.residual_us as f64,
                    stored: probes + points,
                };
            }
            TakeEvent::Index(entries) => {
                self.claims.index_offset = found.offset;
                if !is_damaged {
                    self.claims.index(entries, &progress.take.keys);
                }
            }
            TakeEvent::Footer(footer) if !is_damaged => self.claims.footer(footer),
            TakeEvent::End { bytes, .. } => self.bytes = *bytes,
            _ => {}
        }
        self.rows = progress.n_rows();
    }

    /// Counts rows up to `row` that no stretch contains: gaps in every channel.
    fn skip_rows_to(&mut self, row: u64) {
        if row > self.end_of_stretches {
            self.add_empty_stretch();
            self.end_of_stretches = row;
        }
    }

    /// Counts a stretch in which no marker was seen.
    fn add_empty_stretch(&mut self) {
        for channel in &mut self.per_channel {
            channel.gaps += u64::from(!std::mem::replace(&mut channel.in_gap, true));
        }
    }

    fn add_stretch(&mut self, stretch: &Stretch<'_>, progress: &Progress) {
        let span = stretch.span;
        self.skip_rows_to(span.first_row);
        self.claims.stretch(stretch, progress.channels().len());
        self.stretches += 1;
        self.end_of_stretches = span.end_row();
        let n_rows = span.n_rows as usize;
        if stretch.blocks.iter().all(|block| block.is_empty()) {
            self.add_empty_stretch();
            return;
        }
        let mut present_in = vec![0_u32; n_rows];
        let mut kept_in = vec![false; n_rows];
        let rows = progress.rows().chain(std::iter::repeat(None));
        for (channel, rows) in self.per_channel.iter_mut().zip(rows) {
            let Some(rows) = rows.filter(|rows| rows.has_samples()) else {
                channel.gaps += u64::from(!std::mem::replace(&mut channel.in_gap, true));
                continue;
            };
            channel.max_error_mm = channel.max_error_mm.max(rows.max_error_mm);
            self.claims.block(span.first_row, rows.max_error_mm);
            for row in 0..n_rows {
                let present = rows.present[row];
                channel.gaps += u64::from(!present && !channel.in_gap);
                channel.in_gap = !present;
                channel.samples += u64::from(present);
                channel.knots += u64::from(present && rows.kept[row]);
                present_in[row] += u32::from(present);
                kept_in[row] |= present && rows.kept[row];
            }
        }
        for (present, kept) in present_in.into_iter().zip(kept_in) {
            self.rows_with_samples += u64::from(present > 0);
            self.key_rows += u64::from(kept);
            self.samples_in_key_rows += if kept { u64::from(present) } else { 0 };
        }
    }

    fn add_outages(&mut self, timeline: &Timeline) {
        for run in &timeline.runs {
            let outage = run.lost.is_some_and(|causes| causes.contains(LossCauses::DISCONNECTED));
            self.outages.0 += u32::from(outage && !self.in_outage);
            self.outages.1 += if outage { run.rows } else { 0 };
            self.in_outage = outage;
        }
    }
}

fn ratio(over: u64, under: u64) -> Option<f64> {
    (under > 0).then(|| over as f64 / under as f64)
}

/// Ratio of the samples' float32 bytes to bytes on disk.
#[must_use]
pub fn size_ratio(samples: u64, file_bytes: u64) -> f64 {
    ratio(12 * samples, file_bytes).unwrap_or(0.0)
}

/// Most contradictions to keep; one is enough to distrust a take.
const CONTRADICTIONS_MAX: usize = 20;

/// Compares a take's statements about itself with its content, counting what ledgers count.
#[derive(Debug, Default)]
struct ClaimChecker {
    tolerance_mm: f64,
    recorded: u64,
    announced: u64,
    lost: u64,
    index_offset: u64,
    ledger_offset: u64,
    contradictions: Vec<String>,
}

impl ClaimChecker {
    /// Counts a decoded stretch; `n_channels` is the number of channels so far.
    fn stretch(&mut self, stretch: &Stretch<'_>, n_channels: usize) {
        let rows = u64::from(stretch.span.n_rows);
        let recorded = stretch.timeline.as_ref().map_or(rows, Timeline::n_recorded);
        self.recorded += recorded;
        let runs = stretch.timeline.iter().flat_map(|timeline| &timeline.runs);
        // Ledgers written after a recovery include the rows it found damaged.
        let lost = runs.filter(|run| run.lost.is_some_and(|causes| causes != LossCauses::DAMAGED));
        self.lost += lost.map(|run| run.rows).sum::<u64>();
        self.announced += recorded * n_channels as u64;
    }

    fn index(&mut self, entries: &[IndexEntry], keys: &[IndexEntry]) {
        if entries != keys {
            self.report("the index does not match the key stretches".to_owned());
        }
    }

    fn footer(&mut self, footer: &Footer) {
        if [footer.index_offset, footer.ledger_offset] != [self.index_offset, self.ledger_offset] {
            self.report("the footer does not match the index and the ledger".to_owned());
        }
    }

    /// Checks the error stated by a block with samples.
    fn block(&mut self, first_row: u64, max_error_mm: f64) {
        if max_error_mm > self.tolerance_mm {
            self.report(format!(
                "a block of the stretch from frame {first_row} states an error of {max_error_mm} mm, above the tolerance of {} mm",
                self.tolerance_mm
            ));
        }
    }

    /// Checks a ledger against the `samples` found before it. A ledger is true for what precedes it, all of which must
    /// have been read.
    fn ledger(&mut self, ledger: &Ledger, samples: u64) {
        for (what, stated, found) in [
            ("recorded frames", ledger.recorded, self.recorded),
            ("samples", ledger.samples_present, samples),
            ("announced samples", ledger.samples_announced, self.announced),
        ] {
            if stated != found {
                self.report(format!("a ledger states {stated} {what}, but {found} precede it"));
            }
        }
        // Frames lost after the last stretch are in no timeline yet.
        let (stated, found) = (ledger.frames_lost(), self.lost);
        if stated < found {
            self.report(format!("a ledger states {stated} lost frames, but {found} precede it"));
        }
    }

    fn report(&mut self, sentence: String) {
        if self.contradictions.len() < CONTRADICTIONS_MAX {
            self.contradictions.push(sentence);
        }
    }
}
