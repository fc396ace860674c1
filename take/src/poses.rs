//! Poses of rigid bodies in a recording: groups of sampled channels of the kind [`POSES`]; and poses in the axes after a
//! rotation of the laboratory.
//!
//! `docs/poses.md` describes them. A body has eight channels, and one sample in each frame.

mod by_row;

use std::io::{self, Read, Seek};

use mocapd_codec::poses::{
    POSE_CHANNELS, PoseBounds, PoseRow, RESIDUAL_ERROR_MM, code_without_pose, has_pose, unit,
};

pub(crate) use self::by_row::rows_of;
pub use self::by_row::{PoseBody, PosesByRow, RowPoses};
use crate::{
    TakeError,
    record::SampledGroup,
    sampled::{GroupSamples, LostSamples, POSES},
};

/// What is behind a body's name, and a point, in the names of its channels.
pub const CHANNEL_NAMES: [&str; POSE_CHANNELS] =
    ["x", "y", "z", "qw", "qx", "qy", "qz", "residual"];

/// Their units.
pub const CHANNEL_UNITS: [&str; POSE_CHANNELS] = ["mm", "mm", "mm", "", "", "", "", "mm"];

/// The code of a body that a frame did not list. Codes below 128 are those of the device's states.
pub const UNLISTED: u8 = 255;

/// The code of a pose that the recorder refused: the body has another name since the recording began.
pub const REFUSED: u8 = 254;

/// The number of [`PoseState::Missing`] in outputs. No take has it: there, such rows have no sample.
const MISSING: u8 = 253;

/// Why a row has a pose, or none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PoseState {
    /// The device tracked the body.
    Tracked,
    /// The device did not see enough of it.
    Lost,
    /// The device did not vouch for its pose, or sent numbers that are none.
    Rejected,
    /// The frame did not list it.
    Unlisted,
    /// The recorder refused its pose: the device has another body by its number since the recording began.
    Refused,
    /// For a reason that this version does not know.
    Other,
    /// The take has no pose of any body of its group for this row: they were lost on their way, are damaged, or the device
    /// sent none.
    Missing,
}

impl PoseState {
    /// The name in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Tracked => "tracked",
            Self::Lost => "lost",
            Self::Rejected => "rejected",
            Self::Unlisted => "unlisted",
            Self::Refused => "refused",
            Self::Other => "other",
            Self::Missing => "missing",
        }
    }

    /// Its number in outputs: 0 for a pose, and else the code of its state in takes. Reasons of later versions share one.
    #[must_use]
    pub fn code(self) -> u8 {
        match self {
            Self::Tracked => 0,
            Self::Lost => 1,
            Self::Rejected => 2,
            Self::Other => 3,
            Self::Missing => MISSING,
            Self::Refused => REFUSED,
            Self::Unlisted => UNLISTED,
        }
    }

    /// The state of a number in outputs.
    #[must_use]
    pub fn of_code(code: u8) -> Self {
        match code {
            0 => Self::Tracked,
            1 => Self::Lost,
            2 => Self::Rejected,
            MISSING => Self::Missing,
            REFUSED => Self::Refused,
            UNLISTED => Self::Unlisted,
            _ => Self::Other,
        }
    }
}

/// The pose of a body in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Whether it is there; all numbers are NaN if not.
    pub state: PoseState,
    /// Position of the body's origin in millimetres.
    pub position_mm: [f32; 3],
    /// Rotation from the body's axes to the device's: w, x, y, z; of length 1 if the poses are within bounds, else as the
    /// device sent it.
    pub quaternion: [f32; 4],
    /// How well the body's markers fit, in millimetres; NaN if the device did not report it.
    pub residual_mm: f32,
}

impl Pose {
    /// No pose, for this reason.
    #[must_use]
    pub fn without(state: PoseState) -> Self {
        let (position_mm, quaternion) = ([f32::NAN; 3], [f32::NAN; 4]);
        Self { state, position_mm, quaternion, residual_mm: f32::NAN }
    }

    /// Whether the body was tracked.
    #[must_use]
    pub fn is_tracked(&self) -> bool {
        self.state == PoseState::Tracked
    }
}

/// How the poses of a group are read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseReader {
    /// Whether they are within bounds; else they are as the device sent them.
    is_bounded: bool,
}

impl PoseReader {
    /// For the poses of a group.
    #[must_use]
    pub fn new(group: &SampledGroup) -> Self {
        Self { is_bounded: !group.bounds.0.is_empty() }
    }

    /// The pose of the stored numbers of a body.
    #[must_use]
    pub fn pose(&self, row: &PoseRow) -> Pose {
        let [x, y, z, qw, qx, qy, qz, residual_mm] = *row;
        let quaternion = [qw, qx, qy, qz];
        let quaternion = if self.is_bounded { unit(quaternion) } else { quaternion };
        // A recorder takes lengths of 0.99 to 1.01, and positions that are numbers; others are of damaged takes.
        let square: f64 = quaternion.iter().map(|&number| f64::from(number).powi(2)).sum();
        let is_rotation = (0.98..=1.021).contains(&square);
        if has_pose(row) && is_rotation && [x, y, z].iter().all(|number| number.is_finite()) {
            let (state, position_mm) = (PoseState::Tracked, [x, y, z]);
            return Pose { state, position_mm, quaternion, residual_mm };
        }
        let state = match code_without_pose(row) {
            Some(1) => PoseState::Lost,
            Some(2) => PoseState::Rejected,
            Some(UNLISTED) => PoseState::Unlisted,
            Some(REFUSED) => PoseState::Refused,
            _ => PoseState::Other,
        };
        Pose::without(state)
    }
}

impl SampledGroup {
    /// Whether its channels are the poses of rigid bodies.
    #[must_use]
    pub fn has_poses(&self) -> bool {
        self.kind == POSES
    }

    /// The names of its bodies; none if it has no poses.
    pub fn bodies(&self) -> impl Iterator<Item = &str> {
        self.numbered_bodies().map(|(_, name)| name)
    }

    /// The numbers and the names of its bodies; none if it has no poses.
    pub fn numbered_bodies(&self) -> impl Iterator<Item = (u32, &str)> {
        let channels = if self.has_poses() { &self.channels[..] } else { &[] };
        let suffix = CHANNEL_NAMES[0];
        channels.chunks_exact(POSE_CHANNELS).filter_map(|channels| channels.first()).map(
            move |first| {
                let name = first.name.strip_suffix(suffix);
                let name = name.and_then(|name| name.strip_suffix('.')).unwrap_or(&first.name);
                (first.index, name)
            },
        )
    }

    /// The largest errors of positions in millimetres and of angles in degrees that its poses may have; `None` if they are
    /// as the device sent them.
    #[must_use]
    pub fn pose_bounds(&self) -> Option<[f64; 2]> {
        let position_mm = self.bounds.0.first().filter(|_| self.has_poses())?;
        Some([*position_mm, *self.bounds.0.get(3)?])
    }

    /// States the largest errors that the poses of a group may have.
    pub fn set_pose_bounds(&mut self, bounds: &PoseBounds) {
        let (position_mm, angle_degrees) = (bounds.position_mm(), bounds.angle_degrees());
        let (p, a) = (position_mm, angle_degrees);
        let of_body = [p, p, p, a, a, a, a, RESIDUAL_ERROR_MM];
        self.bounds.0 = of_body.repeat(self.channels.len() / POSE_CHANNELS);
    }
}

impl GroupSamples {
    /// Decodes the poses of the group's bodies. `each` receives the number of the first frame, the number of frames, and
    /// the poses, frame after frame and in each all bodies in order, or `None` where they are lost. Returns those that
    /// cannot be decoded. A group without poses has none.
    ///
    /// # Errors
    /// `Io`, and those of `each`.
    pub fn read_poses(
        &self,
        input: &mut (impl Read + Seek),
        mut each: impl FnMut(u64, u64, Option<&[Pose]>) -> io::Result<()>,
    ) -> Result<Vec<LostSamples>, TakeError> {
        let (reader, n_bodies) = (PoseReader::new(&self.group), self.group.bodies().count());
        let mut poses = Vec::new();
        if n_bodies == 0 {
            return Ok(Vec::new());
        }
        self.read(input, |first, n, samples| {
            let Some(samples) = samples else { return each(first, n, None) };
            poses.clear();
            let columns: Vec<&[f32]> = samples.chunks_exact(n as usize).collect();
            for frame in 0..n as usize {
                for body in columns.chunks_exact(POSE_CHANNELS) {
                    let number = |channel: usize| {
                        let column = body.get(channel).and_then(|column| column.get(frame));
                        column.copied().unwrap_or(f32::NAN)
                    };
                    poses.push(reader.pose(&std::array::from_fn(number)));
                }
            }
            each(first, n, Some(&poses))
        })
    }
}

/// A rotation by a multiple of a quarter turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PoseTurn {
    /// Where the axes x, y and z go.
    columns: [[f64; 3]; 3],
    /// The same as a quaternion: w, x, y, z.
    quaternion: [f64; 4],
}

impl PoseTurn {
    /// The rotation that takes each vector where `turned` does.
    pub(crate) fn new(turned: impl Fn([f64; 3]) -> [f64; 3]) -> Self {
        let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(turned);
        Self { columns, quaternion: quaternion_of(&columns) }
    }

    /// A vector in the axes after the rotation.
    pub(crate) fn vector(&self, at: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| {
            // Each has one number that is not 0, so the sum is exact.
            self.columns.iter().zip(at).map(|(column, x)| column[axis] * x).sum()
        })
    }

    /// A pose in the axes after the rotation.
    pub(crate) fn apply(&self, pose: &Pose) -> Pose {
        let quaternion = product(self.quaternion, pose.quaternion.map(f64::from));
        Pose {
            position_mm: self.vector(pose.position_mm.map(f64::from)).map(|x| x as f32),
            quaternion: quaternion.map(|number| number as f32),
            ..*pose
        }
    }
}

/// The quaternion of a rotation: the largest of its numbers first, whose square the diagonal gives.
fn quaternion_of(columns: &[[f64; 3]; 3]) -> [f64; 4] {
    let [[xx, yx, zx], [xy, yy, zy], [xz, yz, zz]] = *columns;
    // Four times the products of the numbers.
    let products = [
        [1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, 1.0 + xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, 1.0 - xx + yy - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, 1.0 - xx - yy + zz],
    ];
    let largest = (0..4).max_by(|&a, &b| products[a][a].total_cmp(&products[b][b])).unwrap_or(0);
    let twice = products[largest][largest].sqrt();
    products[largest].map(|number| number / (2.0 * twice))
}

/// The rotation `b`, and then `a`.
fn product([aw, ax, ay, az]: [f64; 4], [bw, bx, by, bz]: [f64; 4]) -> [f64; 4] {
    [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
}

/// The 4 x 4 matrix of a pose, column after column: a point p of the body in homogeneous coordinates is at M p. The
/// quaternion is scaled to a length of 1.
pub(crate) fn matrix(pose: &Pose) -> [f64; 16] {
    let length = pose.quaternion.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt();
    let [w, x, y, z] = pose.quaternion.map(|number| f64::from(number) / length);
    let [tx, ty, tz] = pose.position_mm.map(f64::from);
    [
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y + w * z),
        2.0 * (x * z - w * y),
        0.0,
        2.0 * (x * y - w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z + w * x),
        0.0,
        2.0 * (x * z + w * y),
        2.0 * (y * z - w * x),
        1.0 - 2.0 * (x * x + y * y),
        0.0,
        tx,
        ty,
        tz,
        1.0,
    ]
}

#[cfg(test)]
mod tests {
    use mocapd_codec::poses::without_pose;

    use super::PoseState;
    use super::*;
    use crate::record::SampledChannel;

    #[test]
    fn poses_are_read_with_their_states() {
        let names = ["pelvis", "a.b", ""].map(str::to_owned);
        let channel = |body: &String, name| SampledChannel {
            name: format!("{body}.{name}"),
            ..SampledChannel::default()
        };
        let mut group = SampledGroup {
            kind: POSES.to_owned(),
            channels: names
                .iter()
                .flat_map(|body| CHANNEL_NAMES.map(|name| channel(body, name)))
                .collect(),
            ..SampledGroup::default()
        };
        assert!(group.bodies().eq(["pelvis", "a.b", ""]));
        assert_eq!(group.pose_bounds(), None);
        let row = [1.0, -2.0, 3.0, 0.6, 0.0, 0.79, 0.0, 0.25];
        let exact = PoseReader::new(&group).pose(&row);
        assert_eq!((exact.state, exact.quaternion), (PoseState::Tracked, [0.6, 0.0, 0.79, 0.0]));
        assert_eq!((exact.position_mm, exact.residual_mm), ([1.0, -2.0, 3.0], 0.25));
        let tolerance = mocapd_codec::Tolerance::from_mm(0.5).unwrap();
        let bounds = PoseBounds::new(tolerance, 0.25).unwrap();
        group.set_pose_bounds(&bounds);
        assert_eq!((group.bounds.0.len(), group.pose_bounds()), (24, Some([0.5, 0.25])));
        let reader = PoseReader::new(&group);
        let length: f32 = reader.pose(&row).quaternion.iter().map(|x| x * x).sum();
        assert!((length - 1.0).abs() < 1e-6);
        for (code, state) in [
            (1, PoseState::Lost),
            (2, PoseState::Rejected),
            (UNLISTED, PoseState::Unlisted),
            (REFUSED, PoseState::Refused),
            (77, PoseState::Other),
        ] {
            let pose = reader.pose(&without_pose(&row, code));
            assert_eq!(pose.state, state);
            assert!(pose.position_mm.iter().chain(&pose.quaternion).all(|x| x.is_nan()));
        }
        let mut damaged = row;
        damaged[4] = f32::INFINITY;
        assert_eq!(reader.pose(&damaged).state, PoseState::Other);
        damaged[3..7].fill(0.0);
        assert_eq!(reader.pose(&damaged).state, PoseState::Other, "no rotation");
        damaged = row;
        damaged[1] = f32::INFINITY;
        assert_eq!(reader.pose(&damaged).state, PoseState::Other, "no position");
        group.kind = String::new();
        assert_eq!((group.bodies().count(), group.pose_bounds()), (0, None));
    }

    /// Where a pose puts a point of its body.
    fn place(pose: &Pose, point: [f64; 3]) -> [f64; 3] {
        let m = matrix(pose);
        let [x, y, z] = point;
        std::array::from_fn(|i| m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i])
    }

    #[test]
    fn a_turned_pose_puts_every_point_where_the_turned_laboratory_has_it() {
        // A quarter turn about z takes x to y.
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let quarter = Pose {
            state: PoseState::Tracked,
            position_mm: [10.0, 20.0, 30.0],
            quaternion: [half, 0.0, 0.0, half],
            residual_mm: 0.5,
        };
        let found = place(&quarter, [1.0, 0.0, 0.0]);
        assert!((found[0] - 10.0).abs() < 1e-6 && (found[1] - 21.0).abs() < 1e-6, "{found:?}");
        let pose = Pose { quaternion: [0.1, 0.5, -0.7, 0.5], ..quarter };
        let turns: [fn([f64; 3]) -> [f64; 3]; 5] = [
            |[x, y, z]| [x, y, z],
            |[x, y, z]| [x, z, -y],
            |[x, y, z]| [z, y, -x],
            |[x, y, z]| [-x, -y, z],
            |[x, y, z]| [y, z, x],
        ];
        for turned in turns {
            let after = PoseTurn::new(turned).apply(&pose);
            assert_eq!((after.state, after.residual_mm), (PoseState::Tracked, 0.5));
            for point in [[0.0; 3], [100.0, 0.0, 0.0], [3.0, -50.0, 7.0]] {
                let (found, expected) = (place(&after, point), turned(place(&pose, point)));
                let apart = found.iter().zip(expected).map(|(a, b)| (a - b).abs());
                assert!(apart.fold(0.0, f64::max) < 1e-4, "{found:?} {expected:?}");
            }
        }
    }
}
