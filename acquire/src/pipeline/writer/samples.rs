//! Sampled channels in the writer: they go to the open take behind the stretch that was open when they ended, and into
//! the pre-roll.

use std::{collections::VecDeque, io::Write, time::Instant};

use mocapd_take::{
    TakeError, TakeWriter,
    record::{GroupLedger, MeasuredErrors, SampleLedger, SampledGroup},
    sampled::{SampleAnchor, SampleContent, SampleSpan},
    timeline::LossCauses,
};

use crate::pipeline::{
    messages::{PartContent, SamplePart},
    sampled::{HELD_MAX, SAMPLES_WAIT_MAX, SampleReturns},
};

/// What the writer knows of sampled channels, and the parts that wait for their stretch.
#[derive(Debug)]
pub(in crate::pipeline) struct SampleQueue {
    pub(super) groups: Vec<SampledGroup>,
    returns: SampleReturns,
    /// By group, in order.
    held: Vec<VecDeque<SamplePart>>,
    /// By group, the stretch number after the last boundary of which all samples are here.
    through: Vec<u64>,
    /// The last boundary that was executed: parts before it that come later belong to no open take.
    executed: Option<u64>,
    /// When waiting for a boundary began; for the last one of all, or when the last part came.
    waiting_since: Option<Instant>,
    /// Whether a part came since the last look at a boundary.
    has_new: bool,
    /// How many markers have residuals whose groups are described, the first ones.
    n_with_residuals: usize,
}

impl SampleQueue {
    pub(in crate::pipeline) fn new(groups: Vec<SampledGroup>, returns: SampleReturns) -> Self {
        let through = vec![0; groups.len()];
        // No group can be further ahead than it has buffers, and boundaries.
        let held = groups.iter().map(|_| VecDeque::with_capacity(HELD_MAX)).collect();
        let residuals = groups.iter().filter(|group| group.has_residuals());
        let n_with_residuals = residuals.map(|group| group.channels.len()).sum();
        let (executed, waiting_since, has_new) = (None, None, false);
        Self { groups, returns, held, through, executed, waiting_since, has_new, n_with_residuals }
    }

    /// Size of the largest block.
    pub(super) fn block_bytes_max(&self) -> usize {
        self.returns.block_bytes_max
    }

    pub(super) fn add(&mut self, part: SamplePart) {
        if matches!(part.content, PartContent::Boundary) {
            self.through[part.group] = part.stretch + 1;
        }
        self.held[part.group].push_back(part);
        self.has_new = true;
    }

    /// Whether all samples up to a boundary are here, or have been waited for long enough: behind the last one of all
    /// nothing can be late, and the wait lasts while samples come. `is_empty` says whether the queue to the writer is
    /// empty.
    pub(super) fn is_complete(
        &mut self,
        boundary: u64,
        is_last: bool,
        is_empty: impl Fn() -> bool,
    ) -> bool {
        let is_here = |(group, &through): (usize, &u64)| {
            // What a thread sent before it ended is in the queue.
            through > boundary || self.returns.is_gone(group) && is_empty()
        };
        if self.through.iter().enumerate().all(is_here) {
            self.waiting_since = None;
            return true;
        }
        if std::mem::take(&mut self.has_new) && is_last {
            self.waiting_since = None;
        }
        let since = *self.waiting_since.get_or_insert_with(Instant::now);
        since.elapsed() >= SAMPLES_WAIT_MAX
    }

    /// Whether the last boundary had to be executed without some samples. Resets the wait.
    pub(super) fn end_wait(&mut self, boundary: u64) -> bool {
        self.executed = Some(boundary);
        let is_here = self.through.iter().all(|&through| through > boundary);
        self.waiting_since = None;
        !is_here
    }

    /// The next part of a stretch up to `stretch`. Parts that came too late are left out. Those of a group that begins with
    /// markers that appeared wait until these are among the `n_markers` of the table, and have those before them described.
    pub(super) fn next_up_to(&mut self, stretch: u64, n_markers: usize) -> Option<SamplePart> {
        loop {
            let n_described = self.n_with_residuals;
            let is_due = |part: &mut SamplePart| match part.content {
                PartContent::Opens { first_marker, n } => {
                    first_marker == n_described && first_marker + n <= n_markers
                }
                _ => part.stretch <= stretch,
            };
            let part = self.held.iter_mut().find_map(|held| held.pop_front_if(is_due))?;
            if let PartContent::Opens { n, .. } = part.content {
                self.n_with_residuals += n;
                return Some(part);
            }
            if self.executed.is_none_or(|executed| part.stretch > executed) {
                return Some(part);
            }
            self.give_back(part);
        }
    }

    /// Returns the part's buffer to its group.
    pub(super) fn give_back(&self, part: SamplePart) {
        let group = part.group;
        if let PartContent::Block { block: buffer, .. } | PartContent::Lost { buffer, .. } =
            part.content
        {
            drop(self.returns.buffers[group].try_send(buffer));
            self.returns.wakes.wake(group);
        }
    }
}

impl SamplePart {
    fn n(&self) -> u64 {
        match self.content {
            PartContent::Block { n, .. } => n.into(),
            PartContent::Lost { n, .. } => n,
            PartContent::Boundary | PartContent::Opens { .. } => 0,
        }
    }

    /// Memory used by a copy.
    pub(super) fn bytes(&self) -> usize {
        let block =
            if let PartContent::Block { block, .. } = &self.content { block.len() } else { 0 };
        block + size_of::<Self>()
    }

    /// A copy for the pre-roll, with memory for its block alone.
    pub(super) fn copy(&self) -> Self {
        let content = match &self.content {
            PartContent::Block { n, key, time, errors, block } => {
                let (n, key, time, errors, block) = (*n, *key, *time, *errors, block.clone());
                PartContent::Block { n, key, time, errors, block }
            }
            PartContent::Lost { n, causes, .. } => {
                PartContent::Lost { n: *n, causes: *causes, buffer: Vec::new() }
            }
            PartContent::Boundary => PartContent::Boundary,
            PartContent::Opens { first_marker, n } => {
                PartContent::Opens { first_marker: *first_marker, n: *n }
            }
        };
        let Self { group, stretch, first, duplicates, jumps, .. } = *self;
        Self { group, stretch, first, duplicates, jumps, content }
    }
}

/// The sampled channels of an open take.
#[derive(Debug, Default)]
pub(super) struct TakeSamples {
    groups: Vec<TakeGroup>,
}

#[derive(Debug, Default)]
struct TakeGroup {
    /// Whether it is described in the take.
    is_open: bool,
    /// The pipeline's number of the sample that is number 0 of the take.
    base: Option<u64>,
    /// The take's number of the next sample.
    next: u64,
    ledger: GroupLedger,
}

impl TakeSamples {
    /// Writes the descriptions of the groups.
    pub(super) fn begin<W: Write>(
        groups: &[SampledGroup],
        take: &mut TakeWriter<W>,
    ) -> Result<Self, TakeError> {
        let mut all = Self { groups: groups.iter().map(|_| TakeGroup::default()).collect() };
        let known = groups.iter().enumerate().filter(|(_, group)| !group.channels.is_empty());
        for (index, group) in known {
            all.open(index, group, take)?;
        }
        Ok(all)
    }

    /// Writes the description of a group, which the take did not have.
    pub(super) fn open<W: Write>(
        &mut self,
        index: usize,
        group: &SampledGroup,
        take: &mut TakeWriter<W>,
    ) -> Result<(), TakeError> {
        let Some(of_take) = self.groups.get_mut(index) else { return Ok(()) };
        of_take.is_open = true;
        of_take.ledger.group = group.number;
        of_take.ledger.errors = group.pose_bounds().map(|_| MeasuredErrors::default());
        take.sampled_group(group)
    }

    /// Writes samples with their time, or that they are lost.
    pub(super) fn write<W: Write>(
        &mut self,
        part: &SamplePart,
        take: &mut TakeWriter<W>,
    ) -> Result<(), TakeError> {
        let group = self.groups.get_mut(part.group).filter(|group| group.is_open);
        let Some(group) = group else { return Ok(()) };
        if matches!(part.content, PartContent::Boundary | PartContent::Opens { .. }) {
            group.ledger.duplicates += part.duplicates;
            group.ledger.jumps += u64::from(part.jumps);
            return Ok(());
        }
        if group.base.is_none() && matches!(part.content, PartContent::Block { key: false, .. }) {
            // Only in a pre-roll that reached its limit of memory: nothing can be decoded before a key.
            return Ok(());
        }
        let base = *group.base.get_or_insert(part.first);
        let (number, first) = (group.ledger.group, part.first.saturating_sub(base));
        group.ledger.duplicates += part.duplicates;
        group.ledger.jumps += u64::from(part.jumps);
        let n = part.n();
        group.ledger.taken = first.saturating_add(n);
        let gap = first.saturating_sub(group.next);
        group.next = first.saturating_add(n);
        if gap > 0 {
            // Not expected: what was not stated is lost for an unknown reason.
            let content = SampleContent::Lost(LossCauses::default());
            group.ledger.lost_other += gap;
            take.samples(&SampleSpan { group: number, first: first - gap, n: gap, content }, &[])?;
        }
        match &part.content {
            PartContent::Block { key, time, errors, block, .. } => {
                group.ledger.stored += n;
                if let Some(largest) = &mut group.ledger.errors {
                    largest.add(errors);
                }
                let anchor = SampleAnchor {
                    number: first,
                    run_start: time.run_start.saturating_sub(base),
                    device_ticks: time.device_ticks,
                    segment: time.segment,
                };
                let (at, ticks) = time.last_batch;
                take.sample_time(number, &anchor, Some((first + u64::from(at), ticks)))?;
                let content = if *key { SampleContent::Key } else { SampleContent::Continued };
                take.samples(&SampleSpan { group: number, first, n, content }, block)
            }
            PartContent::Lost { causes, .. } => {
                let ledger = &mut group.ledger;
                *match *causes {
                    LossCauses::NOT_RECEIVED => &mut ledger.lost_on_link,
                    LossCauses::DROPPED_BY_DEVICE => &mut ledger.dropped_by_device,
                    LossCauses::RING_FULL => &mut ledger.lost_ring_full,
                    LossCauses::DISCONNECTED => &mut ledger.unknown_after_disconnect,
                    _ => &mut ledger.lost_other,
                } += n;
                let content = SampleContent::Lost(*causes);
                take.samples(&SampleSpan { group: number, first, n, content }, &[])
            }
            PartContent::Boundary | PartContent::Opens { .. } => Ok(()),
        }
    }

    fn ledgers(&self) -> impl Iterator<Item = GroupLedger> {
        self.groups.iter().filter(|group| group.is_open).map(|group| group.ledger)
    }

    /// The ledger so far; `None` without sampled channels.
    pub(super) fn ledger(&self, finished: bool, batches_refused: u64) -> Option<SampleLedger> {
        let groups: Vec<GroupLedger> = self.ledgers().collect();
        let has_some = !groups.is_empty() || batches_refused > 0;
        has_some.then_some(SampleLedger { finished, groups, batches_refused })
    }

    /// Updates the ledger so far in place, without allocation after the first time.
    pub(super) fn state_ledger(&self, stated: &mut Option<SampleLedger>, batches_refused: u64) {
        if self.ledgers().next().is_none() && batches_refused == 0 {
            *stated = None;
            return;
        }
        let stated = stated.get_or_insert_default();
        stated.batches_refused = batches_refused;
        stated.groups.clear();
        stated.groups.extend(self.ledgers());
    }
}
