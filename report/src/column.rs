//! The samples of one marker, from trajectories that are stored frame by frame.

use std::ops::Range;

use mocapd_take::motion::{Motion, Position, is_gap};

/// A position in f64, millimetres.
pub type Vector = [f64; 3];

/// The positions of one marker in every frame of a take; `None` in gaps.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Column(pub Vec<Option<Vector>>);

impl Column {
    /// The marker in column `marker` of `motion`.
    #[must_use]
    pub fn of(motion: &Motion, marker: usize) -> Self {
        let sample = |frame| motion.frame(frame).get(marker).copied().and_then(sample);
        Self((0..motion.n_frames()).map(sample).collect())
    }

    /// The mean of several columns, row by row; `None` where one of them is.
    #[must_use]
    pub fn mean(columns: &[Self]) -> Self {
        let n_rows = columns.iter().map(|column| column.0.len()).min().unwrap_or(0);
        let mean = |row: usize| {
            let mut sum = [0.0; 3];
            for column in columns {
                let at = column.0[row]?;
                sum.iter_mut().zip(at).for_each(|(sum, value)| *sum += value);
            }
            Some(sum.map(|value| value / columns.len() as f64))
        };
        Self((0..n_rows).map(mean).collect())
    }

    /// The runs of rows with a sample, as half-open ranges.
    pub fn runs(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        runs(self.0.iter().map(Option::is_some))
    }

    /// The number of rows with a sample.
    #[must_use]
    pub fn n_samples(&self) -> usize {
        self.0.iter().flatten().count()
    }

    /// The positions with all gaps filled: linear interpolation between samples, the nearest sample at the ends. `None`
    /// if there is no sample at all.
    #[must_use]
    pub fn bridged(&self) -> Option<Vec<Vector>> {
        let known: Vec<(usize, Vector)> =
            self.0.iter().enumerate().filter_map(|(row, at)| Some((row, (*at)?))).collect();
        let (first, last) = (known.first()?, known.last()?);
        let mut bridged = vec![first.1; self.0.len()];
        bridged[last.0..].fill(last.1);
        for pair in known.windows(2) {
            let [(from, a), (to, b)] = [pair[0], pair[1]];
            for (step, place) in bridged[from..to].iter_mut().enumerate() {
                let part = step as f64 / (to - from) as f64;
                *place = std::array::from_fn(|axis| a[axis] + (b[axis] - a[axis]) * part);
            }
        }
        Some(bridged)
    }
}

/// A position in f64; `None` for a gap.
#[must_use]
pub fn sample(position: Position) -> Option<Vector> {
    (!is_gap(position)).then(|| position.map(f64::from))
}

/// Euclidean distance between two positions.
#[must_use]
pub fn distance(a: Vector, b: Vector) -> f64 {
    norm(std::array::from_fn(|axis| a[axis] - b[axis]))
}

/// Euclidean length of a vector.
#[must_use]
pub fn norm([x, y, z]: Vector) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

/// The runs of `true`, as half-open ranges of indices.
pub fn runs(present: impl Iterator<Item = bool>) -> impl Iterator<Item = Range<usize>> {
    let mut rows = present.enumerate();
    std::iter::from_fn(move || {
        let (start, _) = rows.find(|&(_, present)| present)?;
        let end = rows.by_ref().take_while(|&(_, present)| present).last();
        Some(start..end.map_or(start, |(row, _)| row) + 1)
    })
}

/// The median, the upper one of the two in the middle; `None` without values. Reorders `values`.
pub(crate) fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_all_patterns() {
        for pattern in 0..1 << 9_u32 {
            let present: Vec<bool> = (0..9).map(|i| pattern >> i & 1 == 1).collect();
            let mut again = [false; 9];
            let mut before = None;
            for run in runs(present.iter().copied()) {
                assert!(!run.is_empty() && before.is_none_or(|end| run.start > end), "{pattern:b}");
                before = Some(run.end);
                again[run].fill(true);
            }
            assert_eq!(again[..], present[..], "{pattern:b}");
        }
    }

    #[test]
    fn gaps_are_bridged_and_ends_held() {
        let at = |x: f64| Some([x, 0.0, 1.0]);
        let column = Column(vec![None, at(1.0), None, None, at(4.0), None]);
        let bridged = column.bridged().unwrap();
        let x: Vec<f64> = bridged.iter().map(|at| at[0]).collect();
        assert_eq!(x, [1.0, 1.0, 2.0, 3.0, 4.0, 4.0]);
        assert_eq!(Column(vec![None; 3]).bridged(), None);
    }
}
