//! Rigid bodies: their announcement, and their poses in a frame.

/// Maximum number of rigid bodies of a device: twice the most tools and props that a volume holds. It bounds the memory
/// that their poses need.
pub const BODIES_MAX: usize = 128;

/// A rigid body that the device tracks.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct BodyInfo {
    /// The number by which poses refer to it. No two bodies have the same.
    pub id: u16,
    /// Its name; may be empty.
    pub name: String,
}

/// Whether a device has the pose of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PoseStatus {
    /// It has.
    #[default]
    Tracked,
    /// It does not see enough of the body.
    Lost,
    /// It does not vouch for the pose: the body is outside its volume, or its markers do not fit well.
    Rejected,
    /// A code of a later version of the link protocol, 3 to 127: it has none.
    Other(u8),
}

impl PoseStatus {
    /// All that have a name, by their codes.
    pub const ALL: [Self; 3] = [Self::Tracked, Self::Lost, Self::Rejected];

    /// Its number on the wire and in takes, which have numbers of their own from 128 on.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Tracked => 0,
            Self::Lost => 1,
            Self::Rejected => 2,
            Self::Other(code) => code,
        }
    }

    /// That of a number on the wire; `None` from 128 on.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Tracked),
            1 => Some(Self::Lost),
            2 => Some(Self::Rejected),
            3..128 => Some(Self::Other(code)),
            128.. => None,
        }
    }
}

/// The pose of a body in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// The number of the body.
    pub body: u16,
    /// The other fields have a meaning only if it is tracked.
    pub status: PoseStatus,
    /// Position of the body's origin in millimetres, in the device's axes.
    pub position_mm: [f32; 3],
    /// Rotation from the body's axes to the device's, as a unit quaternion w, x, y, z. Its negative is the same rotation.
    pub quaternion: [f32; 4],
    /// How well the body's markers fit, in millimetres; NaN if the device does not report it.
    pub residual_mm: f32,
}

/// Largest deviation of the length of a quaternion from 1. Quaternions and matrices of float32 stay within 1e-6, and those
/// with three decimals within 1e-3; beyond this it is no rotation.
const LENGTH_ERROR_MAX: f64 = 0.01;

impl Pose {
    /// A body without a pose.
    #[must_use]
    pub const fn without(body: u16, status: PoseStatus) -> Self {
        Self {
            body,
            status,
            position_mm: [f32::NAN; 3],
            quaternion: [f32::NAN; 4],
            residual_mm: f32::NAN,
        }
    }

    /// The pose, or none with the status [`Rejected`](PoseStatus::Rejected) if a number is not finite or the quaternion
    /// is no rotation. Nothing but the status remains of a body that is not tracked.
    #[must_use]
    pub fn checked(self) -> Self {
        let status = match self.status {
            PoseStatus::Tracked if !self.is_rotation() => PoseStatus::Rejected,
            status => status,
        };
        if status == PoseStatus::Tracked { self } else { Self::without(self.body, status) }
    }

    fn is_rotation(&self) -> bool {
        let length: f64 = self.quaternion.iter().map(|x| f64::from(*x) * f64::from(*x)).sum();
        (length.sqrt() - 1.0).abs() <= LENGTH_ERROR_MAX
            && self.position_mm.iter().all(|x| x.is_finite())
    }
}

/// The poses of the bodies in one frame. A device that has bodies sends one for each of its frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseFrame<'a> {
    /// Number of the frame: that of [`Frame::seq`](super::Frame::seq), which wraps.
    pub seq: u32,
    /// Counts the pose frames that left the device, and wraps: where frames are missing between two that follow each other
    /// by this number, the device dropped them. A device that does not count them repeats `seq`, and then all missing
    /// ones count as lost on the link.
    pub number: u32,
    /// Device clock at exposure, in ticks.
    pub device_ticks: u64,
    /// The poses; of bodies that are not listed, nothing is known.
    pub poses: &'a [Pose],
}

/// The end of the poses of a run, sent before [`EndOfStream`](super::DeviceEvent::EndOfStream), so that a loss at the end
/// is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EndOfPoses {
    /// Number of the frame that would come next.
    pub seq: u32,
    /// Number of the next message, as [`PoseFrame::number`].
    pub number: u32,
    /// Device clock, in ticks.
    pub device_ticks: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_pose_is_rejected_and_leaves_only_its_status() {
        let good = Pose {
            body: 3,
            status: PoseStatus::Tracked,
            position_mm: [1.0, -2.0, 3.0],
            quaternion: [0.6, 0.0, -0.8, 0.0],
            residual_mm: f32::NAN,
        };
        assert_eq!(good.checked().position_mm, good.position_mm);
        assert_eq!(good.checked().status, PoseStatus::Tracked);
        let rotations = [[0.8001, 0.6, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [1.009, 0.0, 0.0, 0.0]];
        for quaternion in rotations {
            assert_eq!(Pose { quaternion, ..good }.checked().status, PoseStatus::Tracked);
        }
        for bad in [
            Pose { quaternion: [0.0; 4], ..good },
            Pose { quaternion: [1.0, 0.2, 0.0, 0.0], ..good },
            Pose { quaternion: [f32::NAN, 0.0, 0.0, 1.0], ..good },
            Pose { quaternion: [f32::INFINITY, 0.0, 0.0, 1.0], ..good },
            Pose { position_mm: [0.0, f32::NEG_INFINITY, 0.0], ..good },
        ] {
            let found = bad.checked();
            assert_eq!((found.body, found.status), (3, PoseStatus::Rejected), "{bad:?}");
            assert!(found.quaternion.iter().chain(&found.position_mm).all(|x| x.is_nan()));
        }
        let lost = Pose { status: PoseStatus::Lost, ..good }.checked();
        assert!(lost.status == PoseStatus::Lost && lost.residual_mm.is_nan());
    }
}
