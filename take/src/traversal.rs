//! The traversal of a take, shared by all code that reads one. It owns the channel table, the decoders, the lost rows
//! and the problems, and passes its current state along with each element of the take.
//!
//! [`run`](TakeTraversal::run) reads a whole take. Rows between two key stretches can be read independently:
//! [`pieces`](TakeMap::pieces) splits rows there, and each decoding thread has a traversal [of the same
//! map](TakeTraversal::from_map).

use std::{
    io::{Read, Seek, SeekFrom},
    ops::Range,
};

use mocapd_codec::DecodedRows;

use crate::{
    TakeError, TakeEvent, TakeReader,
    chunk::MAGIC,
    damage::{LossTracker, Problem, Refusal, push_problem},
    foreign::ForeignPart,
    index::IndexEntry,
    map::TakeMap,
    reader::{TakeInput, feed},
    record::{Channel, SummaryRecord},
    stretch::{Span, Stretch, StretchDecoder},
    table::ChannelTable,
    timeline::Timeline,
};

pub use crate::table::LostEntries;

/// What a traversal decodes of each stretch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Decode {
    /// All blocks.
    All,
    /// The groups of channels with these numbers, or none. Groups are coded independently of each other; channels of
    /// other groups have no samples.
    Groups(Vec<usize>),
    /// No block, nor the times of rows, nor foreign parts: every CRC is checked, and every record read.
    Nothing,
}

/// An element of a take that the traversal has reached.
#[derive(Debug)]
pub struct LocatedEvent<'a> {
    /// File offset of its chunk.
    pub offset: u64,
    /// Size in bytes.
    pub len: u64,
    /// The element.
    pub event: TakeEvent<'a>,
    /// For a stretch: its rows are unavailable, and the last problem gives the reason.
    pub is_refused: bool,
    /// For a stretch: it revealed lost entries of the channel table.
    pub lost_entries: Option<LostEntries>,
}

/// The state of a traversal.
#[derive(Debug)]
pub struct Progress {
    /// The content of the take so far, except its motion. Channels, rows and damage are set at the end.
    pub take: TakeMap,
    /// By channel, rows lost to damage since the channel was announced.
    pub rows_damaged: Vec<u64>,
    table: ChannelTable,
    losses: LossTracker,
    decoder: Option<StretchDecoder>,
    decode: Decode,
    scope: ProblemScope,
    /// The damage that explains a missing stretch was already reported.
    damage_reported: bool,
    timeline: Option<Timeline>,
}

/// Which problems a traversal reports, and whether it builds a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ProblemScope {
    /// All problems; builds the map.
    All,
    /// All but those of decoding, which a later traversal reports; builds the map.
    Map,
    /// All problems; the existing map was built without reading stretches.
    Unscanned,
    /// Those of decoding; the existing map has all others.
    Decoding,
}

impl Progress {
    /// The channel table so far, in the order in which its channels are coded.
    #[must_use]
    pub fn channels(&self) -> &[Channel] {
        self.table.channels()
    }

    /// The row after the last stretch that was read.
    #[must_use]
    pub fn end_row(&self) -> u64 {
        self.losses.end_row
    }

    /// Rows so far, including lost ones.
    #[must_use]
    pub fn n_rows(&self) -> u64 {
        self.losses.rows_min()
    }

    /// The rows of the last decoded stretch, by column of the source; `None` for one without samples in it.
    pub fn rows(&self) -> impl Iterator<Item = Option<&DecodedRows>> {
        let order = &self.take.order;
        self.decoder.iter().flat_map(|decoder| decoder.rows_in(|column| order.row_of(column)))
    }

    /// The rows like [`rows`](Self::rows), in the order in which they are coded: that of [`channels`](Self::channels).
    pub fn coded_rows(&self) -> impl Iterator<Item = Option<&DecodedRows>> {
        self.decoder.iter().flat_map(StretchDecoder::rows)
    }

    fn new(decode: Decode, scope: ProblemScope) -> Self {
        let builds_map = matches!(scope, ProblemScope::All | ProblemScope::Map);
        let read = builds_map.then_some(0);
        Self {
            take: TakeMap { n_sampled_rows: read, longest_stretch: read, ..TakeMap::default() },
            rows_damaged: Vec::new(),
            table: ChannelTable::default(),
            losses: LossTracker::new(builds_map.then(Vec::new)),
            decoder: None,
            decode,
            scope,
            damage_reported: false,
            timeline: None,
        }
    }

    fn builds_map(&self) -> bool {
        matches!(self.scope, ProblemScope::All | ProblemScope::Map)
    }

    fn report(&mut self, problem: Problem) {
        let is_reported = match self.scope {
            ProblemScope::All | ProblemScope::Unscanned => true,
            ProblemScope::Map => !problem.is_decoding_problem(),
            ProblemScope::Decoding => problem.is_decoding_problem(),
        };
        if is_reported {
            push_problem(&mut self.take.problems, problem);
        }
    }

    fn start_decoding(&mut self) -> Result<(), TakeError> {
        let settings = self.take.header.codec()?;
        self.decoder = Some(match &self.decode {
            Decode::All => StretchDecoder::new(settings),
            Decode::Groups(groups) => StretchDecoder::with_groups(settings, groups.clone()),
            Decode::Nothing => StretchDecoder::with_groups(settings, Vec::new()),
        });
        Ok(())
    }

    fn announce(&mut self, channels: &[Channel]) {
        if self.builds_map() {
            self.table.append(channels);
            self.rows_damaged.resize(self.table.channels().len(), 0);
        }
    }

    /// Counts `rows` of every channel as lost.
    fn add_lost(&mut self, rows: u64) {
        self.rows_damaged.iter_mut().for_each(|channel| *channel += rows);
    }

    fn report_missing(&mut self, problem: Problem) {
        self.take.damaged = true;
        if !std::mem::take(&mut self.damage_reported) {
            self.report(problem);
        }
    }

    /// Applies an event to the state. Returns whether a stretch is refused, and which channel table entries it revealed
    /// as lost.
    fn apply(
        &mut self,
        offset: u64,
        event: &TakeEvent<'_>,
    ) -> Result<(bool, Option<LostEntries>), TakeError> {
        match event {
            TakeEvent::Header(header) if self.builds_map() => {
                self.take.header.clone_from(header);
                self.start_decoding()?;
                self.announce(&header.channels);
            }
            TakeEvent::Channels(more) => self.announce(more),
            TakeEvent::Order(order) if self.builds_map() => self.take.order.clone_from(order),
            TakeEvent::Summary(summary) if self.builds_map() => self.check_order(summary),
            TakeEvent::Stretch(stretch) => return Ok(self.stretch(offset, stretch)),
            TakeEvent::Unplaced { missing_before, n_rows, rows_min } => {
                let from_row = self.n_rows();
                if *missing_before {
                    self.report_missing(Problem::MissingFrom { row: from_row });
                }
                self.take.damaged = true;
                self.report(Problem::Unplaced { n_rows: *n_rows, from_row });
                self.losses.raise_rows_min(*rows_min);
            }
            TakeEvent::Damaged { offset, len, message, .. } => {
                let (offset, len, message) = (*offset, *len, message.clone());
                self.report(Problem::Damaged { offset, len, message });
                self.damage_reported = true;
                self.take.damaged = true;
                self.table.add_damage();
            }
            TakeEvent::Skipped { kind } => self.take.later_samples.skip(*kind),
            TakeEvent::Repaired { offset } => self.report(Problem::Repaired { offset: *offset }),
            TakeEvent::Footer(footer) => {
                let (stated, found) = (footer.n_rows, self.n_rows());
                // Rows may be lost to damage that was reported; the footer adds no problem then.
                if stated < found || stated > found && !self.take.damaged {
                    self.report(Problem::FooterRows { stated, found });
                }
                if self.take.damaged {
                    self.losses.raise_rows_min(stated);
                }
            }
            TakeEvent::End { finished, .. } => self.end(*finished),
            _ => {}
        }
        Ok((false, None))
    }

    /// Compares the order of the markers that a summary states with that of the take.
    fn check_order(&mut self, summary: &SummaryRecord) {
        if summary.contradicts_order(&self.take.order) {
            self.report(match self.take.order.n_channels() {
                0 => Problem::OrderLost,
                _ => Problem::OrderContradicted,
            });
        }
    }

    fn stretch(&mut self, offset: u64, stretch: &Stretch<'_>) -> (bool, Option<LostEntries>) {
        let Span { first_row, n_rows, key, .. } = stretch.span;
        if stretch.missing_before {
            self.report_missing(Problem::MissingBefore { row: first_row });
        }
        let key_here = self.losses.seek_key.filter(|key| key.offset == offset);
        if let Some(key) = key_here.filter(|key| key.first_row != first_row) {
            // The seek to it may have skipped rows that exist.
            self.report(Problem::IndexRow { stated: key.first_row, found: first_row });
            self.take.damaged = true;
        }
        if let Err(refusal) = self.decode(offset, stretch) {
            self.report(Problem::Refused { first_row, n_rows, refusal });
            self.take.damaged = true;
            self.losses.raise_rows_min(stretch.span.end_row());
            return (true, None);
        }
        let mut lost_entries = None;
        if self.builds_map() {
            lost_entries = self.name_channels(stretch.stated_channels());
            let rows_before = self.n_rows();
            if key && n_rows > 0 && first_row >= rows_before {
                self.take.keys.push(IndexEntry { offset, first_row });
            }
            self.take.longest_stretch = self.take.longest_stretch.max(Some(n_rows.into()));
            // A stretch without samples holds no rows.
            let is_sampled = stretch.blocks.iter().any(|block| !block.is_empty());
            if is_sampled && let Some(held) = &mut self.take.n_sampled_rows {
                *held += u64::from(n_rows);
            }
        }
        let lost = self.losses.add_stretch(stretch);
        self.add_lost(lost);
        (false, lost_entries)
    }

    fn decode(&mut self, offset: u64, stretch: &Stretch<'_>) -> Result<(), Refusal> {
        let is_repeated = self.losses.is_repeated(offset, stretch);
        let Some(decoder) = &mut self.decoder else { return Ok(()) };
        if is_repeated {
            decoder.skip();
            Err(Refusal::Twice)
        } else if decoder.depends_on_lost(stretch.span) {
            Err(Refusal::DependsOnLost)
        } else if stretch.span.n_rows == 0 {
            Ok(())
        } else {
            decoder.decode(stretch).map_err(|error| Refusal::Undecodable(error.to_string()))
        }
    }

    /// Adds entries for channels that a stretch has and the table lacks.
    fn name_channels(&mut self, n_channels: usize) -> Option<LostEntries> {
        let lost_entries = self.table.reconcile(n_channels)?;
        self.report(Problem::NamesLost { markers: lost_entries.nameless });
        let at = lost_entries.first.min(self.rows_damaged.len());
        self.rows_damaged.splice(at..at, std::iter::repeat_n(0, lost_entries.inserted));
        Some(lost_entries)
    }

    /// Reports the samples of groups that are missing or damaged in this file.
    fn report_lost_samples(&mut self) {
        if !self.builds_map() {
            return;
        }
        let mut problems = Vec::new();
        for part in self.take.foreign.iter().filter_map(ForeignPart::sampled) {
            if let Some(channels) = part.missing_channels() {
                let kind = part.kind().to_owned();
                push_problem(&mut problems, Problem::DescriptionLost { kind, channels });
            }
            for lost in part.lost().iter().filter(|lost| lost.causes.is_none()) {
                push_problem(&mut problems, Problem::of_samples(part.kind(), lost));
            }
        }
        let chunks = self.take.samples_orphaned;
        // Those of a group of a later version cannot be read, and nothing is wrong with them.
        if chunks > 0 && !self.take.later_samples.groups {
            push_problem(&mut problems, Problem::SamplesOrphaned { chunks });
        }
        self.take.damaged |= !problems.is_empty();
        problems.into_iter().for_each(|problem| self.report(problem));
    }

    fn end(&mut self, finished: bool) {
        let lost = self.losses.finish();
        self.add_lost(lost);
        self.report_lost_samples();
        if !finished {
            self.report(Problem::CutOff);
        } else if self.builds_map() && self.take.ledger.is_none() {
            self.report(Problem::NoLedger);
        }
        self.take.finished = finished;
        self.take.n_rows = self.losses.end_row;
        self.take.damage = self.losses.lost.take().unwrap_or_default();
        self.take.channels = self.table.channels().to_vec();
        self.take.restore_order();
    }
}

/// Reads a take in bounded memory, from its start or from any key stretch. It skips whatever cannot be decoded;
/// [`problems`](Self::problems) gives the reasons.
#[derive(Debug)]
pub struct TakeTraversal<R> {
    input: R,
    reader: TakeReader,
    /// File offset after the last event.
    at: u64,
    progress: Progress,
    /// File offset of the key stretch of the last seek.
    sought: u64,
    /// The last stretch.
    current: Option<Span>,
    ended: bool,
}

impl<R: Read + Seek> TakeTraversal<R> {
    /// A traversal from start to end.
    pub fn new(input: impl TakeInput<Input = R>, decode: Decode) -> Self {
        Self::with(input.input(), Progress::new(decode, ProblemScope::All))
    }

    /// A traversal that decodes nothing. Problems of decoding are left to a later traversal.
    pub(crate) fn without_decoding(input: R) -> Self {
        Self::with(input, Progress::new(Decode::Groups(Vec::new()), ProblemScope::Map))
    }

    fn with(input: R, progress: Progress) -> Self {
        let reader = match progress.decode {
            Decode::Nothing => TakeReader::skipping_content(),
            Decode::All | Decode::Groups(_) => TakeReader::new(),
        };
        let at = MAGIC.len() as u64;
        Self { input, reader, at, progress, sought: at, current: None, ended: false }
    }

    /// A traversal of a take whose map exists, from its start or from a [key stretch](Self::seek). It does not repeat
    /// the problems in [`TakeMap::problems`].
    ///
    /// # Errors
    /// `Unsupported` or `Codec` when the header cannot be used, `Io`.
    pub fn from_map(mut input: R, map: &TakeMap, decode: Decode) -> Result<Self, TakeError> {
        input.seek(SeekFrom::Start(0))?;
        let is_scanned = map.n_sampled_rows.is_some();
        let scope = if is_scanned { ProblemScope::Decoding } else { ProblemScope::Unscanned };
        let mut progress = Progress::new(decode, scope);
        progress.take.header = map.header.clone();
        progress.take.order = map.order.clone();
        progress.take.keys.clone_from(&map.keys);
        progress.start_decoding()?;
        Ok(Self::with(input, progress))
    }

    /// Reads the take to its end. `visit` receives each element of the take and the state after it.
    ///
    /// # Errors
    /// Those of [`TakeReader::next_event`], `Io`, and any error of `visit`.
    pub fn run(
        mut self,
        mut visit: impl FnMut(&LocatedEvent<'_>, &Progress) -> Result<(), TakeError>,
    ) -> Result<Progress, TakeError> {
        while !self.ended {
            self.step(&mut visit)?;
        }
        Ok(self.progress)
    }

    /// Whether the end of the take was reached.
    pub(crate) fn is_ended(&self) -> bool {
        self.ended
    }

    /// Reads a piece of the file, or visits the next event.
    pub(crate) fn step(
        &mut self,
        visit: impl FnOnce(&LocatedEvent<'_>, &Progress) -> Result<(), TakeError>,
    ) -> Result<(), TakeError> {
        let Some((end, event)) = self.reader.next_located()? else {
            return feed(&mut self.input, &mut self.reader);
        };
        // Events are contiguous in the file.
        let offset = std::mem::replace(&mut self.at, end);
        let (is_refused, lost_entries) = self.progress.apply(offset, &event)?;
        let len = end.saturating_sub(offset);
        let found = LocatedEvent { offset, len, event, is_refused, lost_entries };
        visit(&found, &self.progress)?;
        match found.event {
            TakeEvent::End { .. } => {
                self.ended = true;
                self.current = None;
            }
            TakeEvent::Stretch(stretch) if !is_refused => {
                self.current = Some(stretch.span);
                self.progress.timeline = stretch.timeline;
            }
            event if self.progress.builds_map() => {
                self.progress.take.add_content(event, offset, len);
            }
            _ => {}
        }
        Ok(())
    }

    /// Continues at the last key stretch that begins at or before `row`, and skips the stretches before it. Does
    /// nothing if that key lies before the current position. At most ten seconds of the take are then decoded before
    /// `row`, or five minutes of an import where nothing moves, unless its keys are further apart.
    ///
    /// Problems of skipped stretches are not reported.
    ///
    /// # Errors
    /// `Unsupported` or `Codec` when the header cannot be used, `Io`.
    pub fn seek(&mut self, row: u64) -> Result<(), TakeError> {
        let take = &self.progress.take;
        let behind = take.keys.partition_point(|key| key.first_row <= row);
        let Some(&key) = take.keys[..behind].last() else { return Ok(()) };
        let is_read = self.at > MAGIC.len() as u64 && key.first_row <= self.progress.end_row();
        if is_read || key.offset <= self.at || self.ended {
            return Ok(());
        }
        self.input.seek(SeekFrom::Start(key.offset))?;
        self.reader = TakeReader::from_key(&take.header, key)?;
        (self.at, self.sought) = (key.offset, key.offset);
        if let Some(decoder) = &mut self.progress.decoder {
            decoder.skip();
        }
        self.progress.losses.seek(key);
        self.progress.damage_reported = false;
        self.current = None;
        Ok(())
    }

    /// Decodes the next stretch; `None` at the end of the take. A stretch without rows, which only records lost ones,
    /// counts too.
    ///
    /// # Errors
    /// `NotATake`, `Io`.
    pub fn next_stretch(&mut self) -> Result<Option<Span>, TakeError> {
        self.current = None;
        while self.current.is_none() && !self.ended {
            self.step(|_, _| Ok(()))?;
        }
        Ok(self.current)
    }

    /// Bytes of the stretches, and of what is between them, since the start or the last [seek](Self::seek).
    #[must_use]
    pub fn bytes_read(&self) -> u64 {
        self.at - self.sought
    }

    /// Decodes the stretches that contain any of the rows `rows`, from the last key stretch before them on. `each`
    /// receives the range of these rows in a stretch, and the index of the first of them in [the stretch's
    /// rows](Self::rows). Rows in no stretch are lost.
    ///
    /// # Errors
    /// Those of [`next_stretch`](Self::next_stretch), and any error of `each`.
    pub fn read_rows(
        &mut self,
        rows: &Range<u64>,
        mut each: impl FnMut(&Self, Range<u64>, usize) -> Result<(), TakeError>,
    ) -> Result<(), TakeError> {
        self.seek(rows.start)?;
        // The stretch that was decoded last may contain some of them.
        while self.current.is_some() || self.next_stretch()?.is_some() {
            let Some(span) = self.current else { break };
            let part = span.first_row.max(rows.start)..span.end_row().min(rows.end);
            if part.start < part.end {
                let offset = (part.start - span.first_row) as usize;
                each(self, part, offset)?;
            }
            if span.end_row() >= rows.end {
                break;
            }
            self.current = None;
        }
        Ok(())
    }

    /// The rows of the last stretch, by column of the source; `None` for one without samples in it.
    pub fn rows(&self) -> impl Iterator<Item = Option<&DecodedRows>> {
        self.progress.rows()
    }

    /// The times of the last stretch's rows, including those lost before it; `None` in an import.
    #[must_use]
    pub fn timeline(&self) -> Option<&Timeline> {
        self.progress.timeline.as_ref()
    }

    /// Whether nothing read so far was damaged or missing.
    #[must_use]
    pub fn is_intact(&self) -> bool {
        let Progress { take, .. } = &self.progress;
        !take.damaged && (take.finished || !self.ended)
    }

    /// The problems so far.
    #[must_use]
    pub fn problems(&self) -> &[Problem] {
        &self.progress.take.problems
    }

    /// Removes and returns the problems since the last call.
    pub fn take_problems(&mut self) -> Vec<Problem> {
        std::mem::take(&mut self.progress.take.problems)
    }
}
