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
    VERSION,
    columns::{self, ColumnReader, ordered},
    frames::{Frames, Points},
    gap_coordinates,
    header::{ByteOrder, C3dHeader, HeaderEvent, MAX_EVENTS},
    parameters::{Parameters, encode_records},
};
use crate::{
    foreign::content::ContentSlice,
    interchange::rotation::Rotation,
    motion::{Foreign, Position, is_gap},
};

/// Size of the buffer for reading a part: for 64 channels of floats 4096 samples each, read in pieces of 4 kB.
const BLOCK_BYTES: usize = 1 << 20;
/// Most bytes of the parameters. A C3D file has at most 255 blocks of 512 bytes; a rotation adds little.
const PARAMETERS_BYTES_MAX: u64 = 1 << 20;

const PARAMETERS: &str = "c3d/parameters";
const ANALOG: &str = "c3d/analog";
const RESIDUALS: &str = "c3d/residuals";
pub(in crate::interchange) const MODEL_OUTPUTS: &str = "c3d/model-outputs";

/// The foreign parts of a file, except for coordinates under gaps.
pub(super) fn keep(
    header: &C3dHeader,
    parameters: &Parameters,
    frames: &Frames<'_>,
    points: &Points,
    positions: &[Position],
) -> Vec<Foreign> {
    let parts = [
        (PARAMETERS, Some(parameters_data(header, parameters))),
        (ANALOG, (frames.layout.stride.analog_per_frame > 0).then(|| analog_data(frames))),
        (RESIDUALS, residual_data(frames, points, positions)),
        (MODEL_OUTPUTS, (!points.outputs.is_empty()).then(|| output_data(frames, points))),
    ];
    let kept = parts
        .into_iter()
        .filter_map(|(kind, data)| Some(Foreign { kind: kind.to_owned(), data: data?.into() }));
    kept.collect()
}

/// The header of a block of columns over all frames of a file: version, width, number of signals, samples of a column
/// in a frame, number of the first frame, number of frames.
fn sample_header(frames: &Frames<'_>, width: usize, n_signals: usize, ratio: usize) -> Vec<u8> {
    let (first_frame, n_frames) = (frames.layout.first_frame, frames.layout.n_frames);
    SampleHeader { width, n_signals, ratio, first_frame, n_frames }.encode()
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
        let data = parameters_data(&header, &parameters).into();
        Foreign { kind: PARAMETERS.to_owned(), data }
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

fn analog_data(frames: &Frames<'_>) -> Vec<u8> {
    let layout = frames.layout;
    let (n_channels, ratio) = (layout.n_channels(), layout.analog_ratio);
    let width = layout.stride.word_bytes();
    let mut data = sample_header(frames, width, n_channels, ratio);
    for channel in 0..n_channels {
        let samples = (0..layout.n_frames * ratio).map(|sample| {
            let word = 4 * layout.stride.n_points + sample % ratio * n_channels + channel;
            frames.column_word(sample / ratio, word)
        });
        columns::push(&mut data, width, samples);
    }
    data
}

/// The part of the fourth words; `None` if all are 0. A missing sample repeats the previous word, because that
/// compresses best and no export reads it.
fn residual_data(frames: &Frames<'_>, points: &Points, positions: &[Position]) -> Option<Vec<u8>> {
    let layout = frames.layout;
    let n_markers = points.markers.len();
    let present = |frame: usize, marker: usize| {
        positions.get(frame * n_markers + marker).is_some_and(|&p| !is_gap(p))
    };
    let fourth = |frame: usize, point: usize| frames.column_word(frame, 4 * point + 3);
    let zero = if layout.stride.float { ordered(0) } else { 0 };
    let is_zero = points.markers.iter().enumerate().all(|(marker, &(point, _))| {
        (0..layout.n_frames).all(|frame| !present(frame, marker) || fourth(frame, point) == zero)
    });
    if is_zero {
        return None;
    }
    let width = layout.stride.word_bytes();
    let mut data = sample_header(frames, width, n_markers, 1);
    for (marker, &(point, _)) in points.markers.iter().enumerate() {
        let mut before = zero;
        let words = (0..layout.n_frames).map(|frame| {
            if present(frame, marker) {
                before = fourth(frame, point);
            }
            before
        });
        columns::push(&mut data, width, words);
    }
    Some(data)
}

fn output_data(frames: &Frames<'_>, points: &Points) -> Vec<u8> {
    let mut data = sample_header(frames, size_of::<f32>(), points.outputs.len(), 1);
    for &point in &points.outputs {
        data.extend((point as u32).to_le_bytes());
    }
    let scale = frames.scale();
    for &point in &points.outputs {
        for word in 4 * point..4 * point + 4 {
            // The fourth word is not a coordinate: an integer becomes a float of the same value, without the scale
            // factor.
            let scale = if word % 4 == 3 { 1.0 } else { scale };
            let samples = (0..frames.layout.n_frames).map(|frame| {
                let stored = frames.word(frame, word);
                let value = if scale == 1.0 { stored } else { (f64::from(stored) * scale) as f32 };
                ordered(value.to_bits())
            });
            columns::push(&mut data, size_of::<f32>(), samples);
        }
    }
    data
}

/// The header of a block of columns.
#[derive(Debug, Clone, Copy)]
pub(super) struct SampleHeader {
    /// Bytes of a sample: 2 or 4.
    pub(super) width: usize,
    /// Number of channels, markers or points.
    pub(super) n_signals: usize,
    /// Samples of a signal in a frame.
    pub(super) ratio: usize,
    /// Number of the first frame.
    pub(super) first_frame: u64,
    pub(super) n_frames: usize,
}

impl SampleHeader {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut data = vec![VERSION, self.width as u8];
        data.extend((self.n_signals as u32).to_le_bytes());
        data.extend((self.ratio as u32).to_le_bytes());
        data.extend(self.first_frame.to_le_bytes());
        data.extend((self.n_frames as u64).to_le_bytes());
        data
    }

    /// Samples of a column; `None` if they are too many for this machine.
    pub(super) fn samples(&self) -> Option<usize> {
        self.n_frames.checked_mul(self.ratio)
    }

    /// `None` for an unknown version or width, and for more signals than a C3D file has.
    pub(super) fn parse(header: &[u8; 26]) -> Option<Self> {
        let &[VERSION, width @ (2 | 4), ..] = header else { return None };
        let dword =
            |at: usize| Some(u32::from_le_bytes(header.get(at..at + 4)?.try_into().ok()?) as usize);
        let qword = |at: usize| Some(u64::from_le_bytes(header.get(at..at + 8)?.try_into().ok()?));
        Some(Self {
            width: usize::from(width),
            n_signals: dword(2).filter(|&n| n <= usize::from(u16::MAX))?,
            ratio: dword(6)?,
            first_frame: qword(10)?,
            n_frames: usize::try_from(qword(18)?).ok()?,
        })
    }

    /// The columns, `n` for each signal; `None` if the data has another length.
    fn columns<'a>(&self, data: ContentSlice<'a>, n: usize) -> Option<ColumnReader<'a>> {
        let n_columns = self.n_signals.checked_mul(n)?;
        let n_samples = self.samples()?;
        ColumnReader::new(data, self.width, n_columns, n_samples, BLOCK_BYTES)
    }
}

/// The columns of samples in a foreign part, read frame by frame.
#[derive(Debug)]
pub(super) struct PartSamples<'a> {
    pub(super) header: SampleHeader,
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
        let Some(mut columns) = header.columns(rest, columns) else { return Ok(None) };
        let mut points = vec![0; n_indices * 4];
        indices.read_at(0, &mut points)?;
        let points = points.as_chunks().0.iter().map(|&b| u32::from_le_bytes(b) as usize).collect();
        let skip = first_frame.saturating_sub(header.first_frame).min(header.n_frames as u64);
        columns.skip((skip as usize).saturating_mul(header.ratio))?;
        let frames_ahead = header.first_frame.saturating_sub(first_frame);
        Ok(Some(Self { header, points, columns, frames_ahead }))
    }

    /// The analog samples from a frame on.
    pub(super) fn analog(foreign: &'a [Foreign], first_frame: u64) -> io::Result<Option<Self>> {
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
    pub(super) fn begin_frame(&mut self) -> bool {
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
    pub(super) fn next(&mut self) -> io::Result<Option<&[u32]>> {
        self.columns.next()
    }
}

/// The kept header fields and parameters.
pub(super) fn kept_parameters(foreign: &[Foreign]) -> io::Result<Option<(C3dHeader, Parameters)>> {
    let part = foreign.iter().find(|part| part.kind == PARAMETERS);
    let data = part.map(|part| part.data.to_vec(PARAMETERS_BYTES_MAX)).transpose()?.flatten();
    Ok(data.and_then(|data| parse_parameters(&data)))
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
