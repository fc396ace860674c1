//! How many frames a file announces, and which of them is the first.

use super::header::{BLOCK, Header};
use super::layout::as_count;
use super::parameters::Parameters;
use super::stride::{FileBytes, Fit, Stride};

/// Largest value of a word: where a count is this, it may have been larger.
const SATURATED: u64 = 65535;

/// A number of frames, and which place states it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FrameCount {
    pub(super) n_frames: u64,
    place: Option<Place>,
}

/// Where a number of frames is stated, the most trusted first: the first three can say more than 16 bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    Trial,
    LongFrames,
    Frames,
    Header,
    /// By the bytes present, where 16 bits are not enough and nothing wider is there.
    Size,
}

impl Place {
    fn name(self) -> &'static str {
        match self {
            Self::Trial => "TRIAL:ACTUAL_END_FIELD",
            Self::LongFrames => "POINT:LONG_FRAMES",
            Self::Frames => "POINT:FRAMES",
            Self::Header => "the header",
            Self::Size => "the file's size",
        }
    }
}

/// Every count that a file states.
pub(super) struct FrameCounts {
    stated: Vec<(Place, u64)>,
    trial_start: Option<u64>,
    header_first: u64,
    header_last: u64,
    /// Whether nothing wider than 16 bits states the count.
    is_narrow: bool,
}

impl FrameCounts {
    pub(super) fn of(header: &Header, parameters: &Parameters) -> Self {
        let field = |name: &str| match parameters.get("TRIAL", name)?.words()[..] {
            [low] => Some(u64::from(low)),
            [low, high, ..] => Some(u64::from(low) | u64::from(high) << 16),
            [] => None,
        };
        let trial_start = field("ACTUAL_START_FIELD");
        let trial =
            trial_start.zip(field("ACTUAL_END_FIELD")).and_then(|(s, e)| (e + 1).checked_sub(s));
        let count = |name: &str| parameters.number("POINT", name).and_then(as_count);
        let (first, last) = (u64::from(header.first_frame), u64::from(header.last_frame));
        let stated = [
            (Place::Trial, trial),
            (Place::LongFrames, count("LONG_FRAMES")),
            (Place::Frames, count("FRAMES")),
            (Place::Header, (last + 1).checked_sub(first)),
        ];
        let stated = stated.into_iter();
        let has = |group: &str, name: &str| parameters.get(group, name).is_some();
        Self {
            stated: stated.filter_map(|(place, n)| Some((place, n.filter(|&n| n > 0)?))).collect(),
            trial_start,
            header_first: first,
            header_last: last,
            is_narrow: !has("POINT", "LONG_FRAMES") && !has("TRIAL", "ACTUAL_END_FIELD"),
        }
    }

    /// Every count, each once.
    pub(super) fn all(&self) -> Vec<u64> {
        let mut all: Vec<u64> = self.stated.iter().map(|&(_, n)| n).collect();
        all.sort_unstable();
        all.dedup();
        all
    }

    /// The count for frames of a stride: the most trusted one that accounts for the bytes, else the most trusted one
    /// that they can hold, else the most trusted one.
    pub(super) fn of_stride(&self, file: &FileBytes<'_>, stride: &Stride) -> FrameCount {
        let fits = |wanted: &dyn Fn(Fit) -> bool| {
            self.stated.iter().find(|&&(_, n)| wanted(file.fit(stride, n)))
        };
        let found = fits(&|fit| fit == Fit::Exact);
        let is_saturated = self.is_narrow && self.header_last == SATURATED;
        if found.is_none() && is_saturated {
            // What the padding of the last block has room for may be no frames.
            let n_frames =
                file.present(stride).saturating_sub((BLOCK - 1) / stride.frame_bytes().max(1))
                    as u64;
            if self.stated.iter().all(|&(_, n)| n < n_frames) {
                return FrameCount { n_frames, place: Some(Place::Size) };
            }
        }
        let found = found.or_else(|| fits(&|fit| fit != Fit::Short)).or(self.stated.first());
        match found {
            Some(&(place, n_frames)) => FrameCount { n_frames, place: Some(place) },
            None => FrameCount { n_frames: 0, place: None },
        }
    }

    /// The number of the first frame: the one of the TRIAL group where its count was taken.
    pub(super) fn first_frame(&self, taken: &FrameCount) -> u64 {
        let trial = self.stated.iter().find(|(place, _)| *place == Place::Trial);
        match (self.trial_start, trial) {
            (Some(start), Some(&(_, n))) if n == taken.n_frames => start,
            _ => self.header_first,
        }
    }

    /// Says where the places disagree.
    pub(super) fn report(&self, taken: &FrameCount, warnings: &mut Vec<String>) {
        let n_frames = taken.n_frames;
        let Some(place) = taken.place else {
            warnings.push("The number of frames is stated nowhere.".to_owned());
            return;
        };
        if place == Place::Size {
            warnings.push(format!(
                "The number of frames does not fit its 16-bit field; {n_frames} whole frames are present."
            ));
            return;
        }
        for &(other, n) in &self.stated {
            // A 16-bit field that says 65535, or the count modulo 65536, agrees as well as it can.
            let agrees = n == n_frames
                || n_frames > SATURATED && (n == SATURATED || n == n_frames & 0xFFFF)
                || other == Place::Header && self.header_last == SATURATED && n < n_frames;
            if !agrees {
                warnings.push(format!(
                    "{} says {n} frames, {} {n_frames}; {n_frames} was taken.",
                    other.name(),
                    place.name()
                ));
            }
        }
    }
}
