//! Which stray is which: a device lists them in any order, and says nothing of their identity.
//!
//! A stray keeps the number of the one that is nearest to where it would have moved on to, within
//! what a marker can stray from that in a frame. A number whose stray is gone is held for half a
//! second, for one that comes back where it went; then it goes to the next that appears.

use super::seen::{STRAYS_MAX, Seen};
use crate::device::MarkerSample;

/// Ids of strays begin here; port handles are below.
pub(super) const FIRST_ID: u16 = 0x100;

/// How fast a marker moves at most when it is first seen, in millimetres a second; and by how much its
/// velocity changes from one frame to the next. A limb that hits the ground does less.
const SPEED_MAX_MM_S: f32 = 6_000.0;

/// Two strays nearer to each other than this are not told apart by any optical system.
const GATE_MIN_MM: f32 = 10.0;

/// How long a number is held, in seconds.
const HOLD_S: f64 = 0.5;

/// Numbers that are in use before those that are held are given away: the markers that a recorder
/// keeps room for beside those announced.
const NUMBERS_SOON: usize = 64;

/// A stray and a number that it may have.
#[derive(Debug, Clone, Copy)]
struct Pair {
    distance2: f32,
    stray: u16,
    slot: u16,
}

#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    position_mm: [f32; 3],
    /// How far it moved in the last frame, millimetres.
    step_mm: [f32; 3],
    /// Frames for which it is still held; 0: free.
    held: u32,
}

/// The numbers in use.
#[derive(Debug)]
pub(super) struct Strays {
    slots: [Slot; STRAYS_MAX],
    pairs: Vec<Pair>,
    gate2: f32,
    hold: u32,
}

impl Strays {
    pub(super) fn new() -> Self {
        let pairs = Vec::with_capacity(STRAYS_MAX * STRAYS_MAX);
        Self { slots: [Slot::default(); STRAYS_MAX], pairs, gate2: 0.0, hold: 1 }
    }

    /// No stray is known, and frames come at this rate.
    pub(super) fn restart(&mut self, rate_hz: f64) {
        self.slots = [Slot::default(); STRAYS_MAX];
        let gate = (SPEED_MAX_MM_S / rate_hz as f32).max(GATE_MIN_MM);
        self.gate2 = gate * gate;
        self.hold = (HOLD_S * rate_hz).ceil().max(1.0) as u32;
    }

    /// Appends the strays of a frame with their ids.
    pub(super) fn number(&mut self, seen: &Seen, out: &mut Vec<MarkerSample>) {
        let strays = seen.strays.as_slice();
        self.pair(strays);
        let mut numbered = [false; STRAYS_MAX];
        let mut taken = [false; STRAYS_MAX];
        for index in 0..self.pairs.len() {
            let Pair { stray, slot, .. } = self.pairs[index];
            let (stray, slot) = (usize::from(stray), usize::from(slot));
            if !numbered[stray] && !taken[slot] {
                self.put(slot, strays[stray], out);
                (numbered[stray], taken[slot]) = (true, true);
            }
        }
        for (stray, _) in strays.iter().zip(numbered).filter(|(_, numbered)| !numbered) {
            match self.free_slot(&taken) {
                Some(slot) => {
                    self.slots[slot] = Slot::default();
                    self.put(slot, *stray, out);
                    taken[slot] = true;
                }
                None => beyond(*stray, out),
            }
        }
        for (slot, taken) in self.slots.iter_mut().zip(taken) {
            if !taken {
                // Where it went is not known: it is looked for where it was.
                *slot = Slot { held: slot.held.saturating_sub(1), step_mm: [0.0; 3], ..*slot };
            }
        }
        for _ in 0..seen.strays_beyond {
            beyond([0.0; 3], out);
        }
    }

    /// The lowest number that is free; of those that a recorder has no room for, rather the one
    /// that was held longest.
    fn free_slot(&self, taken: &[bool; STRAYS_MAX]) -> Option<usize> {
        let free = (0..STRAYS_MAX).find(|slot| !taken[*slot] && self.slots[*slot].held == 0);
        if free.is_some_and(|slot| slot < NUMBERS_SOON) {
            return free;
        }
        let held = (0..NUMBERS_SOON).filter(|slot| !taken[*slot]);
        held.min_by_key(|slot| self.slots[*slot].held).or(free)
    }

    /// Every stray with every number near it, nearest first.
    fn pair(&mut self, strays: &[[f32; 3]]) {
        self.pairs.clear();
        for (stray, position) in (0_u16..).zip(strays) {
            for (slot, known) in (0_u16..).zip(&self.slots) {
                let ahead = known.position_mm.iter().zip(known.step_mm).map(|(at, step)| at + step);
                let distance2: f32 = ahead.zip(position).map(|(a, b)| (a - b) * (a - b)).sum();
                if known.held > 0 && distance2 <= self.gate2 {
                    self.pairs.push(Pair { distance2, stray, slot });
                }
            }
        }
        self.pairs.sort_unstable_by(|a, b| {
            a.distance2.total_cmp(&b.distance2).then((a.stray, a.slot).cmp(&(b.stray, b.slot)))
        });
    }

    fn put(&mut self, slot: usize, position_mm: [f32; 3], out: &mut Vec<MarkerSample>) {
        let Slot { position_mm: before, held, .. } = self.slots[slot];
        // One that was not there in the last frame has no speed that is known.
        let there = held == self.hold;
        let step = |axis: usize| if there { position_mm[axis] - before[axis] } else { 0.0 };
        let step_mm = std::array::from_fn(step);
        self.slots[slot] = Slot { position_mm, step_mm, held: self.hold };
        out.push(MarkerSample { id: FIRST_ID + slot as u16, position_mm, ..Default::default() });
    }
}

/// A stray for which there is no number: under one id for all, so that it is counted as dropped.
fn beyond(position_mm: [f32; 3], out: &mut Vec<MarkerSample>) {
    let id = FIRST_ID + STRAYS_MAX as u16;
    out.push(MarkerSample { id, position_mm, ..MarkerSample::default() });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ids(strays: &mut Strays, positions: &[[f32; 3]]) -> Vec<u16> {
        let mut seen = Seen::new();
        positions.iter().for_each(|position| seen.stray(*position));
        let mut out = Vec::new();
        strays.number(&seen, &mut out);
        // In the order of the list.
        positions
            .iter()
            .map(|p| out.iter().find(|sample| sample.position_mm == *p).unwrap().id - FIRST_ID)
            .collect()
    }

    #[test]
    fn numbers_stay_with_their_strays() {
        let mut strays = Strays::new();
        strays.restart(60.0);
        let (a, b, c) = ([0.0, 0.0, 0.0], [300.0, 0.0, 0.0], [0.0, 300.0, 0.0]);
        assert_eq!(ids(&mut strays, &[a, b, c]), [0, 1, 2]);
        assert_eq!(ids(&mut strays, &[c, a, b]), [2, 0, 1], "another order");
        assert_eq!(ids(&mut strays, &[c, b]), [2, 1], "one is hidden");
        let near_a = [20.0, 10.0, 0.0];
        assert_eq!(ids(&mut strays, &[near_a, c, b]), [0, 2, 1], "and comes back");
        let far = [900.0; 3];
        assert_eq!(ids(&mut strays, &[far, c, b]), [3, 2, 1], "one too far away is another");
        for _ in 0..30 {
            ids(&mut strays, &[c, b]);
        }
        assert_eq!(ids(&mut strays, &[far, near_a, b]), [0, 3, 1], "numbers are used again");
    }

    #[test]
    fn two_that_pass_each_other_keep_apart_when_each_moves_little() {
        let mut strays = Strays::new();
        strays.restart(60.0);
        for frame in 0..100_u8 {
            let x = f32::from(frame) * 10.0;
            let there = ids(&mut strays, &[[x, 0.0, 0.0], [1000.0 - x, 40.0, 0.0]]);
            assert_eq!(there, [0, 1], "frame {frame}");
        }
    }

    #[test]
    fn more_than_can_be_numbered_are_given_all_the_same() {
        let mut strays = Strays::new();
        strays.restart(60.0);
        let mut seen = Seen::new();
        for i in 0..300_u16 {
            seen.stray([f32::from(i) * 50.0, 0.0, 0.0]);
        }
        let mut out = Vec::new();
        strays.number(&seen, &mut out);
        assert_eq!(out.len(), 300);
        assert_eq!(out.iter().filter(|s| usize::from(s.id - FIRST_ID) == STRAYS_MAX).count(), 45);
    }
}
