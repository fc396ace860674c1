//! Summarises a take, for the numbers of `info` and `verify`, and gives the verdict on one that was read to its end, for
//! `verify` and for the service's check.

use std::{
    fmt,
    io::{Read, Seek, SeekFrom},
};

use mocapd_take::{
    TakeError, TakeEvent, TakeMap, TakeTraversal, chunk,
    damage::Problem,
    index::{Footer, IndexEntry},
    reader::{TakeBytes, TakeInput},
    record::{Channel, EndingKind, GroupLedger, Header, Ledger, MeasuredErrors, SummaryRecord},
    statistics::{ChannelStatistics, StretchTally, TakeStatistics, TakeTally},
    stretch::{ROWS_MAX, Stretch},
    timeline::{LossCauses, Timeline},
    traversal::{Decode, LocatedEvent, Progress},
};

use crate::{
    clock::{ClockStatus, LineDeviation, LineRefit},
    ledger::TakeHealth,
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
}

/// Summary of a whole take.
#[derive(Debug, Default)]
pub struct Summary {
    /// The take without its samples.
    pub take: TakeMap,
    /// By channel.
    pub per_channel: Vec<ChannelSummary>,
    /// The statistics that require decoding.
    pub statistics: TakeStatistics,
    /// The final state of the clocks, as stored in the take.
    pub clock: ClockStatus,
    /// Disconnections of the device, and the rows missing for them.
    pub outages: (u32, u64),
    /// Stretches read.
    pub stretches: u64,
    /// Bytes by purpose.
    pub bytes: TakeBytes,
    in_outage: bool,
    line_refit: LineRefit,
    claims: ClaimChecker,
    /// `None` if nothing is decoded.
    tally: Option<TakeTally>,
}

impl Summary {
    /// Reads and decodes the whole take, and compares the statistics that it states with its samples.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`. Damage is a problem, not an error.
    pub fn read(input: impl TakeInput) -> Result<Self, TakeError> {
        let decoding = Self { tally: Some(TakeTally::default()), ..Self::default() };
        let mut input = input.input();
        let (mut summary, rows_damaged) = decoding.traverse(&mut input, Decode::All)?;
        summary.take.check_samples(&mut input)?;
        let tally = summary.tally.take().unwrap_or_default();
        summary.statistics = tally.finish(summary.take.n_rows);
        summary.take.order.restore(&mut summary.statistics.channels);
        if !summary.take.damaged {
            summary.compare_statistics();
            summary.check_up_axis(&mut input)?;
        }
        summary.fill_channels(rows_damaged);
        Ok(summary)
    }

    /// Reads the whole take and checks every CRC, but takes the statistics that the take states in place of decoding its
    /// samples. [Decodes](Self::read) a take that states none, and one in which anything is damaged, missing or
    /// contradictory.
    ///
    /// # Errors
    /// Those of [`read`](Self::read).
    pub fn read_stated(input: impl TakeInput) -> Result<Self, TakeError> {
        let mut input = input.input();
        let (mut summary, rows_damaged) = Self::default().traverse(&mut input, Decode::Nothing)?;
        if let Some(stated) = summary.usable_statistics() {
            summary.statistics = stated;
            summary.fill_channels(rows_damaged);
            return Ok(summary);
        }
        input.seek(SeekFrom::Start(0))?;
        Self::read(&mut input)
    }

    /// Reads the take to its end. Returns also the rows lost to damage, by channel.
    fn traverse(
        mut self,
        input: impl TakeInput,
        decode: Decode,
    ) -> Result<(Self, Vec<u64>), TakeError> {
        let Progress { take, rows_damaged, .. } =
            TakeTraversal::new(input, decode).run(|found, progress| {
                self.on_event(found, progress);
                Ok(())
            })?;
        self.take = take;
        if self.take.finished && !self.take.damaged {
            self.claims.samples(&self.take);
        }
        Ok((self, rows_damaged))
    }

    /// The statistics that an undecoded take states, if nothing in it is damaged or contradicts them.
    fn usable_statistics(&self) -> Option<TakeStatistics> {
        let take = &self.take;
        let is_intact = take.finished && !take.damaged && take.problems.is_empty();
        let statistics = take.statistics.as_ref().filter(|_| is_intact)?;
        let ledger = take.ledger.as_ref()?;
        let is_consistent = self.claims.contradictions.is_empty()
            && statistics.channels.len() == take.channels.len()
            && statistics.samples() == ledger.samples_present
            && Some(statistics.rows_with_samples) <= take.n_sampled_rows;
        is_consistent.then(|| statistics.clone())
    }

    /// Compares the statistics that the take states with those of its samples.
    fn compare_statistics(&mut self) {
        let Some(stated) = &self.take.statistics else { return };
        let found = &self.statistics;
        if stated == found {
            return;
        }
        let pairs = stated.channels.iter().zip(&found.channels).zip(&self.take.channels);
        let sentence = match pairs.into_iter().find(|((stated, found), _)| stated != found) {
            Some(((stated, found), channel)) => format!(
                "the summary states {} of {}, but the take holds {}",
                figures(stated),
                channel.label,
                figures(found)
            ),
            None if stated.channels.len() != found.channels.len() => format!(
                "the summary has figures for {} markers, but the take has {}",
                stated.channels.len(),
                found.channels.len()
            ),
            None => format!(
                "the summary states {} frames with samples, {} frames with kept samples and {} samples in those, but the take holds {}, {} and {}",
                stated.rows_with_samples,
                stated.key_rows,
                stated.samples_in_key_rows,
                found.rows_with_samples,
                found.key_rows,
                found.samples_in_key_rows
            ),
        };
        self.claims.report(sentence);
    }

    /// Checks that the header states a valid up axis: readers treat any other value as unknown.
    fn check_up_axis(&mut self, input: &mut (impl Read + Seek)) -> Result<(), TakeError> {
        input.seek(SeekFrom::Start(chunk::MAGIC.len() as u64))?;
        let mut header = Vec::new();
        input.by_ref().take(self.bytes.header).read_to_end(&mut header)?;
        if let Some(code) = Header::unknown_up_axis(&header) {
            self.claims.report(format!("the header states the up axis {code}, expected 0 to 3"));
        }
        Ok(())
    }

    fn fill_channels(&mut self, rows_damaged: Vec<u64>) {
        let tolerance = self.take.header.codec().map(|codec| codec.tolerance);
        let summary = |(channel, rows_damaged): (&ChannelStatistics, u64)| ChannelSummary {
            samples: channel.samples,
            gaps: channel.gaps,
            knots: channel.knots,
            // The header was used to decode, or to check, the take.
            max_error_mm: tolerance.as_ref().map_or(0.0, |t| t.stated_mm(channel.error_step)),
            rows_damaged,
        };
        self.per_channel = self.statistics.channels.iter().zip(rows_damaged).map(summary).collect();
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
            let samples = self.take.sample_ledger.as_ref();
            ledger.map_or(TakeHealth::Damaged, |l| TakeHealth::of_closed(l, samples, ending))
        }
    }

    /// Deviation of the clock line from the line fitted to the stored observations; `None` if there is no line,
    /// or observations are missing.
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
        self.statistics.samples()
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

    fn on_event(&mut self, found: &LocatedEvent<'_>, progress: &Progress) {
        let is_damaged = progress.take.damaged;
        if let Some(tally) = &mut self.tally {
            tally.follow_table(found.lost_entries, progress.channels().len());
        }
        match &found.event {
            TakeEvent::Stretch(stretch) => {
                if let Some(timeline) = &stretch.timeline {
                    self.add_outages(timeline);
                }
                if !found.is_refused && stretch.span.n_rows > 0 {
                    self.stretches += 1;
                    self.claims.stretch(stretch, progress.channels().len());
                    if let Some(tally) = &mut self.tally {
                        let decoded = StretchTally::of_decoded(stretch, progress.coded_rows());
                        tally.add(stretch.span, &decoded);
                    }
                }
            }
            TakeEvent::Ledger(ledger) => {
                self.claims.ledger_offset = found.offset;
                if !is_damaged {
                    let samples = self.tally.as_ref().map(TakeTally::samples);
                    self.claims.ledger(ledger, samples);
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
            TakeEvent::Header(header) => self.claims.header(header),
            TakeEvent::Summary(summary) if !is_damaged => {
                self.claims.summary(summary, &progress.take.header, progress.channels());
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

/// The figures of a marker in a sentence.
fn figures(of: &ChannelStatistics) -> String {
    let ChannelStatistics { samples, gaps, knots, error_step } = of;
    format!(
        "{samples} samples, {gaps} gaps, {knots} kept samples and an error of {error_step}/63 of the tolerance"
    )
}

/// Ratio of the samples' float32 bytes to bytes on disk.
#[must_use]
pub fn size_ratio(samples: u64, file_bytes: u64) -> f64 {
    if file_bytes == 0 { 0.0 } else { (12 * samples) as f64 / file_bytes as f64 }
}

/// Maximum number of contradictions kept; one is enough to distrust a take.
const CONTRADICTIONS_MAX: usize = 20;

/// Compares a take's statements about itself with its content, counting what ledgers count.
#[derive(Debug, Default)]
struct ClaimChecker {
    recorded: u64,
    announced: u64,
    lost: u64,
    index_offset: u64,
    ledger_offset: u64,
    n_summaries: u64,
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

    fn header(&mut self, header: &Header) {
        let rows = u64::from(header.stretch_rows);
        if rows > ROWS_MAX {
            self.report(format!(
                "the header states stretches of {rows} frames; the limit is {ROWS_MAX}"
            ));
        }
    }

    /// Checks that there is only one summary, that it states no ending of a recording in an import, and that its
    /// copy of the header differs from the header only in its complete channel table.
    fn summary(&mut self, summary: &SummaryRecord, header: &Header, channels: &[Channel]) {
        self.n_summaries += 1;
        if self.n_summaries == 2 {
            self.report("there is a second summary; a take has only one".to_owned());
        }
        // A part of an import was cut at a length, and one that was recovered had been cut off.
        let of_imports = [EndingKind::Length, EndingKind::CutOff, EndingKind::Truncated];
        if let (Some(_), Some(ending)) = (&header.source, &summary.ending)
            && !of_imports.contains(&ending.kind)
        {
            self.report(format!(
                "the summary states how a recording ended ({}), but the take was imported",
                ending.kind
            ));
        }
        let Some(copy) = &summary.header else { return };
        let is_copy = copy.channels == channels
            && Header { channels: Vec::new(), ..(**copy).clone() }
                == Header { channels: Vec::new(), ..header.clone() };
        if !is_copy {
            self.report("the copy of the header in the summary differs from the header".to_owned());
        }
    }

    /// Checks a ledger against the `samples` found before it, if they were decoded. A ledger is correct for what
    /// precedes it, so everything before it must have been read.
    fn ledger(&mut self, ledger: &Ledger, samples: Option<u64>) {
        for (what, stated, found) in [
            ("recorded frames", ledger.recorded, self.recorded),
            ("samples", ledger.samples_present, samples.unwrap_or(ledger.samples_present)),
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

    /// Checks the last ledger of sampled channels of a closed take against its samples, and their times. What chunks of
    /// later versions state, which are not read, is held against nothing.
    fn samples(&mut self, take: &TakeMap) {
        let recovered = |(name, _): &(String, String)| name == mocapd_take::recovery::RECOVERED;
        let is_recovered = take.header.settings.iter().any(recovered);
        let stated = take.sample_ledger.as_ref().map_or(&[][..], |ledger| &ledger.groups);
        let later = take.later_samples;
        for group in take.sample_groups() {
            let number = group.group.number;
            let found = group.found_ledger();
            if found.stored > 0 && group.anchors().is_empty() && !later.times {
                self.report(format!("no times are stated for the samples of group {number}"));
            }
            if later.ledger {
                continue;
            }
            let stated = stated.iter().find(|stated| stated.group == number);
            // A version that knows ledgers but no poses recovered the take: it copied the group, and states of it what the
            // last ledger did, or nothing.
            let is_stale = stated.is_none_or(|stated| stated.stored < found.stored);
            if is_recovered && group.group.has_poses() && is_stale {
                continue;
            }
            let Some(stated) = stated else {
                self.report(format!("no ledger states the samples of group {number}"));
                continue;
            };
            // What the chunks do not show is taken from the ledger.
            if let (Some(bounds), Some(errors)) = (group.group.pose_bounds(), stated.errors) {
                let most = MeasuredErrors::at_most(bounds);
                let MeasuredErrors { position_nm, angle_nanodegrees } = errors;
                // Both were rounded up.
                let is_within = position_nm <= most.position_nm.saturating_add(1)
                    && angle_nanodegrees <= most.angle_nanodegrees.saturating_add(1);
                if !is_within {
                    self.report(format!(
                        "the summary states errors of the poses of group {number} beyond their bounds"
                    ));
                }
            }
            let shown = GroupLedger { duplicates: 0, jumps: 0, errors: None, ..*stated };
            // A version that does not know the ledger recovered the take, and left it as it was.
            let is_older = is_recovered && stated.taken == found.taken;
            if shown != found && !is_older {
                self.report(format!(
                    "the ledger states {} samples of group {number} in the take and {} lost, but the take holds {} and lacks {}",
                    stated.stored,
                    stated.lost(),
                    found.stored,
                    found.lost()
                ));
            }
        }
        if later.groups || later.ledger {
            return;
        }
        let is_known = |of: &GroupLedger| take.sample_groups().any(|g| g.group.number == of.group);
        // A recovered take may lack the description of a group, and so all its samples.
        if let Some(stated) = stated.iter().find(|stated| stated.stored > 0 && !is_known(stated)) {
            self.report(format!(
                "the ledger states samples of group {}, which is not there",
                stated.group
            ));
        }
    }

    fn report(&mut self, sentence: String) {
        if self.contradictions.len() < CONTRADICTIONS_MAX {
            self.contradictions.push(sentence);
        }
    }
}

/// The result of checking a take.
#[derive(Debug)]
pub struct Verdict<'a> {
    /// What is damaged or missing; empty for an intact take.
    pub problems: Vec<Finding<'a>>,
    /// Statements of the take about itself that its own data contradicts, one sentence each, in bytes that are intact.
    pub contradictions: Vec<String>,
    /// How far the stored clock line is from the line fitted to the stored observations.
    pub clock: Option<LineDeviation>,
}

/// One defect of a take.
#[derive(Debug)]
pub enum Finding<'a> {
    /// A damaged part.
    Damage(&'a Problem),
    /// The last ledger does not close.
    LedgerOpen,
    /// The last ledger of a group of sampled channels does not close.
    SampleLedgerOpen {
        /// Number of the group.
        group: u32,
    },
    /// The last ledger states another number of samples than the take holds.
    Samples {
        /// Samples that the ledger states.
        stated: u64,
        /// Samples found in the take.
        found: u64,
    },
}

impl fmt::Display for Finding<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damage(problem) => problem.fmt(f),
            Self::LedgerOpen => f.write_str("the ledger does not close"),
            Self::SampleLedgerOpen { group } => {
                write!(f, "the ledger of the samples of group {group} does not close")
            }
            Self::Samples { stated, found } => {
                write!(f, "the ledger states {stated} samples, but the take holds {found}")
            }
        }
    }
}

impl<'a> Verdict<'a> {
    /// Checks a take that was read.
    #[must_use]
    pub fn of(summary: &'a Summary) -> Self {
        let take = &summary.take;
        // Problems of the ledger come before damage: a long list of damage is shown in part.
        let mut problems = Vec::new();
        if take.ledger.as_ref().is_some_and(|ledger| !Ledger::closes(ledger)) {
            problems.push(Finding::LedgerOpen);
        }
        let groups = take.sample_ledger.iter().flat_map(|ledger| &ledger.groups);
        let open = groups.filter(|group| !group.closes());
        problems.extend(open.map(|group| Finding::SampleLedgerOpen { group: group.group }));
        // In an undamaged take every ledger was compared already, and a difference is a contradiction.
        if let Some(&Ledger { samples_present: stated, .. }) = take.ledger.as_ref()
            && (take.finished && take.damaged)
            && stated != summary.samples()
        {
            problems.push(Finding::Samples { stated, found: summary.samples() });
        }
        problems.extend(take.problems.iter().map(Finding::Damage));
        let mut contradictions = summary.contradictions().to_vec();
        let clock = summary.clock_deviation();
        if let Some(LineDeviation { offset_us, drift_ppm, agrees: false }) = &clock {
            contradictions.push(format!(
                "the clock line differs by {offset_us:.1} us and {drift_ppm:.3} ppm from the line fitted to its observations"
            ));
        }
        Self { problems, contradictions, clock }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problems_of(summary: &Summary) -> Vec<String> {
        Verdict::of(summary).problems.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_ledger_that_does_not_close_is_a_problem_before_the_end_too() {
        let mut summary = Summary::default();
        assert_eq!(problems_of(&summary), [""; 0], "no ledger");
        summary.take.ledger = Some(Ledger { recorded: 1, ..Ledger::default() });
        for finished in [false, true] {
            summary.take.finished = finished;
            assert_eq!(problems_of(&summary), ["the ledger does not close"]);
        }
        assert!(Verdict::of(&summary).contradictions.is_empty());
        // Regardless of other damage.
        let damage = Problem::MissingBefore { row: 7 };
        summary.take.problems = vec![damage.clone(); 2];
        let damage = damage.to_string();
        assert_eq!(problems_of(&summary), ["the ledger does not close", &damage, &damage]);
    }

    #[test]
    fn the_samples_of_a_damaged_take_are_compared_with_its_ledger() {
        let mut summary = Summary::default();
        let ledger = Ledger { samples_announced: 3, samples_present: 3, ..Ledger::default() };
        summary.take.ledger = Some(ledger);
        assert_eq!(problems_of(&summary), [""; 0]);
        (summary.take.finished, summary.take.damaged) = (true, true);
        assert_eq!(problems_of(&summary), ["the ledger states 3 samples, but the take holds 0"]);
    }
}
