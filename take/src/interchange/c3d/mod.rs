//! C3D, the binary format of biomechanics (The C3D File Format: User Guide, Motion Lab Systems, 2021).
//!
//! The reader holds a few blocks of frames at a time, whatever the size of the file. It accepts Intel, DEC and MIPS
//! files with integer or float samples, more points than one LABELS parameter holds, more frames than 16 bits count, and
//! files with a partly damaged parameter section. The writer produces Intel files with float samples in millimetres.
//!
//! A first pass over the frames sorts their points into markers and model outputs, and finds everything about the
//! trajectories but the samples. The frames can then be read one after another, as often as needed.

mod analog;
pub(crate) mod columns;
mod foreign;
mod gap_coordinates;
mod groups;
mod header;
mod layout;
mod parameters;
mod recorded;
pub(crate) mod sample_parts;
mod stride;
mod write;

use std::{collections::HashSet, io, ops::Range};

use self::{
    columns::ordered,
    foreign::SampleParts,
    gap_coordinates::{GapCounts, GapWriter},
    header::{BLOCK, ByteOrder, C3dHeader},
    layout::Layout,
};
use super::{
    InterchangeError, ReadOptions, Result, counted,
    origin::OriginScan,
    source_file::SourceFile,
    units::{FileUnit, MotionExtent, ToMillimetres},
};
use crate::{
    foreign::content::{Content, PartStore},
    motion::{Ambiguity, Foreign, GAP, Marker, MotionInfo, Notes, Position, is_gap},
    record::Channel,
    up_axis::Rotation,
};

pub use analog::AnalogChannel;
pub(crate) use analog::{
    channels as analog_channels, describe as describe_sampled, factor_of_unit,
    plates as force_plates,
};
pub(crate) use columns::{ANALOG, value as sample_value};
pub(super) use columns::{MODEL_OUTPUTS, RESIDUALS};
pub use foreign::residuals_10um;
pub(super) use foreign::rotate;
pub(crate) use foreign::{
    PARAMETERS, PartSamples, analog_without_parameters, kept_parameters, parameters_of_channels,
};
pub(super) use groups::EVENTS_MAX;
pub use parameters::{C3dParameter, C3dValues};
pub(crate) use parameters::{Parameters, is_unsigned as is_analog_unsigned, parameter_values};
pub(super) use recorded::{RecordedPlan, name_of, warnings_of};
pub(crate) use sample_parts::{is_by_marker, reordered};
pub(crate) use stride::ANALOG_MAX;
pub(super) use write::write;

/// Version of the layouts of the foreign parts (`docs/foreign.md`).
const VERSION: u8 = 1;

fn malformed(place: &str, message: impl Into<String>) -> InterchangeError {
    InterchangeError::malformed("c3d", place, message)
}

/// Reads everything but the samples, and prepares to read those.
pub(super) fn open(
    source: &mut SourceFile<'_>,
    options: &ReadOptions,
    store: &mut PartStore<'_>,
) -> Result<(MotionInfo, C3dFrames)> {
    let (mut notes, order, header, mut parameters) = read_front(source)?;
    let layout = Layout::resolve(&header, &parameters, order, source, &mut notes)?;
    let points = sort_points(&parameters, layout.stride.n_points, &mut notes.warnings);
    let stated = parameters.text("POINT", "UNITS").unwrap_or_default();
    let unit = FileUnit::resolve(&stated, options.unit, &mut notes);
    let has_marks = fourth_words_are_marks(source, &layout, &points, &mut notes)?;
    let millimetres = ToMillimetres::new(unit.factor, options.rotation());
    let mut samples = C3dFrames::new(layout, &points, millimetres, has_marks);
    let mut found = samples.first_pass(source, &points, store)?;
    samples.millimetres.report(&mut notes.warnings);
    found.under_gaps.note(&mut notes);
    unit.check(&mut found.extent, &mut notes);
    if found.origin.needs_steps() {
        samples.for_each_row(source, |row| found.origin.add_steps(row))?;
    }
    found.origin.note(&mut notes);
    let up = options.up(parameters.up_axis(), &mut notes);
    parameters.rotate(options.rotation());
    let mut foreign = vec![foreign::parameters_part(&header, &parameters)];
    foreign.extend(found.parts.into_foreign());
    if let Some(n_bytes) = found.under_gaps.part_bytes(&mut notes.warnings) {
        foreign.push(samples.gap_coordinates(source, &found.under_gaps, store.zeros(n_bytes)?)?);
    }
    note_outputs_not_rotated(&points, options.rotation(), &mut notes);
    let Layout { rate_hz, first_frame, n_frames, frames_missing, .. } = samples.layout;
    let info = MotionInfo {
        rate_hz,
        n_frames: n_frames as u64,
        markers: points.markers.into_iter().map(|(_, marker)| marker).collect(),
        up,
        source: unit.into_source("c3d", first_frame, frames_missing, notes),
        subject: None,
        foreign,
        events: groups::read(&parameters, rate_hz, first_frame, n_frames as u64),
        recording: None,
    };
    Ok((info, samples))
}

/// Reads the header and the parameters.
fn read_front(source: &mut SourceFile<'_>) -> Result<(Notes, ByteOrder, C3dHeader, Parameters)> {
    let mut first = [0; BLOCK];
    let n_read = source.read_some(0, &mut first)?;
    let first = first.get(..n_read).unwrap_or_default();
    let &[parameter_block, key, ..] = first else {
        return Err(malformed("byte 0", "the file is empty or ends within its header"));
    };
    if key != 0x50 {
        let text = format!("expected the C3D signature 50 (hex), found {key:02x}: not a C3D file");
        return Err(malformed("byte 1", text));
    }
    let mut notes = Notes::default();
    let start = u64::from(parameter_block).saturating_sub(1) * BLOCK as u64;
    // Its four leading bytes; those beyond the end of the file count as 0.
    let mut lead = [0; 4];
    source.read_some(start, &mut lead)?;
    let [_, _, n_blocks, processor] = lead;
    let order = byte_order(processor, &mut notes.warnings);
    let Some(header) = C3dHeader::parse(first, order) else {
        let message = format!("expected a header of {BLOCK} bytes, found {n_read}");
        return Err(malformed("byte 0", message));
    };
    let section = section(source, start, n_blocks, &header)?;
    let parameters = Parameters::parse(&section, order, &mut notes.warnings);
    Ok((notes, order, header, parameters))
}

/// What the first pass over the frames finds.
struct FirstPass {
    extent: MotionExtent,
    origin: OriginScan,
    under_gaps: GapCounts,
    parts: SampleParts,
}

/// The frames of a file, read one after another.
#[derive(Debug)]
pub(super) struct C3dFrames {
    layout: Layout,
    /// The index of each marker among the points.
    points: Vec<usize>,
    /// The factor from stored coordinates to the file's unit.
    scale: f64,
    millimetres: ToMillimetres,
    /// Whether fourth words mark missing samples.
    has_marks: bool,
    buffer: FrameBuffer,
    /// The frames in the buffer.
    buffered: Range<usize>,
    next: usize,
}

/// A sample as stored.
#[derive(Clone, Copy)]
enum StoredSample {
    Present(StoredWords),
    /// It is marked as missing, but has coordinates.
    UnderGap(StoredWords),
    Missing,
}

impl C3dFrames {
    fn new(layout: Layout, points: &Points, millimetres: ToMillimetres, has_marks: bool) -> Self {
        Self {
            scale: layout.coordinate_scale(),
            layout,
            points: points.markers.iter().map(|&(point, _)| point).collect(),
            millimetres,
            has_marks,
            buffer: FrameBuffer::default(),
            buffered: 0..0,
            next: 0,
        }
    }

    /// Fills `row` with the positions of the next frame. `false` at the end.
    ///
    /// # Errors
    /// Those of the file, also that it has changed.
    pub(crate) fn next_frame(
        &mut self,
        source: &mut SourceFile<'_>,
        row: &mut [Position],
    ) -> io::Result<bool> {
        if !self.buffered.contains(&self.next) {
            let Some(range) = FrameBuffer::ranges_from(&self.layout, self.next).next() else {
                return Ok(false);
            };
            self.buffered = 0..0;
            self.buffer.read(source, &self.layout, &range)?;
            self.buffered = range;
        }
        let stored = self.buffer.held(&self.layout).points(self.next - self.buffered.start);
        for (position, &point) in row.iter_mut().zip(&self.points) {
            *position = self.position(self.sample(stored, point));
        }
        self.next += 1;
        Ok(true)
    }

    /// Returns to the first frame.
    pub(crate) fn rewind(&mut self) {
        self.next = 0;
    }

    /// The sample of a point in the points of a frame.
    #[inline]
    fn sample(&self, stored: &[StoredWords], point: usize) -> StoredSample {
        let words = stored.get(point).copied().unwrap_or_default();
        let [x, y, z, fourth] = words;
        let is_gap = if self.has_marks { is_missing(fourth) } else { !has_coordinates([x, y, z]) };
        match is_gap {
            false => StoredSample::Present(words),
            true if has_coordinates([x, y, z]) => StoredSample::UnderGap(words),
            true => StoredSample::Missing,
        }
    }

    #[inline]
    fn position(&self, sample: StoredSample) -> Position {
        match sample {
            StoredSample::Present(words) => self.millimetres.position(self.scaled(words)),
            StoredSample::UnderGap(_) | StoredSample::Missing => GAP,
        }
    }

    /// The coordinates, in the file's unit.
    #[inline]
    fn scaled(&self, [x, y, z, _]: StoredWords) -> [f64; 3] {
        [x, y, z].map(|v| f64::from(v) * self.scale)
    }

    fn first_pass(
        &self,
        source: &mut SourceFile<'_>,
        points: &Points,
        store: &mut PartStore<'_>,
    ) -> Result<FirstPass> {
        let (layout, n_markers) = (&self.layout, self.points.len());
        let mut found = FirstPass {
            extent: MotionExtent::new(layout.n_frames),
            origin: OriginScan::new(n_markers),
            under_gaps: GapCounts::new(n_markers),
            parts: SampleParts::new(layout, points, store)?,
        };
        let mut buffer = FrameBuffer::default();
        let mut positions = Vec::new();
        for range in FrameBuffer::ranges_from(layout, 0) {
            let frames = buffer.read(source, layout, &range)?;
            positions.clear();
            let mut has_fourth_words = false;
            for frame in 0..range.len() {
                let (start, stored) = (positions.len(), frames.points(frame));
                for (marker, &point) in self.points.iter().enumerate() {
                    let sample = self.sample(stored, point);
                    let position = self.position(sample);
                    match sample {
                        StoredSample::Present([.., fourth]) => {
                            has_fourth_words |= fourth.to_bits() != 0 && !is_gap(position);
                        }
                        StoredSample::UnderGap(_) => {
                            found.under_gaps.add(range.start + frame, marker);
                        }
                        StoredSample::Missing => {}
                    }
                    positions.push(position);
                }
                let row = positions.get(start..).unwrap_or_default();
                found.extent.add_row(row);
                found.origin.add_row(row);
            }
            let positions = (&positions[..], has_fourth_words);
            found.parts.push((range.start, &frames), points, positions, store)?;
        }
        Ok(found)
    }

    /// Calls `visit` with the positions of every frame.
    fn for_each_row(
        &mut self,
        source: &mut SourceFile<'_>,
        mut visit: impl FnMut(&[Position]),
    ) -> io::Result<()> {
        let mut row = vec![GAP; self.points.len()];
        while self.next_frame(source, &mut row)? {
            visit(&row);
        }
        self.rewind();
        Ok(())
    }

    /// Writes the part of the coordinates under gaps to `data`.
    fn gap_coordinates(
        &self,
        source: &mut SourceFile<'_>,
        counts: &GapCounts,
        data: Content,
    ) -> Result<Foreign> {
        let layout = &self.layout;
        if data.is_omitted() {
            return Ok(gap_coordinates::part(data));
        }
        let mut writer = GapWriter::new(counts, layout.first_frame, data)?;
        let mut buffer = FrameBuffer::default();
        for range in FrameBuffer::ranges_from(layout, 0) {
            let frames = buffer.read(source, layout, &range)?;
            for frame in 0..range.len() {
                let stored = frames.points(frame);
                for (marker, &point) in self.points.iter().enumerate() {
                    if let StoredSample::UnderGap(words) = self.sample(stored, point) {
                        let position = self.millimetres.convert(self.scaled(words));
                        writer.push((range.start + frame, marker), position, words[3])?;
                    }
                }
            }
        }
        Ok(writer.into_foreign()?)
    }
}

fn note_outputs_not_rotated(points: &Points, rotation: Rotation, notes: &mut Notes) {
    if !rotation.is_identity() && !points.outputs.is_empty() {
        notes.warnings.push(format!(
            "{} ({}) not rotated: some are vectors in space, others are angles or scalars.",
            counted(points.outputs.len() as u64, "model output"),
            MODEL_OUTPUTS
        ));
    }
}

/// The byte order from the processor code of the parameter section; Intel, with a warning, if the code is unknown.
fn byte_order(code: u8, warnings: &mut Vec<String>) -> ByteOrder {
    ByteOrder::from_code(code).unwrap_or_else(|| {
        warnings.push(
            "The parameter section has an unknown processor type; the file was read as Intel."
                .to_owned(),
        );
        ByteOrder::Intel
    })
}

/// The records of the parameter section, after its four leading bytes: up to the data, or, if the header does not state
/// where the data begins, for the number of blocks that the section states. Either is counted in 16 bits at most, so
/// they have less than 32 MiB.
fn section(
    source: &mut SourceFile<'_>,
    start: u64,
    n_blocks: u8,
    header: &C3dHeader,
) -> Result<Vec<u8>> {
    let announced = start + u64::from(n_blocks) * BLOCK as u64;
    let data = u64::from(header.data_block).saturating_sub(1) * BLOCK as u64;
    let end = if data > start { data } else { announced }.min(source.len());
    let mut records = vec![0; end.saturating_sub(start + 4) as usize];
    source.read_at(start + 4, &mut records)?;
    Ok(records)
}

/// Whether fourth words mark the missing samples of this file. If every fourth word is negative although there are
/// coordinates, they mark nothing, which is noted as an ambiguity.
fn fourth_words_are_marks(
    source: &mut SourceFile<'_>,
    layout: &Layout,
    points: &Points,
    notes: &mut Notes,
) -> Result<bool> {
    let mut samples = 0u64;
    let mut buffer = FrameBuffer::default();
    for range in FrameBuffer::ranges_from(layout, 0) {
        let frames = buffer.read(source, layout, &range)?;
        for frame in 0..range.len() {
            let stored = frames.points(frame);
            for &(point, _) in &points.markers {
                let [x, y, z, fourth] = stored.get(point).copied().unwrap_or_default();
                if !is_missing(fourth) {
                    return Ok(true);
                }
                samples += u64::from(has_coordinates([x, y, z]));
            }
        }
    }
    if samples > 0 {
        notes.ambiguous(Ambiguity::FourthWords { samples });
    }
    Ok(samples == 0)
}

/// Whether the coordinates are those of a sample: finite and not all 0.
fn has_coordinates(stored: [f32; 3]) -> bool {
    stored.iter().all(|v| v.is_finite()) && stored != [0.0; 3]
}

/// Parameters of POINT that list model outputs: results that are stored as points without being positions.
const MODEL_OUTPUT_GROUPS: [&str; 6] =
    ["ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS"];

/// Maximum number of parameters read as lists of model outputs. Texts of length 0 take no bytes, so a damaged file
/// could claim any number of them.
const MAX_LISTS: usize = 64;

/// The points of a file, sorted.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Points {
    /// The markers in file order, each with its index among the points.
    markers: Vec<(usize, Marker)>,
    /// Indices of the model outputs.
    outputs: Vec<usize>,
}

/// Sorts `n_points` points into markers and model outputs.
fn sort_points(parameters: &Parameters, n_points: usize, warnings: &mut Vec<String>) -> Points {
    let labels = parameters.texts("POINT", "LABELS");
    if labels.len() < n_points {
        warnings.push(format!(
            "POINT:LABELS has {} labels for {n_points} points; the other points are unlabelled.",
            labels.len()
        ));
    } else if labels.iter().skip(n_points).any(|label| !label.is_empty()) {
        warnings.push(format!("POINT:LABELS has {} labels for {n_points} points.", labels.len()));
    }
    let listed = listed_outputs(parameters);
    let mut points = Points { markers: Vec::new(), outputs: Vec::new() };
    for index in 0..n_points {
        let label = labels.get(index).map_or("", String::as_str);
        if !label.is_empty() && listed.contains(label) {
            points.outputs.push(index);
        } else {
            points.markers.push((index, point_marker(label, points.markers.len())));
        }
    }
    points
}

/// The marker of a label. Vicon's labels of unlabelled trajectories begin with `*`.
fn point_marker(label: &str, column: usize) -> Marker {
    if label.is_empty() {
        return Marker { label: Channel::unlabelled_name(column), labelled: false };
    }
    Marker { label: label.to_owned(), labelled: !label.starts_with('*') }
}

/// The labels of all model outputs: those in the parameters named by `MODEL_OUTPUT_GROUPS` and by `POINT:TYPE_GROUPS`, whose
/// texts are pairs of such a name and the name of one of its points.
fn listed_outputs(parameters: &Parameters) -> HashSet<String> {
    let type_groups = parameters.texts("POINT", "TYPE_GROUPS");
    let named = type_groups.iter().step_by(2).map(String::as_str);
    let mut names: Vec<&str> = MODEL_OUTPUT_GROUPS.into_iter().chain(named).collect();
    // MODELED_MARKERS are positions, and the labels of all points are not a list of model outputs.
    names.retain(|name| {
        let name = name.to_ascii_uppercase();
        !name.is_empty() && !name.contains("MARKER") && !name.starts_with("LABELS")
    });
    names.truncate(MAX_LISTS);
    names.sort_unstable();
    names.dedup();
    names
        .into_iter()
        .flat_map(|name| parameters.texts("POINT", name))
        .filter(|label| !label.is_empty())
        .collect()
}

/// Bytes of frames that are read at a time: they stay in the processor's cache with the data derived from them, and a
/// column of a scratch file is written in pieces of 1 kB if a frame has a thousand words.
const BLOCK_BYTES: usize = 1 << 20;
/// Minimum number of frames that are read at a time, unless they have more than [`LARGE_BLOCK_BYTES`]: with fewer, a
/// frame of hundreds of thousands of words would cost as many writes to its columns.
const BLOCK_FRAMES_MIN: usize = 64;
const LARGE_BLOCK_BYTES: usize = 1 << 25;

/// Reads successive frames.
#[derive(Debug, Default)]
struct FrameBuffer {
    bytes: Vec<u8>,
    samples: Vec<f32>,
}

impl FrameBuffer {
    /// The ranges of frames to read one after another, from frame `first` on.
    fn ranges_from(layout: &Layout, first: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let n_frames = layout.n_frames;
        let within = |n_bytes: usize| n_bytes / layout.stride.frame_bytes().max(1);
        let n_block = within(BLOCK_BYTES).max(within(LARGE_BLOCK_BYTES).clamp(1, BLOCK_FRAMES_MIN));
        (first..n_frames).step_by(n_block).map(move |first| first..n_frames.min(first + n_block))
    }

    /// Reads a range of frames.
    ///
    /// # Errors
    /// Those of the file.
    fn read<'b>(
        &'b mut self,
        source: &mut SourceFile<'_>,
        layout: &'b Layout,
        range: &Range<usize>,
    ) -> io::Result<Frames<'b>> {
        let frame_bytes = layout.stride.frame_bytes();
        self.bytes.resize(range.len() * frame_bytes, 0);
        let at = layout.stride.data_start + range.start * frame_bytes;
        source.read_at(at as u64, &mut self.bytes)?;
        self.samples.clear();
        let order = layout.order;
        if !layout.stride.float {
            let words = self.bytes.as_chunks().0.iter();
            self.samples.extend(words.map(|&bytes| f32::from(order.word(bytes) as i16)));
        } else if order == ByteOrder::Intel {
            self.samples
                .extend(self.bytes.as_chunks().0.iter().map(|&word| f32::from_le_bytes(word)));
        } else {
            self.samples.extend(self.bytes.as_chunks().0.iter().map(|&word| order.float(word)));
        }
        Ok(self.held(layout))
    }

    /// Frames that were read before.
    fn held<'b>(&'b self, layout: &'b Layout) -> Frames<'b> {
        Frames { samples: &self.samples, layout }
    }
}

/// The words of a point as stored: three coordinates and the fourth word.
type StoredWords = [f32; 4];

/// Successive frames as stored, counted from the first of them. Integers are floats of the same value.
#[derive(Debug, Clone, Copy)]
struct Frames<'a> {
    samples: &'a [f32],
    layout: &'a Layout,
}

impl<'a> Frames<'a> {
    /// Number of frames.
    fn len(&self) -> usize {
        self.samples.len().checked_div(self.layout.stride.frame_words()).unwrap_or(0)
    }

    /// The points of a frame.
    fn points(&self, frame: usize) -> &'a [StoredWords] {
        let stride = &self.layout.stride;
        let start = frame * stride.frame_words();
        self.samples.get(start..start + 4 * stride.n_points).unwrap_or_default().as_chunks().0
    }

    /// A word of a frame: four for each point, then the analog samples.
    fn word(&self, frame: usize, word: usize) -> f32 {
        let at = frame * self.layout.stride.frame_words() + word;
        self.samples.get(at).copied().unwrap_or_default()
    }

    /// A word of a frame as columns store it: a float mapped by [`ordered`], or an integer.
    fn column_word(&self, frame: usize, word: usize) -> u32 {
        let value = self.word(frame, word);
        if self.layout.stride.float {
            ordered(value.to_bits())
        } else {
            u32::from(value as i16 as u16)
        }
    }
}

/// Whether the fourth word of a point marks it as missing: it is a 16-bit integer, negative for a missing point. Some
/// software writes -1 in float files as the unsigned 65535.0. Residual and camera mask never reach 32768, so that range
/// is missing, too. A point at the origin with another fourth word is a position, as in the field's other readers.
#[inline]
fn is_missing(fourth: f32) -> bool {
    fourth < 0.0 || (32_768.0..65_536.0).contains(&fourth)
}
