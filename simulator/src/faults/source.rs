//! Faults inside the device: in the motion, the frame counter and the clock, before a frame is encoded.
//!
//! Each is a function of the script and of the time since the first Start. A frame's time is its place on the device's
//! own grid, so the same frames change in the same way on a busy host.

use std::sync::Arc;

use mocapd_drivers::device::{MarkerInfo, MarkerSample, Pose, PoseStatus};
use mocapd_take::motion::{GAP, Position, is_gap};

use super::script::{Script, nanoseconds};
use super::{Fault, Kind};
use crate::device::FaultCounts;
use crate::generator::Rng;

/// Ghosts appear within this distance of the origin on each axis: the size of a capture volume.
const GHOST_RANGE_MM: f64 = 3000.0;

/// First random stream of bodies: above those of markers.
const BODIES: u64 = 1 << 40;

/// How long a ghost stays at one place.
const GHOST_STAY_NS: u64 = 250_000_000;

/// Probability that a ghost is visible at one place.
const GHOST_VISIBLE: f64 = 0.7;

/// The faults of a script that act inside the device.
#[derive(Debug)]
pub(crate) struct SourceFaults {
    script: Arc<Script>,
    n_markers: usize,
    /// The counter on the wire less the true one, modulo 2^32.
    counter_offset: u32,
    /// Counter jumps that have happened, and clock jumps before the last frame, as indices into the script.
    jumps_done: Vec<usize>,
    ghosts_announced: bool,
    /// What each kind has done so far.
    pub(crate) counts: FaultCounts,
}

impl SourceFaults {
    pub(crate) fn new(script: Arc<Script>, n_markers: usize) -> Self {
        Self {
            script,
            n_markers,
            counter_offset: 0,
            jumps_done: Vec::new(),
            ghosts_announced: false,
            counts: FaultCounts::default(),
        }
    }

    /// Counts the clock faults that affect the timestamp of a frame.
    pub(crate) fn count_clock_faults(&mut self, since_ns: u64) {
        for (index, scheduled) in self.script.faults.iter().enumerate() {
            match scheduled.fault {
                Fault::ClockDrift { .. } if scheduled.is_on(since_ns) => {
                    self.counts.add(Kind::ClockDrift, 1);
                }
                Fault::ClockJump { at_s, .. }
                    if nanoseconds(at_s) <= since_ns && !self.jumps_done.contains(&index) =>
                {
                    self.jumps_done.push(index);
                    self.counts.add(Kind::ClockJump, 1);
                }
                _ => {}
            }
        }
    }

    /// The device clock's offset from jumps and drift up to this time, nanoseconds; positive when it is ahead.
    pub(crate) fn clock_offset_ns(&self, since_ns: u64) -> i64 {
        let offset_ns = |scheduled: &super::script::ScheduledFault| match scheduled.fault {
            Fault::ClockJump { at_s, by_s } if nanoseconds(at_s) <= since_ns => by_s * 1e9,
            Fault::ClockDrift { ppm } => {
                let lasted = since_ns.min(scheduled.to_ns).saturating_sub(scheduled.from_ns);
                // The sign of --drift-ppm: a clock with a positive drift loses time.
                -(lasted as f64) * ppm * 1e-6
            }
            _ => 0.0,
        };
        self.script.faults.iter().map(offset_ns).sum::<f64>().round() as i64
    }

    /// How early the time stamp of a frame at this time is, nanoseconds: a stamp is never later than what it stands for was
    /// sent.
    pub(crate) fn stamp_jitter_ns(&mut self, since_ns: u64) -> i64 {
        let mut early_ns = 0.0;
        for (index, scheduled) in self.script.active(since_ns) {
            if let Fault::StampJitter { ms } = scheduled.fault {
                early_ns += ms as f64 * 1e6 * stream(&self.script, index, since_ns).unit();
                self.counts.add(Kind::StampJitter, 1);
            }
        }
        early_ns.round() as i64
    }

    /// The frame counter that the device sends; `number` is the true one.
    pub(crate) fn counter(&mut self, number: u32, since_ns: u64) -> u32 {
        for (index, scheduled) in self.script.faults.iter().enumerate() {
            match scheduled.fault {
                Fault::CounterJump { at_s, by }
                    if nanoseconds(at_s) <= since_ns && !self.jumps_done.contains(&index) =>
                {
                    self.jumps_done.push(index);
                    self.counts.add(Kind::CounterJump, 1);
                    self.counter_offset = self.counter_offset.wrapping_add_signed(by);
                }
                // The first frame has no predecessor to repeat.
                Fault::CounterRepeat { rate } if number > 0 && scheduled.is_on(since_ns) => {
                    let repeats = stream(&self.script, index, number.into()).unit() < rate;
                    self.counts.add(Kind::CounterRepeat, repeats.into());
                    self.counter_offset = self.counter_offset.wrapping_sub(u32::from(repeats));
                }
                _ => {}
            }
        }
        number.wrapping_add(self.counter_offset)
    }

    /// Applies swaps and occlusions to the positions of a frame.
    pub(crate) fn positions(&mut self, since_ns: u64, row: &mut [Position]) {
        for (index, scheduled) in self.script.active(since_ns) {
            match scheduled.fault {
                Fault::Swaps { every_s, for_s } => {
                    let (time_ns, every_ns) = (since_ns - scheduled.from_ns, nanoseconds(every_s));
                    if time_ns % every_ns.max(1) < nanoseconds(for_s) && row.len() > 1 {
                        let mut rng = stream(&self.script, index, time_ns / every_ns.max(1));
                        let one = rng.below(row.len());
                        let other = rng.below(row.len() - 1);
                        row.swap(one, if other >= one { other + 1 } else { other });
                        self.counts.add(Kind::Swaps, 1);
                    }
                }
                Fault::OcclusionStorm { part, gap_s } => {
                    let slot = (since_ns - scheduled.from_ns) / nanoseconds(gap_s).max(1);
                    let mut rng = stream(&self.script, index, slot);
                    let mut hides = false;
                    for position in row.iter_mut() {
                        if rng.unit() < part {
                            hides |= !is_gap(*position);
                            *position = GAP;
                        }
                    }
                    self.counts.add(Kind::OcclusionStorm, hides.into());
                }
                _ => {}
            }
        }
    }

    /// Applies occlusions to the poses of a frame: bodies are lost as markers are.
    pub(crate) fn poses(&mut self, since_ns: u64, poses: &mut [Pose]) {
        for (index, scheduled) in self.script.active(since_ns) {
            let Fault::OcclusionStorm { part, gap_s } = scheduled.fault else { continue };
            let slot = (since_ns - scheduled.from_ns) / nanoseconds(gap_s).max(1);
            let mut rng = stream(&self.script, index, BODIES + slot);
            for pose in poses.iter_mut().filter(|_| rng.unit() < part) {
                *pose = Pose::without(pose.body, PoseStatus::Lost);
            }
        }
    }

    /// Appends the ghost markers; their ids follow those of the real markers.
    pub(crate) fn add_ghosts(&mut self, since_ns: u64, samples: &mut Vec<MarkerSample>) {
        let mut id = self.n_markers as u16;
        let before = samples.len();
        for (index, scheduled) in self.script.faults.iter().enumerate() {
            let Fault::Ghosts { count } = scheduled.fault else { continue };
            let mut rng = stream(&self.script, index, since_ns / GHOST_STAY_NS);
            for id in (id..).take(usize::from(count)) {
                let mut axis = || rng.between(-GHOST_RANGE_MM, GHOST_RANGE_MM) as f32;
                let position_mm = [axis(), axis(), axis()];
                if rng.unit() < GHOST_VISIBLE && scheduled.is_on(since_ns) {
                    samples.push(MarkerSample { id, position_mm, ..MarkerSample::default() });
                }
            }
            id += count;
        }
        self.counts.add(Kind::Ghosts, (samples.len() > before).into());
    }

    /// The ghosts' entries for the marker table, once, when the first ghost fault begins; empty otherwise.
    pub(crate) fn announce_ghosts(&mut self, since_ns: u64) -> Vec<MarkerInfo> {
        let mut ghosts = self.script.faults.iter().filter(|scheduled| {
            matches!(scheduled.fault, Fault::Ghosts { .. }) && scheduled.from_ns <= since_ns
        });
        if self.ghosts_announced || ghosts.next().is_none() {
            return Vec::new();
        }
        self.ghosts_announced = true;
        let ids = (self.n_markers as u16..).take(self.script.n_ghosts());
        ids.map(|id| MarkerInfo { id, label: String::new(), labelled: false }).collect()
    }

    /// Forgets what a loss of power erases: the counter offset and the announced ghosts.
    pub(crate) fn reset(&mut self) {
        self.counter_offset = 0;
        self.ghosts_announced = false;
    }
}

/// The random numbers of one fault for one frame, message or time slot.
pub(crate) fn stream(script: &Script, fault: usize, index: u64) -> Rng {
    Rng::stream(script.seed.wrapping_add((fault as u64 + 1) << 32), index)
}
