//! Segments of constant length: what the distance to another marker says.
//!
//! The distance between two markers of a segment changes slowly, however the segment turns; where it
//! stood at the neighbouring rows, it will about stand here. The expectation is moved along the line to
//! such a partner, by a share that is learnt: how much of the difference used to be true.

use crate::GROUP_CHANNELS;

use super::{
    SPAN,
    ahead::LANES,
    lattice::UNITS_PER_TOLERANCE,
    layout::{INTERPOLATED, KINDS},
};

/// Units of a length: lengths are in tolerances.
pub(super) const LENGTH_UNITS: f64 = UNITS_PER_TOLERANCE as f64;

/// Markers that a channel is held against, at most.
pub(super) const PARTNERS: usize = 3;
/// Earlier channels whose distance is followed: the nearest.
const NEAR: usize = 6;
/// As many side by side, and some to fill the last lanes.
pub(super) const NEAR_LANES: usize = NEAR.next_multiple_of(LANES);
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
pub(super) struct Spread {
    variance: f64,
    seen: f64,
}

impl Spread {
    /// Some pairs learn how far their distance was from where its neighbours in time put it; nothing where that is
    /// not known.
    #[inline(always)]
    pub(super) fn learn(pairs: &mut [Self; NEAR_LANES], offs: [f64; NEAR_LANES]) {
        for (pair, off) in pairs.iter_mut().zip(offs) {
            let Self { variance, seen } = *pair;
            let cut = if off < MAX_DIFFERENCE { off } else { MAX_DIFFERENCE };
            let rows = if seen < MEMORY_ROWS { seen } else { MEMORY_ROWS };
            let learnt = variance + (cut * cut - variance) / (rows + 1.0);
            pair.variance = if off.is_nan() { variance } else { learnt };
            pair.seen = if off.is_nan() { seen } else { seen + 1.0 };
        }
    }
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

/// The distances of two channels at the decoded rows of a span, and room up to a power of two; NaN where one of
/// them is not known.
pub(super) type SpanRows = [f64; 2 * SPAN];

/// The same at one row in so many, the rows of anchors and longer strides.
pub(super) type NearRows = [f64; 2 * SPAN / EVERY];
pub(super) const EVERY: usize = 8;

/// Everything of a group.
#[derive(Debug)]
pub(super) struct Lengths {
    spreads: Vec<Spread>,
    shares: Vec<[[Share; PARTNERS]; KINDS]>,
    near: Vec<([usize; NEAR], usize)>,
    partners: Vec<([usize; PARTNERS], usize)>,
    /// By channel and slot: with the partners, and with the near channels.
    partner_distances: Vec<SpanRows>,
    near_distances: Vec<NearRows>,
}

/// In tolerances; NaN where one of them is.
#[inline(always)]
pub(super) fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| a[axis] - b[axis]);
    (x * x + y * y + z * z).sqrt() / LENGTH_UNITS
}

impl Lengths {
    pub(super) fn new() -> Self {
        Self {
            spreads: vec![Spread::default(); GROUP_CHANNELS * GROUP_CHANNELS],
            shares: vec![Default::default(); GROUP_CHANNELS],
            near: vec![Default::default(); GROUP_CHANNELS],
            partners: vec![Default::default(); GROUP_CHANNELS],
            partner_distances: vec![[f64::NAN; _]; GROUP_CHANNELS * PARTNERS],
            near_distances: vec![[f64::NAN; _]; GROUP_CHANNELS * NEAR],
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
        self.near[j] = smallest(0..j, |k| -nearness(k), &self.near[j]);
        let spreads = &self.spreads[j * GROUP_CHANNELS..(j + 1) * GROUP_CHANNELS];
        let steady = (0..j).filter(|&k| spreads[k].seen >= LEAST_SEEN);
        let mut partners = smallest(steady, |k| spreads[k].variance, &self.partners[j]);
        let (near, n_near) = self.near[j];
        if partners.1 == 0 && n_near > 0 && nearness(near[0]) > 0.0 {
            partners.0[0] = near[0];
            partners.1 = 1;
        }
        self.partners[j] = partners;
        self.partner_distances(j).iter_mut().for_each(|rows| rows[..=SPAN].fill(f64::NAN));
        self.near_distances(j).0.fill([f64::NAN; _]);
    }

    /// With the partners of channel `j`, by slot.
    pub(super) fn partner_distances(&mut self, j: usize) -> &mut [SpanRows] {
        &mut self.partner_distances[j * PARTNERS..(j + 1) * PARTNERS]
    }

    /// With the near channels of channel `j`, by slot; and with every channel how steady the distance is.
    pub(super) fn near_distances(&mut self, j: usize) -> (&mut [NearRows], &mut [Spread]) {
        let spreads = &mut self.spreads[j * GROUP_CHANNELS..(j + 1) * GROUP_CHANNELS];
        (&mut self.near_distances[j * NEAR..(j + 1) * NEAR], spreads)
    }

    /// The shares of a channel's partners in one kind of row.
    #[inline(always)]
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
}

/// The candidates with the smallest values, in order, the first of equals first; and how many. Those that were it
/// `before` are candidates.
fn smallest<const N: usize>(
    candidates: impl Iterator<Item = usize>,
    value: impl Fn(usize) -> f64,
    before: &([usize; N], usize),
) -> ([usize; N], usize) {
    let (mut found, mut values, mut n) = ([0; N], [f64::INFINITY; N], 0);
    // They are most often the same again: what is above all of them is not among the first.
    let most = match before.1 == N {
        true => before.0.iter().fold(f64::NEG_INFINITY, |most, &k| most.max(value(k))),
        false => f64::INFINITY,
    };
    for candidate in candidates {
        let own = value(candidate);
        if own > most || n == N && own >= values[N - 1] {
            continue;
        }
        // Up to where it belongs: one place, or the last one's, is free.
        let mut place = n.min(N - 1);
        n = (n + 1).min(N);
        while place > 0 && own < values[place - 1] {
            (found[place], values[place]) = (found[place - 1], values[place - 1]);
            place -= 1;
        }
        (found[place], values[place]) = (candidate, own);
    }
    (found, n)
}
