//! Segments of constant length: what the distance to another marker says.
//!
//! The distance between two markers of a segment changes slowly, however the segment turns; where it
//! stood at the neighbouring rows, it will about stand here. The expectation is moved along the line to
//! such a partner, by a share that is learnt: how much of the difference used to be true.

use crate::GROUP_CHANNELS;

use super::{
    SPAN,
    lattice::UNITS_PER_TOLERANCE,
    layout::{INTERPOLATED, KINDS},
};

/// Markers that a channel is held against, at most.
pub(super) const PARTNERS: usize = 3;
/// Earlier channels whose distance is followed: the nearest.
const NEAR: usize = 6;
/// Distances seen before a pair counts.
const LEAST_SEEN: f64 = 6.0;
/// How far back the spread of a distance remembers, in rows.
const MEMORY_ROWS: f64 = 60.0;
/// Differences count up to this, in tolerances.
const MAX_DIFFERENCE: f64 = 50.0;
/// What a row leaves of the sums of the share, and what keeps it small at first.
const DECAY: f64 = 0.98;
const RIDGE: f64 = 1.0;
/// Shares below this are not used.
pub(super) const LEAST_SHARE: f64 = 0.05;

/// How well a pair's distance follows from its neighbours in time.
#[derive(Debug, Clone, Copy, Default)]
struct Spread {
    variance: f64,
    seen: f64,
}

/// One share: sums of the squared difference, and of difference times truth, and what follows.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Share {
    squares: f64,
    products: f64,
    share: f64,
    /// The share does not follow from the sums yet: that is worked out when it is asked for.
    is_stale: bool,
}

impl Share {
    /// Learns how much of a difference was true, in tolerances.
    #[inline(always)]
    pub(super) fn learn(&mut self, difference: f64, truth: f64) {
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
    fn share(&mut self) -> f64 {
        if self.is_stale {
            // Those below nothing are not used.
            self.share = (self.products / (self.squares + RIDGE)).min(1.0);
            self.is_stale = false;
        }
        self.share
    }
}

/// Everything of a group.
#[derive(Debug)]
pub(super) struct Lengths {
    spreads: Vec<Spread>,
    shares: Vec<[[Share; PARTNERS]; KINDS]>,
    near: Vec<([usize; NEAR], usize)>,
    partners: Vec<([usize; PARTNERS], usize)>,
    /// Distances to the partners at the rows of the span, by channel and slot; NaN where one is not known.
    distances: Vec<[f64; SPAN + 1]>,
}

/// In tolerances; NaN where one of them is.
#[inline(always)]
pub(super) fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| a[axis] - b[axis]);
    (x * x + y * y + z * z).sqrt() / UNITS_PER_TOLERANCE as f64
}

impl Lengths {
    pub(super) fn new() -> Self {
        Self {
            spreads: vec![Spread::default(); GROUP_CHANNELS * GROUP_CHANNELS],
            shares: vec![Default::default(); GROUP_CHANNELS],
            near: vec![Default::default(); GROUP_CHANNELS],
            partners: vec![Default::default(); GROUP_CHANNELS],
            distances: vec![[f64::NAN; SPAN + 1]; GROUP_CHANNELS * PARTNERS],
        }
    }

    pub(super) fn reset(&mut self) {
        self.spreads.fill(Spread::default());
        self.shares.fill(Default::default());
        self.near.fill(Default::default());
        self.partners.fill(Default::default());
    }

    /// The partners of channel `j`.
    pub(super) fn partners(&self, j: usize) -> ([usize; PARTNERS], usize) {
        self.partners[j]
    }

    /// The channels whose distance to channel `j` is followed.
    pub(super) fn near(&self, j: usize) -> ([usize; NEAR], usize) {
        self.near[j]
    }

    /// Chooses partners for a span: the steadiest distances, or else the nearest channel.
    pub(super) fn choose(&mut self, j: usize, nearness: impl Fn(usize) -> f64) {
        self.near[j] = smallest(0..j, |k| -nearness(k));
        let spreads = &self.spreads[j * GROUP_CHANNELS..(j + 1) * GROUP_CHANNELS];
        let steady = (0..j).filter(|&k| spreads[k].seen >= LEAST_SEEN);
        let mut partners = smallest(steady, |k| spreads[k].variance);
        let (near, n_near) = self.near[j];
        if partners.1 == 0 && n_near > 0 && nearness(near[0]) > 0.0 {
            partners.0[0] = near[0];
            partners.1 = 1;
        }
        self.partners[j] = partners;
        self.distances[j * PARTNERS..(j + 1) * PARTNERS].fill([f64::NAN; SPAN + 1]);
    }

    /// The distances to a partner at the rows of the span.
    pub(super) fn distances(&mut self, j: usize, slot: usize) -> &mut [f64; SPAN + 1] {
        &mut self.distances[j * PARTNERS + slot]
    }

    /// The shares of a channel's partners in one kind of row.
    pub(super) fn shares(&mut self, j: usize, kind: usize) -> [f64; PARTNERS] {
        self.shares[j][kind].each_mut().map(Share::share)
    }

    /// What they follow from.
    pub(super) fn shares_mut(&mut self, j: usize, kind: usize) -> &mut [Share; PARTNERS] {
        &mut self.shares[j][kind]
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

    /// Learns how far a pair's distance was from where its neighbours in time put it.
    pub(super) fn learn(&mut self, j: usize, k: usize, distance: f64, length: f64) {
        let spread = &mut self.spreads[j * GROUP_CHANNELS + k];
        let off = (distance - length).abs().min(MAX_DIFFERENCE);
        spread.variance += (off * off - spread.variance) / (spread.seen.min(MEMORY_ROWS) + 1.0);
        spread.seen += 1.0;
    }
}

/// The candidates with the smallest values, in order, the first of equals first; and how many.
fn smallest<const N: usize>(
    candidates: impl Iterator<Item = usize>,
    value: impl Fn(usize) -> f64,
) -> ([usize; N], usize) {
    let (mut found, mut n) = ([0; N], 0);
    for candidate in candidates {
        let place = (0..n).find(|&i| value(candidate) < value(found[i])).unwrap_or(n);
        if place == N {
            continue;
        }
        n = (n + 1).min(N);
        found[place..n].rotate_right(1);
        found[place] = candidate;
    }
    (found, n)
}
