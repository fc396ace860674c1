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

/// The names of a recording's bodies as [`output_names`] has them.
pub(super) fn body_names(info: &MotionInfo) -> Vec<String> {
    let bodies = info.recording.as_ref().map_or(&[][..], |recording| recording.bodies());
    output_names(bodies.iter().map(|body| (body.number, &body.name)))
}

/// The names of bodies in exports and live streams, from their numbers and names: each is unique and has no tabs. A body
/// without a name is named by its number.
pub fn output_names(bodies: impl Iterator<Item = (u32, impl AsRef<str>)>) -> Vec<String> {
    unique_names(bodies.map(|(number, name)| match without_tabs(name.as_ref()).trim() {
        "" => format!("body{number}"),
        name => name.to_owned(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    const BODIES: [&str; 6] = ["hand", " ", "world", "hand", "hand#2", "left\tfoot"];

    #[test]
    fn every_body_has_a_name_of_its_own() {
        let found = output_names((6..).zip(BODIES));
        assert_eq!(found, ["hand", "body7", "world", "hand#2", "hand#2#2", "left foot"]);
    }

    #[cfg(feature = "full")]
    #[test]
    fn no_frame_of_reference_of_a_body_is_that_of_the_positions_or_of_the_world() {
        let found = crate::interchange::foxglove::child_frames(output_names((6..).zip(BODIES)));
        assert_eq!(found, ["hand", "body7", "world#2", "hand#2", "hand#2#2", "left foot"]);
    }
}
