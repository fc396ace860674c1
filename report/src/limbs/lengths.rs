//! The markers of one subject over a take, whose labels can be exchanged: how long its limbs are, and where one is not
//! itself.

use std::ops::Range;

use mocapd_take::motion::{Motion, Position};

use super::Limb;
use crate::column::{Vector, distance, median, runs, sample};

/// A limb's band reaches so far to both sides of its middle: this part of its length, but no less than
/// [`BAND_MIN_MM`] (a marker slides so far on the skin) nor [`BAND_SPREADS`] of its own spread.
pub const BAND_PART: f64 = 0.10;
/// See [`BAND_PART`], mm.
pub const BAND_MIN_MM: f64 = 20.0;
/// See [`BAND_PART`]: of a normal spread 6 frames of 100 000 lie farther out.
pub const BAND_SPREADS: f64 = 4.0;

/// Markers lie this part of the scan's length from its joint centres at most, where they name the joint: the middle of
/// the band is told from such frames, so that labels that were exchanged for most of a take do not pass for the limb.
const LIKE_SCAN_PART: f64 = 0.25;
/// If these are this part of all frames at least.
const LIKE_SCAN_FRAMES: f64 = 0.1;

/// The median distance from a median, times this, is the standard deviation where the spread is normal.
const MAD_TO_SIGMA: f64 = 1.4826;

/// Runs that are closer than this are told as one, s.
const NEAR_S: f64 = 0.1;

/// A limb over a take.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Lengths {
    /// Frames in which both of its markers were seen.
    pub frames: u64,
    /// Its median length, mm; 0 where it was never seen.
    pub median_mm: f64,
    /// A robust standard deviation: 1.4826 times the median distance from the median, mm.
    pub spread_mm: f64,
    /// The middle of its band, mm.
    pub band_middle_mm: f64,
    /// How far the band reaches to both sides, mm.
    pub band_half_mm: f64,
    /// Frames in which it is outside of it.
    pub frames_outside: u64,
}

/// Where a limb leaves its band.
#[derive(Debug, Clone, PartialEq)]
pub struct Outside {
    /// Which limb.
    pub limb: usize,
    /// From its first frame to behind its last.
    pub rows: Range<usize>,
    /// The length that is farthest from the band, mm.
    pub extreme_mm: f64,
}

fn spread(values: &[f64], about: f64) -> f64 {
    let mut off: Vec<f64> = values.iter().map(|value| (value - about).abs()).collect();
    MAD_TO_SIGMA * median(&mut off).unwrap_or_default()
}

/// Measures a limb.
pub(super) fn of(body: &Body<'_>, limb: usize) -> Lengths {
    let mut all: Vec<f64> =
        (0..body.n_rows()).filter_map(|row| body.length_mm(row, limb)).collect();
    let Some(median_mm) = median(&mut all) else { return Lengths::default() };
    let scan_mm = body.limbs.get(limb).map_or(median_mm, |limb| limb.bone.length_mm);
    let is_like_scan = |length: &&f64| (**length - scan_mm).abs() <= LIKE_SCAN_PART * scan_mm;
    let mut like_scan: Vec<f64> = all.iter().filter(is_like_scan).copied().collect();
    let of_band = if like_scan.len() as f64 >= LIKE_SCAN_FRAMES * all.len() as f64 {
        &mut like_scan
    } else {
        &mut all
    };
    let band_middle_mm = median(of_band).unwrap_or(median_mm);
    let band_half_mm = (BAND_PART * band_middle_mm)
        .max(BAND_MIN_MM)
        .max(BAND_SPREADS * spread(of_band, band_middle_mm));
    let is_outside = |length: &&f64| (**length - band_middle_mm).abs() > band_half_mm;
    Lengths {
        frames: all.len() as u64,
        median_mm,
        spread_mm: spread(&all, median_mm),
        band_middle_mm,
        band_half_mm,
        frames_outside: all.iter().filter(is_outside).count() as u64,
    }
}

/// Where limbs are outside of their bands, in the order of the frames.
pub(super) fn outside(body: &Body<'_>) -> Vec<Outside> {
    let mut found: Vec<Outside> = Vec::new();
    for limb in 0..body.limbs.len() {
        let excess = |row: usize| body.excess_mm(row, limb, None).unwrap_or_default();
        for rows in near_as_one(runs((0..body.n_rows()).map(|row| excess(row) > 0.0)), body) {
            let worst = rows.clone().max_by(|&a, &b| excess(a).total_cmp(&excess(b)));
            let extreme_mm = worst.and_then(|row| body.length_mm(row, limb)).unwrap_or_default();
            found.push(Outside { limb, rows, extreme_mm });
        }
    }
    found.sort_by_key(|outside| (outside.rows.start, outside.limb));
    found
}

fn near_as_one(runs: impl Iterator<Item = Range<usize>>, body: &Body<'_>) -> Vec<Range<usize>> {
    let near = body.rows_in(NEAR_S);
    let mut all: Vec<Range<usize>> = Vec::new();
    for run in runs {
        match all.last_mut() {
            Some(last) if run.start - last.end <= near => last.end = run.end,
            _ => all.push(run),
        }
    }
    all
}

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
    pub(super) fn undo(&mut self, [a, b]: Pair, rows: Range<usize>) {
        for row in rows {
            let from = row * self.n_markers;
            if let Some(frame) = self.positions_mm.get_mut(from..from + self.n_markers) {
                frame.swap(a, b);
            }
        }
    }
}
