//! Encodes a take in memory with its channels in the order in which they need the fewest bytes, and searches for this
//! order: `dense` predicts each channel of a group from those before it, so their order decides what each of them can
//! know.
//!
//! No rule gives a good order (docs/codec.md, "Order of channels"): orders are coded, first many at effort 1, then the
//! best of them and more at effort 4, whose sizes say more of those at effort 9. The search starts no threads: it names
//! the orders of a round, and the caller returns their sizes. The orders of a round depend on the rounds before it only,
//! so any number of threads finds the same.

use std::{
    io,
    sync::atomic::{AtomicU64, Ordering},
};

use mocapd_codec::{Effort, GROUP_CHANNELS};

use super::{EncodePart, EncodePlan, EncodedPart, PartEncoder};
use crate::{ChannelOrder, TakeError, motion::MotionInfo, record::Header};

/// Maximum number of samples, missing ones included, that an order is searched with: of a longer take, evenly spaced
/// stretches.
/// 131 072 samples are 22 seconds of 50 markers at 120 Hz; all but three of 20 recorded takes have fewer.
const SEARCHED_SAMPLES_MAX: usize = 1 << 17;

/// Time of coding a sample at effort 9, where that at effort 1 is 1: docs/codec.md, "Effort".
const GREATEST_TIME: u64 = 310;

/// Bytes that an order must save: what may differ in the rest of the take, the first offset in its index.
const SAVED_BYTES_MIN: u64 = 2;

/// The threads that encode: this crate starts none.
pub trait EncodingThreads {
    /// Errors of encoding and of the threads.
    type Error: From<TakeError>;

    /// Does all jobs on any number of threads, or on one if they continue each other. Each thread has its own function
    /// from `worker`. `done` gets the results in the order of the jobs.
    ///
    /// # Errors
    /// The first error of a job or of `done`.
    fn run<J, T, W>(
        &self,
        jobs: impl IntoIterator<Item = J>,
        is_sequential: bool,
        worker: impl Fn() -> W + Sync,
        done: impl FnMut(&J, T) -> Result<(), TakeError>,
    ) -> Result<(), Self::Error>
    where
        J: Send,
        T: Send,
        W: FnMut(&J) -> Result<T, TakeError>;
}

/// Does all jobs on the thread that calls it, after a check before each of them that may end the work.
#[derive(Debug)]
pub struct ThisThread<C>(pub C);

impl<C: Fn() -> io::Result<()>> EncodingThreads for ThisThread<C> {
    type Error = TakeError;

    fn run<J, T, W>(
        &self,
        jobs: impl IntoIterator<Item = J>,
        _: bool,
        worker: impl Fn() -> W + Sync,
        mut done: impl FnMut(&J, T) -> Result<(), TakeError>,
    ) -> Result<(), TakeError>
    where
        J: Send,
        T: Send,
        W: FnMut(&J) -> Result<T, TakeError>,
    {
        let mut work = worker();
        jobs.into_iter().try_for_each(|job| {
            (self.0)()?;
            done(&job, work(&job)?)
        })
    }
}

/// A take in memory.
#[derive(Debug, Clone, Copy)]
pub struct HeldTake<'a> {
    /// The plan of its encoding.
    pub plan: &'a EncodePlan,
    /// All its parts.
    pub parts: &'a [EncodePart],
    /// Its description.
    pub info: &'a MotionInfo,
    /// Its header.
    pub header: &'a Header,
}

/// Encodes all parts on threads whose number changes nothing. Returns the order of their channels: with it the take is
/// shorter, or the channels have their own. `progress` counts samples.
///
/// # Errors
/// Those of encoding and of the threads.
pub fn encode<E: EncodingThreads>(
    take: HeldTake<'_>,
    threads: &E,
    progress: &AtomicU64,
) -> Result<(ChannelOrder, Vec<EncodedPart>), E::Error> {
    let HeldTake { plan, parts, info, header } = take;
    let searched = searched_parts(parts);
    let mut progress = OrderProgress::new(parts, &searched, progress);
    let order = search(take, &searched, threads, &mut progress)?;
    let own = encode_in(take, None, threads, &mut progress)?;
    let own_order = ChannelOrder::default();
    if order.is_identity() {
        progress.finish();
        return Ok((own_order, own));
    }
    let ordered = encode_in(take, Some(&order), threads, &mut progress)?;
    let bytes = |order, coded| plan.ordered_bytes((info, header), order, parts.iter().zip(coded));
    let is_shorter = bytes(&order, &ordered)? + SAVED_BYTES_MIN <= bytes(&own_order, &own)?;
    progress.finish();
    Ok(if is_shorter { (order, ordered) } else { (own_order, own) })
}

/// The parts that an order is searched with, by group.
fn searched_parts(parts: &[EncodePart]) -> Vec<Vec<&EncodePart>> {
    let n_samples: usize = parts.iter().map(|part| part.n_rows * part.n_markers).sum();
    let stretches: Vec<&[EncodePart]> = parts.chunk_by(|a, b| a.first_row == b.first_row).collect();
    let n = (stretches.len() * SEARCHED_SAMPLES_MAX / n_samples.max(1))
        .clamp(1, stretches.len().max(1));
    let n_groups = stretches.first().map_or(0, |stretch| stretch.len());
    let mut groups = vec![Vec::new(); n_groups];
    for stretch in (0..n).filter_map(|i| stretches.get(i * stretches.len() / n)) {
        for (group, part) in groups.iter_mut().zip(*stretch) {
            group.push(part);
        }
    }
    groups
}

/// Searches an order for each group.
fn search<E: EncodingThreads>(
    take: HeldTake<'_>,
    searched: &[Vec<&EncodePart>],
    threads: &E,
    progress: &mut OrderProgress<'_>,
) -> Result<ChannelOrder, E::Error> {
    let mut searches: Vec<_> =
        searched.iter().map(|parts| OrderSearch::new(n_channels(parts))).collect();
    let worker = || {
        let mut encoders = SearchStage::ALL.map(|stage| take.plan.encoder_with(stage.effort()));
        move |job: &OrderCoding| {
            size(&mut encoders[job.stage as usize], &searched[job.group], &job.order)
        }
    };
    loop {
        let mut jobs = Vec::new();
        for (group, search) in searches.iter_mut().enumerate() {
            let (stage, orders) = search.next_round();
            jobs.extend(orders.iter().map(|order| OrderCoding {
                group,
                stage,
                order: order.clone(),
            }));
        }
        if jobs.is_empty() {
            break;
        }
        let mut sizes = vec![Vec::new(); searched.len()];
        threads.run(jobs, false, worker, |job, bytes| {
            let rest = rest_bytes(take, searched, job)?;
            sizes[job.group].push(bytes + rest);
            progress.add(&searched[job.group], job.stage.time());
            Ok(())
        })?;
        for (search, sizes) in searches.iter_mut().zip(sizes).filter(|(_, sizes)| !sizes.is_empty())
        {
            search.report(&sizes);
        }
    }
    progress.end_search();
    let orders = searches.iter().map(OrderSearch::best);
    Ok(order_of(orders.cloned()))
}

/// An order to code.
struct OrderCoding {
    group: usize,
    stage: SearchStage,
    order: GroupOrder,
}

fn n_channels(parts: &[&EncodePart]) -> usize {
    parts.first().map_or(0, |part| part.n_markers)
}

/// The order of a take whose groups have these.
fn order_of(groups: impl Iterator<Item = GroupOrder>) -> ChannelOrder {
    let column = |group: usize, channel: u8| (group * GROUP_CHANNELS + usize::from(channel)) as u16;
    let columns = groups.enumerate().flat_map(|(group, order)| {
        order.into_iter().map(move |channel| column(group, channel)).collect::<Vec<_>>()
    });
    ChannelOrder::from_columns(columns.collect()).unwrap_or_default()
}

/// What the order of a group costs outside the blocks, in ORDER, SUMMARY and the channel table: a share of it, as of the
/// blocks.
fn rest_bytes(
    take: HeldTake<'_>,
    searched: &[Vec<&EncodePart>],
    job: &OrderCoding,
) -> Result<u64, TakeError> {
    let own =
        |parts: &Vec<&EncodePart>| (0..n_channels(parts)).map(|channel| channel as u8).collect();
    let mut groups: Vec<GroupOrder> = searched.iter().map(own).collect();
    groups[job.group].clone_from(&job.order);
    let described = (take.info, take.header);
    let bytes = take.plan.table_bytes(described, &order_of(groups.into_iter()))?;
    let n_searched = searched.iter().flatten().map(|part| samples_in(part)).sum::<u64>();
    let n_samples = take.parts.iter().map(samples_in).sum::<u64>().max(1);
    Ok(bytes.saturating_mul(n_searched) / n_samples)
}

fn size(
    encoder: &mut PartEncoder<'_>,
    parts: &[&EncodePart],
    order: &GroupOrder,
) -> Result<u64, TakeError> {
    let mut bytes = 0;
    for part in parts {
        bytes += encoder.encode_key(part, order)?.n_bytes();
    }
    Ok(bytes)
}

/// Encodes all parts with their channels in an order.
fn encode_in<E: EncodingThreads>(
    take: HeldTake<'_>,
    order: Option<&ChannelOrder>,
    threads: &E,
    progress: &mut OrderProgress<'_>,
) -> Result<Vec<EncodedPart>, E::Error> {
    let worker = || {
        let mut encoder = take.plan.encoder();
        move |part: &&EncodePart| {
            let first = part.first_marker;
            let channel = |order: &ChannelOrder, row| (order.column_of(row) - first) as u8;
            let rows = first..first + part.n_markers;
            let order = order.map(|order| rows.map(|row| channel(order, row)).collect());
            encoder.encode_in(part, order.as_ref())
        }
    };
    let mut all = Vec::new();
    let is_sequential = take.plan.is_sequential();
    threads.run(take.parts, is_sequential, worker, |part, coded: EncodedPart| {
        all.push(coded);
        progress.add(&[*part], GREATEST_TIME);
        Ok(())
    })?;
    Ok(all)
}

/// Shows the work on all orders as that of one encoding.
struct OrderProgress<'a> {
    counter: &'a AtomicU64,
    /// Samples that the counter counts in all, and so far.
    n_samples: u64,
    n_counted: u64,
    /// Work in all, of the search, and so far; coding a sample at the least effort is 1.
    all: u64,
    search: u64,
    done: u64,
}

impl<'a> OrderProgress<'a> {
    fn new(parts: &[EncodePart], searched: &[Vec<&EncodePart>], counter: &'a AtomicU64) -> Self {
        let n_samples = parts.iter().map(samples_in).sum::<u64>();
        let n_searched = searched.iter().flatten().map(|part| samples_in(part)).sum::<u64>();
        let codings = SearchStage::ALL.map(|stage| stage.codings_max() as u64 * stage.time());
        let search = n_searched.saturating_mul(codings.iter().sum());
        let all = search.saturating_add((2 * n_samples).saturating_mul(GREATEST_TIME));
        Self { counter, n_samples, n_counted: 0, all, search, done: 0 }
    }

    /// Parts were encoded, which takes this time a sample.
    fn add(&mut self, parts: &[&EncodePart], time: u64) {
        let samples: u64 = parts.iter().map(|part| samples_in(part)).sum();
        self.go_to(self.done.saturating_add(samples.saturating_mul(time)));
    }

    /// The search is over, if with fewer orders than it may have.
    fn end_search(&mut self) {
        self.go_to(self.done.max(self.search));
    }

    fn finish(&mut self) {
        self.go_to(self.all);
    }

    fn go_to(&mut self, done: u64) {
        self.done = done.min(self.all);
        let share =
            u128::from(self.n_samples) * u128::from(self.done) / u128::from(self.all.max(1));
        // It is at most the number of samples.
        let counted = share as u64;
        self.counter.fetch_add(counted.saturating_sub(self.n_counted), Ordering::Relaxed);
        self.n_counted = counted;
    }
}

fn samples_in(part: &EncodePart) -> u64 {
    (part.n_rows * part.n_markers) as u64
}

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

    /// Maximum number of codings: both stages together take about as long as the two codings of the whole at effort 9.
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
