//! Finds the stride (content and length of a frame) where header, parameters and size of the file disagree about it.
//!
//! POINT:USED and the header state the number of points; the header, and ANALOG:USED times ANALOG:RATE over POINT:RATE,
//! state the number of analog samples in a frame. Every combination is a candidate. A candidate fits if its frames fill
//! the data section except for the padding of the last block, and it is smooth if coordinates are continuous from frame
//! to frame: a wrong stride reads another marker or another coordinate in every frame.

use std::{io, ops::Range};

use super::header::{BLOCK, ByteOrder};

/// Maximum number of analog samples in a frame: 255 channels with 4000 samples each, such as a microphone's at one
/// frame per second.
pub(crate) const ANALOG_MAX: u64 = 255 * 4000;
use crate::interchange::source_file::SourceFile;

/// Maximum number of candidates to compare. The stated values give at most 2 * 2 * 2 * 8; the size of the file adds
/// some for short files, in which several strides leave less than a block.
pub(super) const CANDIDATES_MAX: usize = 256;
/// Frames in a window for measuring roughness.
const WINDOW_FRAMES: usize = 24;
/// Number of windows, evenly spread over the file.
const WINDOWS: usize = 4;
/// Maximum number of points of a frame to measure, evenly spread.
const POINTS: usize = 48;
/// Largest roughness of motion. Coordinates whose velocity changes by a seventh of their range in every frame are read
/// with a wrong stride; human motion at 10 Hz stays below a tenth.
const ROUGHNESS_MAX: f64 = 0.15;
/// A candidate this many times as rough as the smoothest one is wrong. Neighbouring markers of a body are close to each
/// other, so a stride that is wrong by one point is only ten times as rough.
const ROUGHER: f64 = 4.0;
/// Roughness below which all candidates count as smooth.
const SMOOTH: f64 = 0.01;
/// Larger coordinates in the file's unit are not positions: 1 km in millimetres, 1000 km in metres.
const COORDINATE_MAX: f64 = 1e6;
/// Smaller coordinates are other data read as floats.
const COORDINATE_MIN: f64 = 1e-30;

/// The content of a frame and the start of the data section.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stride {
    /// Points in a frame.
    pub(super) n_points: usize,
    /// Analog samples in a frame, of all channels together.
    pub(super) analog_per_frame: usize,
    /// Whether samples are floats.
    pub(super) float: bool,
    /// Offset of the first frame in the file.
    pub(super) data_start: usize,
}

impl Stride {
    /// Bytes of a word.
    pub(super) fn word_bytes(&self) -> usize {
        if self.float { 4 } else { 2 }
    }

    /// Words of a frame: four for each point, and the analog samples.
    pub(super) fn frame_words(&self) -> usize {
        4 * self.n_points + self.analog_per_frame
    }

    /// Bytes of a frame.
    pub(super) fn frame_bytes(&self) -> usize {
        self.frame_words() * self.word_bytes()
    }
}

/// The relation of the size of some frames to the size of the data section.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SizeFit {
    /// The frames fill the data section except for less than a block, or for zeros.
    Exact,
    /// A block or more of other data remains.
    Surplus,
    /// The data section is too short.
    Short,
}

/// The bytes of a file, with the end of its last byte that is not zero, found once for all candidates.
#[derive(Debug)]
pub(super) struct FileBytes<'s, 'a> {
    source: &'s mut SourceFile<'a>,
    order: ByteOrder,
    /// Length of the file.
    pub(super) len: usize,
    /// The end of the last byte that is not zero.
    pub(super) filled: usize,
}

impl<'s, 'a> FileBytes<'s, 'a> {
    pub(super) fn new(source: &'s mut SourceFile<'a>, order: ByteOrder) -> io::Result<Self> {
        let count = |n: u64| usize::try_from(n).unwrap_or(usize::MAX);
        let (len, filled) = (count(source.len()), count(source.filled()?));
        Ok(Self { source, order, len, filled })
    }

    /// Bytes from the start of the data section to the end of the file.
    pub(super) fn available(&self, stride: &Stride) -> usize {
        self.len.saturating_sub(stride.data_start)
    }

    /// Number of complete frames.
    pub(super) fn present(&self, stride: &Stride) -> usize {
        self.available(stride).checked_div(stride.frame_bytes()).unwrap_or(0)
    }

    /// Compares the size of `n_frames` frames with that of the data section.
    pub(super) fn fit(&self, stride: &Stride, n_frames: u64) -> SizeFit {
        let needed = usize::try_from(n_frames).unwrap_or(usize::MAX);
        let needed = needed.saturating_mul(stride.frame_bytes());
        match self.available(stride).checked_sub(needed) {
            None => SizeFit::Short,
            Some(rest) if rest < BLOCK || stride.data_start + needed >= self.filled => {
                SizeFit::Exact
            }
            Some(_) => SizeFit::Surplus,
        }
    }
}

/// A possible stride with measures of how well it fits the file.
#[derive(Debug, Clone, Copy)]
pub(super) struct StrideCandidate {
    pub(super) stride: Stride,
    fit: SizeFit,
    /// Roughness of the motion; `None` if there is not enough of it.
    roughness: Option<f64>,
    /// Whether the file states this stride; otherwise it follows from the size of the file.
    is_stated: bool,
}

impl StrideCandidate {
    pub(super) fn new(
        file: &mut FileBytes<'_, '_>,
        stride: Stride,
        n_frames: u64,
        stated: bool,
    ) -> io::Result<Self> {
        let n_read = file.present(&stride).min(usize::try_from(n_frames).unwrap_or(usize::MAX));
        Ok(Self {
            stride,
            fit: file.fit(&stride, n_frames),
            roughness: roughness(file, &stride, n_read)?,
            is_stated: stated,
        })
    }

    /// Whether its frames fill the data section.
    pub(super) fn fills_data(&self) -> bool {
        self.fit == SizeFit::Exact
    }

    /// Whether motion is continuous, also in comparison with the smoothest candidate; `None` if that cannot be
    /// measured.
    fn is_smooth(&self, smoothest: f64) -> Option<bool> {
        let roughness = self.roughness?;
        Some(roughness <= ROUGHNESS_MAX && roughness <= (ROUGHER * smoothest).max(SMOOTH))
    }

    /// Whether it fills the data section, and motion is continuous or cannot be measured.
    pub(super) fn is_plausible(&self) -> bool {
        self.fills_data() && self.may_be_motion()
    }

    /// Whether the data section is too short for its frames.
    pub(super) fn is_short(&self) -> bool {
        self.fit == SizeFit::Short
    }

    /// Whether the only stated stride can be used without comparison: it fills the data section, or the file is merely
    /// too short and motion is continuous. If it fills the data, roughness does not count: few frames show no motion,
    /// markers may jump, and analog samples may be smooth.
    pub(super) fn is_acceptable(&self) -> bool {
        self.fills_data() || self.is_short() && self.may_be_motion()
    }

    /// Whether motion is continuous or cannot be measured.
    fn may_be_motion(&self) -> bool {
        self.roughness.is_none_or(|roughness| roughness <= ROUGHNESS_MAX)
    }

    /// Whether motion is so much smoother than with another candidate that the other one is wrong.
    pub(super) fn is_much_smoother(&self, other: &Self) -> bool {
        let measured = self.roughness.zip(other.roughness);
        measured.is_some_and(|(roughness, other)| ROUGHER * roughness < other)
    }

    /// Whether the first three frames are smooth. Every candidate reads the first frame as points, so a wrong stride
    /// that finds smooth analog samples everywhere else is rough here.
    pub(super) fn begins_smoothly(&self, file: &mut FileBytes<'_, '_>) -> io::Result<bool> {
        let n_frames = file.present(&self.stride).min(3);
        let roughness = roughness(file, &self.stride, n_frames)?;
        Ok(roughness.is_some_and(|roughness| roughness <= ROUGHNESS_MAX))
    }

    /// The rank of the candidate, 0 being the best; `None` if it is not acceptable.
    fn rank(&self, smoothest: f64) -> Option<u8> {
        match (self.fills_data(), self.is_smooth(smoothest), self.is_stated) {
            (true, Some(true), _) => Some(0),
            (true, None, true) => Some(1),
            (false, Some(true), true) => Some(2),
            (true, Some(false), true) => Some(3),
            _ => None,
        }
    }
}

/// Chooses among candidates in order of preference: the best rank, and within it the first one unless another is at
/// least twice as smooth. `None` if none is acceptable.
pub(super) fn choose(candidates: &[StrideCandidate]) -> Option<StrideCandidate> {
    let smoothest = candidates.iter().filter_map(|candidate| candidate.roughness);
    let smoothest = smoothest.fold(f64::INFINITY, f64::min);
    let rank = candidates.iter().filter_map(|candidate| candidate.rank(smoothest)).min()?;
    let mut best: Option<&StrideCandidate> = None;
    for candidate in candidates.iter().filter(|c| c.rank(smoothest) == Some(rank)) {
        let rough = |candidate: &StrideCandidate| candidate.roughness.unwrap_or(0.0);
        let is_better = best
            .is_none_or(|best| rough(candidate) < rough(best) / 2.0 && rough(best) > SMOOTH / 10.0);
        if is_better {
            best = Some(candidate);
        }
    }
    best.copied()
}

/// Strides like `base`, with other numbers of analog samples, whose `n_frames` frames leave less than a block of the
/// data section. The number of analog samples is a multiple of `n_channels`, if that is known.
pub(super) fn by_size(
    file: &FileBytes<'_, '_>,
    base: Stride,
    n_frames: u64,
    n_channels: Option<u64>,
) -> impl Iterator<Item = Stride> + use<> {
    let available = file.available(&base);
    let width = base.word_bytes();
    let n_frames = usize::try_from(n_frames).unwrap_or(usize::MAX).max(1);
    let most = available / width / n_frames;
    let least = (available.saturating_sub(BLOCK - 1)).div_ceil(width).div_ceil(n_frames);
    let words = (least..=most).rev().take(CANDIDATES_MAX);
    words.filter_map(move |words| {
        let analog = words.checked_sub(4 * base.n_points)?;
        if analog as u64 > ANALOG_MAX {
            return None;
        }
        let whole = match n_channels {
            Some(0) => analog == 0,
            Some(n) => usize::try_from(n).is_ok_and(|n| analog.is_multiple_of(n)),
            None => true,
        };
        whole.then_some(Stride { analog_per_frame: analog, ..base })
    })
}

/// All distinct combinations of the stated values, the preferred ones first.
pub(super) fn combine(
    points: &[u64],
    analog: &[u64],
    floats: &[bool],
    starts: &[usize],
) -> Vec<Stride> {
    let count = |n: u64| usize::try_from(n.min(1 << 32)).unwrap_or(usize::MAX);
    let mut all: Vec<Stride> = Vec::new();
    let starts = starts.iter().flat_map(|start| floats.iter().map(move |float| (start, float)));
    for (&data_start, &float) in starts {
        for (&n_points, &analog) in points.iter().flat_map(|n| analog.iter().map(move |m| (n, m))) {
            let (n_points, analog_per_frame) = (count(n_points), count(analog));
            let stride = Stride { n_points, analog_per_frame, float, data_start };
            if !all.contains(&stride) && all.len() < CANDIDATES_MAX {
                all.push(stride);
            }
        }
    }
    all
}

/// A point of a frame: coordinates and fourth word.
type StoredPoint = [f64; 4];

/// The points in a range of frames, frame by frame: `points` of them, evenly spread; `None` at the origin.
fn window(
    file: &mut FileBytes<'_, '_>,
    stride: &Stride,
    frames: Range<usize>,
    points: usize,
) -> io::Result<Vec<Option<StoredPoint>>> {
    let mut window = Vec::with_capacity(frames.len() * points);
    let (order, width) = (file.order, stride.word_bytes());
    let mut stored = [0; 4 * size_of::<f32>()];
    for frame in frames {
        for index in 0..points {
            let point = index * stride.n_points.saturating_sub(1) / (points - 1).max(1);
            let at = stride.data_start + frame * stride.frame_bytes() + 4 * point * width;
            let n_read = file.source.read_some(at as u64, &mut stored[..4 * width])?;
            let stored = &stored[..n_read];
            let word = |word: usize| {
                if stride.float {
                    order.float_at(stored, word * width).map(f64::from)
                } else {
                    order.word_at(stored, word * width).map(|word| f64::from(word as i16))
                }
            };
            let [x, y, z, fourth] = [0, 1, 2, 3].map(word);
            let sample = x.zip(y).zip(z).zip(fourth).map(|(((x, y), z), fourth)| [x, y, z, fourth]);
            window.push(sample.filter(|sample| sample[..3] != [0.0; 3]));
        }
    }
    Ok(window)
}

/// The roughness of the motion read with a stride: the mean change of a coordinate's velocity from frame to frame as a
/// share of the range of coordinates (0 for constant velocity, 1 for changes as large as the range), plus the share of
/// invalid fourth words. `None` if no point has positions in three successive frames, or if all coordinates are equal.
fn roughness(
    file: &mut FileBytes<'_, '_>,
    stride: &Stride,
    n_frames: usize,
) -> io::Result<Option<f64>> {
    let n_points = stride.n_points.min(POINTS);
    let n_window = n_frames.min(WINDOW_FRAMES);
    let n_windows = if n_frames > n_window { WINDOWS } else { 1 };
    let is_invalid = |v: f64| v != 0.0 && !(COORDINATE_MIN..=COORDINATE_MAX).contains(&v.abs());
    let mut values = Vec::new();
    let mut changes = Vec::new();
    let (mut fourth_words, mut odd_words, mut odd_changes) = (0usize, 0usize, 0usize);
    for number in 0..n_windows {
        let first = (n_frames - n_window) * number / (n_windows - 1).max(1);
        let window = window(file, stride, first..first + n_window, n_points)?;
        for index in 0..n_points {
            let mut before: [Option<StoredPoint>; 2] = [None, None];
            for &now in window.iter().skip(index).step_by(n_points) {
                if let Some([x, y, z, fourth]) = now {
                    fourth_words += 1;
                    odd_words += usize::from(is_invalid(fourth) || (stride.float && fourth < -1.0));
                    values.extend([x, y, z].into_iter().filter(|&v| !is_invalid(v)));
                }
                if let ([Some(a), Some(b)], Some(c)) = (before, now) {
                    for axis in 0..3 {
                        let three = [a[axis], b[axis], c[axis]];
                        if three.iter().any(|&v| is_invalid(v)) {
                            odd_changes += 1;
                        } else {
                            changes.push((three[0] - 2.0 * three[1] + three[2]).abs());
                        }
                    }
                }
                before = [before[1], now];
            }
        }
    }
    let n_changes = changes.len() + odd_changes;
    if n_changes == 0 {
        return Ok(None);
    }
    values.sort_by(f64::total_cmp);
    let share = |part: usize| values.get(part * values.len() / 20).copied().unwrap_or(0.0);
    let span = share(19) - share(1);
    if span <= 0.0 && odd_changes == 0 {
        return Ok(None);
    }
    let rough = changes.iter().map(|change| (change / span.max(f64::MIN_POSITIVE)).min(1.0));
    let mean = (rough.sum::<f64>() + odd_changes as f64) / n_changes as f64;
    Ok(Some(mean + odd_words as f64 / fourth_words.max(1) as f64))
}
