//! Writes a take again in fewer bytes: the same floats, gaps, times, events, parts and stated bounds.
//!
//! What a take has of a lossless resampler can be encoded in any way. The points of a lossy one depend on all that is
//! encoded before them, so its stretches stay as they are; but those that an edit stored as floats may be parts of
//! stretches that can be put together again, and consecutive stretches in which nothing moves need be only one.

use std::io::{Read, Seek, Write};

use mocapd_codec::{
    BlockEncoder, BlockReport, DecodedRows, Effort, GROUP_CHANNELS, Position, ResamplerKind, Rows,
    Settings, stated_error_step,
};

use super::{EditContext, SourceTake, cut::ExactBlocks, damaged, foreign};
use crate::{
    TakeError, TakeEvent, TakeTraversal, TakeWriter,
    compare::{ContentDifference, compare_times},
    frames::TakeFrames,
    motion::{FrameSource, GAP, is_gap},
    motion_encoder::{EncodePlan, MotionWriter, stretch_rows},
    record::{Channel, Header, KeyDistance, long_stretch_rows},
    statistics::{BlockTally, StretchTally},
    stretch::{
        CopiedStretch, NUMBERS, Span, Stretch, StretchHeaderWriter, is_alone, put_block,
        put_renumbered,
    },
    timeline::Timeline,
    traversal::Decode,
};

/// The key in the settings of HEADER that marks a take encoded again with other settings.
pub const REPACK: &str = "repack";

/// How to encode the samples of a lossless take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RepackSettings {
    /// Resampler and tolerance.
    pub codec: Settings,
    /// Effort of the resampler.
    pub effort: Effort,
    /// The distance of key stretches, if one is chosen; of imports only.
    pub keys: Option<KeyDistance>,
}

/// The result of a repack.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RepackReport {
    /// Rows of the take.
    pub rows: u64,
    /// Stretches of the old and the new take.
    pub stretches: [u64; 2],
    /// Size of the new take in bytes.
    pub bytes: u64,
    /// The header of the new take.
    pub header: Header,
}

/// Writes a take again. `input` is the file that `source` was read from. `settings` are for lossless takes: others keep
/// theirs.
///
/// # Errors
/// `InvalidArgument` for settings that would need samples that the take does not have, for content that this version
/// does not know, and for a stretch that cannot be decoded; `Io`; those of [`TakeWriter`].
pub fn repack<W: Write>(
    source: &SourceTake,
    mut input: impl Read + Seek,
    settings: Option<&RepackSettings>,
    out: W,
    context: &EditContext<'_>,
) -> Result<RepackReport, TakeError> {
    let map = source.map();
    let invalid = |why: String| Err(TakeError::InvalidArgument(why));
    if let Some(what) = source.left_out().next() {
        return invalid(format!(
            "it has {what}, which this version cannot keep: use a newer mocapd"
        ));
    }
    let codec = map.header.codec()?;
    let is_lossless = codec.kind.is_lossless();
    if settings.is_some() && !is_lossless {
        return invalid(format!(
            "other settings need the source or a lossless take, and this take is {} within {} mm: import the source again",
            codec.kind,
            codec.tolerance.mm()
        ));
    }
    let is_import = source.ends.is_none() && map.header.device.is_none();
    let settings = settings.filter(|_| is_lossless);
    if settings.is_some_and(|settings| settings.keys.is_some()) && !is_import {
        return invalid(
            "the key stretches of a recording hold its clocks, and stay: omit --keys".to_owned(),
        );
    }
    // A table that grows with the take belongs to the stretches where it does.
    let is_steady = map.header.channels.len() == map.channels.len();
    let is_encoded_anew = settings.is_some() && is_import && is_steady;
    let header = header_of_repacked(source, settings, is_encoded_anew, context)?;
    let mut take = TakeWriter::new(out, &header)?;
    map.subject.iter().try_for_each(|subject| take.subject(subject))?;
    for part in &map.foreign {
        let whole = foreign::read_whole(part, &mut input, context)?;
        take.foreign_with_lost(&whole.part, &whole.lost)?;
    }
    for event in &map.events {
        take.event(event)?;
    }
    let mut report =
        RepackReport { rows: map.n_rows, header: header.clone(), ..Default::default() };
    report.stretches[0] = source.n_stretches;
    let mut take = if is_encoded_anew {
        let (take, n_stretches) = encode_import(&mut input, &header, take, context)?;
        report.stretches[1] = n_stretches;
        take
    } else {
        let mut repacker = Repacker::new(source, settings, take, &header)?;
        TakeTraversal::from_map(&mut input, map, Decode::All)?.run(|found, progress| {
            let TakeEvent::Stretch(stretch) = &found.event else { return Ok(()) };
            if let Some(problem) = progress.take.problems.first() {
                return Err(damaged(problem));
            }
            let rows: Vec<_> = progress.rows().collect();
            repacker.stretch(stretch, &rows)?;
            (context.on_rows)(stretch.span.end_row());
            Ok(())
        })?;
        repacker.flush()?;
        report.stretches[1] = repacker.n_stretches;
        repacker.take
    };
    for clock in &source.clocks {
        take.clock(clock)?;
    }
    take.close(&map.ledger.clone().unwrap_or_default(), map.ending.clone())?;
    report.bytes = take.bytes();
    Ok(report)
}

/// The header of the take, with what other settings change.
fn header_of_repacked(
    source: &SourceTake,
    settings: Option<&RepackSettings>,
    is_encoded_anew: bool,
    context: &EditContext<'_>,
) -> Result<Header, TakeError> {
    let map = source.map();
    let mut header = map.header.clone();
    let Some(settings) = settings else { return Ok(header) };
    header.set_codec(&settings.codec);
    header.set_effort(settings.effort);
    if is_encoded_anew {
        let (n_rows, n_channels) = (map.n_rows as usize, header.channels.len());
        header.stretch_rows =
            stretch_rows(&settings.codec, header.rate_hz, n_rows, n_channels) as u32;
        header.unset_key_distance();
        if let Some(keys) = settings.keys {
            header.set_key_distance(keys, map.n_rows);
        }
    }
    if !settings.codec.kind.is_lossless() {
        // Other samples are another take.
        let note = format!("{}: by {}", map.header.take_id_text(), context.software);
        header.settings.push((REPACK.to_owned(), note));
        header.set_import_id(&map.header.take_id[..], map.subject.as_ref())?;
    }
    Ok(header)
}

/// Encodes all samples of an import anew. Returns the writer, and the number of stretches.
fn encode_import<W: Write>(
    input: &mut (impl Read + Seek),
    header: &Header,
    take: TakeWriter<W>,
    context: &EditContext<'_>,
) -> Result<(TakeWriter<W>, u64), TakeError> {
    let mut frames = TakeFrames::open(input)?;
    let (plan, parts) = EncodePlan::new(&mut frames, header)?;
    let mut writer = MotionWriter::continuing(&plan, header, take);
    let mut encoder = plan.encoder();
    let mut n_stretches = 0;
    for part in parts {
        let part = part?;
        writer.push(&part, &encoder.encode(&part)?)?;
        n_stretches += u64::from(part.first_marker == 0);
        (context.on_rows)((part.first_row + part.n_rows) as u64);
    }
    Ok((writer.into_take(), n_stretches))
}

/// A stretch that waits for those that it may be joined with.
struct Waiting {
    span: Span,
    payload: Vec<u8>,
    /// The errors that its blocks state.
    stated: Vec<u8>,
    tally: StretchTally,
}

/// Copies or encodes the stretches of a take, one after another.
struct Repacker<W> {
    take: TakeWriter<W>,
    source_channels: Vec<(u64, usize)>,
    channels: Vec<Channel>,
    /// Entries of the channel table that were written.
    n_channels: usize,
    stretch_rows: u32,
    /// Most rows of joined stretches in which nothing moves.
    still_rows: u64,
    /// By group, the encoders of a recording that was lossless; empty if stretches are copied.
    encoders: Vec<Box<dyn BlockEncoder>>,
    target: Option<RepackSettings>,
    exact: Option<ExactBlocks>,
    waiting: Vec<Waiting>,
    /// By channel, the rows of the stretches that wait.
    joined: Vec<DecodedRows>,
    is_still: bool,
    number: u8,
    n_stretches: u64,
}

impl<W: Write> Repacker<W> {
    fn new(
        source: &SourceTake,
        target: Option<&RepackSettings>,
        take: TakeWriter<W>,
        header: &Header,
    ) -> Result<Self, TakeError> {
        let map = source.map();
        let codec = map.header.codec()?;
        // Stretches of a recording have times; those that continue others cannot be taken out.
        let is_joined = codec.kind == ResamplerKind::Dense
            && map.header.device.is_none()
            && !map.header.has_long_keys();
        Ok(Self {
            take,
            source_channels: source.tables.iter().map(|size| (size.row, size.n_channels)).collect(),
            channels: map.channels.clone(),
            n_channels: header.channels.len(),
            stretch_rows: header.stretch_rows,
            still_rows: long_stretch_rows(header.rate_hz, map.channels.len()) as u64,
            encoders: Vec::new(),
            target: target.copied(),
            exact: is_joined.then(|| ExactBlocks::new(&codec)),
            waiting: Vec::new(),
            joined: Vec::new(),
            is_still: true,
            number: 0,
            n_stretches: 0,
        })
    }

    fn stretch(
        &mut self,
        stretch: &Stretch<'_>,
        rows: &[Option<&DecodedRows>],
    ) -> Result<(), TakeError> {
        let tally = StretchTally::of_decoded(stretch, rows.iter().copied());
        let can_join = self.exact.is_some()
            && stretch.span.key
            && stretch.timeline.is_none()
            && stretch.span.n_rows > 0;
        if !can_join || !self.continues(stretch, rows, &tally) {
            self.flush()?;
        }
        self.grow(stretch.from_row())?;
        if let Some(target) = self.target
            && stretch.span.n_rows > 0
        {
            return self.encode(&target, stretch, rows);
        }
        let waiting = Waiting {
            span: stretch.span,
            payload: stretch.payload.to_vec(),
            stated: stretch.blocks.iter().map(|block| stated_error_step(block)).collect(),
            tally,
        };
        if !can_join {
            return self.copy(&waiting, stretch.timeline.as_ref(), stretch.from_row());
        }
        self.wait(waiting, rows);
        Ok(())
    }

    /// Writes the channels that are announced up to a row.
    fn grow(&mut self, row: u64) -> Result<(), TakeError> {
        let sizes = self.source_channels.iter().take_while(|(at, _)| *at <= row);
        let n_channels = sizes.last().map_or(0, |(_, n)| *n);
        let more = self.channels.get(self.n_channels..n_channels).unwrap_or_default().to_vec();
        if more.is_empty() {
            return Ok(());
        }
        self.flush()?;
        self.take.channels(&more)?;
        self.n_channels = n_channels;
        Ok(())
    }

    /// Whether a stretch may be joined with those that wait: it states the same errors, and was stored by an edit, or
    /// nothing moves in all of them.
    fn continues(
        &self,
        stretch: &Stretch<'_>,
        rows: &[Option<&DecodedRows>],
        tally: &StretchTally,
    ) -> bool {
        let Some(last) = self.waiting.last() else { return false };
        let stated = stretch.blocks.iter().map(|block| stated_error_step(block));
        if !last.stated.iter().copied().eq(stated) {
            return false;
        }
        let n_waiting: u64 =
            self.waiting.iter().map(|waiting| u64::from(waiting.span.n_rows)).sum();
        let n_rows = n_waiting + u64::from(stretch.span.n_rows);
        let n_bytes: usize = stretch.blocks.iter().map(|block| block.len()).sum();
        let is_stored = is_stored(n_bytes, tally);
        if is_stored && n_rows <= u64::from(self.stretch_rows) {
            return true;
        }
        let goes_on = |(i, decoded): (usize, &Option<&DecodedRows>)| {
            let Some(decoded) = decoded else { return true };
            let before = self.joined.get(i).and_then(last_position);
            let first = first_position(decoded);
            is_still(decoded) && (before.is_none() || first.is_none() || before == first)
        };
        self.is_still && n_rows <= self.still_rows && rows.iter().enumerate().all(goes_on)
    }

    /// Adds a stretch to those that wait.
    fn wait(&mut self, waiting: Waiting, rows: &[Option<&DecodedRows>]) {
        if self.waiting.is_empty() {
            (self.joined, self.is_still) = (Vec::new(), true);
        }
        let before: usize = self.waiting.iter().map(|waiting| waiting.span.n_rows as usize).sum();
        let after = before + waiting.span.n_rows as usize;
        if self.joined.len() < rows.len() {
            self.joined.resize_with(rows.len(), DecodedRows::default);
        }
        for (i, joined) in self.joined.iter_mut().enumerate() {
            joined.positions.resize(before, [0.0; 3]);
            joined.present.resize(before, false);
            if let Some(decoded) = rows.get(i).copied().flatten() {
                self.is_still &= is_still(decoded);
                let parts = last_position(joined).zip(first_position(decoded));
                self.is_still &= parts.is_none_or(|(before, first)| before == first);
                joined.positions.extend_from_slice(&decoded.positions);
                joined.present.extend_from_slice(&decoded.present);
                joined.max_error_mm = joined.max_error_mm.max(decoded.max_error_mm);
            }
            joined.positions.resize(after, [0.0; 3]);
            joined.present.resize(after, false);
        }
        self.waiting.push(waiting);
    }

    /// Writes the stretches that wait: as one, if that takes fewer bytes.
    fn flush(&mut self) -> Result<(), TakeError> {
        let waiting = std::mem::take(&mut self.waiting);
        if let [first, _, ..] = waiting.as_slice() {
            let n_rows: u32 = waiting.iter().map(|waiting| waiting.span.n_rows).sum();
            let span = Span { n_rows, number: self.number, ..first.span };
            let alone = self.joined.len() <= GROUP_CHANNELS;
            let mut payload = Vec::new();
            let mut front = StretchHeaderWriter::new(self.stretch_rows);
            front.put(span, &Timeline::default(), &[], alone, &mut payload);
            let rows: Vec<_> = self.joined.iter().map(Some).collect();
            let encoded = match &mut self.exact {
                Some(exact) => {
                    Some(exact.put(&rows, &(0..n_rows as usize), alone, &mut payload)?)
                }
                None => None,
            };
            let n_before: usize = waiting.iter().map(|waiting| waiting.payload.len()).sum();
            if let Some((tally, _)) = encoded.filter(|_| payload.len() < n_before) {
                return self.push(span, &payload, &tally);
            }
        }
        waiting.iter().try_for_each(|waiting| self.copy(waiting, None, waiting.span.first_row))
    }

    fn copy(
        &mut self,
        waiting: &Waiting,
        timeline: Option<&Timeline>,
        from_row: u64,
    ) -> Result<(), TakeError> {
        let span = Span { number: self.number, ..waiting.span };
        let runs = timeline.map(|timeline| timeline.runs.clone());
        let mut payload = Vec::new();
        CopiedStretch { span, from_row, runs, stretch_rows: [self.stretch_rows; 2] }
            .put(&waiting.payload, &mut payload)?;
        self.push(span, &payload, &waiting.tally)
    }

    /// Encodes the blocks of a stretch anew, behind its header and its times.
    fn encode(
        &mut self,
        target: &RepackSettings,
        stretch: &Stretch<'_>,
        rows: &[Option<&DecodedRows>],
    ) -> Result<(), TakeError> {
        let alone = is_alone(stretch.payload);
        let n_rows = stretch.span.n_rows as usize;
        let sizes = &stretch.sizes;
        let front = (sizes.framing + sizes.time_line) as usize;
        let front = stretch.payload.get(..front).unwrap_or_default();
        let mut payload = Vec::new();
        put_renumbered(front, 0, self.number, &mut payload)?;
        let (absent, nowhere) = (vec![false; n_rows], vec![[0.0; 3]; n_rows]);
        let mut tally = BlockTally::default();
        tally.restart(n_rows);
        for (group, first) in (0..self.n_channels).step_by(GROUP_CHANNELS).enumerate() {
            if self.encoders.len() <= group {
                self.encoders.push(target.codec.encoder_with(target.effort));
            }
            let Some(encoder) = self.encoders.get_mut(group) else { continue };
            let columns = (first..self.n_channels.min(first + GROUP_CHANNELS)).map(|i| {
                let decoded = rows.get(i).copied().flatten();
                let (positions, present): (&[Position], &[bool]) =
                    decoded.map_or((&nowhere, &absent), |rows| (&rows.positions, &rows.present));
                Rows::new(positions, present)
            });
            let columns = columns.collect::<Result<Vec<_>, _>>()?;
            let mut reports = vec![BlockReport::default(); columns.len()];
            let mut block = Vec::new();
            encoder.encode(&columns, &[], stretch.span.key, &mut block, &mut reports)?;
            if group < stretch.blocks.len() {
                put_block(&block, alone, &mut payload);
            }
            tally.append(&BlockTally::of_encoded(&block, &columns, &reports, encoder.kept_rows()));
        }
        let span = Span { number: self.number, ..stretch.span };
        self.push(span, &payload, &StretchTally::of(&tally))
    }

    fn push(&mut self, span: Span, payload: &[u8], tally: &StretchTally) -> Result<(), TakeError> {
        self.take.stretch(span, payload, tally)?;
        self.number = (self.number + 1) % NUMBERS;
        self.n_stretches += 1;
        Ok(())
    }
}

/// Whether the blocks of a stretch are about as large as its samples.
fn is_stored(n_bytes: usize, tally: &StretchTally) -> bool {
    n_bytes as u64 * 10 > tally.n_samples() * 12 * 8
}

fn positions(rows: &DecodedRows) -> impl DoubleEndedIterator<Item = [u32; 3]> {
    let present = rows.positions.iter().zip(&rows.present).filter(|(_, present)| **present);
    present.map(|(position, _)| position.map(f32::to_bits))
}

fn first_position(rows: &DecodedRows) -> Option<[u32; 3]> {
    positions(rows).next()
}

fn last_position(rows: &DecodedRows) -> Option<[u32; 3]> {
    positions(rows).next_back()
}

/// Whether all samples of a marker are at one position.
fn is_still(rows: &DecodedRows) -> bool {
    let first = first_position(rows);
    positions(rows).all(|position| Some(position) == first)
}

/// What a repack with other settings may change of the header, and of its settings.
const ENCODING_FIELDS: [&str; 8] = [
    "take_id",
    "resampler",
    "codec_version",
    "tolerance_mm",
    "stretch_rows",
    "effort",
    "keys",
    REPACK,
];

/// Compares a take with the one that it was repacked from: every sample, gap, time, event and part, the ledger, and the
/// stated errors. Returns the first difference. With `settings`, those may differ that say how it is encoded; with a
/// lossy resampler, samples may differ within its tolerance.
///
/// # Errors
/// Those of [`TakeFrames::open_with`], and `Io`.
pub fn check_repacked(
    mut old: impl Read + Seek,
    mut new: impl Read + Seek,
    settings: Option<&RepackSettings>,
    context: &EditContext<'_>,
) -> Result<Option<String>, TakeError> {
    let mut one = TakeFrames::open_with(&mut old, |_| true, context.new_scratch)?;
    let mut other = TakeFrames::open_with(&mut new, |_| true, context.new_scratch)?;
    let content = ContentDifference::between(
        (one.map(), &one.info().foreign),
        (other.map(), &other.info().foreign),
    );
    let fields = [&content.header, &content.settings, &content.subject, &content.ledger];
    let may_differ = |field: &str| settings.is_some() && ENCODING_FIELDS.contains(&field);
    let fields = fields.into_iter().chain([&content.foreign]).flatten();
    if let Some(found) = fields.into_iter().find(|found| !may_differ(&found.field)) {
        return Ok(Some(format!("`{}` differs", found.field)));
    }
    if !content.events.is_empty() {
        return Ok(Some("an event differs".to_owned()));
    }
    let kept = settings.is_none_or(|settings| settings.codec.kind.is_lossless());
    let tolerance_mm = settings.map_or(0.0, |settings| settings.codec.tolerance.mm());
    if let Some(why) = rows_difference(&mut one, &mut other, (!kept).then_some(tolerance_mm))? {
        return Ok(Some(why));
    }
    let (map, other_map) = (one.map().clone(), other.map().clone());
    if let Some(problem) = map.problems.first() {
        return Err(TakeError::InvalidArgument(format!("the take cannot be compared: {problem}")));
    }
    if let Some(problem) = other_map.problems.first() {
        return Ok(Some(problem.to_string()));
    }
    drop((one, other));
    if map.header.device.is_none() {
        return Ok(None);
    }
    let times = compare_times((old, &map), (new, &other_map))?;
    Ok((!times.is_none()).then(|| "the times differ".to_owned()))
}

/// The first difference between the samples of two takes, and what they state of them; or, with a tolerance, the first
/// sample that is further away.
fn rows_difference(
    one: &mut dyn FrameSource,
    other: &mut dyn FrameSource,
    tolerance_mm: Option<f64>,
) -> Result<Option<String>, TakeError> {
    let n_markers = one.info().markers.len();
    if n_markers != other.info().markers.len() {
        return Ok(Some("the markers differ".to_owned()));
    }
    let (mut a, mut b) = (vec![GAP; n_markers], vec![GAP; n_markers]);
    for row in 0_u64.. {
        let more = [one.next_frame(&mut a)?, other.next_frame(&mut b)?];
        if more == [false; 2] {
            break;
        }
        let is_equal = |column: usize, (a, b): (&Position, &Position)| match tolerance_mm {
            _ if is_gap(*a) || is_gap(*b) => is_gap(*a) && is_gap(*b),
            None => {
                a.map(f32::to_bits) == b.map(f32::to_bits)
                    && one.stated_error_mm(column) == other.stated_error_mm(column)
            }
            Some(tolerance_mm) => {
                let apart = (0..3).map(|axis| f64::from(a[axis]) - f64::from(b[axis]));
                apart.map(|apart| apart * apart).sum::<f64>().sqrt() <= tolerance_mm
            }
        };
        let rows = a.iter().zip(&b).enumerate();
        let differing = rows.into_iter().find(|&(column, pair)| !is_equal(column, pair));
        if more[0] != more[1] || differing.is_some() {
            return Ok(Some(format!("frame {row} (from 0) differs")));
        }
    }
    Ok(None)
}
