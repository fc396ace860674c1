//! What an export has of a recording besides its trajectories: the rows of a table of recorded channels, which are a
//! group's values or the loads of the force plates whose channels it has, and the poses of its frames, one frame after
//! another.

use std::{io, ops::Range};

use super::text::{unique_names, without_tabs};
use crate::{
    TakeError,
    foreign::force_plates::ForcePlate,
    interchange::c3d::{AnalogChannel, factor_of_unit},
    motion::MotionInfo,
    poses::{CHANNEL_NAMES, Pose, PoseState},
    record::{RecordedPlate, SampledChannel, SampledGroup},
    sampled::{GroupSamples, RecordedPoses, RecordedSamples, Recording, SampleBlock},
};

/// The force plates whose channels a group of a recording has, as those of imported files: their channels are those of the
/// group.
#[must_use]
pub fn recorded_plates(recording: &Recording, group: usize) -> Vec<ForcePlate> {
    let found = recording.groups().get(group);
    found.map_or_else(Vec::new, |found| plates_of_group(recording.plates(), &found.group))
}

/// Those of a recording's force plates whose channels this group has, as those of imported files.
#[must_use]
pub fn plates_of_group(plates: &[RecordedPlate], group: &SampledGroup) -> Vec<ForcePlate> {
    let plate = |plate: &RecordedPlate| {
        let units = plate
            .channels
            .iter()
            .map(|&channel| group.channels.get(channel).map_or("", |channel| channel.unit.trim()));
        // Units that are unknown are taken for N, N m and mm.
        let factor = |(place, unit)| factor_of_unit(plate.kind, place, unit).unwrap_or(1.0);
        ForcePlate {
            number: plate.number,
            kind: plate.kind,
            geometry: plate.geometry.clone(),
            channels: plate.channels.clone(),
            calibration: None,
            factors: units.enumerate().map(factor).collect(),
        }
    };
    plates.iter().filter(|of| of.group == group.number).map(plate).collect()
}

/// A sentence on the channels of a plate whose units are none of forces, moments or lengths.
pub(super) fn unknown_units(plate: &RecordedPlate, groups: &[GroupSamples]) -> Option<String> {
    let group = groups.iter().find(|group| group.group.number == plate.group)?;
    let unknown = plate.channels.iter().enumerate().filter_map(|(place, &channel)| {
        let channel = group.group.channels.get(channel)?;
        let unit = channel.unit.trim();
        let factor = factor_of_unit(plate.kind, place, unit);
        factor.is_none().then(|| format!("{} ('{unit}')", channel.name))
    });
    let unknown: Vec<String> = unknown.collect();
    (!unknown.is_empty()).then(|| {
        format!(
            "Channels of force plate {} have other units than forces, moments and lengths, and were read in N, N m and \
             mm: {}.",
            plate.number,
            unknown.join(", ")
        )
    })
}

/// A recorded channel, as those of imported files.
pub(super) fn as_analog(channel: &SampledChannel) -> AnalogChannel {
    AnalogChannel {
        name: channel.name.clone(),
        unit: channel.unit.clone(),
        description: String::new(),
        scale: channel.scale,
        offset: channel.offset,
    }
}

/// The rows, one for each sample.
#[derive(Debug)]
pub(super) struct RecordedRows<'a> {
    recording: &'a Recording,
    samples: RecordedSamples<'a>,
    /// Whose loads the rows have; empty for a table of channels.
    plates: Vec<ForcePlate>,
    block: SampleBlock,
    next: usize,
    first_row: u64,
    /// The values of a sample.
    values: Vec<f64>,
}

impl<'a> RecordedRows<'a> {
    /// # Errors
    /// Those of [`Recording::samples`].
    pub(super) fn new(
        info: &MotionInfo,
        recording: &'a Recording,
        group: usize,
        plates: Vec<ForcePlate>,
    ) -> Result<Self, TakeError> {
        let rows = info.rows();
        Self::within(recording, group, plates, (&rows, rows.start))
    }

    /// The samples of other rows, with times and places from the first row of the export.
    ///
    /// # Errors
    /// Those of [`Recording::samples`].
    pub(super) fn within(
        recording: &'a Recording,
        group: usize,
        plates: Vec<ForcePlate>,
        (rows, first_row): (&Range<u64>, u64),
    ) -> Result<Self, TakeError> {
        let samples = recording.samples(group, rows)?;
        let (block, values) = (SampleBlock::default(), Vec::new());
        Ok(Self { recording, samples, plates, block, next: 0, first_row, values })
    }

    pub(super) fn plates(&self) -> &[ForcePlate] {
        &self.plates
    }

    pub(super) fn n_rows(&self) -> u64 {
        self.samples.n_samples()
    }

    /// The times of all rows, in seconds from the first frame.
    pub(super) fn times_s(&self) -> impl Iterator<Item = f64> + '_ {
        self.samples.positions().map(|at| self.recording.time_s(at, self.first_row))
    }

    /// The place of the next row in frames from the first one; `None` at the end.
    ///
    /// # Errors
    /// Those of reading the take.
    pub(super) fn peek(&mut self) -> io::Result<Option<f64>> {
        while self.next >= self.block.positions.len() {
            self.next = 0;
            if !self.samples.next_block(&mut self.block)? {
                self.block = SampleBlock::default();
                return Ok(None);
            }
        }
        Ok(self.block.positions.get(self.next).map(|at| at - self.first_row as f64))
    }

    /// Appends the row that was [seen](Self::peek), and returns its time.
    pub(super) fn take(&mut self, out: &mut Vec<f32>) -> f64 {
        let channels = self.samples.channels();
        let n = channels.len();
        let position = self.block.positions.get(self.next).copied().unwrap_or(f64::NAN);
        let stored = self.block.stored.get(self.next * n..(self.next + 1) * n).unwrap_or(&[]);
        self.next += 1;
        self.values.clear();
        self.values.extend(channels.iter().zip(stored).map(|(channel, &s)| channel.value(s)));
        if self.plates.is_empty() {
            out.extend(self.values.iter().map(|&value| value as f32));
        }
        let mut of_plate = [0.0; 8];
        for plate in &self.plates {
            for (value, &channel) in of_plate.iter_mut().zip(&plate.channels) {
                *value = self.values.get(channel).copied().unwrap_or(f64::NAN);
            }
            let load = plate.load(of_plate.get(..plate.channels.len()).unwrap_or(&[]));
            out.extend(load.values().map(|value| value as f32));
        }
        self.recording.time_s(position, self.first_row)
    }
}

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
