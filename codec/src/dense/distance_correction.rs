//! Moving expectations to where the distances to the partners would be right.
//!
//! An expectation is moved along the line to a partner, by a share of the difference that is learnt: how much of it
//! used to be true.

use super::{
    contexts::{INTERPOLATED, KINDS},
    level_prediction::LevelPrediction,
    points::{LANES, Points, UNITS_PER_TOLERANCE, lanes, put, round},
    segment_lengths::{MAX_DIFFERENCE, PARTNERS, SegmentLengths, away},
    track::Track,
};
use crate::GROUP_CHANNELS;

/// Rows of a fine level that are held against the partners together: what they teach holds for those after them.
/// Of other levels there are no more than [`LANES`].
pub(super) const TOGETHER: usize = 8;

/// What a row leaves of the sums of the share, and what keeps it small at first.
const DECAY: f64 = 0.98;
const RIDGE: f64 = 1.0;
/// Shares below this are not used.
const LEAST_SHARE: f64 = 0.05;

/// One share: sums of the squared difference, and of difference times truth, and what follows.
#[derive(Debug, Clone, Copy, Default)]
struct Share {
    squares: f64,
    products: f64,
    share: f64,
    /// The share does not follow from the sums yet: that is worked out when it is asked for.
    is_stale: bool,
}

impl Share {
    /// Learns how much of a difference was true, in tolerances.
    #[inline(always)]
    fn learn(&mut self, difference: f64, truth: f64) {
        // Not `clamp`, which looks for NaN.
        let cut = |value: f64| {
            let value = if value < MAX_DIFFERENCE { value } else { MAX_DIFFERENCE };
            if value > -MAX_DIFFERENCE { value } else { -MAX_DIFFERENCE }
        };
        let (difference, truth) = (cut(difference), cut(truth));
        self.squares = self.squares * DECAY + difference * difference;
        self.products = self.products * DECAY + difference * truth;
        self.is_stale = true;
    }

    /// How much of a difference is true.
    #[inline(always)]
    fn share(&mut self) -> f64 {
        if self.is_stale {
            // Those below nothing are not used.
            self.share = (self.products / (self.squares + RIDGE)).min(1.0);
            self.is_stale = false;
        }
        self.share
    }
}

/// One value for each of the rows that are held against the partners together.
type Together = [f64; TOGETHER];

/// What one partner says of some rows.
#[derive(Debug, Clone, Copy)]
struct FromPartner {
    /// By axis: away from the partner, length 1; 0 where it says nothing.
    direction: [Together; 3],
    /// Too far from the partner by so much, in tolerances, where the partners before this one leave the row. NaN
    /// where it says nothing.
    left: Together,
    /// How far it moved the row towards itself, in units.
    by: Together,
}

/// What the partners make of some rows.
#[derive(Debug)]
pub(super) struct DistanceCorrection {
    by_partner: [FromPartner; PARTNERS],
    n_partners: usize,
    /// By channel, kind of row and slot of a partner.
    shares: Vec<[[Share; PARTNERS]; KINDS]>,
}

impl DistanceCorrection {
    pub(super) fn new() -> Self {
        let (none, unknown) = ([0.0; TOGETHER], [f64::NAN; TOGETHER]);
        Self {
            by_partner: [FromPartner { direction: [none; 3], left: unknown, by: none }; PARTNERS],
            n_partners: 0,
            shares: vec![Default::default(); GROUP_CHANNELS],
        }
    }

    pub(super) fn reset(&mut self) {
        self.shares.fill(Default::default());
    }

    /// A level begins: a share that has learnt nothing yet is that of the level above.
    pub(super) fn begin(&mut self, j: usize, kind: usize) {
        if !(INTERPOLATED..KINDS - 1).contains(&kind) {
            return;
        }
        for slot in 0..PARTNERS {
            if self.shares[j][kind][slot].squares == 0.0 {
                let above = self.shares[j][kind + 1][slot].share();
                let own = &mut self.shares[j][kind][slot];
                (own.share, own.is_stale) = (above, false);
            }
        }
    }

    /// Learns how much of what was done to row `i` of these was true, which was expected at one point and is at
    /// another. The shares are those of its channel and kind.
    #[inline(always)]
    pub(super) fn score(
        &mut self,
        j: usize,
        kind: usize,
        i: usize,
        expected: [f64; 3],
        point: [f64; 3],
    ) {
        let shares = &mut self.shares[j][kind];
        let i = i % TOGETHER;
        // Where each partner saw the row.
        let mut from = expected;
        for (partner, share) in self.by_partner[..self.n_partners].iter().zip(shares) {
            let difference = partner.left[i];
            if difference.is_nan() {
                continue;
            }
            let direction = partner.direction.each_ref().map(|axis| axis[i]);
            let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| {
                (from[axis] - point[axis]) / UNITS_PER_TOLERANCE * direction[axis]
            });
            share.learn(difference, x + y + z);
            from = std::array::from_fn(|axis| from[axis] - partner.by[i] * direction[axis]);
        }
    }

    /// Where the partners of a channel put the rows of a level from `at` on, by axis in whole units: each moves a row
    /// that those before it have moved already. Where that is `FAR`, the distance and direction are worked out anew.
    #[inline(always)]
    pub(super) fn correct<const N: usize, const FAR: bool>(
        &mut self,
        j: usize,
        kind: usize,
        level: &LevelPrediction,
        segments: &SegmentLengths,
        tracks: &[Track],
        at: usize,
    ) -> Points<N> {
        let slot = level.sites.slot + at;
        let from: Points<N> = level.prediction.each_ref().map(|axis| lanes(axis, at));
        let partners = segments.partners(j);
        let shares = self.shares[j][kind].each_mut().map(Share::share);
        let mut moved = [[0.0; N]; 3];
        self.n_partners = partners.channels().len();
        let by_partner = self.by_partner.iter_mut().zip(partners.channels());
        for (((out, &k), lengths), share) in by_partner.zip(&segments.expected).zip(shares) {
            let share = if share > LEAST_SHARE { share } else { 0.0 };
            let mut own = from;
            if FAR {
                for axis in 0..3 {
                    for i in 0..N {
                        own[axis][i] += moved[axis][i];
                    }
                }
            }
            let FromPartner { direction: [x, y, z], left, by } = out;
            for first in (0..N).step_by(LANES) {
                let own = own.each_ref().map(|axis| lanes(axis, first));
                let (differences, directions) =
                    aim(&tracks[k], slot + first, own, lanes(lengths, at + first));
                put(left, first, differences);
                for (out, direction) in [&mut *x, &mut *y, &mut *z].into_iter().zip(directions) {
                    put(out, first, direction);
                }
            }
            if !FAR {
                for i in 0..N {
                    let along = moved[0][i] * x[i] + moved[1][i] * y[i] + moved[2][i] * z[i];
                    left[i] += along / UNITS_PER_TOLERANCE;
                }
            }
            for i in 0..N {
                let units = share * left[i] * UNITS_PER_TOLERANCE;
                // Not so where it says nothing.
                by[i] = if units.abs() < f64::INFINITY { units } else { 0.0 };
            }
            for (moved, direction) in moved.iter_mut().zip([x, y, z]) {
                for i in 0..N {
                    moved[i] -= by[i] * direction[i];
                }
            }
        }
        let mut points = from;
        for axis in 0..3 {
            for i in 0..N {
                points[axis][i] = round(from[axis][i] + moved[axis][i]);
            }
        }
        points
    }
}

/// How much too far rows are from a partner, in tolerances, and the direction away from it.
#[inline(always)]
fn aim(
    partner: &Track,
    slot: usize,
    own: Points<LANES>,
    lengths: [f64; LANES],
) -> ([f64; LANES], Points<LANES>) {
    // Loops of a few operations, and all of them for every row: so the rows stay side by side.
    let (mut off, units) = away(partner, slot, own);
    let mut inverses = [0.0; LANES];
    for i in 0..LANES {
        inverses[i] = 1.0 / units[i];
    }
    let (mut differences, mut says) = ([0.0; LANES], [false; LANES]);
    for i in 0..LANES {
        differences[i] = units[i] / UNITS_PER_TOLERANCE - lengths[i];
        // Not so where something is not known, either.
        says[i] = (units[i] >= UNITS_PER_TOLERANCE) & (differences[i] < f64::INFINITY);
        differences[i] = if says[i] { differences[i] } else { f64::NAN };
    }
    for off in &mut off {
        for i in 0..LANES {
            let along = off[i] * inverses[i];
            off[i] = if says[i] { along } else { 0.0 };
        }
    }
    (differences, off)
}
