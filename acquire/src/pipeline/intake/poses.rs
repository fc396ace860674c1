//! Poses in step with the frames: they go into the rings behind their frame, before a boundary of takes that follows it,
//! whichever of both came first.

use mocapd_drivers::device::{BODIES_MAX, BodyInfo, EndOfPoses, Pose, PoseFrame};

use super::Intake;
use crate::pipeline::{
    plan::POSES_WAIT_NS,
    publish_tap::PublishTapSender,
    sampled::{NewPoses, PosesOutcome},
};

/// Poses whose frame has not come, and the frame whose poses have not.
#[derive(Debug, Default)]
pub(super) struct PoseStep {
    /// Number of the frame, number of the message, and ticks of the poses that wait.
    waiting: Option<(u32, u32, u64)>,
    poses: Vec<Pose>,
    /// The last frame.
    last_frame: Option<u32>,
    /// The frame of the last poses in the rings.
    last_poses: Option<u32>,
    /// Whether the device has sent poses: those of a frame are expected.
    is_active: bool,
}

impl PoseStep {
    /// For a device with this many bodies.
    pub(super) fn new(n_bodies: usize) -> Self {
        // Drivers report at most as many poses, also of bodies that were not announced.
        let capacity = if n_bodies > 0 { BODIES_MAX } else { 0 };
        Self { poses: Vec::with_capacity(capacity), ..Self::default() }
    }
}

impl Intake {
    /// Accepts the poses of a frame: all of them go into the rings of their groups, or are counted as lost.
    pub fn poses(&mut self, frame: &PoseFrame<'_>) {
        self.flush_poses();
        self.pose_step.is_active = true;
        let last = self.pose_step.last_frame;
        if last.is_none_or(|last| frame.seq.wrapping_sub(last).cast_signed() > 0) {
            self.pose_step.waiting = Some((frame.seq, frame.number, frame.device_ticks));
            self.pose_step.poses.clear();
            self.pose_step.poses.extend_from_slice(frame.poses);
            return;
        }
        self.put_poses(frame);
        // The frame was the last one of the take, whose end waited for its poses.
        self.end_before_frame();
    }

    /// Counts the poses that are missing up to the end of a run.
    pub fn end_of_poses(&mut self, end: &EndOfPoses) {
        self.flush_poses();
        let (stretch, segment) = (self.feed.next_stretch(), self.clocks.segment());
        self.samples.end_of_poses(end, stretch, segment);
    }

    /// Reports rigid bodies that differ from those announced before the start.
    pub fn announce_bodies(&mut self, bodies: &[BodyInfo]) {
        if !self.samples.announce_bodies(bodies) {
            let n = bodies.len();
            self.report_announcement(format_args!("other rigid bodies than before, {n} in all,"));
        }
    }

    fn put_poses(&mut self, frame: &PoseFrame<'_>) {
        self.pose_step.last_poses = Some(frame.seq);
        let segment = self.clocks.segment();
        let outcome = self.samples.poses(frame, self.feed.next_stretch(), segment);
        if let Some(NewPoses { rows, n_frames, n_tracked }) = self.samples.new_poses() {
            self.tap.offer_poses(frame.seq, n_frames, (rows, n_tracked));
            self.publish.iter_mut().for_each(|tap| tap.poses(frame.seq, rows));
        }
        if let PosesOutcome::Refused { body } = outcome {
            self.count_refused(format_args!("poses of body {body}"));
        }
    }

    /// Puts the poses that wait into the rings.
    pub(super) fn flush_poses(&mut self) {
        let Some((seq, number, device_ticks)) = self.pose_step.waiting.take() else { return };
        let poses = std::mem::take(&mut self.pose_step.poses);
        self.put_poses(&PoseFrame { seq, number, device_ticks, poses: &poses });
        self.pose_step.poses = poses;
    }

    /// A frame comes: poses of one before it, which did not come, are not behind a boundary before this one.
    pub(super) fn flush_poses_before(&mut self, seq: u32) {
        let is_before = |(of, ..): (u32, u32, u64)| seq.wrapping_sub(of).cast_signed() > 0;
        if self.pose_step.waiting.is_some_and(is_before) {
            self.flush_poses();
        }
    }

    /// The frame is in the rings: its poses follow, if they wait. Returns whether its poses are still to come.
    pub(super) fn flush_poses_of(&mut self, seq: u32) -> bool {
        self.pose_step.last_frame = Some(seq);
        if self.pose_step.waiting.is_some_and(|(of, ..)| of == seq) {
            self.flush_poses();
        }
        self.lacks_poses()
    }

    fn lacks_poses(&self) -> bool {
        let step = &self.pose_step;
        step.is_active && step.last_frame.is_some() && step.last_poses != step.last_frame
    }

    /// Whether the poses of the last frame are still expected.
    pub(super) fn awaits_poses(&self, now_ns: u64) -> bool {
        self.lacks_poses() && now_ns.saturating_sub(self.last_arrival_ns) < POSES_WAIT_NS
    }

    /// The poses of the last frame of a take did not come: its end does not wait any longer.
    pub(super) fn end_without_poses(&mut self) {
        if self.pose_step.is_active {
            self.end_before_frame();
        }
    }

    /// The device was away or starts again: its numbers do, too.
    pub(super) fn reset_poses(&mut self) {
        self.flush_poses();
        self.pose_step.last_frame = None;
        self.tap.forget_frame();
        self.publish.iter_mut().for_each(PublishTapSender::forget_frame);
    }
}
