//! Correction of predictions by the distances to the partners.
//!
//! A prediction is moved along the line to a partner by a share of its error in distance. The share is learnt by least
//! squares: the share of such errors that was real at earlier rows.

use super::{
    contexts::{INTERPOLATED, KINDS},
    lattice::{LANES, Points, UNITS_PER_TOLERANCE, lanes, put, round},
    level_prediction::LevelPrediction,
    segment_lengths::{MAX_DIFFERENCE, PARTNERS, SegmentLengths, offsets_from},
    track::Track,
};
use crate::GROUP_CHANNELS;

/// Rows of a fine level that are corrected together; the shares learnt from them hold from the next batch on. Coarse
/// levels have at most [`LANES`] rows.
pub(super) const BATCH_ROWS: usize = 8;

/// The factor on the sums of a share at every row, and the ridge, in squared tolerances, that keeps it small at first.
const DECAY: f64 = 0.98;
const RIDGE: f64 = 1.0;
/// Smaller shares are not used.
const MIN_SHARE: f64 = 0.05;

/// A share: the decaying sums of squared error and of error times true error, and their quotient.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Share {
    squares: f64,
    products: f64,
    share: f64,
    /// Whether the sums have changed since the share was computed.
    is_stale: bool,
}

impl Share {
    /// Updates the sums with an error in distance and its true part, in tolerances.
    #[inline(always)]
    fn learn(&mut self, difference: f64, truth: f64) {
        // Not `clamp`, which handles NaN at a cost.
        let cut = |value: f64| {
            let value = if value < MAX_DIFFERENCE { value } else { MAX_DIFFERENCE };
            if value > -MAX_DIFFERENCE { value } else { -MAX_DIFFERENCE }
        };
        let (difference, truth) = (cut(difference), cut(truth));
        self.squares = self.squares * DECAY + difference * difference;
        self.products = self.products * DECAY + difference * truth;
        self.is_stale = true;
    }

    /// The share of an error that is expected to be true, at most 1.
    #[inline(always)]
    fn share(&mut self) -> f64 {
        if self.is_stale {
            // Negative shares are not used.
            self.share = (self.products / (self.squares + RIDGE)).min(1.0);
            self.is_stale = false;
        }
        self.share
    }
}

/// The shares of a channel by kind of row and slot of the partner.
pub(super) type KindShares = [[Share; PARTNERS]; KINDS];

/// One value for each row of a batch.
type BatchRows = [f64; BATCH_ROWS];

/// The correction of a batch of rows by one partner.
#[derive(Debug, Clone, Copy)]
struct PartnerCorrection {
    /// Unit vectors away from the partner, by axis; 0 where the partner or its distance is unknown.
    direction: [BatchRows; 3],
    /// Excess distance from the partner in tolerances, after the corrections of the partners before it; NaN where
    /// unknown.
    excess: BatchRows,
    /// How far this partner moved the row towards itself, in units.
    shift: BatchRows,
}

/// The corrections of a batch of rows by the partners of its channel, and the shares of all channels.
#[derive(Debug)]
pub(super) struct DistanceCorrection {
    by_partner: [PartnerCorrection; PARTNERS],
    n_partners: usize,
    /// Shares by channel, kind of row and slot of the partner.
    shares: Vec<KindShares>,
}

impl DistanceCorrection {
    pub(super) fn new() -> Self {
        let (none, unknown) = ([0.0; BATCH_ROWS], [f64::NAN; BATCH_ROWS]);
        let direction = [none; 3];
        Self {
            by_partner: [PartnerCorrection { direction, excess: unknown, shift: none }; PARTNERS],
            n_partners: 0,
            shares: vec![Default::default(); GROUP_CHANNELS],
        }
    }

    pub(super) fn reset(&mut self) {
        self.shares.fill(Default::default());
    }

    pub(super) fn shares(&self, j: usize) -> &KindShares {
        &self.shares[j]
    }

    pub(super) fn shares_mut(&mut self, j: usize) -> &mut KindShares {
        &mut self.shares[j]
    }

    /// Copies the shares of `n` channels.
    pub(super) fn follow(&mut self, other: &Self, n: usize) {
        self.shares[..n].copy_from_slice(&other.shares[..n]);
    }

    /// Begins a level: shares that have seen no row start from those of the level above, without which the
    /// ratio loses 0.6 %.
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

    /// Updates the shares of channel `j` and a kind of row with row `i` of the batch, which was predicted at `expected`
    /// and decoded at `point`.
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
        let i = i % BATCH_ROWS;
        // The row's position before the correction of each partner.
        let mut from = expected;
        for (partner, share) in self.by_partner[..self.n_partners].iter().zip(shares) {
            let difference = partner.excess[i];
            if difference.is_nan() {
                continue;
            }
            let direction = partner.direction.each_ref().map(|axis| axis[i]);
            let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| {
                (from[axis] - point[axis]) / UNITS_PER_TOLERANCE * direction[axis]
            });
            share.learn(difference, x + y + z);
            from = std::array::from_fn(|axis| from[axis] - partner.shift[i] * direction[axis]);
        }
    }

    /// The predictions of the rows of a level from index `at` on, corrected by the partners of channel `j` one after
    /// another, by axis in whole units. On `COARSE` levels the distance and direction are recomputed after the
    /// correction of each partner; elsewhere all start from one position, which costs 0.1 % and is faster.
    #[inline(always)]
    pub(super) fn correct<const N: usize, const COARSE: bool>(
        &mut self,
        j: usize,
        kind: usize,
        level: &LevelPrediction,
        segments: &SegmentLengths,
        tracks: &[Track],
        at: usize,
    ) -> Points<N> {
        let slot = level.layout.slot + at;
        let from: Points<N> = level.prediction.each_ref().map(|axis| lanes(axis, at));
        let partners = segments.partners(j);
        let shares = self.shares[j][kind].each_mut().map(Share::share);
        let mut moved = [[0.0; N]; 3];
        self.n_partners = partners.channels().len();
        let by_partner = self.by_partner.iter_mut().zip(partners.channels());
        for (((out, &k), lengths), share) in by_partner.zip(&segments.expected).zip(shares) {
            let share = if share > MIN_SHARE { share } else { 0.0 };
            let mut own = from;
            if COARSE {
                for axis in 0..3 {
                    for i in 0..N {
                        own[axis][i] += moved[axis][i];
                    }
                }
            }
            let PartnerCorrection { direction: [x, y, z], excess, shift } = out;
            for first in (0..N).step_by(LANES) {
                let own = own.each_ref().map(|axis| lanes(axis, first));
                let (differences, directions) =
                    distance_excess(&tracks[k], slot + first, own, lanes(lengths, at + first));
                put(excess, first, differences);
                for (out, direction) in [&mut *x, &mut *y, &mut *z].into_iter().zip(directions) {
                    put(out, first, direction);
                }
            }
            if !COARSE {
                for i in 0..N {
                    let along = moved[0][i] * x[i] + moved[1][i] * y[i] + moved[2][i] * z[i];
                    excess[i] += along / UNITS_PER_TOLERANCE;
                }
            }
            for i in 0..N {
                let units = share * excess[i] * UNITS_PER_TOLERANCE;
                // NaN, where the partner is unknown, becomes 0.
                shift[i] = if units.abs() < f64::INFINITY { units } else { 0.0 };
            }
            for (moved, direction) in moved.iter_mut().zip([x, y, z]) {
                for i in 0..N {
                    moved[i] -= shift[i] * direction[i];
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

/// The excess distances of rows from a partner in tolerances, and the unit vectors away from it.
#[inline(always)]
fn distance_excess(
    partner: &Track,
    slot: usize,
    own: Points<LANES>,
    lengths: [f64; LANES],
) -> ([f64; LANES], Points<LANES>) {
    // Short loops without branches, so that the compiler vectorises each of them.
    let (mut off, units) = offsets_from(partner, slot, own);
    let mut inverses = [0.0; LANES];
    for i in 0..LANES {
        inverses[i] = 1.0 / units[i];
    }
    let (mut differences, mut is_known) = ([0.0; LANES], [false; LANES]);
    for i in 0..LANES {
        differences[i] = units[i] / UNITS_PER_TOLERANCE - lengths[i];
        // False where something is unknown (NaN), too.
        is_known[i] = (units[i] >= UNITS_PER_TOLERANCE) & (differences[i] < f64::INFINITY);
        differences[i] = if is_known[i] { differences[i] } else { f64::NAN };
    }
    for off in &mut off {
        for i in 0..LANES {
            let along = off[i] * inverses[i];
            off[i] = if is_known[i] { along } else { 0.0 };
        }
    }
    (differences, off)
}
