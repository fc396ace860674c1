//! The search for an order of the channels of a group in which `dense` needs fewer bytes: each channel is predicted from
//! those before it, so their order decides what each of them can know.
//!
//! No rule gives a good order (docs/codec.md, "Order of channels"): orders are coded, first many at effort 1, then the
//! best of them and more at effort 4, whose sizes say more of those at effort 9. The search starts no threads: it names
//! the orders of a round, and the caller returns their sizes. The orders of a round depend on the rounds before it only,
//! so any number of threads finds the same.

use mocapd_codec::Effort;

/// Orders that are coded in a round: a few threads have work, and the next round still begins from the best of them.
const ROUND_ORDERS: usize = 8;

/// A stage ends when three rounds in a row save less than a share of 1/1024 each.
const WEAK_ROUNDS_MAX: usize = 3;
const WEAK_SHARE: u64 = 1024;

/// A stage of the search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SearchStage {
    /// Many orders at effort 1.
    Coarse,
    /// The best of them, and orders that differ little from them, at effort 4.
    Fine,
}

impl SearchStage {
    /// The stages in order.
    pub(super) const ALL: [Self; 2] = [Self::Coarse, Self::Fine];

    /// The effort of its codings.
    pub(super) fn effort(self) -> Effort {
        match self {
            Self::Coarse => Effort::MIN,
            Self::Fine => Effort::new(4).unwrap_or_default(),
        }
    }

    /// Time of coding a sample, rounded up, where that at effort 1 is 1: docs/codec.md, "Effort".
    pub(super) fn time(self) -> u64 {
        match self {
            Self::Coarse => 1,
            Self::Fine => 6,
        }
    }

    /// Maximum number of codings: in both stages, a few times as long as the two codings of the whole at effort 9.
    pub(super) fn codings_max(self) -> usize {
        self.rounds_max() * ROUND_ORDERS
    }

    fn rounds_max(self) -> usize {
        match self {
            Self::Coarse => 24,
            Self::Fine => 8,
        }
    }
}

/// An order of the channels of a group: by place, the channel in the source.
pub type GroupOrder = Vec<u8>;

/// The search for one group.
#[derive(Debug)]
pub(super) struct OrderSearch {
    stage: SearchStage,
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
    /// A search for `n_channels` channels.
    pub(super) fn new(n_channels: usize) -> Self {
        Self {
            stage: SearchStage::Coarse,
            best: own_order(n_channels),
            best_bytes: None,
            round: Vec::new(),
            n_rounds: 0,
            n_weak: 0,
            found: Vec::new(),
            random: Random(0x9e37_79b9_7f4a_7c15),
        }
    }

    /// The orders of the next round, and its stage; no orders at the end.
    pub(super) fn next_round(&mut self) -> (SearchStage, &[GroupOrder]) {
        self.round.clear();
        if self.is_over() && self.stage == SearchStage::Coarse {
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
        (self.stage, &self.round)
    }

    fn is_over(&self) -> bool {
        self.n_rounds >= self.stage.rounds_max() || self.n_weak >= WEAK_ROUNDS_MAX
    }

    fn begin_fine(&mut self) {
        (self.stage, self.best_bytes, self.n_rounds, self.n_weak) = (SearchStage::Fine, None, 0, 0);
        self.best = own_order(self.best.len());
    }

    /// The first orders of a stage: the own one, and its reverse or the best so far.
    fn begin_round(&mut self) {
        self.round.push(self.best.clone());
        if self.stage == SearchStage::Fine {
            let best = self.found.drain(..).map(|(_, order)| order);
            self.round.extend(best.take(ROUND_ORDERS - 1));
        } else {
            self.round.push(self.best.iter().rev().copied().collect());
        }
    }

    /// Takes the bytes of the orders of the round.
    pub(super) fn report(&mut self, bytes: &[u64]) {
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
    pub(super) fn best(&self) -> &GroupOrder {
        &self.best
    }

    /// The best order with some channels that follow each other at another place: in the coarse stage up to half of
    /// all in the first round, ever fewer, one in the last; in the fine one up to an eighth.
    fn moved(&mut self) -> GroupOrder {
        let n = self.best.len();
        let all = self.stage.rounds_max();
        let left = all.saturating_sub(self.n_rounds);
        let share = if self.stage == SearchStage::Fine { n / 8 } else { n / 2 };
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
    /// of the own order, and the codings of the two stages.
    fn search(n: usize) -> (OrderSearch, u64, [usize; 2]) {
        let hidden = |channel: u8| u64::from(channel) * 7 % n as u64;
        let size = |order: &GroupOrder| {
            let steps = order.windows(2).map(|pair| hidden(pair[0]).abs_diff(hidden(pair[1])));
            1000 + 10 * steps.sum::<u64>()
        };
        let (mut search, mut n_coded) = (OrderSearch::new(n), [0; 2]);
        loop {
            let (stage, orders) = search.next_round();
            let sizes: Vec<u64> = orders.iter().map(size).collect();
            if sizes.is_empty() {
                return (search, size(&own_order(n)), n_coded);
            }
            n_coded[stage as usize] += sizes.len();
            search.report(&sizes);
        }
    }

    #[test]
    fn it_is_bounded_repeatable_and_finds_smaller_sizes() {
        for n in [3, 4, 5, 15, 48, 64] {
            let (found, own, n_coded) = search(n);
            let mut codings = n_coded.iter().zip(SearchStage::ALL);
            assert!(codings.all(|(&n, stage)| n > 0 && n <= stage.codings_max()));
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
