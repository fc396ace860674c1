//! The up direction in plots, the same for all plots of a take.

use mocapd_take::motion::Motion;

use crate::column::{Vector, sample};

/// Number of frames that are sampled, evenly spread, if the take does not state its up axis.
const FRAMES: usize = 64;

/// The up direction: an axis and its sign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Up {
    /// 0, 1 or 2 for x, y or z.
    pub axis: usize,
    /// 1, or -1 if the axis points down.
    pub sign: f64,
}

impl Up {
    /// The up axis that the take states; else the axis nearest to `top_of_face`, a direction; else the axis along which
    /// the markers spread most, since a body is taller than wide.
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

    /// The height of a position, mm.
    #[must_use]
    pub fn height(self, at: Vector) -> f64 {
        self.sign * at[self.axis]
    }
}

/// The index of the largest value; the last one of equal values.
fn largest(values: [f64; 3]) -> usize {
    (0..3).max_by(|&a, &b| values[a].total_cmp(&values[b])).unwrap_or(2)
}

/// The extent of the markers of a frame along each axis, summed over frames.
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
    fn the_stated_axis_precedes_the_face_and_the_face_the_tallest_axis() {
        let tall = [[0.0; 3], [100.0, 1700.0, 300.0]];
        let up = |axis, sign| Up { axis, sign };
        assert_eq!(Up::of(&motion(UpAxis::Z, tall), Some([0.0, 1.0, 0.0])), up(2, 1.0));
        assert_eq!(Up::of(&motion(UpAxis::Unknown, tall), Some([-1.0, 0.2, 0.1])), up(0, -1.0));
        assert_eq!(Up::of(&motion(UpAxis::Unknown, tall), None), up(1, 1.0));
        assert_eq!(Up::of(&motion(UpAxis::Unknown, [[0.0; 3]; 2]), None), up(2, 1.0));
    }
}
