//! Import of a C3D file.

use super::{
    events, foreign,
    frames::{Frames, Points, is_missing, sort_points},
    gap_coordinates::GapCoordinates,
    header::{BLOCK, ByteOrder, C3dHeader},
    layout::Layout,
    malformed,
    parameters::Parameters,
};
use crate::{
    ambiguity::{Ambiguity, Notes},
    interchange::{
        ReadOptions, Result, counted, origin,
        units::{FileUnit, ToMillimetres},
    },
    motion::{GAP, Motion, MotionInfo, Position},
};

/// Reads a whole file.
pub(crate) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Motion> {
    let &[parameter_block, key, ..] = bytes else {
        return Err(malformed("byte 0", "the file is empty or ends within its header"));
    };
    if key != 0x50 {
        let text = format!("expected the C3D signature 50 (hex), found {key:02x}: not a C3D file");
        return Err(malformed("byte 1", text));
    }
    let mut notes = Notes::default();
    let section_start = usize::from(parameter_block).saturating_sub(1) * BLOCK;
    let order = byte_order(bytes, section_start, &mut notes.warnings);
    let Some(header) = C3dHeader::parse(bytes, order) else {
        let message = format!("expected a header of {BLOCK} bytes, found {}", bytes.len());
        return Err(malformed("byte 0", message));
    };
    let section = section(bytes, section_start, &header);
    let mut parameters = Parameters::parse(section, order, &mut notes.warnings);
    let layout = Layout::resolve(&header, &parameters, order, bytes, &mut notes)?;
    let points = sort_points(&parameters, layout.stride.n_points, &mut notes.warnings);
    let stated = parameters.text("POINT", "UNITS").unwrap_or_default();
    let unit = FileUnit::resolve(&stated, options.unit, &mut notes);
    let frames = Frames::new(bytes, &layout);
    let millimetres = ToMillimetres::new(unit.factor, options.rotation());
    let has_marks = fourth_words_are_marks(&frames, &points, &mut notes);
    let mut under_gaps = GapCoordinates::default();
    let positions_mm = read_positions(&frames, &points, &millimetres, has_marks, &mut under_gaps);
    millimetres.report(&mut notes.warnings);
    under_gaps.note(&mut notes);
    unit.check(&positions_mm, points.markers.len(), &mut notes);
    origin::note_samples_at_origin(&positions_mm, points.markers.len(), &mut notes);
    let up = options.up(parameters.up_axis(), &mut notes);
    parameters.rotate(options.rotation());
    let mut foreign = foreign::keep(&header, &parameters, &frames, &points, &positions_mm);
    foreign.extend(under_gaps.into_foreign(layout.first_frame, &mut notes.warnings));
    if !options.rotation().is_identity() && !points.outputs.is_empty() {
        notes.warnings.push(format!(
            "{} ({}) not rotated: some are vectors in space, others are angles or scalars.",
            counted(points.outputs.len() as u64, "model output"),
            foreign::MODEL_OUTPUTS
        ));
    }
    let events =
        events::read(&parameters, layout.rate_hz, layout.first_frame, layout.n_frames as u64);
    Ok(Motion {
        info: MotionInfo {
            rate_hz: layout.rate_hz,
            n_frames: layout.n_frames as u64,
            markers: points.markers.into_iter().map(|(_, marker)| marker).collect(),
            up,
            source: unit.into_source("c3d", layout.first_frame, layout.frames_missing, notes),
            subject: None,
            foreign,
            events,
        },
        positions_mm,
    })
}

/// The byte order from the processor code of the parameter section; Intel, with a warning, if the code is unknown.
fn byte_order(bytes: &[u8], section_start: usize, warnings: &mut Vec<String>) -> ByteOrder {
    let code = bytes.get(section_start + 3).copied();
    code.and_then(ByteOrder::from_code).unwrap_or_else(|| {
        warnings.push(
            "The parameter section has an unknown processor type; the file was read as Intel."
                .to_owned(),
        );
        ByteOrder::Intel
    })
}

/// The records of the parameter section, after its four leading bytes: up to the data, or, if the header does not state
/// where the data begins, for the number of blocks that the section states.
fn section<'a>(bytes: &'a [u8], start: usize, header: &C3dHeader) -> &'a [u8] {
    let announced = start + usize::from(bytes.get(start + 2).copied().unwrap_or(0)) * BLOCK;
    let data = usize::from(header.data_block).saturating_sub(1) * BLOCK;
    let end = if data > start { data } else { announced }.min(bytes.len());
    bytes.get(start + 4..end).unwrap_or(&[])
}

/// Whether fourth words mark the missing samples of this file. If every fourth word is negative although there are
/// coordinates, they mark nothing, which is noted as an ambiguity.
fn fourth_words_are_marks(frames: &Frames<'_>, points: &Points, notes: &mut Notes) -> bool {
    let mut samples = 0u64;
    for frame in 0..frames.layout.n_frames {
        for &(point, _) in &points.markers {
            let (stored, fourth) = frames.point(frame, point);
            if !is_missing(fourth) {
                return true;
            }
            samples += u64::from(has_coordinates(stored));
        }
    }
    if samples > 0 {
        notes.ambiguous(Ambiguity::FourthWords { samples });
    }
    samples == 0
}

/// Whether the coordinates are those of a sample: finite and not all 0.
fn has_coordinates(stored: [f64; 3]) -> bool {
    stored.iter().all(|v| v.is_finite()) && stored != [0.0; 3]
}

/// Reads the positions of all markers. Coordinates of samples that are marked as missing go to `gap_coordinates`.
fn read_positions(
    frames: &Frames<'_>,
    points: &Points,
    millimetres: &ToMillimetres,
    has_marks: bool,
    gap_coordinates: &mut GapCoordinates,
) -> Vec<Position> {
    let layout = frames.layout;
    let mut positions = Vec::with_capacity(layout.n_frames * points.markers.len());
    let scale = frames.scale();
    for index in 0..layout.n_frames {
        for (marker, &(point, _)) in points.markers.iter().enumerate() {
            let (stored, fourth) = frames.point(index, point);
            let scaled = stored.map(|v| v * scale);
            let is_gap = if has_marks { is_missing(fourth) } else { !has_coordinates(stored) };
            if is_gap && has_coordinates(stored) {
                gap_coordinates.push(index, marker, millimetres.convert(scaled), fourth);
            }
            positions.push(if is_gap { GAP } else { millimetres.position(scaled) });
        }
    }
    positions
}
