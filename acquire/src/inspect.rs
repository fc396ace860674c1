//! Reads a whole take and tells what is in it: the numbers behind `info` and `verify`.

use mocapd_take::{
    TakeError, TakeEvent, TakeReader,
    chunk::MAGIC,
    frames::mended,
    loss::{Losses, LostRows},
    problems::Problems,
    reader::{TakeBytes, TakeInput, pull},
    record::{Channel, Clock, ClockLine, Event, Header, Ledger, Subject, TakeEnding},
    stretch::{Stretch, StretchDecoder},
    table::ChannelTable,
    timeline::{Causes, Timeline},
};

use crate::{
    clock::{Apart, ClockStatus, LineAgain},
    health::TakeHealth,
};

mod claims;

use self::claims::Claims;

/// One channel, over the whole take.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ChannelSummary {
    /// Samples present.
    pub samples: u64,
    /// Runs of rows without a sample, at the ends too.
    pub gaps: u64,
    /// Samples kept.
    pub knots: u64,
    /// The largest error that the blocks with samples of it state for all their channels, in
    /// millimetres.
    pub max_error_mm: f64,
    /// Rows that are lost because the take is damaged, or was when it was recovered: it was announced, and
    /// nobody knows whether it was seen.
    pub rows_damaged: u64,
    in_gap: bool,
}

/// A whole take.
#[derive(Debug, Default)]
pub struct Summary {
    /// Its header.
    pub header: Option<Header>,
    table: ChannelTable,
    losses: Losses,
    /// By channel.
    pub per_channel: Vec<ChannelSummary>,
    /// Rows, lost ones included.
    pub rows: u64,
    /// The last ledger.
    pub ledger: Option<Ledger>,
    /// How it ended, where it says.
    pub ending: Option<TakeEnding>,
    /// The last that was said of the clocks, without what the line was laid through.
    pub clock: Option<Clock>,
    /// Round trips that are in the take.
    pub clock_probes: u64,
    /// Frames that were kept for the line.
    pub clock_points: u64,
    /// By segment, the last line of each that has one.
    pub clock_lines: Vec<(u32, ClockLine)>,
    /// Times that the device was away, and the rows missing for it.
    pub outages: (u32, u64),
    in_outage: bool,
    line_again: LineAgain,
    claims: Claims,
    /// Who was captured.
    pub subject: Option<Subject>,
    /// The events.
    pub events: Vec<Event>,
    /// What an importer kept: kind, and bytes as they were.
    pub foreign: Vec<(String, u64)>,
    /// Stretches that were decoded.
    pub stretches: u64,
    end_of_stretches: u64,
    /// The damage that explains a missing stretch was told.
    damage_told: bool,
    /// What was found may not be all rows.
    damaged: bool,
    ended: bool,
    /// What the bytes are for.
    pub bytes: TakeBytes,
    /// Whether the take was closed in order.
    pub finished: bool,
    /// What is missing or damaged.
    pub problems: Vec<String>,
    /// Rows with at least one sample: T of (Shi et al. 2012).
    pub rows_with_samples: u64,
    /// Rows with at least one kept sample: K.
    pub key_rows: u64,
    /// Samples present in those rows: the sum of |K in `P_i`|.
    pub samples_in_key_rows: u64,
}

impl Summary {
    /// Reads and decodes everything.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`. Damage is a problem, not an error.
    pub fn read(input: impl TakeInput) -> Result<Self, TakeError> {
        let mut input = input.input();
        let mut summary = Self::default();
        let mut decoder = None;
        let mut reader = TakeReader::new();
        // Events lie behind each other: one begins where the one before ends.
        let mut offset = 0;
        while !summary.ended {
            match reader.next_event()? {
                Some(event) => {
                    summary.event(event, offset.max(MAGIC.len() as u64), &mut decoder)?;
                }
                None => pull(&mut input, &mut reader)?,
            }
            offset = reader.offset();
        }
        summary.skip_rows_to(summary.rows);
        summary.losses.at_least(summary.rows);
        let lost = summary.losses.finish();
        summary.lose(lost);
        if !summary.finished {
            summary.problems.note("the take was cut off: its end is missing".to_owned());
        }
        Ok(summary)
    }

    /// The whole channel table.
    #[must_use]
    pub fn channels(&self) -> &[Channel] {
        self.table.channels()
    }

    /// Rows that are lost because the take is damaged, or was when it was recovered.
    #[must_use]
    pub fn damage(&self) -> &[LostRows] {
        self.losses.lost()
    }

    /// Whether anything was found that is damaged, missing or not decodable: what a whole take says of itself need
    /// not be true then.
    #[must_use]
    pub fn is_damaged(&self) -> bool {
        self.damaged
    }

    /// What the take says of itself and what is not so, though nothing is damaged: one sentence each.
    #[must_use]
    pub fn contradictions(&self) -> &[String] {
        self.claims.broken()
    }

    /// How it is, in one word.
    #[must_use]
    pub fn health(&self) -> TakeHealth {
        let clock_is_off = self.clock_apart().is_some_and(|apart| !apart.agrees);
        if !self.contradictions().is_empty() || clock_is_off {
            TakeHealth::Damaged
        } else if !self.finished && self.damage().is_empty() {
            // All that is missing is its end, and perhaps half a chunk before that.
            TakeHealth::CutOff
        } else if self.is_damaged() || !self.problems.is_empty() {
            TakeHealth::Damaged
        } else {
            let ending = self.ending.as_ref();
            self.ledger.as_ref().map_or(TakeHealth::Damaged, |l| TakeHealth::of_closed(l, ending))
        }
    }

    /// How far the clocks' line lies from what the stored observations give; `None` where there is no line, or not
    /// all of them are there.
    #[must_use]
    pub fn clock_apart(&self) -> Option<Apart> {
        // A take that was recovered need not have all that the line was laid through.
        let recovered = self.header.as_ref().is_some_and(|header| {
            header.settings.iter().any(|(name, _)| name == mocapd_take::recovery::RECOVERED)
        });
        if self.damaged || recovered { None } else { self.line_again.apart() }
    }

    /// How the clocks ran in the end, as far as the take tells.
    #[must_use]
    pub fn clock_status(&self) -> ClockStatus {
        let Some(clock) = &self.clock else { return ClockStatus::default() };
        ClockStatus {
            segment: clock.segment,
            tick_hz: clock.tick_hz,
            line: clock.line,
            jitter: clock.jitter,
            probes: self.clock_probes,
            points: self.clock_points,
            residual_us: clock.jitter.residual_us as f64,
            stored: self.clock_probes + self.clock_points,
        }
    }

    /// Samples present.
    #[must_use]
    pub fn samples(&self) -> u64 {
        self.per_channel.iter().map(|channel| channel.samples).sum()
    }

    /// Samples kept.
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

    /// The next thing found, which begins at file offset `offset`.
    fn event(
        &mut self,
        event: TakeEvent<'_>,
        offset: u64,
        decoder: &mut Option<StretchDecoder>,
    ) -> Result<(), TakeError> {
        match event {
            TakeEvent::Header(header) => {
                *decoder = Some(StretchDecoder::new(header.codec()?));
                self.claims = Claims::new(header.tolerance_mm);
                self.add_channels(&header.channels);
                self.header = Some(*header);
            }
            TakeEvent::Channels(more) => self.add_channels(&more),
            TakeEvent::Mended { offset } => self.problems.note(mended(offset)),
            TakeEvent::Stretch(stretch) => {
                if let Some(decoder) = decoder {
                    self.add_stretch(&stretch, offset, decoder);
                }
            }
            TakeEvent::Unplaced { missing_before, n_rows, rows_min } => {
                self.add_unplaced(missing_before, n_rows, rows_min);
            }
            TakeEvent::Subject(subject) => self.subject = Some(*subject),
            TakeEvent::Event(event) => self.events.push(event),
            TakeEvent::Ledger(ledger) => {
                self.claims.ledger(&ledger, offset, self.samples(), self.damaged);
                self.ledger = Some(*ledger);
            }
            TakeEvent::Summary(summary) => self.ending = summary.ending,
            TakeEvent::Foreign(part) => {
                self.foreign.push((part.kind, part.data_bytes));
            }
            TakeEvent::Clock(clock) => {
                self.clock_probes += clock.probes.len() as u64;
                self.clock_points += clock.points.len() as u64;
                self.line_again.add(&clock);
                if let Some(line) = clock.line {
                    self.clock_lines.pop_if(|last| last.0 == clock.segment);
                    self.clock_lines.push((clock.segment, line));
                }
                self.clock = Some(Clock { probes: vec![], points: vec![], ..*clock });
            }
            TakeEvent::Footer(footer) => {
                self.claims.footer(&footer, self.damaged);
                self.check_rows(footer.n_rows);
            }
            TakeEvent::Damaged { offset, len, message, .. } => {
                self.problems.note(format!("{len} bytes at byte {offset}: {message}"));
                self.damage_told = true;
                self.damaged = true;
                self.table.damaged();
            }
            TakeEvent::End { finished, bytes } => {
                self.ended = true;
                self.finished = finished;
                self.bytes = bytes;
            }
            TakeEvent::Index(entries) => self.claims.index(&entries, offset, self.damaged),
            TakeEvent::Skipped { .. } => {}
        }
        Ok(())
    }

    fn add_channels(&mut self, more: &[Channel]) {
        self.table.append(more);
        self.per_channel.resize(self.table.channels().len(), self.late());
    }

    /// A marker that appears later has had a gap until then.
    fn late(&self) -> ChannelSummary {
        ChannelSummary {
            in_gap: self.rows > 0,
            gaps: u64::from(self.rows > 0),
            ..Default::default()
        }
    }

    /// So many rows of every channel.
    fn lose(&mut self, rows: u64) {
        for channel in &mut self.per_channel {
            channel.rows_damaged += rows;
        }
    }

    fn check_rows(&mut self, n_rows: u64) {
        if n_rows != self.rows {
            self.problems
                .note(format!("the footer tells of {n_rows} frames, {} were found", self.rows));
        }
        if self.damaged {
            self.rows = self.rows.max(n_rows);
        }
    }

    /// Rows up to `row` that no stretch holds: gaps in every channel.
    fn skip_rows_to(&mut self, row: u64) {
        if row > self.end_of_stretches {
            self.add_empty_stretch();
            self.end_of_stretches = row;
        }
    }

    /// A stretch in which no marker was seen.
    fn add_empty_stretch(&mut self) {
        for channel in &mut self.per_channel {
            channel.gaps += u64::from(!std::mem::replace(&mut channel.in_gap, true));
        }
    }

    /// A stretch whose rows nobody knows: they stand as gaps before what follows.
    fn add_unplaced(&mut self, missing_before: bool, n_rows: u32, rows_min: u64) {
        let from = self.rows;
        if missing_before && !std::mem::take(&mut self.damage_told) {
            self.problems.note(format!("stretches from frame {from} on are missing"));
        }
        self.problems.note(format!(
            "a stretch of {n_rows} frames, from frame {from} or later: it depends on a damaged one"
        ));
        self.damaged = true;
        self.rows = self.rows.max(rows_min);
    }

    fn add_stretch(&mut self, stretch: &Stretch<'_>, offset: u64, decoder: &mut StretchDecoder) {
        let span = stretch.span;
        let end = span.end_row();
        self.damaged |= stretch.missing_before;
        self.claims.key(span, offset);
        if stretch.missing_before && !std::mem::take(&mut self.damage_told) {
            self.problems.note(format!("stretches before frame {} are missing", span.first_row));
        }
        if let Some(timeline) = &stretch.timeline {
            self.add_outages(timeline);
        }
        if span.n_rows == 0 {
            // The take ends with lost rows, or some were lost before it was recovered.
            self.rows = self.rows.max(end);
            let lost = self.losses.stretch(stretch);
            self.lose(lost);
            return;
        }
        self.name_channels(stretch.stated_channels());
        let refused = if span.first_row < self.end_of_stretches {
            decoder.pass();
            Some("it comes twice".to_owned())
        } else if decoder.depends_on_lost(span) {
            Some("it depends on a damaged one".to_owned())
        } else {
            decoder.decode(stretch).err().map(|error| error.to_string())
        };
        self.rows = self.rows.max(end);
        if let Some(reason) = refused {
            let frames = format!("frames {} to {}", span.first_row, end.saturating_sub(1));
            self.problems.note(format!("the stretch of {frames}: {reason}"));
            self.damaged = true;
            return;
        }
        self.skip_rows_to(span.first_row);
        let lost = self.losses.stretch(stretch);
        self.lose(lost);
        self.claims.stretch(stretch, self.table.channels().len());
        self.stretches += 1;
        self.end_of_stretches = end;
        let n_rows = span.n_rows as usize;
        if stretch.blocks.iter().all(|block| block.is_empty()) {
            self.add_empty_stretch();
            return;
        }
        let mut present_in = vec![0_u32; n_rows];
        let mut kept_in = vec![false; n_rows];
        let rows = decoder.rows().chain(std::iter::repeat(None));
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
            let away = run.lost.is_some_and(|causes| causes.contain(Causes::DISCONNECTED));
            self.outages.0 += u32::from(away && !self.in_outage);
            self.outages.1 += if away { run.rows } else { 0 };
            self.in_outage = away;
        }
    }

    /// A stretch has samples of so many channels at least: those without an entry in the table get one.
    fn name_channels(&mut self, n_channels: usize) {
        let Some(renamed) = self.table.stated(n_channels) else { return };
        self.problems.note(renamed.to_string());
        let late = self.late();
        let at = renamed.first.min(self.per_channel.len());
        self.per_channel.splice(at..at, std::iter::repeat_n(late, renamed.inserted));
    }
}

fn ratio(over: u64, under: u64) -> Option<f64> {
    (under > 0).then(|| over as f64 / under as f64)
}

/// Raw float32 bytes of so many samples to bytes on disk.
#[must_use]
pub fn size_ratio(samples: u64, file_bytes: u64) -> f64 {
    ratio(12 * samples, file_bytes).unwrap_or(0.0)
}
