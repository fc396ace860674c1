//! How long a frame is, where header, parameters and the number of bytes disagree about it.
//!
//! The number of points is stated by POINT:USED and by the header, the number of analog samples a frame by the header
//! and by ANALOG:USED times ANALOG:RATE over POINT:RATE. Every combination is a candidate. A candidate accounts for the
//! bytes when its frames fill them up to the padding of the last block, and it is smooth when coordinates go on from
//! frame to frame: a wrong stride reads another marker, or another coordinate, in every frame.

use super::header::{BLOCK, ByteOrder};

/// Most candidates that are compared: the places that state something give at most 2 * 2 * 2 * 8 of them, the file's
/// size some more for short files, where several strides leave less than a block.
pub(super) const CANDIDATES_MAX: usize = 256;
/// Frames in a row that are looked at together, and how many such windows are spread over the file.
const WINDOW_FRAMES: usize = 24;
const WINDOWS: usize = 4;
/// Points of a frame that are looked at, evenly spread.
const POINTS: usize = 48;
/// Largest roughness of motion: coordinates that change their velocity by a seventh of all they span in each frame are
/// read at a wrong stride. Human motion at 10 Hz stays below a tenth.
const ROUGHNESS_MAX: f64 = 0.15;
/// A reading this many times as rough as the smoothest one is a wrong one: neighbouring markers of one body are near
/// each other, so that a stride which is wrong by one point is only ten times as rough.
const ROUGHER: f64 = 4.0;
/// Roughness below which readings are equally smooth.
const SMOOTH: f64 = 0.01;
/// Larger coordinates, in the file's unit, are no positions: a thousand kilometres in mm.
const COORDINATE_MAX: f64 = 1e6;
/// Smaller ones are other numbers read as floats.
const COORDINATE_MIN: f64 = 1e-30;

/// One way to cut the data section into frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stride {
    /// Points a frame.
    pub(super) n_points: usize,
    /// Analog samples a frame, all channels together.
    pub(super) analog_per_frame: usize,
    /// Whether samples are floats.
    pub(super) float: bool,
    /// Offset of the first frame in the file.
    pub(super) data_start: usize,
}

impl Stride {
    /// Bytes of a sample word.
    pub(super) fn word_bytes(&self) -> usize {
        if self.float { 4 } else { 2 }
    }

    /// Bytes of a frame.
    pub(super) fn frame_bytes(&self) -> usize {
        (4 * self.n_points + self.analog_per_frame) * self.word_bytes()
    }
}

/// How a number of frames fits the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fit {
    /// They fill them, but for less than a block, or for zeros.
    Exact,
    /// More than a block is left.
    Surplus,
    /// There are fewer bytes.
    Short,
}

/// A file, and where its zeros at the end begin: found once, however many strides are tried.
#[derive(Debug, Clone, Copy)]
pub(super) struct FileBytes<'a> {
    pub(super) bytes: &'a [u8],
    order: ByteOrder,
    filled: usize,
}

impl<'a> FileBytes<'a> {
    pub(super) fn new(bytes: &'a [u8], order: ByteOrder) -> Self {
        let filled = bytes.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
        Self { bytes, order, filled }
    }

    /// Bytes from the first frame on.
    pub(super) fn available(&self, stride: &Stride) -> usize {
        self.bytes.len().saturating_sub(stride.data_start)
    }

    /// Whole frames that are there.
    pub(super) fn present(&self, stride: &Stride) -> usize {
        self.available(stride).checked_div(stride.frame_bytes()).unwrap_or(0)
    }

    /// How many frames of a stride fit.
    pub(super) fn fit(&self, stride: &Stride, n_frames: u64) -> Fit {
        let needed = usize::try_from(n_frames).unwrap_or(usize::MAX);
        let needed = needed.saturating_mul(stride.frame_bytes());
        match self.available(stride).checked_sub(needed) {
            None => Fit::Short,
            Some(left) if left < BLOCK || stride.data_start + needed >= self.filled => Fit::Exact,
            Some(_) => Fit::Surplus,
        }
    }
}

/// A stride with the frames that it gives, and how well it suits the file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    pub(super) stride: Stride,
    fit: Fit,
    /// `None` where there is nothing to judge by.
    roughness: Option<f64>,
    /// Whether a place in the file states it: else it follows from the number of bytes alone.
    is_stated: bool,
}

impl Candidate {
    pub(super) fn new(
        file: &FileBytes<'_>,
        stride: Stride,
        n_frames: u64,
        is_stated: bool,
    ) -> Self {
        let n_read = file.present(&stride).min(usize::try_from(n_frames).unwrap_or(usize::MAX));
        Self {
            stride,
            fit: file.fit(&stride, n_frames),
            roughness: roughness(file, &stride, n_read),
            is_stated,
        }
    }

    /// Whether its frames fill the bytes.
    pub(super) fn accounts(&self) -> bool {
        self.fit == Fit::Exact
    }

    /// Whether coordinates go on from frame to frame, beside the smoothest reading of all.
    fn is_smooth(&self, smoothest: f64) -> Option<bool> {
        let roughness = self.roughness?;
        Some(roughness <= ROUGHNESS_MAX && roughness <= (ROUGHER * smoothest).max(SMOOTH))
    }

    /// Whether nothing speaks against it, with no other reading to compare with.
    pub(super) fn is_plausible(&self) -> bool {
        self.accounts() && self.may_be_motion()
    }

    /// Whether there are fewer bytes than its frames need.
    pub(super) fn is_short(&self) -> bool {
        self.fit == Fit::Short
    }

    /// Whether nothing speaks against the only reading that is stated: it accounts for the bytes, or the file is only
    /// shorter and motion goes on. A few frames tell nothing of motion, markers may jump, and analog samples be smooth.
    pub(super) fn is_uncontradicted(&self) -> bool {
        self.accounts() || self.is_short() && self.may_be_motion()
    }

    /// Whether coordinates go on from frame to frame, or are too few to tell.
    fn may_be_motion(&self) -> bool {
        self.roughness.is_none_or(|roughness| roughness <= ROUGHNESS_MAX)
    }

    /// Whether coordinates go on so much better than in another reading that the other one is wrong.
    pub(super) fn is_much_smoother(&self, other: &Self) -> bool {
        let measured = self.roughness.zip(other.roughness);
        measured.is_some_and(|(roughness, other)| ROUGHER * roughness < other)
    }

    /// Whether coordinates go on from the first frame, which is a frame in every reading: where a wrong one finds smooth
    /// analog samples everywhere else, it does not.
    pub(super) fn begins_smoothly(&self, file: &FileBytes<'_>) -> bool {
        let roughness = roughness(file, &self.stride, file.present(&self.stride).min(3));
        roughness.is_some_and(|roughness| roughness <= ROUGHNESS_MAX)
    }

    /// The order in which readings are taken; `None` for one that nothing speaks for.
    fn tier(&self, smoothest: f64) -> Option<u8> {
        match (self.accounts(), self.is_smooth(smoothest), self.is_stated) {
            (true, Some(true), _) => Some(0),
            (true, None, true) => Some(1),
            (false, Some(true), true) => Some(2),
            (true, Some(false), true) => Some(3),
            _ => None,
        }
    }
}

/// The reading to take, of candidates in order of preference. `None` when none accounts for the bytes or keeps motion
/// continuous.
pub(super) fn choose(candidates: &[Candidate]) -> Option<Candidate> {
    let smoothest = candidates.iter().filter_map(|candidate| candidate.roughness);
    let smoothest = smoothest.fold(f64::INFINITY, f64::min);
    let tier = candidates.iter().filter_map(|candidate| candidate.tier(smoothest)).min()?;
    let mut best: Option<&Candidate> = None;
    for candidate in candidates.iter().filter(|c| c.tier(smoothest) == Some(tier)) {
        let rough = |candidate: &Candidate| candidate.roughness.unwrap_or(0.0);
        let is_better = best
            .is_none_or(|best| rough(candidate) < rough(best) / 2.0 && rough(best) > SMOOTH / 10.0);
        if is_better {
            best = Some(candidate);
        }
    }
    best.copied()
}

/// Strides that leave less than a block of the bytes when there are `n_frames` frames of `n_points` points.
pub(super) fn by_size(
    file: &FileBytes<'_>,
    of: Stride,
    n_frames: u64,
    n_channels: Option<u64>,
) -> impl Iterator<Item = Stride> + use<> {
    let available = file.available(&of);
    let width = of.word_bytes();
    let n_frames = usize::try_from(n_frames).unwrap_or(usize::MAX).max(1);
    let most = available / width / n_frames;
    let least = (available.saturating_sub(BLOCK - 1)).div_ceil(width).div_ceil(n_frames);
    let words = (least..=most).rev().take(CANDIDATES_MAX);
    words.filter_map(move |words| {
        let analog = words.checked_sub(4 * of.n_points)?;
        let whole = match n_channels {
            Some(0) => analog == 0,
            Some(n) => usize::try_from(n).is_ok_and(|n| analog.is_multiple_of(n)),
            None => true,
        };
        whole.then_some(Stride { analog_per_frame: analog, ..of })
    })
}

/// Every combination of what the places in a file state, the preferred first, none twice.
pub(super) fn combine(
    points: &[u64],
    analog: &[u64],
    floats: &[bool],
    starts: &[usize],
) -> Vec<Stride> {
    let count = |n: u64| usize::try_from(n.min(1 << 32)).unwrap_or(usize::MAX);
    let mut all: Vec<Stride> = Vec::new();
    for (&data_start, &float) in
        starts.iter().flat_map(|start| floats.iter().map(move |float| (start, float)))
    {
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

/// How much the velocity of a coordinate changes from frame to frame, as a share of what coordinates span, in the mean
/// (0: not at all; 1: by all of it), and the share of fourth words that are none. `None` where fewer than three frames
/// in a row have positions, or all coordinates are the same.
fn roughness(file: &FileBytes<'_>, stride: &Stride, n_frames: usize) -> Option<f64> {
    let word = |frame: usize, word: usize| {
        let at = stride.data_start + frame * stride.frame_bytes() + word * stride.word_bytes();
        if stride.float {
            file.order.float_at(file.bytes, at).map(f64::from)
        } else {
            file.order.word_at(file.bytes, at).map(|word| f64::from(word as i16))
        }
    };
    let n_points = stride.n_points.min(POINTS);
    let window = n_frames.min(WINDOW_FRAMES);
    let n_windows = if n_frames > window { WINDOWS } else { 1 };
    let is_none = |v: f64| {
        !v.is_finite() || v.abs() > COORDINATE_MAX || (v != 0.0 && v.abs() < COORDINATE_MIN)
    };
    let mut values = Vec::new();
    let mut changes = Vec::new();
    let (mut fourth_words, mut odd_words, mut odd_changes) = (0usize, 0usize, 0usize);
    for number in 0..n_windows {
        let first = (n_frames - window) * number / (n_windows - 1).max(1);
        for index in 0..n_points {
            let point = index * stride.n_points.saturating_sub(1) / (n_points - 1).max(1);
            let sample = |frame: usize| -> Option<[f64; 4]> {
                let mut sample = [0.0; 4];
                for (axis, value) in sample.iter_mut().enumerate() {
                    *value = word(frame, 4 * point + axis)?;
                }
                (sample[..3] != [0.0; 3]).then_some(sample)
            };
            let mut before: [Option<[f64; 4]>; 2] = [None, None];
            for frame in first..first + window {
                let now = sample(frame);
                if let Some([x, y, z, fourth]) = now {
                    fourth_words += 1;
                    odd_words += usize::from(is_none(fourth) || (stride.float && fourth < -1.0));
                    values.extend([x, y, z].into_iter().filter(|&v| !is_none(v)));
                }
                if let ([Some(a), Some(b)], Some(c)) = (before, now) {
                    for axis in 0..3 {
                        let three = [a[axis], b[axis], c[axis]];
                        if three.iter().any(|&v| is_none(v)) {
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
        return None;
    }
    values.sort_by(f64::total_cmp);
    let share = |part: usize| values.get(part * values.len() / 20).copied().unwrap_or(0.0);
    let span = share(19) - share(1);
    if span <= 0.0 && odd_changes == 0 {
        return None;
    }
    let rough: f64 =
        changes.iter().map(|change| (change / span.max(f64::MIN_POSITIVE)).min(1.0)).sum();
    let mean = (rough + odd_changes as f64) / n_changes as f64;
    Some(mean + odd_words as f64 / fourth_words.max(1) as f64)
}
