//! Moving expectations to where the distances to the partners would be right.

use crate::coding::isa::Kernel;

use super::{
    ahead::{Ahead, LANES, MOST, PerRow, ROOM, Sites, lanes, put},
    lattice::{UNITS_PER_TOLERANCE, round},
    lengths::{LEAST_SHARE, PARTNERS, Share},
    track::Track,
};

const TOLERANCE: f64 = UNITS_PER_TOLERANCE as f64;

/// What one partner says of the rows ahead.
#[derive(Debug)]
struct Pull {
    /// By axis: away from the partner, length 1; 0 where it says nothing.
    direction: [PerRow; 3],
    /// Too far from the partner by so much, in tolerances: where the references leave the row, and where the
    /// partners before this one do. NaN where it says nothing.
    difference: PerRow,
    left: PerRow,
    /// How far it moved the row towards itself, in units.
    by: PerRow,
}

/// What the partners make of the rows ahead.
#[derive(Debug)]
pub(super) struct Pulls {
    by_partner: [Pull; PARTNERS],
    n_partners: usize,
}

impl Pulls {
    pub(super) fn new() -> Self {
        let none = || Pull {
            direction: [[0.0; ROOM]; 3],
            difference: [f64::NAN; ROOM],
            left: [f64::NAN; ROOM],
            by: [0.0; ROOM],
        };
        Self { by_partner: std::array::from_fn(|_| none()), n_partners: 0 }
    }

    /// Learns how much of the pulls was true of a row that is at `point`.
    #[inline(always)]
    pub(super) fn score(
        &self,
        i: usize,
        (expected, point): ([f64; 3], [f64; 3]),
        shares: &mut [Share; PARTNERS],
    ) {
        let i = i % MOST;
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

    /// Where the partners put some rows, by axis in whole units: each pulls a row that those before it have
    /// pulled already. Where that is `far`, the distance and direction are worked out anew, and the level is not
    /// aimed before.
    #[inline(always)]
    pub(super) fn pull<const N: usize>(
        &mut self,
        ahead: &Ahead,
        (partners, far): (&[&Track], bool),
        shares: [f64; PARTNERS],
        at: usize,
    ) -> [[f64; N]; 3] {
        let slot = ahead.sites.slot + at;
        let from: [[f64; N]; 3] = ahead.prediction.each_ref().map(|axis| lanes(axis, at));
        let mut moved = [[0.0; N]; 3];
        self.n_partners = partners.len().min(PARTNERS);
        let by_partner = self.by_partner.iter_mut().zip(partners).zip(&ahead.lengths).zip(shares);
        for (((pull, partner), lengths), share) in by_partner {
            let share = if share > LEAST_SHARE { share } else { 0.0 };
            let mut left: [f64; N];
            let direction: [[f64; N]; 3];
            if far {
                let own = std::array::from_fn(|axis| {
                    std::array::from_fn(|i| from[axis][i] + moved[axis][i])
                });
                (left, direction) = aim(own, partner, slot, &lanes(lengths, at));
                for (lane, direction) in pull.direction.iter_mut().zip(&direction) {
                    lane[at..at + N].copy_from_slice(direction);
                }
            } else {
                direction = pull.direction.each_ref().map(|axis| lanes(axis, at));
                left = lanes(&pull.difference, at);
                for i in 0..N {
                    let along = moved[0][i] * direction[0][i]
                        + moved[1][i] * direction[1][i]
                        + moved[2][i] * direction[2][i];
                    left[i] += along / TOLERANCE;
                }
            }
            let mut by = [0.0; N];
            for i in 0..N {
                let units = share * left[i] * TOLERANCE;
                // Not so where it says nothing.
                by[i] = if units.abs() < f64::INFINITY { units } else { 0.0 };
                for axis in 0..3 {
                    moved[axis][i] -= by[i] * direction[axis][i];
                }
            }
            pull.left[at..at + N].copy_from_slice(&left);
            pull.by[at..at + N].copy_from_slice(&by);
        }
        std::array::from_fn(|axis| std::array::from_fn(|i| round(from[axis][i] + moved[axis][i])))
    }
}

/// How much too far rows are from a partner, in tolerances, and the direction away from it.
#[inline(always)]
fn aim<const N: usize>(
    own: [[f64; N]; 3],
    partner: &Track,
    slot: usize,
    lengths: &[f64; N],
) -> ([f64; N], [[f64; N]; 3]) {
    let mut off = own;
    for (off, other) in off.iter_mut().zip(&partner.span.0) {
        let other: [f64; N] = lanes(other, slot);
        off.iter_mut().zip(other).for_each(|(off, other)| *off -= other);
    }
    let (mut differences, mut inverses) = ([0.0; N], [0.0; N]);
    for i in 0..N {
        let [x, y, z] = [off[0][i], off[1][i], off[2][i]];
        let units = (x * x + y * y + z * z).sqrt();
        let difference = units / TOLERANCE - lengths[i];
        // Not so where something is not known, either.
        let near = units >= TOLERANCE && difference < f64::INFINITY;
        inverses[i] = if near { 1.0 / units } else { 0.0 };
        differences[i] = if near { difference } else { f64::NAN };
    }
    for off in &mut off {
        for i in 0..N {
            let along = off[i] * inverses[i];
            off[i] = if inverses[i] > 0.0 { along } else { 0.0 };
        }
    }
    (differences, off)
}

/// Works out how far the rows ahead are from the partners, and in which direction.
#[derive(Debug)]
pub(super) struct Aiming<'a> {
    pub(super) pulls: &'a mut Pulls,
    pub(super) ahead: &'a Ahead,
    pub(super) partners: &'a [&'a Track],
}

impl Kernel for Aiming<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { pulls, ahead, partners } = self;
        let Sites { n, slot, .. } = ahead.sites;
        for ((pull, partner), lengths) in
            pulls.by_partner.iter_mut().zip(partners).zip(&ahead.lengths)
        {
            for at in (0..n).step_by(LANES) {
                let own = ahead.prediction.each_ref().map(|axis| lanes::<LANES>(axis, at));
                let (differences, directions) = aim(own, partner, slot + at, &lanes(lengths, at));
                put(&mut pull.difference, at, differences);
                for (lane, direction) in pull.direction.iter_mut().zip(directions) {
                    put(lane, at, direction);
                }
            }
        }
    }
}
