//! Import of a C3D file.
//!
//! A first pass over the frames finds everything about the trajectories but the samples. The frames can then be read
//! one after another, as often as needed.

use std::{io, ops::Range};

use super::{
    columns, events,
    foreign::{self, SampleParts},
    frames::{FrameBuffer, Points, StoredWords, is_missing, sort_points},
    gap_coordinates::{self, GapCounts, GapWriter},
    header::{BLOCK, ByteOrder, C3dHeader},
    layout::Layout,
    malformed,
    parameters::Parameters,
};
use crate::{
    foreign::content::{Content, PartStore},
    interchange::{
        ReadOptions, Result, counted,
        origin::OriginScan,
        rotation::Rotation,
        source_file::SourceFile,
        units::{FileUnit, MotionExtent, ToMillimetres},
    },
    motion::{Ambiguity, Foreign, GAP, MotionInfo, Notes, Position, is_gap},
};

/// Reads everything but the samples, and prepares to read those.
pub(crate) fn open(
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
        events: events::read(&parameters, rate_hz, first_frame, n_frames as u64),
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
pub(crate) struct C3dFrames {
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
            columns::MODEL_OUTPUTS
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
