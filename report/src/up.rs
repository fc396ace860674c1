//! Which way is up in a picture: one answer for all pictures of a take.

use mocapd_take::motion::Motion;

use crate::column::{Vector, sample};

/// Frames that are looked at where the take does not say what is up, evenly spread.
const FRAMES: usize = 64;

/// An axis, and which way along it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Up {
    /// 0, 1 or 2.
    pub axis: usize,
    /// 1, or -1 where the axis points down.
    pub sign: f64,
}

impl Up {
    /// What the take says, else the way that the top of a face points, else the axis along which its markers lie farthest
    /// apart: a body is taller than wide.
    #[must_use]
    pub fn of(motion: &Motion, top_of_face: Option<Vector>) -> Self {
        if let Some(axis) = motion.info.up.index() {
            return Self { axis, sign: 1.0 };
        }
        match top_of_face {
            Some(top) => {
                let axis = largest(top.map(f64::abs));
                Self { axis, sign: top[axis].signum() }
            }
            None => Self { axis: largest(extents(motion)), sign: 1.0 },
        }
    }

    /// How far up a position is.
    #[must_use]
    pub fn height(self, at: Vector) -> f64 {
        self.sign * at[self.axis]
    }
}

/// The axis with the largest value; of equal ones the last.
fn largest(values: [f64; 3]) -> usize {
    (0..3).max_by(|&a, &b| values[a].total_cmp(&values[b])).unwrap_or(2)
}

/// How far apart the markers of a frame lie along each axis, summed over frames.
fn extents(motion: &Motion) -> [f64; 3] {
    let step = motion.n_frames().div_ceil(FRAMES).max(1);
    let extent = |row: usize, axis: usize| {
        let values = motion.frame(row).iter().filter_map(|&at| Some(sample(at)?[axis]));
        let (low, high) = values.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        (high - low).max(0.0)
    };
    let rows = || (0..motion.n_frames()).step_by(step);
    std::array::from_fn(|axis| rows().map(|row| extent(row, axis)).sum())
}

#[cfg(test)]
mod tests {
    use mocapd_take::motion::{Marker, MotionInfo, UpAxis};

    use super::*;

    fn motion(up: UpAxis, frame: [[f32; 3]; 2]) -> Motion {
        let markers = ["a", "b"].map(|label| Marker { label: label.to_owned(), labelled: true });
        let info = MotionInfo {
            rate_hz: 100.0,
            n_frames: 1,
            markers: markers.to_vec(),
            up,
            ..Default::default()
        };
        Motion { info, positions_mm: frame.to_vec() }
    }

    #[test]
    fn the_take_counts_most_then_a_face_then_the_tallest_axis() {
        let tall = [[0.0; 3], [100.0, 1700.0, 300.0]];
        let up = |axis, sign| Up { axis, sign };
        assert_eq!(Up::of(&motion(UpAxis::Z, tall), Some([0.0, 1.0, 0.0])), up(2, 1.0));
        assert_eq!(Up::of(&motion(UpAxis::Unknown, tall), Some([-1.0, 0.2, 0.1])), up(0, -1.0));
        assert_eq!(Up::of(&motion(UpAxis::Unknown, tall), None), up(1, 1.0));
        assert_eq!(Up::of(&motion(UpAxis::Unknown, [[0.0; 3]; 2]), None), up(2, 1.0));
    }
}
