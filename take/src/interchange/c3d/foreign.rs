//! The foreign parts of a C3D file: all content besides marker trajectories, kept for a later export to C3D
//! (`docs/foreign.md`).
//!
//! | kind | content |
//! |---|---|
//! | `c3d/parameters` | header fields and events, all groups and parameters |
//! | `c3d/analog` | analog samples |
//! | `c3d/residuals` | the fourth words of the markers' samples, if one of them is not zero |
//! | `c3d/model-outputs` | points that are not positions |
//! | `c3d/gap-coordinates` | coordinates of samples that are marked as missing |

use std::io;

use super::{
    Frames, Points, VERSION,
    columns::{
        self, ANALOG, ColumnReader, ColumnWriter, MODEL_OUTPUTS, RESIDUALS, SampleHeader, ordered,
    },
    gap_coordinates,
    header::{ByteOrder, C3dHeader, HeaderEvent, MAX_EVENTS},
    layout::Layout,
    parameters::{Parameters, encode_records},
};
use crate::{
    foreign::{
        ForeignPart,
        content::{Content, PartStore},
    },
    motion::{Foreign, MotionInfo, Position, is_gap},
    record::{SampleForm, SampledChannel},
    sampled::{RESIDUAL_SCALE, SampledPart},
    up_axis::Rotation,
};

/// Size of the buffer for reading a part: for 64 channels of floats 4096 samples each, read in pieces of 4 kB.
const BLOCK_BYTES: usize = 1 << 20;
/// Maximum number of bytes of the parameters. A C3D file has at most 255 blocks of 512 bytes; a rotation adds little.
const PARAMETERS_BYTES_MAX: u64 = 1 << 20;

pub(crate) const PARAMETERS: &str = "c3d/parameters";

/// The header of a block of columns over all frames of a file: version, width, number of signals, samples of a column
/// in a frame, number of the first frame, number of frames.
fn sample_header(layout: &Layout, width: usize, n_signals: usize, ratio: usize) -> Vec<u8> {
    let (first_frame, n_frames) = (layout.first_frame, layout.n_frames);
    SampleHeader { width, n_signals, ratio, first_frame, n_frames }.encode()
}

/// A part of columns that is written block of frames by block of frames.
#[derive(Debug)]
struct ColumnsPart {
    kind: &'static str,
    data: Content,
    /// Byte at which the columns begin.
    from: u64,
    width: usize,
    /// Samples of a column.
    length: usize,
    columns: Vec<ColumnWriter>,
}

impl ColumnsPart {
    /// A part of `n_columns` columns of `length` samples of `width` bytes, after `header`.
    fn new(
        kind: &'static str,
        header: &[u8],
        width: usize,
        (n_columns, length): (usize, usize),
        store: &mut PartStore<'_>,
    ) -> io::Result<Self> {
        let mut data = store.zeros((header.len() + n_columns * length * width) as u64)?;
        data.write_at(0, header)?;
        let columns = match data.is_omitted() {
            true => Vec::new(),
            false => vec![ColumnWriter::new(width); n_columns],
        };
        Ok(Self { kind, data, from: header.len() as u64, width, length, columns })
    }

    /// Writes the next `n` samples of every column: `sample(column, index)`. The closure of a column is made once, from
    /// the last sample that was written.
    fn push<S: FnMut(usize) -> u32>(
        &mut self,
        n: usize,
        mut samples_of: impl FnMut(usize, Option<u32>) -> S,
    ) -> io::Result<()> {
        for (index, column) in self.columns.iter_mut().enumerate() {
            let from = self.from + (index * self.length * self.width) as u64;
            let samples = (0..n).map(samples_of(index, column.last()));
            column.write(&mut self.data, from, self.length, samples)?;
        }
        Ok(())
    }

    fn into_foreign(self) -> Foreign {
        Foreign::exact(self.kind, self.data)
    }
}

/// The parts of a file that have samples for its frames, except for coordinates under gaps.
#[derive(Debug)]
pub(super) struct SampleParts {
    analog: Option<ColumnsPart>,
    /// `None` as long as all fourth words are 0.
    residuals: Option<ColumnsPart>,
    outputs: Option<ColumnsPart>,
}

impl SampleParts {
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn new(
        layout: &Layout,
        points: &Points,
        store: &mut PartStore<'_>,
    ) -> io::Result<Self> {
        let analog =
            (layout.stride.analog_per_frame > 0).then(|| new_analog(layout, store)).transpose()?;
        let outputs = (!points.outputs.is_empty())
            .then(|| new_outputs(layout, &points.outputs, store))
            .transpose()?;
        Ok(Self { analog, residuals: None, outputs })
    }

    /// Adds frames, the first of which is number `first`, with the positions of all markers in them. `has_fourth_words`:
    /// the fourth word of a sample that is present is not 0.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn push(
        &mut self,
        (first, frames): (usize, &Frames<'_>),
        points: &Points,
        (positions, has_fourth_words): (&[Position], bool),
        store: &mut PartStore<'_>,
    ) -> io::Result<()> {
        if let Some(analog) = &mut self.analog {
            push_analog(analog, frames)?;
        }
        if let Some(outputs) = &mut self.outputs {
            push_outputs(outputs, frames, &points.outputs)?;
        }
        if self.residuals.is_none() && has_fourth_words {
            self.residuals = Some(new_residuals(frames.layout, points, first, store)?);
        }
        if let Some(residuals) = &mut self.residuals {
            push_fourth_words(residuals, frames, points, positions)?;
        }
        Ok(())
    }

    /// The parts, in their order.
    pub(super) fn into_foreign(self) -> impl Iterator<Item = Foreign> {
        let parts = [self.analog, self.residuals, self.outputs];
        parts.into_iter().flatten().map(ColumnsPart::into_foreign)
    }
}

/// The part with the header and the parameters.
pub(super) fn parameters_part(header: &C3dHeader, parameters: &Parameters) -> Foreign {
    Foreign::exact(PARAMETERS, parameters_data(header, parameters))
}

/// The analog samples of a take that has lost the parameters of the file.
pub(crate) fn analog_without_parameters(parts: &[ForeignPart]) -> Option<&SampledPart> {
    let part = parts.iter().find(|part| part.kind == ANALOG)?.sampled()?;
    let has_parameters = parts.iter().any(|part| part.kind == PARAMETERS);
    (!has_parameters && part.is_block()).then_some(part)
}

/// The part with the parameters that follow from the descriptions of the analog channels: their names, units, scales and
/// offsets.
pub(crate) fn parameters_of_channels(part: &SampledPart) -> Foreign {
    let groups = || part.groups().iter().map(|found| &found.group);
    let channels = || groups().flat_map(|group| &group.channels);
    let mut parameters = Parameters::default();
    let mut set_texts = |list: &str, text: fn(&SampledChannel) -> &str| {
        // A longer one cannot have come from a C3D file.
        let text =
            |channel| Some(text(channel)).filter(|text| text.len() <= 255).unwrap_or_default();
        let texts: Vec<String> = channels().map(|channel| text(channel).to_owned()).collect();
        let _is_set = parameters.set_texts("ANALOG", list, &texts).is_ok();
    };
    set_texts("LABELS", |channel| &channel.name);
    set_texts("UNITS", |channel| &channel.unit);
    parameters.set_float("ANALOG", "GEN_SCALE", 1.0);
    let scales: Vec<f32> = channels().map(|channel| channel.scale as f32).collect();
    parameters.set_float_list("ANALOG", "SCALE", &scales);
    let is_signed = |offset: f64| offset == f64::from(offset as i16);
    let fits_unsigned = |offset: f64| offset == f64::from(offset as u16);
    // Samples that are floats may come from a converter without signs, too, as their offsets show.
    let is_large =
        |channel: &SampledChannel| !is_signed(channel.offset) && fits_unsigned(channel.offset);
    let is_unsigned = groups().any(|group| match group.form {
        SampleForm::Uint16 => true,
        SampleForm::Float32 => group.channels.iter().any(is_large),
        SampleForm::Int16 => false,
    });
    let is_integer =
        |offset: f64| if is_unsigned { fits_unsigned(offset) } else { is_signed(offset) };
    if channels().all(|channel| is_integer(channel.offset)) {
        let offsets = channels().map(|channel| channel.offset as i32 as u16);
        parameters.set_integer_list("ANALOG", "OFFSET", &offsets.collect::<Vec<_>>());
    } else {
        let offsets = channels().map(|channel| channel.offset as f32);
        parameters.set_float_list("ANALOG", "OFFSET", &offsets.collect::<Vec<_>>());
    }
    if is_unsigned {
        parameters.set_text("ANALOG", "FORMAT", "UNSIGNED");
    }
    parameters_part(&C3dHeader::default(), &parameters)
}

/// Rotates the parts that are positions in space: force plate corners and coordinates under gaps.
///
/// # Errors
/// Those of reading and rewriting the parts.
pub(in crate::interchange) fn rotate(
    foreign: &mut [Foreign],
    n_markers: usize,
    rotation: Rotation,
) -> io::Result<()> {
    let parameters = kept_parameters(foreign)?.map(|(header, mut parameters)| {
        parameters.rotate(rotation);
        let data = parameters_data(&header, &parameters);
        Foreign::exact(PARAMETERS, data)
    });
    let gap_coordinates = gap_coordinates::rotated(foreign, n_markers, rotation)?;
    for new in parameters.into_iter().chain(gap_coordinates) {
        for part in foreign.iter_mut().filter(|part| part.kind == new.kind) {
            *part = new.clone();
        }
    }
    Ok(())
}

fn parameters_data(header: &C3dHeader, parameters: &Parameters) -> Vec<u8> {
    let mut data = vec![VERSION];
    data.extend(header.max_gap.to_le_bytes());
    data.push(header.events.len().min(MAX_EVENTS) as u8);
    for event in header.events.iter().take(MAX_EVENTS) {
        data.extend(event.time_s.to_le_bytes());
        data.push(event.flag);
        data.extend(event.label);
    }
    encode_records(parameters, &mut data);
    data
}

fn new_analog(layout: &Layout, store: &mut PartStore<'_>) -> io::Result<ColumnsPart> {
    let (n_channels, ratio) = (layout.n_channels(), layout.analog_ratio);
    let width = layout.stride.word_bytes();
    let header = sample_header(layout, width, n_channels, ratio);
    ColumnsPart::new(ANALOG, &header, width, (n_channels, layout.n_frames * ratio), store)
}

fn push_analog(part: &mut ColumnsPart, frames: &Frames<'_>) -> io::Result<()> {
    let layout = frames.layout;
    let (n_channels, ratio) = (layout.n_channels(), layout.analog_ratio);
    part.push(frames.len() * ratio, |channel, _| {
        move |sample| {
            let word = 4 * layout.stride.n_points + sample % ratio * n_channels + channel;
            frames.column_word(sample / ratio, word)
        }
    })
}

/// A missing sample repeats the word before it, because that compresses best and no export reads it.
fn push_fourth_words(
    part: &mut ColumnsPart,
    frames: &Frames<'_>,
    points: &Points,
    positions: &[Position],
) -> io::Result<()> {
    let n_markers = points.markers.len();
    part.push(frames.len(), |marker, last| {
        let mut before = last.unwrap_or(zero(frames.layout));
        let point = points.markers.get(marker).map_or(0, |&(point, _)| point);
        move |frame| {
            let position = positions.get(frame * n_markers + marker);
            if position.is_some_and(|&at| !is_gap(at)) {
                before = frames.column_word(frame, 4 * point + 3);
            }
            before
        }
    })
}

/// The word 0, as columns store it.
fn zero(layout: &Layout) -> u32 {
    if layout.stride.float { ordered(0) } else { 0 }
}

/// The part of the fourth words, of which those before frame `n_zeros` are 0.
fn new_residuals(
    layout: &Layout,
    points: &Points,
    n_zeros: usize,
    store: &mut PartStore<'_>,
) -> io::Result<ColumnsPart> {
    let (width, n_markers) = (layout.stride.word_bytes(), points.markers.len());
    let header = sample_header(layout, width, n_markers, 1);
    let shape = (n_markers, layout.n_frames);
    let mut part = ColumnsPart::new(RESIDUALS, &header, width, shape, store)?;
    if n_zeros > 0 {
        part.push(1, |_, _| move |_| zero(layout))?;
        part.columns.iter_mut().for_each(|column| column.repeat(n_zeros - 1));
    }
    Ok(part)
}

fn new_outputs(
    layout: &Layout,
    points: &[usize],
    store: &mut PartStore<'_>,
) -> io::Result<ColumnsPart> {
    let width = size_of::<f32>();
    let mut header = sample_header(layout, width, points.len(), 1);
    for &point in points {
        header.extend((point as u32).to_le_bytes());
    }
    let shape = (4 * points.len(), layout.n_frames);
    ColumnsPart::new(MODEL_OUTPUTS, &header, width, shape, store)
}

fn push_outputs(part: &mut ColumnsPart, frames: &Frames<'_>, points: &[usize]) -> io::Result<()> {
    let scale = frames.layout.coordinate_scale();
    part.push(frames.len(), |column, _| {
        let word = 4 * points.get(column / 4).copied().unwrap_or(0) + column % 4;
        // The fourth word is not a coordinate: an integer becomes a float of the same value, without the scale factor.
        let scale = if column % 4 == 3 { 1.0 } else { scale };
        move |frame| {
            let stored = frames.word(frame, word);
            let value = if scale == 1.0 { stored } else { (f64::from(stored) * scale) as f32 };
            ordered(value.to_bits())
        }
    })
}

/// The columns of samples in a foreign part, read frame by frame.
#[derive(Debug)]
pub(crate) struct PartSamples<'a> {
    pub(crate) header: SampleHeader,
    /// Indices of the points; empty except for model outputs.
    pub(super) points: Vec<usize>,
    columns: ColumnReader<'a>,
    /// Number of frames before the first one in the part.
    frames_ahead: u64,
}

impl<'a> PartSamples<'a> {
    /// The part of a kind, positioned at frame number `first_frame`. Each signal has `columns` columns; if `indexed`,
    /// point indices precede the columns. `None` if there is no such part or it is damaged.
    fn parse(
        foreign: &'a [Foreign],
        kind: &str,
        columns: usize,
        indexed: bool,
        first_frame: u64,
    ) -> io::Result<Option<Self>> {
        let Some(part) = foreign.iter().find(|part| part.kind == kind) else { return Ok(None) };
        let Some((header, rest)) = part.data.as_slice().split_array()? else { return Ok(None) };
        let Some(header) = SampleHeader::parse(&header) else { return Ok(None) };
        let n_indices = if indexed { header.n_signals } else { 0 };
        let Some((indices, rest)) = rest.split_at(4 * n_indices as u64) else { return Ok(None) };
        let Some(mut columns) = header.columns(rest, columns, BLOCK_BYTES) else { return Ok(None) };
        let mut points = vec![0; n_indices * 4];
        indices.read_at(0, &mut points)?;
        let points = points.as_chunks().0.iter().map(|&b| u32::from_le_bytes(b) as usize).collect();
        let skip = first_frame.saturating_sub(header.first_frame).min(header.n_frames as u64);
        columns.skip((skip as usize).saturating_mul(header.ratio))?;
        let frames_ahead = header.first_frame.saturating_sub(first_frame);
        Ok(Some(Self { header, points, columns, frames_ahead }))
    }

    /// The analog samples from a frame on.
    pub(crate) fn analog(foreign: &'a [Foreign], first_frame: u64) -> io::Result<Option<Self>> {
        let kept = Self::parse(foreign, ANALOG, 1, false, first_frame)?;
        Ok(kept.filter(|kept| kept.header.ratio > 0))
    }

    /// The fourth words from a frame on.
    pub(super) fn residuals(foreign: &'a [Foreign], first_frame: u64) -> io::Result<Option<Self>> {
        let kept = Self::parse(foreign, RESIDUALS, 1, false, first_frame)?;
        Ok(kept.filter(|kept| kept.header.ratio == 1))
    }

    /// The model outputs from a frame on.
    pub(super) fn outputs(foreign: &'a [Foreign], first_frame: u64) -> io::Result<Option<Self>> {
        let kept = Self::parse(foreign, MODEL_OUTPUTS, 4, true, first_frame)?;
        Ok(kept.filter(|kept| kept.header.ratio == 1 && kept.header.width == 4))
    }

    /// Advances to the next frame. Returns whether the part may have samples of it.
    pub(crate) fn begin_frame(&mut self) -> bool {
        if self.frames_ahead > 0 {
            self.frames_ahead -= 1;
            return false;
        }
        true
    }

    /// Advances to the next frame and returns its sample of every column, if the part has them.
    pub(super) fn next_frame(&mut self) -> io::Result<Option<&[u32]>> {
        if self.begin_frame() { self.next() } else { Ok(None) }
    }

    /// The next sample of every column, in the integers of the column encoding.
    pub(crate) fn next(&mut self) -> io::Result<Option<&[u32]>> {
        self.columns.next()
    }
}

/// The kept header fields and parameters.
pub(crate) fn kept_parameters(foreign: &[Foreign]) -> io::Result<Option<(C3dHeader, Parameters)>> {
    let part = foreign.iter().find(|part| part.kind == PARAMETERS);
    let data = part.map(|part| part.data.to_vec(PARAMETERS_BYTES_MAX)).transpose()?.flatten();
    Ok(data.and_then(|data| parse_parameters(&data)))
}

/// The residuals that a C3D file had, frame after frame and in each all markers: in units of 10 micrometres as devices report
/// them, 255 for larger ones and 0 where the file states none. `None` for a motion that does not come from a C3D file with
/// residuals.
///
/// # Errors
/// Those of the scratch file that the samples may be in.
pub fn residuals_10um(info: &MotionInfo) -> io::Result<Option<Vec<u8>>> {
    let first = info.source.first_frame;
    let Some(mut kept) = PartSamples::residuals(&info.foreign, first)? else { return Ok(None) };
    let n_markers = info.markers.len();
    let Some((_, parameters)) = kept_parameters(&info.foreign)? else { return Ok(None) };
    if kept.header.n_signals != n_markers {
        return Ok(None);
    }
    let scale_10um = f64::from(residual_scale(&parameters, info.source.factor)) / RESIDUAL_SCALE;
    let width = kept.header.width;
    let mut counts = Vec::new();
    for _ in 0..info.n_frames {
        let Some(words) = kept.next_frame()? else {
            counts.resize(counts.len() + n_markers, 0);
            continue;
        };
        counts.extend(words.iter().map(|&word| {
            // The high byte has the cameras.
            let residual = columns::value(width, word, false) as i32 & 0xff;
            let count = (f64::from(residual) * scale_10um).round();
            // A small one is not none.
            if residual == 0 { 0 } else { count.clamp(1.0, 255.0) as u8 }
        }));
    }
    Ok(Some(counts))
}

/// The magnitude of POINT:SCALE: the unit of residuals in millimetres.
pub(super) fn residual_scale(parameters: &Parameters, factor: f64) -> f32 {
    let source = parameters.number("POINT", "SCALE").unwrap_or(1.0).abs();
    let factor = if factor.is_finite() && factor > 0.0 { factor } else { 1.0 };
    let scale = (source * factor) as f32;
    if scale.is_finite() && scale > 0.0 { scale } else { 1.0 }
}

fn parse_parameters(data: &[u8]) -> Option<(C3dHeader, Parameters)> {
    let (&[VERSION, gap_low, gap_high, n_events], mut rest) = data.split_first_chunk::<4>()? else {
        return None;
    };
    let mut header =
        C3dHeader { max_gap: u16::from_le_bytes([gap_low, gap_high]), ..C3dHeader::default() };
    for _ in 0..n_events {
        let (&[t0, t1, t2, t3, flag, l0, l1, l2, l3], after) = rest.split_first_chunk::<9>()?;
        let time_s = f32::from_le_bytes([t0, t1, t2, t3]);
        header.events.push(HeaderEvent { time_s, flag, label: [l0, l1, l2, l3] });
        rest = after;
    }
    Some((header, Parameters::parse(rest, ByteOrder::Intel, &mut Vec::new())))
}
