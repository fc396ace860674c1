//! The poses of an export's frames, one frame after another.

use std::io;

use super::text::{unique_names, without_tabs};
use crate::{
    motion::MotionInfo,
    poses::{CHANNEL_NAMES, Pose, PoseState},
    sampled::RecordedPoses,
};

/// The column with the number of a body's state, after its [channels](CHANNEL_NAMES).
pub(super) const STATE: &str = "state";

/// What a state is.
pub(super) const ABOUT_STATE: &str =
    "0 tracked, 1 lost, 2 rejected, 3 other, 253 missing, 254 refused, 255 unlisted";

/// Columns of a body in a table.
pub(super) const BODY_COLUMNS: usize = CHANNEL_NAMES.len() + 1;

/// The poses of all bodies, frame by frame.
#[derive(Debug)]
pub(super) struct FramePoses<'a> {
    poses: RecordedPoses<'a>,
    n_bodies: usize,
    /// Of some frames, and the index of the next one's first.
    block: Vec<Pose>,
    next: usize,
}

impl<'a> FramePoses<'a> {
    /// The poses of the frames that `info` describes; `None` if there are no bodies.
    pub(super) fn open(info: &'a MotionInfo) -> Option<Self> {
        let recording = info.recording.as_ref()?;
        let n_bodies = recording.bodies().len();
        let poses = recording.poses(info.rows());
        (n_bodies > 0).then(|| Self { poses, n_bodies, block: Vec::new(), next: 0 })
    }

    /// The poses of the next frame, in order of the bodies.
    ///
    /// # Errors
    /// Those of reading the take.
    pub(super) fn next_frame(&mut self) -> io::Result<&[Pose]> {
        if self.next >= self.block.len() {
            self.next = 0;
            if self.poses.next(&mut self.block)?.is_none() {
                // Frames behind the last row of the take.
                self.block.resize(self.n_bodies, Pose::without(PoseState::Missing));
            }
        }
        let from = self.next;
        self.next += self.n_bodies;
        Ok(self.block.get(from..self.next).unwrap_or_default())
    }

    /// Appends the columns of the next frame, [`BODY_COLUMNS`] for each body; NaN where a body has no pose.
    pub(super) fn next_row(&mut self, out: &mut Vec<f32>) -> io::Result<()> {
        for pose in self.next_frame()? {
            out.extend(pose.position_mm);
            out.extend(pose.quaternion);
            out.extend([pose.residual_mm, f32::from(pose.state.code())]);
        }
        Ok(())
    }
}

/// The names of the bodies, each of which is unique and has no tabs; a body without a name is named by its number.
pub(super) fn body_names(info: &MotionInfo) -> Vec<String> {
    let bodies = info.recording.as_ref().map_or(&[][..], |recording| recording.bodies());
    let names = bodies.iter().map(|body| match without_tabs(&body.name).trim() {
        "" => format!("body{}", body.number),
        name => name.to_owned(),
    });
    unique_names(names)
}
