//! Resamples a motion to another rate, one frame at a time, without storing the result.

use std::sync::Arc;

use mocapd_take::motion::{GAP, Motion, Position, is_gap};

/// A motion, sampled in steps of a fraction of its own frames.
///
/// Positions between recorded frames are interpolated (Catmull-Rom). A frame that coincides with a recorded one
/// equals it bit for bit. Where one of the two enclosing samples is missing, the result is a gap.
#[derive(Debug, Clone)]
pub struct Replay {
    motion: Arc<Motion>,
    /// Recorded frames per step, as an exact fraction.
    step: (u64, u64),
}

impl Replay {
    /// Plays every recorded frame unchanged.
    #[must_use]
    pub fn native(motion: Arc<Motion>) -> Self {
        Self { motion, step: (1, 1) }
    }

    /// Resamples from the `recorded` to the `wanted` rate, both in the same unit (the device uses millihertz). `None`
    /// when either is 0.
    #[must_use]
    pub fn resampled(motion: Arc<Motion>, recorded: u64, wanted: u64) -> Option<Self> {
        (recorded > 0 && wanted > 0).then_some(Self { motion, step: (recorded, wanted) })
    }

    /// The recorded motion.
    #[must_use]
    pub fn motion(&self) -> &Arc<Motion> {
        &self.motion
    }

    /// Number of resampled frames from the first recorded one to the last.
    #[must_use]
    pub fn n_frames(&self) -> u64 {
        let Some(last) = (self.motion.n_frames() as u64).checked_sub(1) else { return 0 };
        let (num, den) = self.step;
        let steps = u128::from(last) * u128::from(den) / u128::from(num);
        u64::try_from(steps).unwrap_or(u64::MAX - 1) + 1
    }

    /// Replaces `row` by one frame, with one position per marker, in millimetres; empty past the end.
    pub fn frame(&self, index: u64, row: &mut Vec<Position>) {
        row.clear();
        let (num, den) = (u128::from(self.step.0), u128::from(self.step.1));
        let at = u128::from(index) * num;
        if index >= self.n_frames() {
            return;
        }
        let before = (at / den) as usize;
        let part = at % den;
        if part == 0 {
            row.extend_from_slice(self.motion.frame(before));
        } else {
            between(&self.motion, before, part as f64 / den as f64, row);
        }
    }
}

/// Appends every marker's position between frame `before` and the next, at the fraction `part` in (0, 1).
fn between(motion: &Motion, before: usize, part: f64, row: &mut Vec<Position>) {
    let here = motion.frame(before);
    let next = motion.frame(before + 1);
    let earlier = before.checked_sub(1).map_or(&[][..], |i| motion.frame(i));
    let later = motion.frame(before + 2);
    for (marker, &p1) in here.iter().enumerate() {
        let get = |frame: &[Position]| frame.get(marker).copied().filter(|p| !is_gap(*p));
        row.push(match get(next) {
            Some(p2) if !is_gap(p1) => cubic(get(earlier), p1, p2, get(later), part),
            _ => GAP,
        });
    }
}

/// The cubic between `p1` and `p2` whose slopes are the chords of their neighbours.
///
/// Catmull and Rom, "A class of local interpolating splines", 1974; Hermite form. Next to a gap the slope is that of
/// the segment itself, which gives a parabola, or a line between two gaps.
fn cubic(
    p0: Option<Position>,
    p1: Position,
    p2: Position,
    p3: Option<Position>,
    x: f64,
) -> Position {
    let mut out = [0.0; 3];
    for (axis, value) in out.iter_mut().enumerate() {
        let at = |p: Position| f64::from(p[axis]);
        let (a, b) = (at(p1), at(p2));
        let from = p0.map_or(b - a, |p| 0.5 * (b - at(p)));
        let to = p3.map_or(b - a, |p| 0.5 * (at(p) - a));
        let d = b - a;
        let (c2, c3) = (3.0 * d - 2.0 * from - to, from + to - 2.0 * d);
        *value = (a + x * (from + x * (c2 + x * c3))) as f32;
    }
    out
}

#[cfg(test)]
mod tests {
    use crate::generator::JumpSpec;
    use mocapd_take::motion::{GAP, Marker, MotionInfo, is_gap};
    use proptest::prelude::*;

    use super::*;

    /// All resampled frames as a motion of rate `rate_hz`.
    fn to_motion(replay: &Replay, rate_hz: f64) -> Motion {
        let mut out = Motion { info: replay.motion.info.clone(), positions_mm: Vec::new() };
        let mut row = Vec::new();
        for index in 0..replay.n_frames() {
            replay.frame(index, &mut row);
            out.positions_mm.extend_from_slice(&row);
        }
        out.info.rate_hz = rate_hz;
        out.info.n_frames = replay.n_frames();
        out
    }

    fn line(samples: &[Position]) -> Arc<Motion> {
        let markers = vec![Marker { label: "m".to_owned(), labelled: true }];
        let n_frames = samples.len() as u64;
        let info = MotionInfo { rate_hz: 60.0, n_frames, markers, ..MotionInfo::default() };
        Arc::new(Motion { info, positions_mm: samples.to_vec() })
    }

    fn at(x: f32) -> Position {
        [x, 2.0 * x, -x]
    }

    #[test]
    fn coinciding_frames_are_bit_equal() {
        let motion = Arc::new(JumpSpec::new(2, 60.0).generate().unwrap().motion);
        let replay = Replay::resampled(Arc::clone(&motion), 60_000, 240_000).unwrap();
        assert_eq!(replay.n_frames(), (motion.n_frames() as u64 - 1) * 4 + 1);
        let mut row = Vec::new();
        for k in 0..motion.n_frames() {
            replay.frame(4 * k as u64, &mut row);
            assert_eq!(row, motion.frame(k));
        }
        // Down again by the same factor gives the recording.
        let up = Arc::new(to_motion(&replay, 240.0));
        let down = to_motion(&Replay::resampled(up, 240_000, 60_000).unwrap(), 60.0);
        assert_eq!(down, *motion);
    }

    #[test]
    fn interpolation_follows_smooth_motion() {
        let fine = Arc::new(JumpSpec::new(2, 480.0).clean().generate().unwrap().motion);
        let coarse = to_motion(&Replay::resampled(Arc::clone(&fine), 480, 120).unwrap(), 120.0);
        let again = Replay::resampled(Arc::new(coarse), 120, 480).unwrap();
        let mut row = Vec::new();
        let mut worst = 0.0f32;
        for k in 0..again.n_frames() {
            again.frame(k, &mut row);
            for (a, b) in row.iter().zip(fine.frame(k as usize)) {
                for axis in 0..3 {
                    worst = worst.max((a[axis] - b[axis]).abs());
                }
            }
        }
        // Linear interpolation would miss by acceleration * dt^2 / 8 = 1 mm at 130 m/s^2.
        assert!(worst < 0.35, "{worst} mm");
    }

    #[test]
    fn gaps_stay_gaps_and_do_not_grow() {
        let motion = line(&[at(0.0), at(1.0), at(2.0), GAP, at(4.0), at(5.0), at(6.0)]);
        let replay = Replay::resampled(motion, 1, 2).unwrap();
        let mut row = Vec::new();
        let mut seen = Vec::new();
        for k in 0..replay.n_frames() {
            replay.frame(k, &mut row);
            seen.push(if is_gap(row[0]) { None } else { Some(row[0][0]) });
        }
        // Only frames next to the missing sample are gaps, and a straight line stays straight up to the gap.
        let expected = [0.0, 0.5, 1.0, 1.5, 2.0, -1.0, -1.0, -1.0, 4.0, 4.5, 5.0, 5.5, 6.0];
        let expected: Vec<_> = expected.map(|x| (x >= 0.0).then_some(x)).to_vec();
        assert_eq!(seen, expected);
    }

    #[test]
    fn motions_of_zero_frames_and_of_one() {
        let empty = Replay::native(line(&[]));
        assert_eq!(empty.n_frames(), 0);
        let one = Replay::resampled(line(&[at(3.0)]), 60, 999).unwrap();
        assert_eq!(one.n_frames(), 1);
        let mut row = Vec::new();
        one.frame(1, &mut row);
        assert!(row.is_empty());
        assert!(Replay::resampled(line(&[]), 0, 1).is_none());
    }

    proptest! {
        #[test]
        fn any_rate_ends_at_or_before_the_last_frame(n in 1u32..50, from in 1u64..20_000, to in 1u64..20_000) {
            let samples: Vec<_> = (0..n).map(|i| at(i as f32)).collect();
            let replay = Replay::resampled(line(&samples), from, to).unwrap();
            let mut row = Vec::new();
            replay.frame(replay.n_frames() - 1, &mut row);
            prop_assert_eq!(row.len(), 1);
            let x = (replay.n_frames() - 1) as f64 * from as f64 / to as f64;
            prop_assert!((f64::from(row[0][0]) - x).abs() < 1e-3);
            replay.frame(replay.n_frames(), &mut row);
            prop_assert!(row.is_empty());
        }
    }
}
