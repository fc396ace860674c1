//! Bytes of a C3D file -> trajectories.

use super::bytes::ByteOrder;
use super::events;
use super::foreign;
use super::gap_coordinates::GapCoordinates;
use super::header::{BLOCK, Header};
use super::labels::{Points, sort_points};
use super::layout::Layout;
use super::malformed;
use super::parameters::Parameters;
use crate::interchange::units::{FileUnit, Millimetres};
use crate::interchange::{InterchangeError, ReadOptions, notes::Notes, origin};
use crate::motion::{Ambiguity, GAP, Motion, MotionInfo, Position, Source, UpAxis};

/// Reads a whole file.
pub(crate) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Motion, InterchangeError> {
    let &[parameter_block, key, ..] = bytes else {
        return Err(malformed("byte 0", "the file is empty or cut off in its first bytes"));
    };
    if key != 0x50 {
        return Err(malformed(
            "byte 1",
            format!(
                "expected 50 (hexadecimal), the sign of a C3D file, found {key:02x}: not a C3D file"
            ),
        ));
    }
    let mut notes = Notes::default();
    let section_start = usize::from(parameter_block).saturating_sub(1) * BLOCK;
    let order = byte_order(bytes, section_start, &mut notes.warnings);
    let Some(header) = Header::parse(bytes, order) else {
        return Err(malformed(
            "byte 0",
            format!("expected a header of {BLOCK} bytes, found {}", bytes.len()),
        ));
    };
    let section = section(bytes, section_start, &header);
    let mut parameters = Parameters::parse(section, order, &mut notes.warnings);
    let layout = Layout::settle(&header, &parameters, order, bytes, &mut notes)?;
    let points = sort_points(&parameters, layout.n_points, &mut notes.warnings);
    let stated = parameters.text("POINT", "UNITS").unwrap_or_default();
    let unit = FileUnit::of(&stated, options, &mut notes);
    let frames = Frames::new(bytes, &layout);
    let millimetres = Millimetres::new(unit.factor, options);
    let marks = FourthWords::of(&frames, &points, &mut notes);
    let mut under_gaps = GapCoordinates::default();
    let positions_mm = read_positions(&frames, &points, &millimetres, marks, &mut under_gaps);
    millimetres.report(&mut notes.warnings);
    under_gaps.note(&mut notes);
    unit.judge(&positions_mm, points.markers.len(), &mut notes);
    origin::note_zeros(&positions_mm, points.markers.len(), &mut notes);
    let up = options.up(up_axis(&parameters), &mut notes);
    parameters.turn(options.turn());
    let mut foreign = foreign::keep(&header, &parameters, &frames, &points, &positions_mm);
    foreign.extend(under_gaps.into_foreign(layout.first_frame, &mut notes.warnings));
    if !options.turn().is_none() && !points.outputs.is_empty() {
        notes.warnings.push(format!(
            "{} model outputs ({}) were not given that half a turn: some are in space, some are angles.",
            points.outputs.len(),
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
            source: Source {
                format: "c3d".to_owned(),
                unit: unit.stated,
                factor: unit.factor,
                first_frame: layout.first_frame,
                frames_missing: layout.frames_missing,
                warnings: notes.warnings,
                ambiguities: notes.ambiguities,
            },
            subject: None,
            foreign,
            events,
        },
        positions_mm,
    })
}

/// The byte order by the processor code of the parameter section.
fn byte_order(bytes: &[u8], section_start: usize, warnings: &mut Vec<String>) -> ByteOrder {
    let code = bytes.get(section_start + 3).copied();
    code.and_then(ByteOrder::from_code).unwrap_or_else(|| {
        warnings.push(
            "The parameter section names no known processor; the file was read as Intel."
                .to_owned(),
        );
        ByteOrder::Intel
    })
}

/// The records of the parameter section: from behind its four bytes to the data, or where the header does not
/// say where those begin, over as many blocks as the section announces.
fn section<'a>(bytes: &'a [u8], start: usize, header: &Header) -> &'a [u8] {
    let announced = start + usize::from(bytes.get(start + 2).copied().unwrap_or(0)) * BLOCK;
    let data = usize::from(header.data_block).saturating_sub(1) * BLOCK;
    let end = if data > start { data } else { announced }.min(bytes.len());
    bytes.get(start + 4..end).unwrap_or(&[])
}

/// The frames of a file as stored.
pub(super) struct Frames<'a> {
    bytes: &'a [u8],
    /// How they are laid out.
    pub(super) layout: &'a Layout,
}

impl<'a> Frames<'a> {
    fn new(file: &'a [u8], layout: &'a Layout) -> Self {
        Self { bytes: file.get(layout.data_start..).unwrap_or(&[]), layout }
    }

    /// One frame's words: four for each point, then the analog samples.
    fn frame(&self, index: usize) -> &'a [u8] {
        let n_bytes = self.layout.frame_bytes();
        self.bytes.get(index * n_bytes..(index + 1) * n_bytes).unwrap_or(&[])
    }

    /// One word of a frame as a float; integers as such.
    pub(super) fn word(&self, frame: usize, word: usize) -> f32 {
        let bytes = self.frame(frame);
        let order = self.layout.order;
        if self.layout.float {
            order.float_at(bytes, 4 * word).unwrap_or(0.0)
        } else {
            f32::from(order.word_at(bytes, 2 * word).unwrap_or(0) as i16)
        }
    }

    /// One word of a frame of an integer file.
    pub(super) fn integer(&self, frame: usize, word: usize) -> u16 {
        self.layout.order.word_at(self.frame(frame), 2 * word).unwrap_or(0)
    }

    /// The coordinates as stored and the fourth word of a point.
    fn point(&self, frame: usize, point: usize) -> ([f64; 3], f32) {
        let n_bytes = 4 * self.layout.word_bytes();
        let sample = self.frame(frame).get(n_bytes * point..n_bytes * (point + 1));
        point_words(sample.unwrap_or(&[]), self.layout)
    }

    /// What a coordinate is multiplied by before its unit counts.
    pub(super) fn scale(&self) -> f64 {
        if self.layout.float { 1.0 } else { f64::from(self.layout.scale) }
    }
}

/// Whether a sample's fourth word says that it is missing: it is a 16-bit integer, and negative. In float files some
/// software writes the -1 unsigned, as 65535.0: no residual and camera mask reach 32768, so these are missing, too.
/// What stands at the origin with another fourth word is a position, as for the field's other readers.
pub(super) fn is_missing(fourth: f32) -> bool {
    fourth < 0.0 || (32_768.0..65_536.0).contains(&fourth)
}

/// What the fourth words of a file's markers say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FourthWords {
    /// Which samples are missing.
    Marks,
    /// All say "missing", also where coordinates are: nothing.
    Nothing,
}

impl FourthWords {
    fn of(frames: &Frames<'_>, points: &Points, notes: &mut Notes) -> Self {
        let mut samples = 0u64;
        for frame in 0..frames.layout.n_frames {
            for &(point, _) in &points.markers {
                let (stored, fourth) = frames.point(frame, point);
                if !is_missing(fourth) {
                    return Self::Marks;
                }
                samples += u64::from(has_coordinates(stored));
            }
        }
        if samples == 0 {
            return Self::Marks;
        }
        notes.ambiguous(Ambiguity::FourthWords { samples });
        Self::Nothing
    }
}

/// Whether these are coordinates, and no filling for a missing sample.
fn has_coordinates(stored: [f64; 3]) -> bool {
    stored.iter().all(|v| v.is_finite()) && stored != [0.0; 3]
}

/// The positions of all markers, and the coordinates that stand where they are missing.
fn read_positions(
    frames: &Frames<'_>,
    points: &Points,
    millimetres: &Millimetres,
    marks: FourthWords,
    under_gaps: &mut GapCoordinates,
) -> Vec<Position> {
    let layout = frames.layout;
    let mut positions = Vec::with_capacity(layout.n_frames * points.markers.len());
    let scale = frames.scale();
    for index in 0..layout.n_frames {
        for (marker, &(point, _)) in points.markers.iter().enumerate() {
            let (stored, fourth) = frames.point(index, point);
            let scaled = stored.map(|v| v * scale);
            let is_gap = match marks {
                FourthWords::Marks => is_missing(fourth),
                FourthWords::Nothing => !has_coordinates(stored),
            };
            if is_gap && has_coordinates(stored) {
                under_gaps.push(index, marker, millimetres.as_stored(scaled), fourth);
            }
            positions.push(if is_gap { GAP } else { millimetres.position(scaled) });
        }
    }
    positions
}

/// The coordinates as stored and the fourth word of a point.
fn point_words(sample: &[u8], layout: &Layout) -> ([f64; 3], f32) {
    if layout.float {
        let (words, _) = sample.as_chunks::<4>();
        if let &[x, y, z, fourth] = words {
            return (
                [x, y, z].map(|b| f64::from(layout.order.float(b))),
                layout.order.float(fourth),
            );
        }
    } else {
        let (words, _) = sample.as_chunks::<2>();
        if let &[x, y, z, fourth] = words {
            let signed = |b| layout.order.word(b) as i16;
            return ([x, y, z].map(|b| f64::from(signed(b))), f32::from(signed(fourth)));
        }
    }
    ([f64::NAN; 3], -1.0)
}

/// The axis that points up on a screen, where the file says so and it is a positive one.
fn up_axis(parameters: &Parameters) -> UpAxis {
    let axis = parameters.text("POINT", "Y_SCREEN").unwrap_or_default();
    match axis.trim().to_ascii_uppercase().as_str() {
        "+X" | "X" => UpAxis::X,
        "+Y" | "Y" => UpAxis::Y,
        "+Z" | "Z" => UpAxis::Z,
        _ => UpAxis::Unknown,
    }
}
