//! Poses of rigid bodies as sampled channels: eight of a body, eight bodies a group, one sample a frame.

use std::ops::RangeInclusive;

use mocapd_codec::{
    GROUP_CHANNELS,
    poses::{GROUP_BODIES, POSE_CHANNELS, PoseRow, RESIDUAL_NOT_REPORTED, has_pose, without_pose},
};
use mocapd_drivers::{
    device::{
        BODIES_MAX, BodyInfo, EndOfPoses, Pose, PoseFrame, PoseStatus, SampleBatch, SampleForm,
        SampledChannelInfo, SampledGroupInfo,
    },
    link::GROUPS_MAX,
};
use mocapd_take::{
    poses::{CHANNEL_NAMES, CHANNEL_UNITS, REFUSED, UNLISTED},
    sampled::RESIDUAL_GROUPS,
};

/// Numbers of the groups of poses: those behind the numbers of the device's own groups.
pub(super) const NUMBERS: RangeInclusive<u8> =
    GROUPS_MAX as u8..=(GROUPS_MAX + BODIES_MAX / GROUP_BODIES - 1) as u8;

const _: () = assert!(*NUMBERS.end() as u32 + 1 == RESIDUAL_GROUPS.start);

/// The bodies as groups of sampled channels.
pub(super) fn groups(bodies: &[BodyInfo], rate_millihertz: u32) -> Vec<SampledGroupInfo> {
    let group = |(id, bodies): (u8, &[BodyInfo])| SampledGroupInfo {
        id,
        form: SampleForm::Float32,
        rate_millihertz,
        channels: bodies.iter().flat_map(channels).collect(),
    };
    (*NUMBERS.start()..).zip(bodies.chunks(GROUP_BODIES)).map(group).collect()
}

fn channels(body: &BodyInfo) -> impl Iterator<Item = SampledChannelInfo> {
    CHANNEL_NAMES.iter().zip(CHANNEL_UNITS).map(|(name, unit)| SampledChannelInfo {
        name: format!("{}.{name}", body.name),
        unit: unit.to_owned(),
        scale: 1.0,
        offset: 0.0,
    })
}

/// What became of the poses of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::pipeline) enum PosesOutcome {
    /// They are in the rings, or were counted as lost or as duplicates.
    Counted,
    /// So are the others; this body was not announced before the start, or was announced otherwise since.
    Refused { body: u16 },
}

/// Turns the poses of a frame into one sample of every group.
#[derive(Debug, Default)]
pub(super) struct PoseRows {
    bodies: Vec<KnownBody>,
    /// The last frame's number as sent, and counted on without wrapping.
    last: Option<(u32, u64)>,
    /// The samples of all groups, one group after another; those of the last frame that had poses until the next.
    row: Vec<f32>,
    /// Whether the frame had any.
    has_samples: bool,
    /// Frames with poses, and by body in how many of them it was tracked.
    n_frames: u64,
    n_tracked: Vec<u64>,
}

/// The poses of a frame that had not come before.
#[derive(Debug, Clone, Copy)]
pub(in crate::pipeline) struct NewPoses<'a> {
    /// By body.
    pub(in crate::pipeline) rows: &'a [PoseRow],
    /// Frames with poses so far, and by body in how many of them it was tracked.
    pub(in crate::pipeline) n_frames: u64,
    pub(in crate::pipeline) n_tracked: &'a [u64],
}

#[derive(Debug)]
struct KnownBody {
    info: BodyInfo,
    /// Whether the device announced it otherwise since: its poses must not be stored under its old name.
    is_contradicted: bool,
}

impl PoseRows {
    pub(super) fn new(bodies: &[BodyInfo]) -> Self {
        let known = |info: &BodyInfo| KnownBody { info: info.clone(), is_contradicted: false };
        let row = vec![0.0; bodies.len() * POSE_CHANNELS];
        Self {
            bodies: bodies.iter().map(known).collect(),
            last: None,
            row,
            has_samples: false,
            n_frames: 0,
            n_tracked: vec![0; bodies.len()],
        }
    }

    /// Whether an announcement has the known bodies and no others.
    pub(super) fn announce(&mut self, bodies: &[BodyInfo]) -> bool {
        let mut are_known = bodies.len() == self.bodies.len();
        for known in &mut self.bodies {
            let now = bodies.iter().find(|body| body.id == known.info.id);
            known.is_contradicted = now.is_some_and(|now| *now != known.info);
            are_known &= now == Some(&known.info);
        }
        are_known
    }

    /// Takes the poses of a frame. The samples are those of [`batches`](Self::batches) until the next call.
    pub(super) fn fill(&mut self, frame: &PoseFrame<'_>) -> PosesOutcome {
        self.count(frame.seq);
        self.has_samples = true;
        let mut outcome = PosesOutcome::Counted;
        let (rows, _) = self.row.as_chunks_mut::<POSE_CHANNELS>();
        rows.iter_mut().for_each(|row| *row = without_pose(row, UNLISTED));
        for (place, pose) in frame.poses.iter().enumerate() {
            let is_its = |known: &KnownBody| known.info.id == pose.body;
            // Most devices send the bodies in the order of their table.
            let place = match self.bodies.get(place).is_some_and(is_its) {
                true => Some(place),
                false => self.bodies.iter().position(is_its),
            };
            let known = place.and_then(|place| self.bodies.get(place).zip(rows.get_mut(place)));
            match known {
                Some((known, row)) if !known.is_contradicted => {
                    *row = next_row(row, &pose.checked());
                    continue;
                }
                Some((_, row)) => *row = without_pose(row, REFUSED),
                None => {}
            }
            outcome = PosesOutcome::Refused { body: pose.body };
        }
        outcome
    }

    /// Counts the frame, and by body whether it was tracked in it.
    pub(super) fn count_tracked(&mut self) {
        self.n_frames += 1;
        let (rows, _) = self.row.as_chunks::<POSE_CHANNELS>();
        for (n_tracked, row) in self.n_tracked.iter_mut().zip(rows) {
            *n_tracked += u64::from(has_pose(row));
        }
    }

    /// The poses of the last frame that had any.
    pub(super) fn last(&self) -> NewPoses<'_> {
        let rows = self.row.as_chunks().0;
        NewPoses { rows, n_frames: self.n_frames, n_tracked: &self.n_tracked }
    }

    /// Takes the number of samples at the end.
    pub(super) fn end(&mut self, end: &EndOfPoses) {
        self.count(end.seq);
        self.has_samples = false;
    }

    /// A take may begin here: it has nothing of the rows before.
    pub(super) fn forget(&mut self) {
        self.row.fill(0.0);
    }

    fn count(&mut self, seq: u32) {
        let (last, count) = self.last.unwrap_or((seq, seq.into()));
        let step = i64::from(seq.wrapping_sub(last).cast_signed());
        self.last = Some((seq, count.wrapping_add_signed(step)));
    }

    /// The batch of each group: one sample, or none to say how many there were.
    pub(super) fn batches(
        &self,
        number: u32,
        device_ticks: u64,
    ) -> impl Iterator<Item = SampleBatch<'_>> + Clone {
        let first = self.last.map_or(0, |(_, count)| count);
        let groups = self.bodies.chunks(GROUP_BODIES).enumerate();
        groups.map(move |(index, bodies)| SampleBatch {
            group: NUMBERS.start() + index as u8,
            number,
            first,
            device_ticks,
            form: SampleForm::Float32,
            n_channels: (bodies.len() * POSE_CHANNELS) as u8,
            samples: self.samples(index),
        })
    }

    /// The samples of a group; none in a frame without poses.
    fn samples(&self, group: usize) -> &[f32] {
        let samples = self.row.chunks(GROUP_CHANNELS).nth(group).filter(|_| self.has_samples);
        samples.unwrap_or_default()
    }
}

/// The row of a body after `before`.
fn next_row(before: &PoseRow, pose: &Pose) -> PoseRow {
    if pose.status != PoseStatus::Tracked {
        return without_pose(before, pose.status.code());
    }
    let ([x, y, z], [qw, qx, qy, qz]) = (pose.position_mm, pose.quaternion);
    let is_reported = pose.residual_mm.is_finite() && pose.residual_mm >= 0.0;
    let residual = if is_reported { pose.residual_mm } else { RESIDUAL_NOT_REPORTED };
    [x, y, z, qw, qx, qy, qz, residual]
}
