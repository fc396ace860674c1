//! Segment lengths: the distances between the markers of a group, and which of them are steady.
//!
//! The distance between two markers of one body segment hardly changes when the segment moves and turns, so the
//! distances at neighbouring rows predict the distance at a row between. The steadiest pairs are found by the variance
//! of the error of that prediction. Following distances to up to three partners gains 3 %.

use std::ops::Range;

use super::{
    SPAN,
    lattice::{LANES, Points, UNITS_PER_TOLERANCE, lanes, put},
    level_prediction::{DecodedRun, LevelLayout, PADDED_ROWS, PerRow},
    track::Track,
};
use crate::{GROUP_CHANNELS, block::squared_distance};

/// Maximum number of partners of a channel; two instead of three lose 0.3 %.
pub(super) const PARTNERS: usize = 3;
/// Number of nearest earlier channels whose distances are followed. All pairs instead of six channels gain 0.0 %,
/// eight channels lose 0.1 %.
const NEAR: usize = 6;
/// [`NEAR`], padded to whole vectors.
const NEAR_LANES: usize = NEAR.next_multiple_of(LANES);
/// Minimum number of errors of a pair before its channels may be partners.
const N_ERRORS_MIN: f64 = 6.0;
/// Memory of the variance of a distance, in rows.
const MEMORY_ROWS: f64 = 60.0;
/// Errors in distance are clamped to this, in tolerances.
pub(super) const MAX_DIFFERENCE: f64 = 50.0;

/// How well the distance of a pair is predicted by its neighbours in time.
#[derive(Debug, Clone, Copy, Default)]
struct Spread {
    /// Mean squared error, in squared tolerances.
    variance: f64,
    /// Number of errors so far.
    n_errors: f64,
}

impl Spread {
    /// Updates pairs with the absolute errors of their predicted distances; NaN, where one is unknown, changes nothing.
    #[inline(always)]
    fn update(pairs: &mut [Self; NEAR_LANES], errors: [f64; NEAR_LANES]) {
        for (pair, error) in pairs.iter_mut().zip(errors) {
            let Self { variance, n_errors } = *pair;
            let cut = if error < MAX_DIFFERENCE { error } else { MAX_DIFFERENCE };
            let rows = if n_errors < MEMORY_ROWS { n_errors } else { MEMORY_ROWS };
            let learnt = variance + (cut * cut - variance) / (rows + 1.0);
            pair.variance = if error.is_nan() { variance } else { learnt };
            pair.n_errors = if error.is_nan() { n_errors } else { n_errors + 1.0 };
        }
    }
}

/// Up to `N` channels in order of preference.
#[derive(Debug, Clone, Copy)]
pub(super) struct ChannelList<const N: usize> {
    channels: [usize; N],
    n: usize,
}

impl<const N: usize> ChannelList<N> {
    const NONE: Self = Self { channels: [0; N], n: 0 };

    pub(super) fn channels(&self) -> &[usize] {
        &self.channels[..self.n]
    }

    /// The `N` candidates with the smallest values, in ascending order; ties keep the order of the candidates. The
    /// channels in `before`, the previous result, must be candidates too.
    fn smallest(
        candidates: impl Iterator<Item = usize>,
        value: impl Fn(usize) -> f64,
        before: &Self,
    ) -> Self {
        let Self { mut channels, mut n } = Self::NONE;
        let mut values = [f64::INFINITY; N];
        // The result is most often the same again: candidates above all previous values cannot be among the first.
        let most = match before.n == N {
            true => before.channels.iter().fold(f64::NEG_INFINITY, |most, &k| most.max(value(k))),
            false => f64::INFINITY,
        };
        for candidate in candidates {
            let own = value(candidate);
            if own > most || n == N && own >= values[N - 1] {
                continue;
            }
            // Insertion sort; a full list loses its last entry.
            let mut place = n.min(N - 1);
            n = (n + 1).min(N);
            while place > 0 && own < values[place - 1] {
                (channels[place], values[place]) = (channels[place - 1], values[place - 1]);
                place -= 1;
            }
            (channels[place], values[place]) = (candidate, own);
        }
        Self { channels, n }
    }
}

/// The distances of two channels at the decoded rows of a span in tolerances, padded to a power of two; NaN where one
/// of the channels is unknown.
type SpanRows = [f64; 2 * SPAN];

/// The distances of a channel to its partners.
pub(super) type PartnerDistances = [SpanRows; PARTNERS];

/// The distances of two channels at every eighth row, those of anchors and of the strides 8 and more.
type NearRows = [f64; 2 * SPAN / 8];

/// The distances of a group, and their statistics.
#[derive(Debug)]
pub(super) struct SegmentLengths {
    /// Spreads by channel and channel.
    spreads: Vec<Spread>,
    near: Vec<ChannelList<NEAR>>,
    partners: Vec<ChannelList<PARTNERS>>,
    /// Distances to the partners and to the near channels, by channel and slot.
    partner_distances: Vec<PartnerDistances>,
    near_distances: Vec<NearRows>,
    /// Predicted distances to the partners at the rows of a level in tolerances, by slot; NaN where unknown.
    pub(super) expected: [PerRow; PARTNERS],
}

impl SegmentLengths {
    pub(super) fn new() -> Self {
        Self {
            spreads: vec![Spread::default(); GROUP_CHANNELS * GROUP_CHANNELS],
            near: vec![ChannelList::NONE; GROUP_CHANNELS],
            partners: vec![ChannelList::NONE; GROUP_CHANNELS],
            partner_distances: vec![[[f64::NAN; _]; _]; GROUP_CHANNELS],
            near_distances: vec![[f64::NAN; _]; GROUP_CHANNELS * NEAR],
            expected: [[f64::NAN; PADDED_ROWS]; PARTNERS],
        }
    }

    pub(super) fn reset(&mut self) {
        self.spreads.fill(Spread::default());
        self.near.fill(ChannelList::NONE);
        self.partners.fill(ChannelList::NONE);
    }

    pub(super) fn partner_distances(&self, j: usize) -> &PartnerDistances {
        &self.partner_distances[j]
    }

    pub(super) fn partner_distances_mut(&mut self, j: usize) -> &mut PartnerDistances {
        &mut self.partner_distances[j]
    }

    /// Copies the statistics of the distances of `n` channels.
    pub(super) fn follow(&mut self, other: &Self, n: usize) {
        for j in 0..n {
            let pairs = j * GROUP_CHANNELS..j * GROUP_CHANNELS + j;
            self.spreads[pairs.clone()].copy_from_slice(&other.spreads[pairs]);
        }
        self.near[..n].copy_from_slice(&other.near[..n]);
        self.partners[..n].copy_from_slice(&other.partners[..n]);
    }

    /// The partners of channel `j`, by slot.
    pub(super) fn partners(&self, j: usize) -> ChannelList<PARTNERS> {
        self.partners[j]
    }

    /// Chooses the near channels and the partners of channel `j` for a span: those at the steadiest distances, or else
    /// the nearest channel. `nearness` is the prior correlation with a channel.
    pub(super) fn choose_partners(&mut self, j: usize, nearness: impl Fn(usize) -> f64) {
        let near = ChannelList::smallest(0..j, |k| -nearness(k), &self.near[j]);
        let spreads = &self.spreads[j * GROUP_CHANNELS..(j + 1) * GROUP_CHANNELS];
        let steady = (0..j).filter(|&k| spreads[k].n_errors >= N_ERRORS_MIN);
        let mut partners =
            ChannelList::smallest(steady, |k| spreads[k].variance, &self.partners[j]);
        if let (0, Some(&nearest)) = (partners.n, near.channels().first())
            && nearness(nearest) > 0.0
        {
            partners.channels[0] = nearest;
            partners.n = 1;
        }
        (self.near[j], self.partners[j]) = (near, partners);
        self.partner_distances[j].iter_mut().for_each(|rows| rows[..=SPAN].fill(f64::NAN));
        self.near_distances[j * NEAR..(j + 1) * NEAR].fill([f64::NAN; _]);
    }

    /// Predicts the distances to the partners at the rows of a level.
    #[inline(always)]
    pub(super) fn expect(&mut self, layout: &LevelLayout, tracks: &[Track]) {
        let (pairs, j) = (PairDistances::new(layout, tracks), layout.run.channel);
        let known = &mut self.partner_distances[j];
        let partners = self.partners[j];
        for ((&k, known), lengths) in partners.channels().iter().zip(known).zip(&mut self.expected)
        {
            pairs.expect(k, known, lengths);
        }
    }

    /// Stores the distances to the partners at the rows that were just coded, for the levels below.
    #[inline(always)]
    pub(super) fn remember(&mut self, layout: &LevelLayout, tracks: &[Track]) {
        let (pairs, j) = (PairDistances::new(layout, tracks), layout.run.channel);
        let known = &mut self.partner_distances[j];
        for (&k, known) in self.partners[j].channels().iter().zip(known) {
            for first in (0..layout.n).step_by(LANES) {
                pairs.remember(known, first, pairs.measured(k, first));
            }
        }
    }

    /// Updates the spreads of the distances to the near channels with the rows that were just coded.
    #[inline(always)]
    pub(super) fn learn(&mut self, layout: &LevelLayout, tracks: &[Track]) {
        let (pairs, j) = (PairDistances::new(layout, tracks), layout.run.channel);
        let near = self.near[j];
        let spreads = &mut self.spreads[j * GROUP_CHANNELS..(j + 1) * GROUP_CHANNELS];
        let known = &mut self.near_distances[j * NEAR..(j + 1) * NEAR];
        let mut lengths = [0.0; PADDED_ROWS];
        // Absolute errors by near channel and row.
        let mut errors = [[f64::NAN; LANES]; NEAR_LANES];
        let mut learning = [Spread::default(); NEAR_LANES];
        for (slot, (&k, known)) in near.channels().iter().zip(known).enumerate() {
            pairs.expect(k, known, &mut lengths);
            let measured = pairs.measured(k, 0);
            let expected: [f64; LANES] = lanes(&lengths, 0);
            for i in 0..LANES {
                errors[slot][i] = (measured[i] - expected[i]).abs();
            }
            learning[slot] = spreads[k];
            pairs.remember(known, 0, measured);
        }
        // Anchors and the strides 8 and more have at most four rows.
        for row in 0..layout.n.min(LANES) {
            Spread::update(&mut learning, errors.map(|rows| rows[row]));
        }
        for (&k, spread) in near.channels().iter().zip(learning) {
            spreads[k] = spread;
        }
    }
}

/// The vectors from the points of a channel, from `slot` on, to the points `to`; and their lengths, in units.
#[inline(always)]
pub(super) fn offsets_from(
    from: &Track,
    slot: usize,
    to: Points<LANES>,
) -> (Points<LANES>, [f64; LANES]) {
    let mut off = to;
    for (off, from) in off.iter_mut().zip(&from.span) {
        let from: [f64; LANES] = lanes(from, slot);
        for i in 0..LANES {
            off[i] -= from[i];
        }
    }
    let mut units = [0.0; LANES];
    for i in 0..LANES {
        let [x, y, z] = [off[0][i], off[1][i], off[2][i]];
        units[i] = (x * x + y * y + z * z).sqrt();
    }
    (off, units)
}

/// The rows of a level of one channel, for distances to other channels.
struct PairDistances<'a> {
    layout: &'a LevelLayout,
    /// The rows whose neighbours on both sides are exactly a stride away.
    interior: Range<usize>,
    tracks: &'a [Track],
    own: &'a Track,
}

impl<'a> PairDistances<'a> {
    fn new(layout: &'a LevelLayout, tracks: &'a [Track]) -> Self {
        Self { layout, interior: layout.interior(), tracks, own: &tracks[layout.run.channel] }
    }

    /// Predicts the distances to channel `k` at the rows, linearly between the neighbours. The distances at decoded
    /// rows are read from `known`, which has one for every `2 * SPAN / N` rows, or else computed.
    #[inline(always)]
    fn expect<const N: usize>(&self, k: usize, known: &mut [f64; N], lengths: &mut PerRow) {
        let every = const { 2 * SPAN / N };
        let LevelLayout { stride, step, n, run: DecodedRun { zero, end, .. }, before, .. } =
            *self.layout;
        let other = &self.tracks[k];
        let mut at = |row: usize| {
            let (place, remainder) = ((row - before) / every % N, (row - before) % every);
            if remainder != 0 || known[place].is_nan() {
                let units = squared_distance(self.own.points[row], other.points[row]).sqrt();
                let distance = units / UNITS_PER_TOLERANCE;
                if remainder == 0 {
                    known[place] = distance;
                }
                return distance;
            }
            known[place]
        };
        let first = at(zero);
        if stride == 0 {
            lengths[0] = first;
            return;
        }
        let last = at(end);
        let Range { start: from, end: to } = self.interior;
        let mut place = (self.layout.at(from) - stride - before) / every;
        let spacing = step / every;
        for first in (from..to).step_by(LANES) {
            let mut nodes = [0.0; LANES + 1];
            for (i, node) in nodes.iter_mut().enumerate() {
                *node = known[(place + i * spacing) % N];
            }
            place += LANES * spacing;
            let mut middle = [0.0; LANES];
            for i in 0..LANES {
                middle[i] = nodes[i] + (nodes[i + 1] - nodes[i]) * 0.5;
            }
            put(lengths, first, middle);
        }
        for i in (0..from).chain(to..n) {
            let (left, right) = self.layout.neighbours(i);
            let at = |row: usize, end: usize, at_end: f64| {
                if row == end { at_end } else { known[(row - before) / every % N] }
            };
            let (first, last) = (at(left, zero, first), at(right, end, last));
            let (before, whole) = (self.layout.at(i) - left, right - left);
            lengths[i] = first + (last - first) * before as f64 / whole as f64;
        }
    }

    /// The distances to channel `k` at the decoded rows from index `first` on, in tolerances.
    #[inline(always)]
    fn measured(&self, k: usize, first: usize) -> [f64; LANES] {
        let slot = self.layout.slot + first;
        let mut own = [[0.0; LANES]; 3];
        for (own, axis) in own.iter_mut().zip(&self.own.span) {
            *own = lanes(axis, slot);
        }
        let (_, units) = offsets_from(&self.tracks[k], slot, own);
        units.map(|units| units * (1.0 / UNITS_PER_TOLERANCE))
    }

    /// Stores the distances of the rows from index `first` on in `known`.
    #[inline(always)]
    fn remember<const N: usize>(&self, known: &mut [f64; N], first: usize, measured: [f64; LANES]) {
        let every = const { 2 * SPAN / N };
        let LevelLayout { step, n, before, .. } = *self.layout;
        let row = self.layout.at(first) - before;
        if !row.is_multiple_of(every) {
            return;
        }
        let (mut place, step) = (row / every, step / every);
        for measured in &measured[..LANES.min(n - first)] {
            known[place % N] = *measured;
            place += step;
        }
    }
}
