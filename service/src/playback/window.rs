//! A window of frames as bytes: a header and the positions of all markers, frame by frame.

use std::{
    io::{Read, Seek},
    ops::Range,
};

use mocapd_take::{
    TakeError, TakeMap, TakeTraversal,
    motion::{GAP, Position},
    traversal::Decode,
};

use super::WINDOW_SAMPLES_MAX;

/// Maximum size of a window in bytes, header included: less than a megabyte.
pub const WINDOW_BYTES_MAX: u64 = 1_000_000;

/// Size of the header in bytes.
pub const HEADER_BYTES: u64 = 32;

/// Bytes of a sample: three f32.
const SAMPLE_BYTES: u64 = 12;

/// Longest window in seconds: more than any response holds; larger numbers are typing errors.
pub const SECONDS_MAX: f64 = 3600.0;

/// Largest distance between the frames of a thinned window.
pub const EVERY_MAX: u32 = 10_000;

/// The signature of a window: "mocapd window", version 1.
const MAGIC: &[u8; 4] = b"MPW1";

/// The window ends before the requested end, because it would be larger than [`WINDOW_BYTES_MAX`] or need too much work.
pub(super) const SHORTENED: u32 = 1;
/// Something in it, or before it in its key stretch, is damaged: the frames that cannot be read are gaps.
pub(super) const DAMAGED: u32 = 2;

/// The frames that a window is to have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowRequest {
    /// Where it begins, in seconds: at the first frame at or after this time.
    pub from_s: f64,
    /// How long it is, in seconds.
    pub length_s: f64,
    /// It has every frame (1), every second one (2), and so on.
    pub every: u32,
}

/// A window of frames.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameWindow {
    n_markers: u32,
    first_row: u64,
    every: u32,
    flags: u32,
    /// By frame, one position per marker.
    positions: Vec<Position>,
}

/// Why a window cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum WindowError {
    /// It begins after the last frame.
    #[error("the take ends after {seconds:.3} s, before the window begins")]
    BehindEnd {
        /// The length of the take.
        seconds: f64,
    },
    /// One frame alone is larger than a window.
    #[error("a frame of {n_markers} markers is larger than a window can be")]
    TooManyMarkers {
        /// Number of markers.
        n_markers: usize,
    },
    /// A frame of it needs too many samples.
    #[error("a frame of this window needs too many samples: request it with a smaller `every`")]
    TooMuchWork,
    /// The take cannot be read.
    #[error(transparent)]
    Take(#[from] TakeError),
}

/// Maximum number of frames of a window.
pub(super) fn frames_max(n_markers: usize) -> u64 {
    (WINDOW_BYTES_MAX - HEADER_BYTES) / (SAMPLE_BYTES * n_markers.max(1) as u64)
}

impl FrameWindow {
    /// Decodes the frames of a window of a take with this map, from the last key stretch before it on.
    ///
    /// # Errors
    /// Those of [`WindowError`].
    pub fn read(
        input: &mut (impl Read + Seek),
        map: &TakeMap,
        request: &WindowRequest,
    ) -> Result<Self, WindowError> {
        let n_markers = map.channels.len();
        let rows = rows_of(map, request)?;
        let every = request.every.clamp(1, EVERY_MAX);
        let held_max = frames_max(n_markers);
        if held_max == 0 {
            return Err(WindowError::TooManyMarkers { n_markers });
        }
        let worked_max = WINDOW_SAMPLES_MAX / n_markers.max(1) as u64;
        let rows_max = held_max.saturating_mul(every.into()).min(worked_max.max(1));
        let mut flags = 0;
        let mut end = rows.end;
        if end - rows.start > rows_max {
            end = rows.start + rows_max;
            flags |= SHORTENED;
        }
        let rows = rows.start..end;
        let (positions, is_damaged) = decode_rows(input, map, &rows, every)?;
        flags |= if is_damaged { DAMAGED } else { 0 };
        Ok(Self { n_markers: n_markers as u32, first_row: rows.start, every, flags, positions })
    }

    /// The window as bytes, little endian: the four bytes `MPW1`, u32 number of markers, u64 first row, u32 number of
    /// frames, u32 rows from one frame to the next, u32 flags, u32 zero; then the frames, each three f32 per marker in
    /// millimetres, NaN where the sample is missing.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let n_frames = self.positions.len() as u64 / u64::from(self.n_markers.max(1));
        let n_bytes = HEADER_BYTES as usize + self.positions.len() * SAMPLE_BYTES as usize;
        let mut out = Vec::with_capacity(n_bytes);
        put_header(
            &mut out,
            MAGIC,
            self.first_row,
            [self.n_markers, n_frames as u32, self.every, self.flags],
        );
        for value in self.positions.iter().flatten() {
            out.extend_from_slice(&value.to_le_bytes());
        }
        out
    }
}

/// Appends the header of a window, [`HEADER_BYTES`] long: a signature, u32 number of signals, u64 first row, u32 number of
/// frames, u32 rows from one to the next, u32 flags, u32 zero. `words` are the four numbers of 32 bits.
pub(super) fn put_header(out: &mut Vec<u8>, magic: &[u8; 4], first_row: u64, words: [u32; 4]) {
    let [n_signals, n_frames, every, flags] = words;
    out.extend_from_slice(magic);
    out.extend_from_slice(&n_signals.to_le_bytes());
    out.extend_from_slice(&first_row.to_le_bytes());
    for word in [n_frames, every, flags, 0] {
        out.extend_from_slice(&word.to_le_bytes());
    }
}

/// Decodes every n-th of the rows, and says whether something in them or before them in their key stretch is damaged. One
/// position for each marker; a row that cannot be read has gaps. The caller bounds the number of rows.
pub(super) fn decode_rows(
    input: &mut (impl Read + Seek),
    map: &TakeMap,
    rows: &Range<u64>,
    every: u32,
) -> Result<(Vec<Position>, bool), TakeError> {
    let n_markers = map.channels.len();
    let n_frames = (rows.end - rows.start).div_ceil(every.into());
    let positions = vec![GAP; n_frames as usize * n_markers];
    let mut decoded = DecodedFrames { n_markers, first_row: rows.start, every, positions };
    if n_markers == 0 {
        return Ok((decoded.positions, map.damaged));
    }
    let mut take = TakeTraversal::from_map(input, map, Decode::All)?;
    take.read_rows(rows, |take, part, offset| {
        decoded.copy(take, &part, offset);
        Ok(())
    })?;
    Ok((decoded.positions, !take.is_intact() || map.damaged))
}

/// Frames that are being decoded.
struct DecodedFrames {
    n_markers: usize,
    first_row: u64,
    every: u32,
    positions: Vec<Position>,
}

impl DecodedFrames {
    /// Copies those rows of the last stretch that are among the frames. `part` are its rows within them, and the first of
    /// them has the index `offset` in the stretch.
    fn copy<R: Read + Seek>(&mut self, take: &TakeTraversal<R>, part: &Range<u64>, offset: usize) {
        let (every, n_markers) = (u64::from(self.every), self.n_markers);
        let skipped = (part.start - self.first_row).next_multiple_of(every);
        let first = self.first_row + skipped;
        if first >= part.end {
            return;
        }
        let n = ((part.end - first).div_ceil(every)) as usize;
        let within = offset + (first - part.start) as usize;
        let frame = (skipped / every) as usize;
        for (column, rows) in take.rows().take(n_markers).enumerate() {
            let Some(rows) = rows else { continue };
            let samples = rows.positions.iter().zip(&rows.present);
            let samples = samples.skip(within).step_by(every as usize).take(n);
            let places =
                self.positions.iter_mut().skip(frame * n_markers + column).step_by(n_markers);
            for (place, (&position, &present)) in places.zip(samples) {
                if present {
                    *place = position;
                }
            }
        }
    }
}

/// The first frame at or after a time. A time that a client computed from the number of a frame is that frame's, whatever
/// the rate: a division and a multiplication of f64 are off by far less than this tolerance.
pub(super) fn frame_at(time_s: f64, rate_hz: f64) -> u64 {
    let frame = time_s * rate_hz;
    let nearest = frame.round();
    let is_close = (frame - nearest).abs() <= FRAME_TOLERANCE + 4.0 * f64::EPSILON * frame;
    // A number that does not fit is behind every take.
    if is_close { nearest as u64 } else { frame.ceil() as u64 }
}

/// Frames by which a time may miss that of a frame.
const FRAME_TOLERANCE: f64 = 1e-6;

/// The labels of a take's markers.
pub(super) fn labels(map: &TakeMap) -> Vec<String> {
    map.channels.iter().map(|channel| channel.label.clone()).collect()
}

/// The rows from the first to the last of a request, within the take.
pub(super) fn rows_of(map: &TakeMap, request: &WindowRequest) -> Result<Range<u64>, WindowError> {
    let rate_hz = map.header.rate_hz;
    let first = frame_at(request.from_s, rate_hz);
    if first >= map.n_rows {
        return Err(WindowError::BehindEnd { seconds: map.n_rows as f64 / rate_hz });
    }
    let end = frame_at(request.from_s + request.length_s, rate_hz);
    Ok(first..end.clamp(first + 1, map.n_rows))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frames_time_is_that_frame_at_every_rate() {
        for rate_hz in [0.001, 23.976, 29.97, 60.0, 60.003, 120.0, 300.0, 333.3, 1000.0, 9999.0] {
            for frame in (0..2000).chain([99_999, 123_456_789, 4_000_000_000]) {
                assert_eq!(frame_at(frame as f64 / rate_hz, rate_hz), frame, "{rate_hz} Hz");
                let later = (frame as f64 + 0.01) / rate_hz;
                assert_eq!(frame_at(later, rate_hz), frame + 1, "{rate_hz} Hz");
            }
        }
        assert_eq!(frame_at(1e9, 1e6), 1_000_000_000_000_000);
    }
}
