//! Writes a take again in fewer bytes: the same floats, gaps, times, events, parts and stated bounds; and compares a
//! repacked take with the old one.
//!
//! What a take has of a lossless resampler can be encoded in any way. The points of a lossy one depend on all that is
//! encoded before them, so its stretches stay as they are; but those that an edit stored as floats may be parts of
//! stretches that can be put together again, and consecutive stretches in which nothing moves need be only one.

mod joining;

use std::io::{Read, Seek, Write};

use mocapd_codec::{
    BlockEncoder, BlockReport, DecodedRows, Effort, GROUP_CHANNELS, Rows, Settings,
};

use self::joining::{StretchJoiner, Waiting, stated};
use super::{EditContext, SourceTake, damaged, recorded};
use crate::{
    ChannelOrder, TakeError, TakeEvent, TakeTraversal, TakeWriter,
    compare::{ContentDifference, compare_recorded, compare_times},
    damage::Problem,
    frames::TakeFrames,
    motion::{FrameSource, GAP, Position, is_gap},
    motion_encoder::{EncodePlan, MotionWriter, stretch_rows},
    record::{Header, KeyDistance},
    sampled::{SampledPart, is_recorded},
    statistics::{BlockTally, StretchTally},
    stretch::{CopiedStretch, NUMBERS, Span, Stretch, is_alone, put_block, put_renumbered},
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
    /// The distance of key stretches, if one is chosen; of imports that are encoded anew. Others keep theirs.
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
        let remedy = match map.header.source {
            Some(_) => "import the source again with them",
            None => "a recording within a tolerance keeps its own",
        };
        return invalid(format!(
            "other settings need the source or a lossless take, and this take is {} within {} mm: {remedy}",
            codec.kind,
            codec.tolerance.mm()
        ));
    }
    let why_stretches_stay = source.why_stretches_stay();
    if let Some(why) = why_stretches_stay
        && settings.is_some_and(|settings| settings.keys.is_some())
    {
        return invalid(format!("{why}: omit --keys"));
    }
    let is_encoded_anew = settings.is_some() && why_stretches_stay.is_none();
    let header = header_of_repacked(source, settings, is_encoded_anew, context)?;
    let mut take = TakeWriter::new(out, &header)?;
    map.subject.iter().try_for_each(|subject| take.subject(subject))?;
    take.order(&map.order)?;
    recorded::write_groups(map, &mut take)?;
    take.describe_as(map)?;
    for part in map.foreign.iter().filter(|part| !is_recorded(&part.kind)) {
        let whole = super::read_whole_part(part, &mut input, context)?;
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
        let mut repacker = Repacker::new(source, settings, take)?;
        TakeTraversal::from_map(&mut input, map, Decode::All)?.run(|found, progress| {
            let TakeEvent::Stretch(stretch) = &found.event else { return Ok(()) };
            if let Some(problem) = progress.take.problems.first() {
                return Err(damaged(problem));
            }
            let rows: Vec<_> = progress.coded_rows().collect();
            repacker.stretch(stretch, &rows)?;
            (context.on_rows)(stretch.span.end_row());
            Ok(())
        })?;
        // Channels may be announced after the last stretch.
        repacker.grow(map.channels.len())?;
        repacker.flush()?;
        report.stretches[1] = repacker.n_stretches;
        repacker.take
    };
    for clock in &source.clocks {
        take.clock(clock)?;
    }
    recorded::copy(map, &mut input, &mut take)?;
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
        match settings.keys {
            Some(keys) => header.set_key_distance(keys, map.n_rows),
            None if map.header.has_long_keys() => header.fit_key_distance(map.n_rows),
            // Keys that are not far apart stay so, however long the take has become: joined takes have those of each.
            None => header.fit_key_distance(0),
        }
    } else {
        header.codec_version = map.header.codec_version;
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
    let mut writer = MotionWriter::continuing(&plan, header, ChannelOrder::default(), take);
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

impl SourceTake {
    /// Why its stretches cannot be divided in another way; `None` for an import of which nothing was lost.
    fn why_stretches_stay(&self) -> Option<&'static str> {
        let map = self.map();
        if self.ends.is_some() || map.header.device.is_some() {
            Some("the key stretches of a recording hold its clocks, and stay")
        } else if self.has_time_lines || !map.damage.is_empty() {
            Some("the stretches of a recovered take state which frames are lost, and stay")
        } else if map.header.channels.len() < map.channels.len() {
            Some("further markers begin at some of its stretches, which therefore stay")
        } else if !map.order.is_identity() {
            Some("its markers are encoded in another order than that of the source, which stays")
        } else {
            None
        }
    }
}

/// Copies or encodes the stretches of a take, one after another.
struct Repacker<'a, W> {
    source: &'a SourceTake,
    take: TakeWriter<W>,
    /// Entries of the channel table that were written.
    n_channels: usize,
    /// By group, the encoders of a take that was lossless; empty if stretches are copied.
    encoders: Vec<Box<dyn BlockEncoder>>,
    target: Option<RepackSettings>,
    joiner: Option<StretchJoiner>,
    number: u8,
    n_stretches: u64,
}

impl<'a, W: Write> Repacker<'a, W> {
    fn new(
        source: &'a SourceTake,
        target: Option<&RepackSettings>,
        take: TakeWriter<W>,
    ) -> Result<Self, TakeError> {
        Ok(Self {
            source,
            take,
            n_channels: source.map().header.channels.len(),
            encoders: Vec::new(),
            target: target.copied(),
            joiner: StretchJoiner::new(source)?,
            number: 0,
            n_stretches: 0,
        })
    }

    fn stretch(
        &mut self,
        stretch: &Stretch<'_>,
        rows: &[Option<&DecodedRows>],
    ) -> Result<(), TakeError> {
        self.grow(self.source.channels_at(stretch.from_row()))?;
        if let Some(target) = self.target
            && stretch.span.n_rows > 0
        {
            return self.encode(&target, stretch, rows);
        }
        let tally = StretchTally::of_decoded(stretch, rows.iter().copied());
        let joiner = self.joiner.as_ref();
        let continues = joiner.is_some_and(|joiner| joiner.continues(stretch, rows, &tally));
        if !continues {
            self.flush()?;
        }
        let payload = stretch.payload.to_vec();
        let waiting = Waiting { span: stretch.span, payload, tally };
        match &mut self.joiner {
            Some(joiner) if continues || joiner.may_begin(stretch, rows) => {
                joiner.add(waiting, stated(stretch), rows);
                Ok(())
            }
            _ => self.copy(&waiting, stretch.timeline.as_ref(), stretch.from_row()),
        }
    }

    /// Writes the channels that appear up to entry `n_channels`.
    fn grow(&mut self, n_channels: usize) -> Result<(), TakeError> {
        let more = self.source.map().channels.get(self.n_channels..n_channels).unwrap_or_default();
        if more.is_empty() {
            return Ok(());
        }
        self.flush()?;
        self.take.channels(more)?;
        self.n_channels = n_channels;
        Ok(())
    }

    /// Writes the stretches that wait: as one, if that takes fewer bytes.
    fn flush(&mut self) -> Result<(), TakeError> {
        let Some(joiner) = &mut self.joiner else { return Ok(()) };
        let (waiting, joined) = joiner.take(self.number)?;
        match joined {
            Some(joined) => self.push(joined.span, &joined.payload, &joined.tally),
            None => waiting
                .iter()
                .try_for_each(|waiting| self.copy(waiting, None, waiting.span.first_row)),
        }
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
        let stretch_rows = [self.source.map().header.stretch_rows; 2];
        CopiedStretch { span, from_row, runs, stretch_rows }.put(&waiting.payload, &mut payload)?;
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

/// What other settings change of the header, and of its settings.
const ENCODING_FIELDS: [&str; 5] = ["take_id", "resampler", "tolerance_mm", "effort", REPACK];

/// Compares a take with the one that it was repacked from: every sample, gap, lost row, time, event and part, the header
/// with the channel table, the subject, the observations of the clocks, the last ledger, and the stated errors. Returns
/// the first difference. `source` is what was read of the old take. With `settings`, those fields may differ that say how
/// it is encoded; with a lossy resampler, samples may differ within its tolerance.
///
/// # Errors
/// Those of [`TakeFrames::open_with`], and `Io`.
pub fn check_repacked(
    source: &SourceTake,
    mut old: impl Read + Seek,
    mut new: impl Read + Seek,
    settings: Option<&RepackSettings>,
    context: &EditContext<'_>,
) -> Result<Option<String>, TakeError> {
    let found = SourceTake::scan(&mut new)?;
    if let Some(problem) = found.map.problems.first() {
        return Ok(Some(problem.to_string()));
    }
    if let Some(why) = content_difference(source, &found, settings) {
        return Ok(Some(why));
    }
    if let Some(why) = frames_difference((&mut old, &mut new), settings, context)? {
        return Ok(Some(why));
    }
    let recorded = compare_recorded((source.map(), &mut old), (found.map(), &mut new))?;
    if let Some(difference) = recorded.first() {
        return Ok(Some(format!("the {} differ", difference.field)));
    }
    // A joined take may have other runs of samples, and other segments of the clock; a repacked one has the same.
    let pairs = source.map().sample_groups().zip(found.map().sample_groups());
    if pairs.into_iter().any(|(a, b)| a.anchors() != b.anchors()) {
        return Ok(Some("the times of sampled channels differ".to_owned()));
    }
    // Times are compared where both takes have them.
    if source.has_time_lines != found.has_time_lines {
        return Ok(Some("the times differ".to_owned()));
    }
    if !source.has_time_lines {
        return Ok(None);
    }
    let times = compare_times((old, source.map()), (new, found.map()))?;
    Ok((!times.is_none()).then(|| "the times differ".to_owned()))
}

/// The first difference of what two takes state besides their samples and times.
fn content_difference(
    one: &SourceTake,
    other: &SourceTake,
    settings: Option<&RepackSettings>,
) -> Option<String> {
    let is_encoded_anew = settings.is_some() && one.why_stretches_stay().is_none();
    let may_differ = |field: &str| match field {
        "keys" => settings.is_some_and(|settings| settings.keys.is_some()),
        "codec_version" | "stretch_rows" => is_encoded_anew,
        _ => settings.is_some() && ENCODING_FIELDS.contains(&field),
    };
    let (map, other_map) = (one.map(), other.map());
    let content = ContentDifference::between((map, &[]), (other_map, &[]));
    let fields = [&content.header, &content.settings, &content.subject, &content.ledger];
    if let Some(found) = fields.into_iter().flatten().find(|found| !may_differ(&found.field)) {
        return Some(format!("`{}` differs", found.field));
    }
    let parts = |take: &SourceTake| -> Vec<_> {
        let parts = take.map().foreign.iter();
        parts
            .map(|part| {
                let lost = part.sampled().map(SampledPart::lost);
                (part.kind.clone(), part.bounds(), lost)
            })
            .collect()
    };
    let differing = [
        ("an event", !content.events.is_empty()),
        ("the channel table", map.channels != other_map.channels),
        ("a lost frame", (map.n_rows, &map.damage) != (other_map.n_rows, &other_map.damage)),
        ("an observation of the clocks", one.clocks != other.clocks),
        ("the bound or the lost samples of a part", parts(one) != parts(other)),
    ];
    let (what, _) = differing.into_iter().find(|(_, differs)| *differs)?;
    Some(format!("{what} differs"))
}

/// The first difference of the samples of two takes, and of their parts.
fn frames_difference(
    (old, new): (&mut (impl Read + Seek), &mut (impl Read + Seek)),
    settings: Option<&RepackSettings>,
    context: &EditContext<'_>,
) -> Result<Option<String>, TakeError> {
    let mut one = TakeFrames::open_with(old, |_| true, context.new_scratch)?;
    let mut other = TakeFrames::open_with(new, |_| true, context.new_scratch)?;
    if one.info().foreign != other.info().foreign {
        return Ok(Some("a part of the imported file differs".to_owned()));
    }
    let lossy = settings.filter(|settings| !settings.codec.kind.is_lossless());
    let tolerance_mm = lossy.map(|settings| settings.codec.tolerance.mm());
    if let Some(why) = rows_difference(&mut one, &mut other, tolerance_mm)? {
        return Ok(Some(why));
    }
    // The old take may have lost samples or parameters, and the new one must have lost the same.
    let is_stated = |problem: &&Problem| {
        matches!(problem, Problem::SamplesLost { .. } | Problem::ParametersLost)
    };
    if let Some(problem) = one.problems().iter().find(|problem| !is_stated(problem)) {
        return Err(TakeError::InvalidArgument(format!("the take cannot be compared: {problem}")));
    }
    let mut added = other.problems().iter().filter(|problem| !one.problems().contains(problem));
    Ok(added.next().map(ToString::to_string))
}

/// The first difference between the samples of two takes, and what they state of them; or, with a tolerance, the first
/// sample that is further away.
fn rows_difference(
    one: &mut dyn FrameSource,
    other: &mut dyn FrameSource,
    tolerance_mm: Option<f64>,
) -> Result<Option<String>, TakeError> {
    let n_markers = one.info().markers.len();
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
