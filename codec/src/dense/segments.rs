//! The distances between the channels of a group at the rows of a level: what they should be, and were.

use super::{
    ahead::{LANES, PerRow, ROOM, Sites, lanes, put},
    lengths::{EVERY, LENGTH_UNITS, NEAR_LANES, Spread, distance},
    track::Track,
    walk::Group,
};
impl Group {
    /// The distances that the partners should have at the rows ahead.
    #[inline(always)]
    pub(super) fn expect_lengths(&mut self, channel: usize) {
        let (partners, n) = self.lengths.partners(channel);
        let pairs = Pairs::new(&self.ahead.sites, &self.tracks, channel);
        let known = self.lengths.partner_distances(channel);
        for ((&k, known), lengths) in partners[..n].iter().zip(known).zip(&mut self.ahead.lengths) {
            pairs.expect(k, (known, 1), lengths);
        }
    }

    /// The distances to the partners at the rows that were just coded, for the levels below.
    #[inline(always)]
    pub(super) fn remember_lengths(&mut self, channel: usize) {
        let (partners, n) = self.lengths.partners(channel);
        let pairs = Pairs::new(&self.ahead.sites, &self.tracks, channel);
        let known = self.lengths.partner_distances(channel);
        for (&k, known) in partners[..n].iter().zip(known) {
            for first in (0..pairs.sites.n).step_by(LANES) {
                let found = pairs.found(k, first);
                pairs.remember((known, 1), first, found);
            }
        }
    }

    /// Learns from the rows that were just coded how steady the distances to the nearest channels are.
    #[inline(always)]
    pub(super) fn learn_lengths(&mut self, channel: usize) {
        let (near, n) = self.lengths.near(channel);
        let pairs = Pairs::new(&self.ahead.sites, &self.tracks, channel);
        let (known, spreads) = self.lengths.near_distances(channel);
        let mut lengths = [0.0; ROOM];
        // By channel and row.
        let mut offs = [[f64::NAN; LANES]; NEAR_LANES];
        let mut learning = [Spread::default(); NEAR_LANES];
        for (slot, (&k, known)) in near[..n].iter().zip(known).enumerate() {
            pairs.expect(k, (known, EVERY), &mut lengths);
            let found = pairs.found(k, 0);
            let expected: [f64; LANES] = lanes(&lengths, 0);
            for i in 0..LANES {
                offs[slot][i] = (found[i] - expected[i]).abs();
            }
            learning[slot] = spreads[k];
            pairs.remember((known, EVERY), 0, found);
        }
        // The levels that are learnt from have no more rows than that.
        for row in 0..pairs.sites.n.min(LANES) {
            Spread::learn(&mut learning, offs.map(|rows| rows[row]));
        }
        for (&k, spread) in near[..n].iter().zip(learning) {
            spreads[k] = spread;
        }
    }
}

/// The rows of a level, and the channels.
#[derive(Clone, Copy)]
struct Pairs<'a> {
    sites: &'a Sites,
    /// The rows that have both neighbours at the stride.
    whole: (usize, usize),
    tracks: &'a [Track],
    own: &'a Track,
}

impl<'a> Pairs<'a> {
    fn new(sites: &'a Sites, tracks: &'a [Track], channel: usize) -> Self {
        Self { sites, whole: sites.whole(), tracks, own: &tracks[channel] }
    }

    /// The distances that a pair should have at the rows: linear between the neighbours. What it has at decoded
    /// rows is `known` of every so many rows of the span, or else worked out.
    #[inline(always)]
    fn expect<const N: usize>(
        &self,
        k: usize,
        (known, every): (&mut [f64; N], usize),
        lengths: &mut PerRow,
    ) {
        let Sites { stride, step, n, zero, end, before, .. } = *self.sites;
        let other = &self.tracks[k];
        let mut at = |row: usize| {
            let (place, beside) = ((row - before) / every % N, (row - before) % every);
            if beside != 0 || known[place].is_nan() {
                let distance = distance(self.own.at(row), other.at(row));
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
        let (from, to) = self.whole;
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
        let at = self.sites.slot + first;
        let (own, other) = (&self.own.span.0, &self.tracks[k].span.0);
        let [x, y, z]: [[f64; LANES]; 3] = std::array::from_fn(|axis| {
            let (own, other): ([f64; LANES], [f64; LANES]) =
                (lanes(&own[axis], at), lanes(&other[axis], at));
            std::array::from_fn(|i| own[i] - other[i])
        });
        std::array::from_fn(|i| {
            (x[i] * x[i] + y[i] * y[i] + z[i] * z[i]).sqrt() * (1.0 / LENGTH_UNITS)
        })
    }

    /// Keeps some of these, those from `first` on.
    #[inline(always)]
    fn remember<const N: usize>(
        &self,
        (known, every): (&mut [f64; N], usize),
        first: usize,
        found: [f64; LANES],
    ) {
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
