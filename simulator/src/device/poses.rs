//! The poses of rigid bodies that the device sends behind each frame.

use mocapd_drivers::device::{BodyInfo, EndOfPoses, PoseFrame};
use mocapd_drivers::link::pose_frame_bytes_max;

use super::{Device, Queued, SentBatch};

/// The group that poses have in logs of batches: the one after those of sampled channels. Takes have them from this number
/// on.
pub const POSES_GROUP: u8 = mocapd_drivers::link::GROUPS_MAX as u8;

impl Device {
    /// The rigid bodies that it announces.
    pub(super) fn body_infos(&self) -> Vec<BodyInfo> {
        self.settings.bodies.as_ref().map(|bodies| bodies.infos()).unwrap_or_default()
    }

    /// Bytes on the wire of the poses of a frame, at most.
    pub(super) fn pose_bytes(&self) -> usize {
        match self.body_infos().len() {
            0 => 0,
            n_bodies => pose_frame_bytes_max(n_bodies),
        }
    }

    /// Queues the poses of frame `counter`, the one with this number in the run, or drops them when the queue is full.
    pub(super) fn produce_poses(&mut self, counter: u32, number: u64, at_ns: u64) {
        let Some(bodies) = &self.settings.bodies else { return };
        let mut poses = std::mem::take(&mut self.poses);
        let rate_hz = f64::from(self.hello.rate_millihertz) / 1000.0;
        let is_sent = bodies.poses(number, rate_hz, &mut poses);
        let since_ns = self.since_ns(at_ns).unwrap_or(0);
        if let Some(faults) = &mut self.faults {
            faults.poses(since_ns, &mut poses);
        }
        self.poses = poses;
        self.put_poses((counter, is_sent), (number, 1), at_ns);
    }

    /// States the number of the frame that would come next.
    pub(super) fn end_poses(&mut self, at_ns: u64) {
        if self.settings.bodies.is_some() {
            self.poses.clear();
            self.put_poses((self.counter, true), (self.log.run.frames_produced, 0), at_ns);
        }
    }

    /// `is_sent`: otherwise the device dropped them.
    fn put_poses(
        &mut self,
        (seq, is_sent): (u32, bool),
        (first_in_run, n): (u64, u64),
        at_ns: u64,
    ) {
        let (number, device_ticks) = (self.poses_sent, self.ticks(at_ns));
        let poses = std::mem::take(&mut self.poses);
        let frame = PoseFrame { seq, number, device_ticks, poses: &poses };
        let mut dropped = !is_sent || !self.outbox.has_room(pose_frame_bytes_max(poses.len()));
        if !dropped {
            let link = &mut self.link;
            // They fit by construction. If the link refused them, they would count as dropped.
            let end = EndOfPoses { seq, number, device_ticks };
            self.outbox.put(Queued::Batch, |out| match n {
                0 => link.end_of_poses(end, out),
                _ => dropped = link.poses(&frame, out).is_err(),
            });
        }
        self.poses = poses;
        if dropped {
            self.log.batches_dropped += 1;
        } else {
            self.poses_sent = number.wrapping_add(1);
            self.log.batches_produced += 1;
        }
        if self.settings.log_frames {
            self.log.batches.push(SentBatch {
                run: self.log.starts,
                group: POSES_GROUP,
                number,
                first: seq.into(),
                first_in_run,
                n,
                device_ticks,
                dropped,
                host_ns: at_ns,
            });
        }
    }
}
