//! The markers of one subject over a take, whose labels can be put back into their places.

use mocapd_take::motion::{Motion, Position};

use super::{Lengths, Limb};
use crate::column::{Vector, distance, sample};

/// The length that a limb has, and how far from it is still its own.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Band {
    pub(super) middle_mm: f64,
    pub(super) half_mm: f64,
}

#[derive(Debug)]
pub(super) struct Body<'a> {
    positions_mm: Vec<Position>,
    n_markers: usize,
    pub(super) rate_hz: f64,
    pub(super) limbs: &'a [Limb],
    pub(super) columns: &'a [usize],
    bands: Vec<Band>,
}

/// Two markers whose labels are exchanged for a look.
pub(super) type Pair = [usize; 2];

impl<'a> Body<'a> {
    pub(super) fn new(motion: &Motion, limbs: &'a [Limb], columns: &'a [usize]) -> Self {
        let n_markers = motion.info.markers.len();
        Self {
            positions_mm: motion.positions_mm.clone(),
            n_markers,
            rate_hz: motion.info.rate_hz,
            limbs,
            columns,
            bands: vec![Band::default(); limbs.len()],
        }
    }

    pub(super) fn set_bands(&mut self, lengths: &[Lengths]) {
        let band = |of: &Lengths| Band { middle_mm: of.band_middle_mm, half_mm: of.band_half_mm };
        self.bands = lengths.iter().map(band).collect();
    }

    pub(super) fn n_rows(&self) -> usize {
        self.positions_mm.len() / self.n_markers.max(1)
    }

    /// Rows in so many seconds, one at least.
    pub(super) fn rows_in(&self, seconds: f64) -> usize {
        ((seconds * self.rate_hz) as usize).max(1)
    }

    /// Where a marker is; `None` where it was not seen.
    pub(super) fn at(&self, row: usize, column: usize) -> Option<Vector> {
        if column >= self.n_markers {
            return None;
        }
        sample(*self.positions_mm.get(row * self.n_markers + column)?)
    }

    /// A limb's length, with the labels of `pair` exchanged.
    fn length_of(&self, row: usize, limb: usize, pair: Option<Pair>) -> Option<f64> {
        let ends = self.limbs.get(limb)?.ends.map(|end| match pair {
            Some([a, b]) if end == a => b,
            Some([a, b]) if end == b => a,
            _ => end,
        });
        Some(distance(self.at(row, ends[0])?, self.at(row, ends[1])?))
    }

    pub(super) fn length_mm(&self, row: usize, limb: usize) -> Option<f64> {
        self.length_of(row, limb, None)
    }

    /// By how much a limb is out of its band, mm; 0 within it.
    pub(super) fn excess_mm(&self, row: usize, limb: usize, pair: Option<Pair>) -> Option<f64> {
        let band = self.bands.get(limb)?;
        let length_mm = self.length_of(row, limb, pair)?;
        Some(((length_mm - band.middle_mm).abs() - band.half_mm).max(0.0))
    }

    /// The limbs that end at one of two markers.
    pub(super) fn touched(&self, pair: Pair) -> Vec<usize> {
        let ends = |limb: &Limb| pair.iter().any(|column| limb.ends.contains(column));
        let limbs = self.limbs.iter().enumerate().filter(|(_, limb)| ends(limb));
        limbs.map(|(i, _)| i).collect()
    }

    /// The sum of what these limbs are out of their bands; `None` where none of them is seen.
    pub(super) fn excess_of(&self, row: usize, limbs: &[usize], pair: Option<Pair>) -> Option<f64> {
        let excess = |limb: &usize| self.excess_mm(row, *limb, pair);
        limbs.iter().filter_map(excess).reduce(|sum, more| sum + more)
    }

    /// How far these limbs are from the middles of their bands: the sum of squares, a band's half being 1.
    pub(super) fn strain(&self, row: usize, limbs: &[usize], pair: Option<Pair>) -> f64 {
        let strain = |limb: &usize| {
            let band = self.bands.get(*limb)?;
            let off_mm = self.length_of(row, *limb, pair)? - band.middle_mm;
            Some((off_mm / band.half_mm).powi(2))
        };
        limbs.iter().filter_map(strain).sum()
    }

    /// Gives the labels back over these rows.
    pub(super) fn undo(&mut self, [a, b]: Pair, rows: std::ops::Range<usize>) {
        for row in rows {
            let from = row * self.n_markers;
            if let Some(frame) = self.positions_mm.get_mut(from..from + self.n_markers) {
                frame.swap(a, b);
            }
        }
    }
}
