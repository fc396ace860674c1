//! Segments of constant length: the distances between the channels of a group, what they should be and were.
//!
//! The distance between two markers of a segment changes slowly, however the segment turns; where it
//! stood at the neighbouring rows, it will about stand here.

use std::ops::Range;

use super::{
    SPAN,
    level_prediction::{Decoded, PerRow, ROOM, Sites},
    points::{LANES, Points, UNITS_PER_TOLERANCE, lanes, put},
    track::Track,
};
use crate::{GROUP_CHANNELS, bound::squared_distance};

/// Markers that a channel is held against, at most.
pub(super) const PARTNERS: usize = 3;
/// Earlier channels whose distance is followed: the nearest.
const NEAR: usize = 6;
/// As many side by side, and some to fill the last lanes.
const NEAR_LANES: usize = NEAR.next_multiple_of(LANES);
/// Distances seen before a pair counts.
const LEAST_SEEN: f64 = 6.0;
/// How far back the spread of a distance remembers, in rows.
const MEMORY_ROWS: f64 = 60.0;
/// Differences count up to this, in tolerances.
pub(super) const MAX_DIFFERENCE: f64 = 50.0;

/// How well a pair's distance follows from its neighbours in time.
#[derive(Debug, Clone, Copy, Default)]
struct Spread {
    variance: f64,
    seen: f64,
}

impl Spread {
    /// Some pairs learn how far their distance was from where its neighbours in time put it; nothing where that is
    /// not known.
    #[inline(always)]
    fn learn(pairs: &mut [Self; NEAR_LANES], offs: [f64; NEAR_LANES]) {
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

/// Some channels, in order.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chosen<const N: usize> {
    channels: [usize; N],
    n: usize,
}

impl<const N: usize> Chosen<N> {
    const NONE: Self = Self { channels: [0; N], n: 0 };

    pub(super) fn channels(&self) -> &[usize] {
        &self.channels[..self.n]
    }

    /// The candidates with the smallest values, the first of equals first. Those that were it `before` are candidates.
    fn smallest(
        candidates: impl Iterator<Item = usize>,
        value: impl Fn(usize) -> f64,
        before: &Self,
    ) -> Self {
        let Self { mut channels, mut n } = Self::NONE;
        let mut values = [f64::INFINITY; N];
        // They are most often the same again: what is above all of them is not among the first.
        let most = match before.n == N {
            true => before.channels.iter().fold(f64::NEG_INFINITY, |most, &k| most.max(value(k))),
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
                (channels[place], values[place]) = (channels[place - 1], values[place - 1]);
                place -= 1;
            }
            (channels[place], values[place]) = (candidate, own);
        }
        Self { channels, n }
    }
}

/// The distances of two channels at the decoded rows of a span, and room up to a power of two; NaN where one of
/// them is not known.
type SpanRows = [f64; 2 * SPAN];

/// The same at one row in eight, the rows of anchors and longer strides.
type NearRows = [f64; 2 * SPAN / 8];

/// Everything of a group.
#[derive(Debug)]
pub(super) struct SegmentLengths {
    /// By channel and channel.
    spreads: Vec<Spread>,
    near: Vec<Chosen<NEAR>>,
    partners: Vec<Chosen<PARTNERS>>,
    /// By channel and slot: with the partners, and with the near channels.
    partner_distances: Vec<SpanRows>,
    near_distances: Vec<NearRows>,
    /// The distances that the partners should have at the rows of a level; NaN where nothing says so.
    pub(super) expected: [PerRow; PARTNERS],
}

impl SegmentLengths {
    pub(super) fn new() -> Self {
        Self {
            spreads: vec![Spread::default(); GROUP_CHANNELS * GROUP_CHANNELS],
            near: vec![Chosen::NONE; GROUP_CHANNELS],
            partners: vec![Chosen::NONE; GROUP_CHANNELS],
            partner_distances: vec![[f64::NAN; _]; GROUP_CHANNELS * PARTNERS],
            near_distances: vec![[f64::NAN; _]; GROUP_CHANNELS * NEAR],
            expected: [[f64::NAN; ROOM]; PARTNERS],
        }
    }

    pub(super) fn reset(&mut self) {
        self.spreads.fill(Spread::default());
        self.near.fill(Chosen::NONE);
        self.partners.fill(Chosen::NONE);
    }

    /// The partners of channel `j`, by slot.
    pub(super) fn partners(&self, j: usize) -> Chosen<PARTNERS> {
        self.partners[j]
    }

    /// Chooses partners for a span: the steadiest distances, or else the nearest channel.
    pub(super) fn choose(&mut self, j: usize, nearness: impl Fn(usize) -> f64) {
        let near = Chosen::smallest(0..j, |k| -nearness(k), &self.near[j]);
        let spreads = &self.spreads[j * GROUP_CHANNELS..(j + 1) * GROUP_CHANNELS];
        let steady = (0..j).filter(|&k| spreads[k].seen >= LEAST_SEEN);
        let mut partners = Chosen::smallest(steady, |k| spreads[k].variance, &self.partners[j]);
        if let (0, Some(&nearest)) = (partners.n, near.channels().first())
            && nearness(nearest) > 0.0
        {
            partners.channels[0] = nearest;
            partners.n = 1;
        }
        (self.near[j], self.partners[j]) = (near, partners);
        let distances = &mut self.partner_distances[j * PARTNERS..(j + 1) * PARTNERS];
        distances.iter_mut().for_each(|rows| rows[..=SPAN].fill(f64::NAN));
        self.near_distances[j * NEAR..(j + 1) * NEAR].fill([f64::NAN; _]);
    }

    /// Works out the distances that the partners should have at the rows of a level.
    #[inline(always)]
    pub(super) fn expect(&mut self, sites: &Sites, tracks: &[Track]) {
        let (pairs, j) = (Pairs::new(sites, tracks), sites.run.channel);
        let known = &mut self.partner_distances[j * PARTNERS..(j + 1) * PARTNERS];
        let partners = self.partners[j];
        for ((&k, known), lengths) in partners.channels().iter().zip(known).zip(&mut self.expected)
        {
            pairs.expect(k, known, lengths);
        }
    }

    /// Remembers the distances to the partners at the rows that were just coded, for the levels below.
    #[inline(always)]
    pub(super) fn remember(&mut self, sites: &Sites, tracks: &[Track]) {
        let (pairs, j) = (Pairs::new(sites, tracks), sites.run.channel);
        let known = &mut self.partner_distances[j * PARTNERS..(j + 1) * PARTNERS];
        for (&k, known) in self.partners[j].channels().iter().zip(known) {
            for first in (0..sites.n).step_by(LANES) {
                pairs.remember(known, first, pairs.found(k, first));
            }
        }
    }

    /// Learns from the rows that were just coded how steady the distances to the nearest channels are.
    #[inline(always)]
    pub(super) fn learn(&mut self, sites: &Sites, tracks: &[Track]) {
        let (pairs, j) = (Pairs::new(sites, tracks), sites.run.channel);
        let near = self.near[j];
        let spreads = &mut self.spreads[j * GROUP_CHANNELS..(j + 1) * GROUP_CHANNELS];
        let known = &mut self.near_distances[j * NEAR..(j + 1) * NEAR];
        let mut lengths = [0.0; ROOM];
        // By channel and row.
        let mut offs = [[f64::NAN; LANES]; NEAR_LANES];
        let mut learning = [Spread::default(); NEAR_LANES];
        for (slot, (&k, known)) in near.channels().iter().zip(known).enumerate() {
            pairs.expect(k, known, &mut lengths);
            let found = pairs.found(k, 0);
            let expected: [f64; LANES] = lanes(&lengths, 0);
            for i in 0..LANES {
                offs[slot][i] = (found[i] - expected[i]).abs();
            }
            learning[slot] = spreads[k];
            pairs.remember(known, 0, found);
        }
        // The levels that are learnt from have no more rows than that.
        for row in 0..sites.n.min(LANES) {
            Spread::learn(&mut learning, offs.map(|rows| rows[row]));
        }
        for (&k, spread) in near.channels().iter().zip(learning) {
            spreads[k] = spread;
        }
    }
}

/// From the points of a channel's span at some places, from `slot` on, to others; and how far that is, in units.
#[inline(always)]
pub(super) fn away(from: &Track, slot: usize, to: Points<LANES>) -> (Points<LANES>, [f64; LANES]) {
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

/// The rows of a level, and the channels.
struct Pairs<'a> {
    sites: &'a Sites,
    /// The rows that have both neighbours at the stride.
    whole: Range<usize>,
    tracks: &'a [Track],
    own: &'a Track,
}

impl<'a> Pairs<'a> {
    fn new(sites: &'a Sites, tracks: &'a [Track]) -> Self {
        Self { sites, whole: sites.whole(), tracks, own: &tracks[sites.run.channel] }
    }

    /// The distances that a pair should have at the rows: linear between the neighbours. What it has at decoded
    /// rows is `known`, of every so many rows of the span, or else worked out.
    #[inline(always)]
    fn expect<const N: usize>(&self, k: usize, known: &mut [f64; N], lengths: &mut PerRow) {
        let every = const { 2 * SPAN / N };
        let Sites { stride, step, n, run: Decoded { zero, end, .. }, before, .. } = *self.sites;
        let other = &self.tracks[k];
        let mut at = |row: usize| {
            let (place, beside) = ((row - before) / every % N, (row - before) % every);
            if beside != 0 || known[place].is_nan() {
                let units = squared_distance(self.own.points[row], other.points[row]).sqrt();
                let distance = units / UNITS_PER_TOLERANCE;
                if beside == 0 {
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
        let Range { start: from, end: to } = self.whole;
        let mut place = (self.sites.at(from) - stride - before) / every;
        let beside = step / every;
        for first in (from..to).step_by(LANES) {
            let mut nodes = [0.0; LANES + 1];
            for (i, node) in nodes.iter_mut().enumerate() {
                *node = known[(place + i * beside) % N];
            }
            place += LANES * beside;
            let mut middle = [0.0; LANES];
            for i in 0..LANES {
                middle[i] = nodes[i] + (nodes[i + 1] - nodes[i]) * 0.5;
            }
            put(lengths, first, middle);
        }
        for i in (0..from).chain(to..n) {
            let (left, right) = self.sites.neighbours(i);
            let at = |row: usize, end: usize, at_end: f64| {
                if row == end { at_end } else { known[(row - before) / every % N] }
            };
            let (first, last) = (at(left, zero, first), at(right, end, last));
            let (before, whole) = (self.sites.at(i) - left, right - left);
            lengths[i] = first + (last - first) * before as f64 / whole as f64;
        }
    }

    /// The distances that it has at some of the rows, now that they are decoded.
    #[inline(always)]
    fn found(&self, k: usize, first: usize) -> [f64; LANES] {
        let slot = self.sites.slot + first;
        let mut own = [[0.0; LANES]; 3];
        for (own, axis) in own.iter_mut().zip(&self.own.span) {
            *own = lanes(axis, slot);
        }
        let (_, units) = away(&self.tracks[k], slot, own);
        units.map(|units| units * (1.0 / UNITS_PER_TOLERANCE))
    }

    /// Keeps some of these, those from `first` on.
    #[inline(always)]
    fn remember<const N: usize>(&self, known: &mut [f64; N], first: usize, found: [f64; LANES]) {
        let every = const { 2 * SPAN / N };
        let Sites { step, n, before, .. } = *self.sites;
        let row = self.sites.at(first) - before;
        if !row.is_multiple_of(every) {
            return;
        }
        let (mut place, step) = (row / every, step / every);
        for found in &found[..LANES.min(n - first)] {
            known[place % N] = *found;
            place += step;
        }
    }
}
