//! Moving expectations to where the distances to the partners would be right.

use crate::coding::isa::Kernel;

use super::{
    ahead::{Ahead, LANES, MOST, PerRow, lanes},
    lattice::{UNITS_PER_TOLERANCE, round},
    lengths::{LEAST_SHARE, PARTNERS, Share},
    track::Track,
};

const TOLERANCE: f64 = UNITS_PER_TOLERANCE as f64;

/// What the partners say of the rows ahead.
#[derive(Debug)]
pub(super) struct Pulls {
    /// Too far from the partner by so much, in tolerances; NaN where nothing says so.
    differences: [PerRow; PARTNERS],
    /// Away from the partner, length 1, by axis; 0 where there is none.
    directions: [[PerRow; 3]; PARTNERS],
    /// Cosines between the directions: of 1 and 0, 2 and 0, 2 and 1.
    cosines: [PerRow; PARTNERS],
}

/// What was made of one row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pulled {
    pub(super) point: [f64; 3],
    /// Where each partner saw the row, in units, and what it saw after those before it.
    from: [[f64; 3]; PARTNERS],
    differences: [f64; PARTNERS],
    /// How far the partners before each had moved the row along its direction.
    gone: [f64; PARTNERS],
}

impl Pulls {
    pub(super) fn new() -> Self {
        Self {
            differences: [[f64::NAN; MOST]; PARTNERS],
            directions: [[[0.0; MOST]; 3]; PARTNERS],
            cosines: [[0.0; MOST]; PARTNERS],
        }
    }

    /// Moves a row: each partner sees what those before it did, along its own direction.
    #[inline(always)]
    pub(super) fn pull(&self, i: usize, from: [f64; 3], shares: &[Share; PARTNERS]) -> Pulled {
        let i = i % MOST;
        let share = |slot: usize, difference: f64| {
            let share = shares[slot].share;
            let moves = share > LEAST_SHARE && !difference.is_nan();
            if moves { share * difference } else { 0.0 }
        };
        let [first, second, third] = [0, 1, 2].map(|slot| self.differences[slot][i]);
        let cosines = [0, 1, 2].map(|pair| self.cosines[pair][i]);
        let a = share(0, first);
        let gone_second = a * cosines[0];
        let second = second - gone_second;
        let b = share(1, second);
        let gone_third = a * cosines[1] + b * cosines[2];
        let third = third - gone_third;
        let c = share(2, third);
        let far = [a, b, c].map(|tolerances| tolerances * TOLERANCE);
        let point = std::array::from_fn(|axis| {
            let direction = |slot: usize| self.directions[slot][axis][i];
            let moved = from[axis] - far[0] * direction(0) - far[1] * direction(1);
            round(moved - far[2] * direction(2))
        });
        Pulled {
            point,
            from: [from; PARTNERS],
            differences: [first, second, third],
            gone: [0.0, gone_second, gone_third],
        }
    }

    /// Moves a row to one partner after another.
    #[inline(always)]
    pub(super) fn pull_in_turn(
        &mut self,
        i: usize,
        from: [f64; 3],
        shares: &[Share; PARTNERS],
        partner: impl Fn(usize) -> Option<([f64; 3], f64)>,
    ) -> Pulled {
        let i = i % MOST;
        let mut moved = from;
        let mut from = [from; PARTNERS];
        for slot in 0..PARTNERS {
            from[slot] = moved;
            self.differences[slot][i] = f64::NAN;
            let Some((other, length)) = partner(slot) else { continue };
            let off: [f64; 3] = std::array::from_fn(|axis| moved[axis] - other[axis]);
            let distance = (off[0] * off[0] + off[1] * off[1] + off[2] * off[2]).sqrt() / TOLERANCE;
            let difference = distance - length;
            if distance < 1.0 || difference.is_nan() {
                continue;
            }
            self.differences[slot][i] = difference;
            let share = shares[slot].share;
            for axis in 0..3 {
                let direction = off[axis] / (distance * TOLERANCE);
                self.directions[slot][axis][i] = direction;
                if share > LEAST_SHARE {
                    moved[axis] -= share * difference * TOLERANCE * direction;
                }
            }
        }
        let differences = [0, 1, 2].map(|slot| self.differences[slot][i]);
        let point = moved.map(round);
        Pulled { point, from, differences, gone: [0.0; PARTNERS] }
    }

    /// Learns how much of the pulls was true of a row that is at `point`.
    #[inline(always)]
    pub(super) fn score(
        &self,
        i: usize,
        pulled: &Pulled,
        point: [f64; 3],
        shares: &mut [Share; PARTNERS],
    ) {
        let i = i % MOST;
        for (slot, share) in shares.iter_mut().enumerate() {
            let difference = pulled.differences[slot];
            if difference.is_nan() {
                continue;
            }
            let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| {
                (pulled.from[slot][axis] - point[axis]) / TOLERANCE * self.directions[slot][axis][i]
            });
            let truth = x + y + z - pulled.gone[slot];
            share.learn(difference, truth);
        }
    }
}

/// Works out the pulls of all rows.
#[derive(Debug)]
pub(super) struct Pulling<'a> {
    pub(super) pulls: &'a mut Pulls,
    pub(super) ahead: &'a Ahead,
    pub(super) partners: [Option<&'a Track>; PARTNERS],
}

impl Kernel for Pulling<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { pulls, ahead, partners } = self;
        let (first, n) = (ahead.sites.slot, ahead.sites.n);
        for (slot, track) in partners.iter().enumerate() {
            let Some(track) = track else {
                pulls.differences[slot][..n].fill(f64::NAN);
                pulls.directions[slot].iter_mut().for_each(|axis| axis[..n].fill(0.0));
                continue;
            };
            for at in (0..n).step_by(LANES) {
                let own = ahead.prediction.each_ref().map(|axis| lanes(axis, at));
                let other = track.span.0.each_ref().map(|axis| lanes(axis, first + at));
                let lengths = lanes(&ahead.lengths[slot], at);
                let mut differences = [0.0; LANES];
                let mut directions = [[0.0; LANES]; 3];
                for i in 0..LANES {
                    let [x, y, z] = [0, 1, 2].map(|axis| own[axis][i] - other[axis][i]);
                    let units = (x * x + y * y + z * z).sqrt();
                    let difference = units / TOLERANCE - lengths[i];
                    // Not so where something is not known, either.
                    let near = units >= TOLERANCE;
                    let inverse = if near { 1.0 / units } else { 0.0 };
                    differences[i] = if near { difference } else { f64::NAN };
                    directions[0][i] = if near { x * inverse } else { 0.0 };
                    directions[1][i] = if near { y * inverse } else { 0.0 };
                    directions[2][i] = if near { z * inverse } else { 0.0 };
                }
                pulls.differences[slot][at..at + LANES].copy_from_slice(&differences);
                for (axis, lane) in pulls.directions[slot].iter_mut().zip(&directions) {
                    axis[at..at + LANES].copy_from_slice(lane);
                }
            }
        }
        for (of, (a, b)) in [(1, 0), (2, 0), (2, 1)].into_iter().enumerate() {
            for at in (0..n).step_by(LANES) {
                let [a, b] = [a, b].map(|slot: usize| {
                    pulls.directions[slot].each_ref().map(|axis| lanes(axis, at))
                });
                let cosines: [f64; LANES] = std::array::from_fn(|i| {
                    a[0][i] * b[0][i] + a[1][i] * b[1][i] + a[2][i] * b[2][i]
                });
                pulls.cosines[of][at..at + LANES].copy_from_slice(&cosines);
            }
        }
    }
}
