//! Moving expectations to where the distances to the partners would be right.

use crate::coding::isa::Kernel;

use super::{
    ahead::{Ahead, LANES, MOST, PerRow, lanes},
    lattice::{UNITS_PER_TOLERANCE, round},
    lengths::{LEAST_SHARE, PARTNERS, Share},
    track::Track,
};

const TOLERANCE: f64 = UNITS_PER_TOLERANCE as f64;

/// What one partner says of the rows ahead.
#[derive(Debug)]
struct Pull {
    /// Too far from the partner by so much, in tolerances; NaN where nothing says so.
    difference: PerRow,
    /// By axis: away from the partner, length 1; 0 where there is none.
    direction: [PerRow; 3],
    /// How far it moved the row towards itself, in units.
    by: PerRow,
}

/// What the partners make of the rows ahead.
#[derive(Debug)]
pub(super) struct Pulls {
    by_partner: [Pull; PARTNERS],
    n_partners: usize,
    /// By axis: where the rows are expected after all, in whole units.
    pub(super) point: [PerRow; 3],
}

impl Pulls {
    pub(super) fn new() -> Self {
        let none =
            || Pull { difference: [f64::NAN; MOST], direction: [[0.0; MOST]; 3], by: [0.0; MOST] };
        Self { by_partner: std::array::from_fn(|_| none()), n_partners: 0, point: [[0.0; MOST]; 3] }
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
            let difference = pull.difference[i];
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
}

/// Works out the pulls of some rows.
#[derive(Debug)]
pub(super) struct Pulling<'a> {
    pub(super) pulls: &'a mut Pulls,
    pub(super) ahead: &'a Ahead,
    pub(super) partners: [Option<&'a Track>; PARTNERS],
    pub(super) shares: [f64; PARTNERS],
    /// The first of the rows, a multiple of [`LANES`], and the one behind the last.
    pub(super) rows: (usize, usize),
}

impl Pulling<'_> {
    /// `N` rows side by side.
    #[inline(always)]
    fn block<const N: usize>(&mut self, at: usize) {
        let Self { pulls, ahead, partners, shares, .. } = self;
        let mut moved: [[f64; N]; 3] = ahead.prediction.each_ref().map(|axis| lanes(axis, at));
        for (slot, track) in partners.iter().flatten().enumerate() {
            let pull = &mut pulls.by_partner[slot];
            let share = shares[slot];
            let far = if share > LEAST_SHARE { share } else { 0.0 };
            let lengths: [f64; N] = lanes(&ahead.lengths[slot], at);
            let other: [[f64; N]; 3] =
                track.span.0.each_ref().map(|axis| lanes(axis, ahead.sites.slot + at));
            let (mut differences, mut bys) = ([0.0; N], [0.0; N]);
            let mut directions = [[0.0; N]; 3];
            for i in 0..N {
                let [x, y, z] = [0, 1, 2].map(|axis| moved[axis][i] - other[axis][i]);
                let units = (x * x + y * y + z * z).sqrt();
                let difference = units / TOLERANCE - lengths[i];
                // Not so where something is not known, either.
                let near = units >= TOLERANCE && difference < f64::INFINITY;
                let inverse = if near { 1.0 / units } else { 0.0 };
                let by = if near { far * difference * TOLERANCE } else { 0.0 };
                bys[i] = by;
                differences[i] = if near { difference } else { f64::NAN };
                for (axis, off) in [x, y, z].into_iter().enumerate() {
                    let direction = if near { off * inverse } else { 0.0 };
                    directions[axis][i] = direction;
                    moved[axis][i] -= by * direction;
                }
            }
            pull.difference[at..at + N].copy_from_slice(&differences);
            pull.by[at..at + N].copy_from_slice(&bys);
            for (axis, lane) in pull.direction.iter_mut().zip(&directions) {
                axis[at..at + N].copy_from_slice(lane);
            }
        }
        for (out, moved) in pulls.point.iter_mut().zip(&moved) {
            for (out, &units) in out[at..at + N].iter_mut().zip(moved) {
                *out = round(units);
            }
        }
    }
}

impl Kernel for Pulling<'_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        let (mut at, end) = self.rows;
        self.pulls.n_partners = self.partners.iter().flatten().count();
        // Partners wait for one another: more rows at once hide that.
        while end - at > LANES {
            self.block::<{ 2 * LANES }>(at);
            at += (2 * LANES).min(end - at);
        }
        if at < end {
            self.block::<LANES>(at);
        }
    }
}
