//! Knots, their float32 reconstruction, and more knots until that keeps the tolerance.

use super::natural::{Knot, Moments, rebuild, widen};
use crate::{CodecError, Position, bound};

/// One run: its knots and what a decoder makes of them. Reused from run to run.
#[derive(Debug, Clone, Default)]
pub(crate) struct RunFit {
    knots: Vec<Knot>,
    moments: Moments,
    rebuilt: Vec<Position>,
    max_error_mm: f64,
}

impl RunFit {
    /// No knots.
    pub(crate) fn clear(&mut self) {
        self.knots.clear();
        self.max_error_mm = 0.0;
    }

    /// Keeps one more row, after all kept so far.
    pub(crate) fn keep(&mut self, row: usize) {
        self.knots.push((row, [0.0; 3]));
    }

    /// Starts with the given rows, in order.
    pub(crate) fn start(&mut self, rows: impl IntoIterator<Item = usize>) {
        self.clear();
        rows.into_iter().for_each(|row| self.keep(row));
    }

    /// Gives every kept row its position.
    pub(crate) fn fill(
        &mut self,
        mut position: impl FnMut(usize) -> Result<Position, CodecError>,
    ) -> Result<(), CodecError> {
        for (row, value) in &mut self.knots {
            *value = widen(position(*row)?);
        }
        Ok(())
    }

    /// Rebuilds all `len` rows of the run.
    pub(crate) fn rebuild(&mut self, len: usize) {
        self.rebuilt.resize(len, [0.0; 3]);
        rebuild(&self.knots, &mut self.moments, &mut self.rebuilt);
    }

    /// Rebuilds the run from its kept samples and measures it; gives the row that is off the most, the
    /// first of equals.
    pub(crate) fn measure(&mut self, samples: &[Position]) -> usize {
        for (row, value) in &mut self.knots {
            *value = widen(samples[*row]);
        }
        self.rebuild(samples.len());
        let (mut worst, mut at) = (0.0, 0);
        for (row, (&a, &b)) in self.rebuilt.iter().zip(samples).enumerate() {
            let error = bound::distance_mm(a, b);
            // An overflow to infinity less infinity is the worst of all.
            let error = if error.is_nan() { f64::INFINITY } else { error };
            if error > worst {
                (worst, at) = (error, row);
            }
        }
        self.max_error_mm = worst;
        at
    }

    /// Inserts the worst sample until the float32 reconstruction is within `tolerance_mm`.
    pub(crate) fn prove(&mut self, samples: &[Position], tolerance_mm: f64) {
        loop {
            let worst = self.measure(samples);
            // A knot is rebuilt to the bit, so that this ends with every sample kept at the latest.
            if self.max_error_mm <= tolerance_mm {
                return;
            }
            self.insert(worst);
        }
    }

    /// Keeps one more row, wherever it lies.
    pub(crate) fn insert(&mut self, row: usize) {
        let index = self.knots.partition_point(|&(knot, _)| knot < row);
        self.knots.insert(index, (row, [0.0; 3]));
    }

    /// The kept rows.
    pub(crate) fn rows(&self) -> impl ExactSizeIterator<Item = usize> {
        self.knots.iter().map(|&(row, _)| row)
    }

    /// What the decoder gives.
    pub(crate) fn rebuilt(&self) -> &[Position] {
        &self.rebuilt
    }

    /// Of the last measurement.
    pub(crate) fn max_error_mm(&self) -> f64 {
        self.max_error_mm
    }
}
