//! Moving expectations to where the distances to the partners would be right.

use super::{
    ahead::{Ahead, LANES, lanes, put},
    code::{Points, TOGETHER},
    lattice::{UNITS_PER_TOLERANCE, round},
    lengths::{LEAST_SHARE, PARTNERS, Share},
    track::Track,
};

const TOLERANCE: f64 = UNITS_PER_TOLERANCE as f64;

/// One value for each of the rows that are held against the partners together.
type Together = [f64; TOGETHER];

/// What one partner says of some rows.
#[derive(Debug)]
struct Pull {
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
pub(super) struct Pulls {
    by_partner: [Pull; PARTNERS],
    n_partners: usize,
}

impl Pulls {
    pub(super) fn new() -> Self {
        let none = || Pull {
            direction: [[0.0; TOGETHER]; 3],
            left: [f64::NAN; TOGETHER],
            by: [0.0; TOGETHER],
        };
        Self { by_partner: std::array::from_fn(|_| none()), n_partners: 0 }
    }

    /// Learns how much of the pulls was true of one of these rows, which is at `point`.
    #[inline(always)]
    pub(super) fn score(
        &self,
        i: usize,
        (expected, point): ([f64; 3], [f64; 3]),
        shares: &mut [Share; PARTNERS],
    ) {
        let i = i % TOGETHER;
        // Where each partner saw the row.
        let mut from = expected;
        for (pull, share) in self.by_partner[..self.n_partners].iter().zip(shares) {
            let difference = pull.left[i];
            if difference.is_nan() {
                continue;
            }
            let direction = pull.direction.each_ref().map(|axis| axis[i]);
            let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| {
                (from[axis] - point[axis]) / TOLERANCE * direction[axis]
            });
            share.learn(difference, x + y + z);
            from = std::array::from_fn(|axis| from[axis] - pull.by[i] * direction[axis]);
        }
    }

    /// Where the partners put the rows ahead from `at` on, by axis in whole units: each pulls a row that those
    /// before it have pulled already. Where that is `FAR`, the distance and direction are worked out anew.
    #[inline(always)]
    pub(super) fn pull<const N: usize, const FAR: bool>(
        &mut self,
        ahead: &Ahead,
        partners: &[&Track],
        shares: [f64; PARTNERS],
        at: usize,
    ) -> Points<N> {
        let slot = ahead.sites.slot + at;
        let from: Points<N> = ahead.prediction.each_ref().map(|axis| lanes(axis, at));
        let mut moved = [[0.0; N]; 3];
        self.n_partners = partners.len().min(PARTNERS);
        let by_partner = self.by_partner.iter_mut().zip(partners).zip(&ahead.lengths).zip(shares);
        for (((pull, partner), lengths), share) in by_partner {
            let share = if share > LEAST_SHARE { share } else { 0.0 };
            let mut own = from;
            if FAR {
                for axis in 0..3 {
                    for i in 0..N {
                        own[axis][i] += moved[axis][i];
                    }
                }
            }
            let Pull { direction: [x, y, z], left, by } = pull;
            for first in (0..N).step_by(LANES) {
                let own = own.each_ref().map(|axis| lanes(axis, first));
                let (differences, directions) =
                    aim(own, partner, slot + first, lanes(lengths, at + first));
                put(left, first, differences);
                for (out, direction) in [&mut *x, &mut *y, &mut *z].into_iter().zip(directions) {
                    put(out, first, direction);
                }
            }
            if !FAR {
                for i in 0..N {
                    let along = moved[0][i] * x[i] + moved[1][i] * y[i] + moved[2][i] * z[i];
                    left[i] += along / TOLERANCE;
                }
            }
            for i in 0..N {
                let units = share * left[i] * TOLERANCE;
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
    own: Points<LANES>,
    partner: &Track,
    slot: usize,
    lengths: [f64; LANES],
) -> ([f64; LANES], Points<LANES>) {
    let mut off = own;
    for (off, other) in off.iter_mut().zip(&partner.span.0) {
        let other: [f64; LANES] = lanes(other, slot);
        for i in 0..LANES {
            off[i] -= other[i];
        }
    }
    // Loops of a few operations, and all of them for every row: so the rows stay side by side.
    let (mut units, mut inverses) = ([0.0; LANES], [0.0; LANES]);
    for i in 0..LANES {
        let [x, y, z] = [off[0][i], off[1][i], off[2][i]];
        units[i] = (x * x + y * y + z * z).sqrt();
    }
    for i in 0..LANES {
        inverses[i] = 1.0 / units[i];
    }
    let (mut differences, mut says) = ([0.0; LANES], [false; LANES]);
    for i in 0..LANES {
        differences[i] = units[i] / TOLERANCE - lengths[i];
        // Not so where something is not known, either.
        says[i] = (units[i] >= TOLERANCE) & (differences[i] < f64::INFINITY);
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
