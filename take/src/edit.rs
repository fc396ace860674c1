//! Editing takes: [`cut`] copies a range of frames into a new take, [`concat()`] joins takes, [`repack()`] writes a take in
//! fewer bytes. No sample changes.
//!
//! Stretches are copied wherever they do not depend on one that is left out. The rows of a stretch that is only partly
//! kept, or that continues one that is not kept, are encoded again where that gives the same floats, as for whole spans
//! behind a key and rows in which nothing moves; else they are stored as the floats that they decode to
//! (`docs/decisions/0012-the-ends-of-a-cut-are-stored-exactly.md`).

mod concat;
mod cut;
mod recorded;
mod repack;

#[cfg(test)]
mod tests;

use std::{
    io::{self, Read, Seek},
    ops::Range,
    sync::Arc,
};

pub use self::{
    concat::{ConcatReport, Mismatch, check_joinable, concat},
    cut::{CutReport, cut},
    repack::{REPACK, RepackReport, RepackSettings, check_repacked, repack},
};
use crate::{
    TakeError, TakeEvent, TakeMap, TakeTraversal,
    chunk::types,
    damage::Problem,
    foreign::{
        Foreign, ForeignPart,
        content::{PartStore, ScratchFile, Spool},
    },
    interchange::c3d::sample_parts,
    record::{Clock, Device, Header, SeriesPlace},
    sampled::{LostSamples, SampledPart, is_recorded},
    timeline::RowTime,
    traversal::{Decode, LocatedEvent, Progress},
};

/// The key in the settings of HEADER that marks a take cut from another.
pub const CUT: &str = "cut";

/// The key in the settings of HEADER that marks a take joined of others.
pub const CONCAT: &str = "concat";

/// What the caller of an edit provides.
pub struct EditContext<'a> {
    /// Names the program in the new take.
    pub software: &'a str,
    /// Creates the file for foreign parts that are too large for memory.
    pub new_scratch: &'a dyn Fn() -> io::Result<Arc<dyn ScratchFile>>,
    /// Receives the number of rows after each stretch, for a progress display.
    pub on_rows: &'a dyn Fn(u64),
}

impl std::fmt::Debug for EditContext<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("EditContext").field("software", &self.software).finish_non_exhaustive()
    }
}

/// The error for a take that is not whole.
fn damaged(problem: &Problem) -> TakeError {
    TakeError::InvalidArgument(format!(
        "only complete takes can be cut, joined or repacked: use the take that `mocapd recover` writes ({problem})"
    ))
}

/// The number of channels from a row on.
#[derive(Debug, Clone, Copy)]
struct TableSize {
    row: u64,
    n_channels: usize,
}

/// A whole take, without its samples: what an edit knows before it writes.
#[derive(Debug, Default)]
pub struct SourceTake {
    map: TakeMap,
    clocks: Vec<Clock>,
    tables: Vec<TableSize>,
    /// The first and the last recorded row with their times; `None` in an import.
    ends: Option<[(u64, RowTime); 2]>,
    /// Whether a stretch has a time line, as those of a recovered import may.
    has_time_lines: bool,
    /// Types of chunks that this version does not know.
    unknown_chunks: Vec<u8>,
    n_stretches: u64,
}

impl SourceTake {
    /// Reads a take and checks every checksum, without decoding samples.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`; `InvalidArgument` for a take that is damaged or was cut off.
    pub fn read(input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        let source = Self::scan(input)?;
        match source.map.problems.first() {
            Some(problem) => Err(damaged(problem)),
            None => Ok(source),
        }
    }

    /// Reads a take like [`read`](Self::read), but keeps its problems in the map instead of refusing it.
    fn scan(input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        let mut source = Self::default();
        let traversal = TakeTraversal::without_decoding(input);
        let Progress { take, .. } = traversal.run(|found, progress| {
            source.visit(found, progress);
            Ok(())
        })?;
        Ok(Self { map: take, ..source })
    }

    /// Everything in the take but its samples.
    #[must_use]
    pub fn map(&self) -> &TakeMap {
        &self.map
    }

    fn visit(&mut self, found: &LocatedEvent<'_>, progress: &Progress) {
        match &found.event {
            TakeEvent::Header(_) | TakeEvent::Channels(_) => self
                .tables
                .push(TableSize { row: progress.end_row(), n_channels: progress.channels().len() }),
            TakeEvent::Clock(clock) => self.clocks.push((**clock).clone()),
            TakeEvent::Stretch(stretch) => {
                self.n_stretches += 1;
                let Some(timeline) = &stretch.timeline else { return };
                self.has_time_lines = true;
                let (first, last) = (timeline.recorded().next(), timeline.recorded().last());
                if let Some((first, last)) = first.zip(last) {
                    let first = self.ends.map_or(first, |ends| ends[0]);
                    self.ends = Some([first, last]);
                }
            }
            TakeEvent::Skipped { kind }
                if *kind != types::INDEX && !self.unknown_chunks.contains(kind) =>
            {
                self.unknown_chunks.push(*kind);
            }
            _ => {}
        }
    }

    /// The size of the channel table for the stretch from `row` on.
    fn channels_at(&self, row: u64) -> usize {
        let n_sizes = self.tables.partition_point(|size| size.row <= row);
        self.tables[..n_sizes].last().map_or(0, |size| size.n_channels)
    }

    /// The number of the first row in the file that the take was imported from.
    fn first_frame(&self) -> u64 {
        self.map.header.source.as_ref().map_or(0, |source| source.first_frame)
    }

    /// Its rows in a divided recording; `None` in other takes.
    fn place(&self) -> Option<SeriesPlace> {
        SeriesPlace::of(&self.map.header, self.map.n_rows)
    }

    /// What an edit leaves out of any take: content whose rows are unknown to this version.
    fn left_out(&self) -> impl Iterator<Item = String> + '_ {
        self.unknown_chunks.iter().map(|kind| format!("chunks of the unknown type {kind:02x}"))
    }

    /// The rows `rows`, extended to stretches that can be copied: from the last key stretch at or before the first row
    /// to the end of the stretch with the last row.
    ///
    /// # Errors
    /// Those of [`TakeTraversal::next_stretch`].
    pub fn whole_stretches(
        &self,
        input: impl Read + Seek,
        rows: &Range<u64>,
    ) -> Result<Range<u64>, TakeError> {
        let keys = self.map.keys.iter().map(|key| key.first_row);
        let start = keys.take_while(|row| *row <= rows.start).last().unwrap_or(0);
        let mut traversal = TakeTraversal::from_map(input, &self.map, Decode::Groups(Vec::new()))?;
        traversal.seek(rows.end.saturating_sub(1))?;
        while let Some(span) = traversal.next_stretch()? {
            if span.end_row() >= rows.end {
                // The rows lost before a stretch belong to it: they need none of its blocks.
                let end = if span.first_row >= rows.end { rows.end } else { span.end_row() };
                return Ok(start..end);
            }
        }
        Ok(start..rows.end)
    }
}

/// The longest time between two takes that counts as an outage within one recording, in seconds: the service waits for
/// its device as long (`take.reconnect`). After a longer time it begins another take, which is a recording of its own.
const OUTAGE_S_MAX: f64 = 60.0;

/// Most that the two clocks of a recording may differ over an outage, in seconds. A queue holds frames back for a
/// fraction of that, and crystals differ by a few milliseconds a minute.
const CLOCKS_APART_S_MAX: f64 = 1.0;

/// What lies between one take and the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Seam {
    /// Nothing: the second continues the first.
    Continuous,
    /// Both are of one recording, and this many frames between them are in neither: by the clocks of both, or by their
    /// places in a divided recording.
    Missing(u64),
    /// Unknown: the two are not known to be of one recording.
    Unknown,
}

impl Seam {
    /// Rows of the joined take that lie in neither of the two.
    fn rows(self) -> u64 {
        if let Self::Missing(rows) = self { rows } else { 0 }
    }

    /// The seam between `before` and `after`.
    fn between(before: &SourceTake, after: &SourceTake) -> Self {
        let (one, other) = (&before.map().header, &after.map().header);
        let origins = CutOrigin::of(one).zip(CutOrigin::of(other));
        if origins.is_some_and(|(one, other)| other.follows(&one)) {
            return Self::Continuous;
        }
        let in_series = SeriesPlace::rows_between(before.place(), after.place());
        let missing = match (&one.device, &other.device) {
            (Some(_), Some(_)) if in_series.is_some() => in_series,
            (Some(a), Some(b)) if is_one_device(a, b) => missing_by_clocks(before, after),
            (None, None) => {
                let next_frame = before.first_frame().checked_add(before.map().n_rows);
                let continues = next_frame == Some(after.first_frame());
                (is_one_file(one, other) && continues).then_some(0)
            }
            _ => None,
        };
        match missing {
            Some(0) => Self::Continuous,
            Some(rows) => Self::Missing(rows),
            None => Self::Unknown,
        }
    }
}

fn is_one_device(a: &Device, b: &Device) -> bool {
    let identity = |device: &Device| {
        (device.driver.clone(), device.model.clone(), device.serial.clone(), device.tick_hz)
    };
    identity(a) == identity(b)
}

fn is_one_file(one: &Header, other: &Header) -> bool {
    let files = one.source.as_ref().zip(other.source.as_ref());
    files.is_some_and(|(a, b)| (&a.format, &a.file) == (&b.format, &b.file))
}

/// Rows between two recordings of one device, by its clock and the host's; `None` unless they show that both belong to
/// one recording.
fn missing_by_clocks(before: &SourceTake, after: &SourceTake) -> Option<u64> {
    let ([first, last], [next, _]) = before.ends.zip(after.ends)?;
    let header = &before.map().header;
    let tick_hz = header.device.as_ref()?.tick_hz;
    let until_end = before.map().n_rows.checked_sub(last.0)?;
    let clock = DeviceClock::new(tick_hz, header.rate_hz, first, last);
    clock.missing(last.1, next.1, until_end.checked_add(next.0)?)
}

/// The take and the rows that a part was cut from.
#[derive(Debug, Clone, PartialEq, Eq)]
struct CutOrigin {
    take_id: String,
    rows: Range<u64>,
}

impl CutOrigin {
    /// The origin that the header of a part states in its settings.
    fn of(header: &Header) -> Option<Self> {
        let (_, text) = header.settings.iter().rfind(|(key, _)| key == CUT)?;
        let (take_id, rest) = text.split_once(": frames ")?;
        let (rows, _) = rest.split_once(" of ")?;
        let (start, end) = rows.split_once("..")?;
        let rows = start.parse().ok()?..end.parse().ok()?;
        Some(Self { take_id: take_id.to_owned(), rows })
    }

    /// The setting, for a part of a take of `n_rows` rows.
    fn to_setting(&self, n_rows: u64, software: &str) -> String {
        let Self { take_id, rows: Range { start, end } } = self;
        format!("{take_id}: frames {start}..{end} of {n_rows}, by {software}")
    }

    /// Whether these rows follow `before` in the same take.
    fn follows(&self, before: &Self) -> bool {
        self.take_id == before.take_id && self.rows.start == before.rows.end
    }
}

/// The clock of a device, measured over a take.
struct DeviceClock {
    tick_hz: f64,
    rate_hz: f64,
    ticks_per_row: f64,
}

impl DeviceClock {
    /// Measures the period between the first and the last recorded row.
    fn new(tick_hz: u64, rate_hz: f64, first: (u64, RowTime), last: (u64, RowTime)) -> Self {
        let tick_hz = tick_hz.max(1) as f64;
        let (rows, ticks) = (
            last.0.saturating_sub(first.0) as f64,
            last.1.device_ticks.wrapping_sub(first.1.device_ticks).cast_signed() as f64,
        );
        let nominal = tick_hz / rate_hz;
        let measured = ticks / rows;
        // A clock that jumped during the take does not measure it.
        let is_plausible = (measured / nominal - 1.0).abs() < 0.01;
        let ticks_per_row = if is_plausible { measured } else { nominal };
        Self { tick_hz, rate_hz, ticks_per_row }
    }

    /// Rows that are missing between the rows recorded at `last` and `next`, if `rows` lie between them when none is.
    /// `None` unless both clocks show that the second follows the first within an outage.
    fn missing(&self, last: RowTime, next: RowTime, rows: u64) -> Option<u64> {
        let ticks = next.device_ticks.wrapping_sub(last.device_ticks).cast_signed() as f64;
        let arrivals = next.arrival_10us.wrapping_sub(last.arrival_10us).cast_signed() as f64;
        let apart_s = arrivals * 1e-5 - ticks / self.tick_hz;
        let found = (ticks / self.ticks_per_row).round();
        let missing = found - rows as f64;
        let is_possible = missing >= 0.0 && missing <= OUTAGE_S_MAX * self.rate_hz;
        (is_possible && apart_s.abs() <= CLOCKS_APART_S_MAX).then_some(missing as u64)
    }
}

/// How the content of a part relates to frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FrameRelation {
    /// It describes the whole file.
    None,
    /// It gives the numbers of the frames that it belongs to, so that the part of a take finds its own.
    Numbered,
    /// It holds samples of every frame.
    Samples,
}

/// The kinds that importers keep. How others relate to frames is unknown.
const KINDS: [(&str, FrameRelation); 8] = [
    ("c3d/parameters", FrameRelation::None),
    ("c3d/analog", FrameRelation::Samples),
    ("c3d/residuals", FrameRelation::Samples),
    ("c3d/model-outputs", FrameRelation::Samples),
    ("c3d/gap-coordinates", FrameRelation::Numbered),
    ("trc/header", FrameRelation::None),
    ("tsv/header", FrameRelation::None),
    ("csv/header", FrameRelation::None),
];

fn relation_of(kind: &str) -> Option<FrameRelation> {
    KINDS.iter().find(|(known, _)| *known == kind).map(|(_, relation)| *relation)
}

/// A foreign part of an edited take, and the samples of it that are lost.
#[derive(Debug)]
struct EditedPart {
    part: Foreign,
    lost: Vec<LostSamples>,
}

/// Cuts a foreign part to the frame numbers `frames`; `None` if its relation to frames is unknown. `input` is the file
/// of the take.
fn cut_part(
    part: &ForeignPart,
    input: &mut (impl Read + Seek),
    frames: &Range<u64>,
    context: &EditContext<'_>,
) -> Result<Option<EditedPart>, TakeError> {
    let Some(relation) = relation_of(&part.kind) else { return Ok(None) };
    let whole = read_part(part, input, &mut Spool::new(context.new_scratch))?;
    if relation != FrameRelation::Samples {
        return Ok(Some(whole));
    }
    let found = sample_parts::cut(&whole.part, frames, &mut part_store(context))?;
    Ok(found.map(|(part, samples)| {
        let of_range = |lost: LostSamples| {
            let first = lost.first.max(samples.start);
            let n = lost.first.saturating_add(lost.n).min(samples.end).checked_sub(first)?;
            (n > 0).then(|| LostSamples { first: first - samples.start, n, ..lost })
        };
        EditedPart { part, lost: whole.lost.into_iter().filter_map(of_range).collect() }
    }))
}

/// Reads a part whole, to write it again.
fn read_whole_part(
    part: &ForeignPart,
    input: &mut (impl Read + Seek),
    context: &EditContext<'_>,
) -> Result<EditedPart, TakeError> {
    if relation_of(&part.kind).is_none() {
        return Err(TakeError::InvalidArgument(format!(
            "it has the part `{}`, which this version cannot keep: use a newer mocapd",
            part.kind
        )));
    }
    read_part(part, input, &mut Spool::new(context.new_scratch))
}

/// Reads a foreign part; damage is an error.
fn read_part(
    part: &ForeignPart,
    input: &mut (impl Read + Seek),
    spool: &mut Spool<impl Fn() -> io::Result<Arc<dyn ScratchFile>>>,
) -> Result<EditedPart, TakeError> {
    let (whole, lost, undecodable) = part.read_for_edit(input, spool)?;
    match undecodable.first() {
        Some(found) => Err(damaged(&Problem::of_samples(&part.kind, found))),
        None => Ok(EditedPart { part: whole, lost }),
    }
}

/// Holds the contents of new parts.
fn part_store<'a>(context: &EditContext<'a>) -> PartStore<'a> {
    PartStore::new(true, context.new_scratch)
}

/// The foreign parts of joined takes, and the kinds that cannot be joined.
#[derive(Debug, Default)]
struct JoinedParts {
    parts: Vec<EditedPart>,
    left_out: Vec<String>,
}

/// Joins the foreign parts of takes, kind by kind. `frames_continue`: every take begins with the frame number after the
/// last of the one before.
fn join_parts<R: Read + Seek>(
    sources: &[SourceTake],
    open: &mut impl FnMut(usize) -> io::Result<R>,
    frames_continue: bool,
    context: &EditContext<'_>,
) -> Result<JoinedParts, TakeError> {
    let mut kinds: Vec<&str> = Vec::new();
    let parts = sources.iter().flat_map(|source| &source.map().foreign);
    for part in parts.filter(|part| !is_recorded(&part.kind)) {
        if !kinds.contains(&part.kind.as_str()) {
            kinds.push(&part.kind);
        }
    }
    let mut joined = JoinedParts::default();
    // Samples mean nothing without the parameters that they were stored with.
    let mut parameters_differ = false;
    for kind in kinds {
        let found: Option<Vec<_>> = sources.iter().map(|source| part_of(source, kind)).collect();
        let part = match found.filter(|_| !parameters_differ) {
            Some(found) => join_kind(sources, open, &found, frames_continue, context)?,
            None => None,
        };
        if part.is_none() {
            joined.left_out.push(kind.to_owned());
            parameters_differ |= relation_of(kind) == Some(FrameRelation::None);
        }
        joined.parts.extend(part);
    }
    Ok(joined)
}

/// The only part of a kind.
fn part_of<'a>(source: &'a SourceTake, kind: &str) -> Option<&'a ForeignPart> {
    let mut parts = source.map().foreign.iter().filter(|part| part.kind == kind);
    parts.next().filter(|_| parts.next().is_none())
}

/// Joins the parts of one kind, one of each take; `None` if they cannot be.
fn join_kind<R: Read + Seek>(
    sources: &[SourceTake],
    open: &mut impl FnMut(usize) -> io::Result<R>,
    found: &[&ForeignPart],
    frames_continue: bool,
    context: &EditContext<'_>,
) -> Result<Option<EditedPart>, TakeError> {
    let mut spool = Spool::new(context.new_scratch);
    let mut read_parts = Vec::new();
    for (i, part) in found.iter().enumerate() {
        read_parts.push(read_part(part, &mut open(i)?, &mut spool)?);
    }
    let parts: Vec<&Foreign> = read_parts.iter().map(|read| &read.part).collect();
    let relation = relation_of(found.first().map_or("", |part| part.kind.as_str()));
    if relation == Some(FrameRelation::Samples) {
        let frames = sources.iter().map(|source| source.map().n_rows);
        let sized: Vec<_> = parts.iter().copied().zip(frames.clone()).collect();
        let joined = sample_parts::join(&sized, &mut part_store(context))?;
        let (mut lost, mut before) = (Vec::new(), 0_u64);
        // Parts of different ratios are not joined.
        let ratio = found.iter().find_map(|part| part.sampled());
        let ratio = ratio.map_or(1, SampledPart::samples_per_frame);
        for (read, n_frames) in read_parts.iter().zip(frames) {
            lost.extend(
                read.lost
                    .iter()
                    .map(|lost| LostSamples { first: lost.first.saturating_add(before), ..*lost }),
            );
            before = before.saturating_add(n_frames.saturating_mul(ratio));
        }
        return Ok(joined.map(|part| EditedPart { part, lost }));
    }
    let are_equal = parts.array_windows().all(|[a, b]| a == b);
    let is_joined = match relation {
        Some(FrameRelation::Numbered) => frames_continue,
        relation => relation.is_some(),
    };
    Ok(read_parts.into_iter().next().filter(|_| are_equal && is_joined))
}
