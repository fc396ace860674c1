//! The search for an order of the channels of a group in which `dense` needs fewer bytes: each channel is predicted from
//! those before it, so their order decides what each of them can know.
//!
//! No rule gives a good order (docs/codec.md, "Order of channels"): orders are coded, first many at the least effort,
//! then the best of them and more at the greatest. The search starts no threads: it names the orders of a round, and the
//! caller returns their sizes. The orders of a round depend on the rounds before it only, so any number of threads finds
//! the same.

use mocapd_codec::Effort;

/// Orders that are coded in a round: a few threads have work, and the next round still begins from the best of them.
const ROUND_ORDERS: usize = 8;

/// Most rounds at the least effort: 192 codings, less than two at the greatest.
const COARSE_ROUNDS_MAX: usize = 24;

/// Most rounds at the greatest effort: 64 codings.
const FINE_ROUNDS_MAX: usize = 8;

/// A stage ends when three rounds in a row save less than a share of 1/1024 each.
const WEAK_ROUNDS_MAX: usize = 3;
const WEAK_SHARE: u64 = 1024;

/// An order of the channels of a group: by place, the channel in the source.
pub type GroupOrder = Vec<u8>;

/// The search for one group.
#[derive(Debug)]
pub struct OrderSearch {
    /// Whether the greatest effort is used.
    is_fine: bool,
    best: GroupOrder,
    /// `None` before the first round of a stage.
    best_bytes: Option<u64>,
    /// The orders of the round.
    round: Vec<GroupOrder>,
    n_rounds: usize,
    n_weak: usize,
    /// The best orders so far with their bytes, the best first.
    found: Vec<(u64, GroupOrder)>,
    random: Random,
}

impl OrderSearch {
    /// Most codings at the least and at the greatest effort.
    pub const CODINGS_MAX: [usize; 2] =
        [COARSE_ROUNDS_MAX * ROUND_ORDERS, FINE_ROUNDS_MAX * ROUND_ORDERS];

    /// A search for `n_channels` channels.
    #[must_use]
    pub fn new(n_channels: usize) -> Self {
        Self {
            is_fine: false,
            best: own_order(n_channels),
            best_bytes: None,
            round: Vec::new(),
            n_rounds: 0,
            n_weak: 0,
            found: Vec::new(),
            random: Random(0x9e37_79b9_7f4a_7c15),
        }
    }

    /// The orders of the next round, and the effort with which they are coded; no orders at the end.
    pub fn next_round(&mut self) -> (Effort, &[GroupOrder]) {
        self.round.clear();
        if self.is_over() && !self.is_fine {
            self.begin_fine();
        }
        // Fewer channels have nothing to predict each other from.
        if self.best.len() > 2 && !self.is_over() {
            if self.best_bytes.is_none() {
                self.begin_round();
            }
            while self.round.len() < ROUND_ORDERS {
                let order = self.moved();
                self.round.push(order);
            }
            self.n_rounds += 1;
        }
        (if self.is_fine { Effort::MAX } else { Effort::MIN }, &self.round)
    }

    fn rounds_max(&self) -> usize {
        if self.is_fine { FINE_ROUNDS_MAX } else { COARSE_ROUNDS_MAX }
    }

    fn is_over(&self) -> bool {
        self.n_rounds >= self.rounds_max() || self.n_weak >= WEAK_ROUNDS_MAX
    }

    fn begin_fine(&mut self) {
        (self.is_fine, self.best_bytes, self.n_rounds, self.n_weak) = (true, None, 0, 0);
        self.best = own_order(self.best.len());
    }

    /// The first orders of a stage: the own one, and its reverse or the best so far.
    fn begin_round(&mut self) {
        self.round.push(self.best.clone());
        if self.is_fine {
            let best = self.found.drain(..).map(|(_, order)| order);
            self.round.extend(best.take(ROUND_ORDERS - 1));
        } else {
            self.round.push(self.best.iter().rev().copied().collect());
        }
    }

    /// Takes the bytes of the orders of the round.
    pub fn report(&mut self, bytes: &[u64]) {
        let before = self.best_bytes;
        for (bytes, order) in bytes.iter().copied().zip(self.round.drain(..)) {
            if self.best_bytes.is_none_or(|best| bytes < best) {
                self.best_bytes = Some(bytes);
                self.best.clone_from(&order);
            }
            let is_new = self.found.iter().all(|(_, other)| *other != order);
            if is_new && order != own_order(order.len()) {
                let at = self.found.partition_point(|(other, _)| *other <= bytes);
                self.found.insert(at, (bytes, order));
                self.found.truncate(ROUND_ORDERS - 1);
            }
        }
        let saved = before.zip(self.best_bytes).map(|(before, now)| (before - now, before));
        let is_weak = saved.is_some_and(|(saved, of)| saved.saturating_mul(WEAK_SHARE) < of);
        self.n_weak = if is_weak { self.n_weak + 1 } else { 0 };
    }

    /// The order with the fewest bytes.
    #[must_use]
    pub fn best(&self) -> &GroupOrder {
        &self.best
    }

    /// The best order with some channels that follow each other at another place: at the least effort up to half of all
    /// in the first round, ever fewer, one in the last; at the greatest effort up to an eighth.
    fn moved(&mut self) -> GroupOrder {
        let n = self.best.len();
        let all = self.rounds_max();
        let left = all.saturating_sub(self.n_rounds);
        let share = if self.is_fine { n / 8 } else { n / 2 };
        let most = (share * left.pow(3) / all.pow(3)).max(1);
        let n_moved = 1 + self.random.below(most);
        let from = self.random.below(n - n_moved + 1);
        let mut order = self.best.clone();
        let moved: GroupOrder = order.drain(from..from + n_moved).collect();
        // Any place but their own.
        let to = self.random.below(order.len());
        let to = if to >= from { to + 1 } else { to };
        order.splice(to..to, moved);
        order
    }
}

fn own_order(n_channels: usize) -> GroupOrder {
    (0..n_channels).map(|channel| channel as u8).collect()
}

/// Numbers for the choice of orders: the same on every machine (xorshift64; Marsaglia, Xorshift RNGs, 2003).
#[derive(Debug)]
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (((self.0 >> 32) * n as u64) >> 32) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Searches with a size that counts the neighbours of a hidden order that are not neighbours. Returns also the size
    /// of the own order, and the codings at the two efforts.
    fn search(n: usize) -> (OrderSearch, u64, [usize; 2]) {
        let hidden = |channel: u8| u64::from(channel) * 7 % n as u64;
        let size = |order: &GroupOrder| {
            let steps = order.windows(2).map(|pair| hidden(pair[0]).abs_diff(hidden(pair[1])));
            1000 + 10 * steps.sum::<u64>()
        };
        let (mut search, mut n_coded) = (OrderSearch::new(n), [0; 2]);
        loop {
            let (effort, orders) = search.next_round();
            let sizes: Vec<u64> = orders.iter().map(size).collect();
            if sizes.is_empty() {
                return (search, size(&own_order(n)), n_coded);
            }
            n_coded[usize::from(effort == Effort::MAX)] += sizes.len();
            search.report(&sizes);
        }
    }

    #[test]
    fn it_is_bounded_repeatable_and_finds_smaller_sizes() {
        for n in [3, 4, 5, 15, 48, 64] {
            let (found, own, n_coded) = search(n);
            assert!(
                n_coded.iter().zip(OrderSearch::CODINGS_MAX).all(|(&n, most)| n > 0 && n <= most)
            );
            let best = found.best_bytes.unwrap();
            assert!(best < own || n < 5 && best == own, "{n}: {best}");
            assert_eq!(found.best(), search(n).0.best());
            let mut order = found.best().clone();
            order.sort_unstable();
            assert_eq!(order, own_order(n));
        }
    }

    #[test]
    fn few_channels_keep_their_order() {
        for n in 0..3 {
            let (found, _, n_coded) = search(n);
            assert_eq!((n_coded, found.best()), ([0; 2], &own_order(n)));
        }
    }
}
