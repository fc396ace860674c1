//! What goes wrong before a frame becomes bytes: the motion, the counter, the clock.
//!
//! All of it is a function of the script and of the time since the first Start, which for a frame is its place on the
//! device's own grid: the same frames are changed in the same way however busy the host is.

use std::sync::Arc;

use mocapd_drivers::device::{MarkerInfo, MarkerSample};
use mocapd_take::motion::{GAP, Position, is_gap};

use super::kinds::{Fault, Kind};
use super::script::{Script, nanoseconds};
use crate::device::Parts;
use crate::generator::Rng;

/// Ghosts stay within so much of the origin on each axis: a volume's size.
const GHOST_RANGE_MM: f64 = 3000.0;

/// A ghost moves on after so long.
const GHOST_STAYS_NS: u64 = 250_000_000;

/// Ghosts are there for so much of the time.
const GHOST_PART: f64 = 0.7;

/// The faults of a script that act inside the device.
#[derive(Debug)]
pub(crate) struct SourceFaults {
    script: Arc<Script>,
    n_markers: usize,
    /// What the counter on the wire is ahead of the true one.
    ahead: u32,
    jumped: Vec<usize>,
    /// Clock jumps that a frame was stamped after.
    leapt: Vec<usize>,
    told_ghosts: bool,
    /// What they had a part in so far.
    pub(crate) parts: Parts,
}

impl SourceFaults {
    pub(crate) fn new(script: Arc<Script>, n_markers: usize) -> Self {
        let (jumped, leapt) = (Vec::new(), Vec::new());
        let parts = Parts::default();
        Self { script, n_markers, ahead: 0, jumped, leapt, told_ghosts: false, parts }
    }

    /// A frame is stamped by the device's clock.
    pub(crate) fn stamped(&mut self, since_ns: u64) {
        for (index, windowed) in self.script.faults.iter().enumerate() {
            match windowed.fault {
                Fault::ClockDrift { .. } if windowed.is_on(since_ns) => {
                    self.parts.add(Kind::ClockDrift, 1);
                }
                Fault::ClockJump { at_s, .. }
                    if nanoseconds(at_s) <= since_ns && !self.leapt.contains(&index) =>
                {
                    self.leapt.push(index);
                    self.parts.add(Kind::ClockJump, 1);
                }
                _ => {}
            }
        }
    }

    /// What the device's clock is ahead of itself, in nanoseconds: what jumps and drift came to until then.
    pub(crate) fn clock_ahead_ns(&self, since_ns: u64) -> i64 {
        let ahead = |windowed: &super::script::Windowed| match windowed.fault {
            Fault::ClockJump { at_s, by_s } if nanoseconds(at_s) <= since_ns => by_s * 1e9,
            Fault::ClockDrift { ppm } => {
                let lasted = since_ns.min(windowed.to_ns).saturating_sub(windowed.from_ns);
                // As --drift-ppm: a clock that drifts by more than 0 loses.
                -(lasted as f64) * ppm * 1e-6
            }
            _ => 0.0,
        };
        self.script.faults.iter().map(ahead).sum::<f64>().round() as i64
    }

    /// The counter of a frame, as the device says it. `number` is the true one.
    pub(crate) fn counter(&mut self, number: u32, since_ns: u64) -> u32 {
        for (index, windowed) in self.script.faults.iter().enumerate() {
            match windowed.fault {
                Fault::CounterJump { at_s, by }
                    if nanoseconds(at_s) <= since_ns && !self.jumped.contains(&index) =>
                {
                    self.jumped.push(index);
                    self.parts.add(Kind::CounterJump, 1);
                    self.ahead = self.ahead.wrapping_add_signed(by);
                }
                // The first frame has none before it to repeat.
                Fault::CounterRepeat { rate } if number > 0 && windowed.is_on(since_ns) => {
                    let repeats = stream(&self.script, index, number.into()).unit() < rate;
                    self.parts.add(Kind::CounterRepeat, repeats.into());
                    self.ahead = self.ahead.wrapping_sub(u32::from(repeats));
                }
                _ => {}
            }
        }
        number.wrapping_add(self.ahead)
    }

    /// The positions of a frame.
    pub(crate) fn positions(&mut self, since_ns: u64, row: &mut [Position]) {
        for (index, windowed) in self.script.faults.iter().enumerate() {
            if !windowed.is_on(since_ns) {
                continue;
            }
            match windowed.fault {
                Fault::Swaps { every_s, for_s } => {
                    let (time_ns, every_ns) = (since_ns - windowed.from_ns, nanoseconds(every_s));
                    if time_ns % every_ns.max(1) < nanoseconds(for_s) && row.len() > 1 {
                        let mut rng = stream(&self.script, index, time_ns / every_ns.max(1));
                        let one = rng.below(row.len());
                        let other = rng.below(row.len() - 1);
                        row.swap(one, if other >= one { other + 1 } else { other });
                        self.parts.add(Kind::Swaps, 1);
                    }
                }
                Fault::OcclusionStorm { part, gap_s } => {
                    let slot = (since_ns - windowed.from_ns) / nanoseconds(gap_s).max(1);
                    let mut rng = stream(&self.script, index, slot);
                    let mut hides = false;
                    for position in row.iter_mut() {
                        if rng.unit() < part {
                            hides |= !is_gap(*position);
                            *position = GAP;
                        }
                    }
                    self.parts.add(Kind::OcclusionStorm, hides.into());
                }
                _ => {}
            }
        }
    }

    /// Adds the markers that are not there, their ids above all others.
    pub(crate) fn add_ghosts(&mut self, since_ns: u64, samples: &mut Vec<MarkerSample>) {
        let mut id = self.n_markers as u16;
        let before = samples.len();
        for (index, windowed) in self.script.faults.iter().enumerate() {
            let Fault::Ghosts { count } = windowed.fault else { continue };
            let mut rng = stream(&self.script, index, since_ns / GHOST_STAYS_NS);
            for id in (id..).take(usize::from(count)) {
                let mut axis = || rng.between(-GHOST_RANGE_MM, GHOST_RANGE_MM) as f32;
                let position_mm = [axis(), axis(), axis()];
                if rng.unit() < GHOST_PART && windowed.is_on(since_ns) {
                    samples.push(MarkerSample { id, position_mm, ..MarkerSample::default() });
                }
            }
            id += count;
        }
        self.parts.add(Kind::Ghosts, (samples.len() > before).into());
    }

    /// What the device says of them before the first is seen; nothing once it has.
    pub(crate) fn announce_ghosts(&mut self, since_ns: u64) -> Vec<MarkerInfo> {
        let mut ghosts = self.script.faults.iter().filter(|windowed| {
            matches!(windowed.fault, Fault::Ghosts { .. }) && windowed.from_ns <= since_ns
        });
        if self.told_ghosts || ghosts.next().is_none() {
            return Vec::new();
        }
        self.told_ghosts = true;
        let ids = (self.n_markers as u16..).take(self.script.n_ghosts());
        ids.map(|id| MarkerInfo { id, label: String::new(), labelled: false }).collect()
    }

    /// The device lost its power.
    pub(crate) fn begin_anew(&mut self) {
        self.ahead = 0;
        self.told_ghosts = false;
    }
}

/// The random numbers of one fault at one place.
pub(super) fn stream(script: &Script, fault: usize, index: u64) -> Rng {
    Rng::stream(script.seed.wrapping_add((fault as u64 + 1) << 32), index)
}
