//! Which way a body or a face is looked at, and how large it is drawn.

use super::{Pose, ROW, WIDTH, seen};
use crate::{column::Vector, up::Up};

/// How a body becomes lines on the sheet.
pub(super) struct View {
    pub(super) across: Direction,
    pub(super) up: Up,
    /// Units of the sheet to a millimetre.
    pub(super) scale: f64,
    /// Lowest height of all, mm.
    pub(super) floor_mm: f64,
}

/// An axis, or the other way along it.
#[derive(Clone, Copy)]
pub(super) struct Direction {
    axis: usize,
    sign: f64,
}

impl Direction {
    /// The axis that a direction is nearest to, but for one.
    fn nearest(direction: Vector, but: Option<usize>) -> Option<Self> {
        let axes = (0..3).filter(|&axis| Some(axis) != but);
        let axis = axes.max_by(|&a, &b| direction[a].abs().total_cmp(&direction[b].abs()))?;
        Some(Self { axis, sign: direction[axis].signum() })
    }

    pub(super) fn of(self, at: Vector) -> f64 {
        self.sign * at[self.axis]
    }
}

impl View {
    pub(super) fn of(wanted: &Pose<'_>) -> Option<Self> {
        let motion = &wanted.coded.motion;
        let axis = |axis: usize| Direction { axis, sign: 1.0 };
        let up = wanted.up;
        let face =
            |moment: usize| wanted.faces.get(moment).into_iter().flatten().flatten().copied();
        let of_moment = |(moment, &row): (usize, &usize)| {
            let markers = seen(motion, row).map(|(_, at)| at);
            markers.chain(face(moment)).collect()
        };
        let moments: Vec<Vec<Vector>> = wanted.rows.iter().enumerate().map(of_moment).collect();
        // From the side on which the body is seen best: where it goes, or else where it is wide.
        let spread = |axis: usize| {
            let values = moments.iter().flatten().map(|at| at[axis]);
            let (low, high) = values.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
            high - low
        };
        let across = match wanted.front {
            Some([left, _]) => Direction::nearest(left, Some(up.axis))?,
            None => axis(
                (0..3)
                    .filter(|&axis| axis != up.axis)
                    .max_by(|&a, &b| spread(a).total_cmp(&spread(b)))?,
            ),
        };
        let floor_mm = moments.iter().flatten().map(|&at| up.height(at)).reduce(f64::min)?;
        let high_mm = moments.iter().flatten().map(|&at| up.height(at)).reduce(f64::max)?;
        let wide_mm = moments
            .iter()
            .filter_map(|points| {
                let middle = middle(points, across)?;
                points.iter().map(|&at| 2.0 * (across.of(at) - middle).abs()).reduce(f64::max)
            })
            .fold(1.0, f64::max);
        let cell = f64::from(WIDTH - 120) / wanted.rows.len() as f64;
        let scale =
            ((f64::from(ROW) - 60.0) / (high_mm - floor_mm).max(1.0)).min(0.94 * cell / wide_mm);
        Some(Self { across, up, scale, floor_mm })
    }
}

pub(super) fn middle(points: &[Vector], along: Direction) -> Option<f64> {
    let values = || points.iter().map(|&at| along.of(at));
    Some(0.5 * (values().reduce(f64::min)? + values().reduce(f64::max)?))
}
