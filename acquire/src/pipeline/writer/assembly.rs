//! Parts of stretches, until each stretch has all of them.

use std::collections::VecDeque;

use crate::pipeline::{
    messages::{Part, StretchEnd},
    plan::Plan,
};

/// One stretch.
#[derive(Debug)]
pub(super) struct Assembly {
    pub(super) stretch: u64,
    pub(super) end: StretchEnd,
    /// By group; the time line's is the last.
    slots: Vec<Option<Part>>,
    missing: usize,
}

impl Assembly {
    /// The time line's part and the channels' parts, in order, of a complete stretch.
    pub(super) fn parts(&self) -> Option<(&Part, impl Iterator<Item = &Part>)> {
        let mut present = self.slots.iter().flatten();
        Some((present.next_back()?, present))
    }
}

/// The stretches that are coded and not yet written, oldest first.
#[derive(Debug)]
pub(super) struct Assemblies {
    waiting: VecDeque<Assembly>,
    spare: Vec<Vec<Option<Part>>>,
    next_stretch: u64,
    plan: Plan,
}

impl Assemblies {
    pub(super) fn new(plan: &Plan) -> Self {
        // No group can be further ahead than it has buffers.
        let most = plan.buffers_per_group() + 1;
        let n_groups = plan.n_groups() + 1;
        let empty = || (0..n_groups).map(|_| None).collect();
        Self {
            waiting: VecDeque::with_capacity(most),
            spare: (0..most).map(|_| empty()).collect(),
            next_stretch: 0,
            plan: plan.clone(),
        }
    }

    pub(super) fn add(&mut self, part: Part) {
        let at = (part.stretch - self.next_stretch) as usize;
        let n_groups = self.plan.n_groups() + 1;
        while self.waiting.len() <= at {
            self.waiting.push_back(Assembly {
                stretch: self.next_stretch + self.waiting.len() as u64,
                end: part.end,
                slots: self.spare.pop().unwrap_or_else(|| (0..n_groups).map(|_| None).collect()),
                missing: usize::MAX,
            });
        }
        let assembly = &mut self.waiting[at];
        if assembly.missing == usize::MAX {
            assembly.end = part.end;
            assembly.missing = self.plan.groups_of(part.end.n_channels) + 1;
        }
        let group = part.group;
        assembly.missing -= 1;
        assembly.slots[group] = Some(part);
    }

    /// The oldest stretch.
    pub(super) fn front(&self) -> Option<&Assembly> {
        self.waiting.front()
    }

    /// When the oldest stretch is complete: whether it is the take's last.
    pub(super) fn front_last(&self) -> Option<bool> {
        self.front().filter(|front| front.missing == 0).map(|front| front.end.last)
    }

    /// Drops the oldest stretch and gives its parts away.
    pub(super) fn pop_front(&mut self, mut give: impl FnMut(Part)) {
        let Some(mut front) = self.waiting.pop_front() else { return };
        front.slots.iter_mut().filter_map(Option::take).for_each(&mut give);
        self.spare.push(front.slots);
        self.next_stretch += 1;
    }
}
