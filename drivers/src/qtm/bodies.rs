//! Components of rigid bodies in frames, in both directions.

use super::rotation::{angles_of, matrix_of, quaternion_of};
use crate::{
    bytes::{Cursor, WireValue},
    device::{Pose, PoseStatus},
    qtm::packet::MISSING,
};

/// Bytes of a component before its bodies: size, type, count and two rates.
const COMPONENT_HEADER_BYTES: usize = 16;

/// Components of rigid bodies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum BodyComponentKind {
    /// Positions and rotation matrices.
    Matrices = 5,
    /// Positions and angles.
    Angles = 6,
    /// Positions, rotation matrices and residuals.
    MatricesWithResiduals = 11,
    /// Positions, angles and residuals.
    AnglesWithResiduals = 12,
}

impl BodyComponentKind {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 4] =
        [Self::Matrices, Self::Angles, Self::MatricesWithResiduals, Self::AnglesWithResiduals];

    pub(super) fn of(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| u32::from(*kind as u8) == code)
    }

    /// Its name in commands.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Matrices => "6D",
            Self::Angles => "6DEuler",
            Self::MatricesWithResiduals => "6DRes",
            Self::AnglesWithResiduals => "6DEulerRes",
        }
    }

    /// Whether rotations are matrices, and not angles.
    pub(super) fn has_matrices(self) -> bool {
        matches!(self, Self::Matrices | Self::MatricesWithResiduals)
    }

    fn has_residuals(self) -> bool {
        matches!(self, Self::MatricesWithResiduals | Self::AnglesWithResiduals)
    }

    /// Bytes of one body, from protocol version 1.8 on.
    #[must_use]
    pub fn body_bytes(self) -> usize {
        let rotation = if self.has_matrices() { 36 } else { 12 };
        12 + rotation + 4 * usize::from(self.has_residuals())
    }
}

/// A body of a component.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ServedBody {
    /// Position of its origin in millimetres; NaN when the body is lost.
    pub position_mm: [f32; 3],
    /// Rotation from the body's axes to the laboratory's, column after column.
    pub matrix: [f32; 9],
    /// How well its markers fit; NaN where that is not known.
    pub residual_mm: f32,
}

impl ServedBody {
    /// A body that is lost.
    pub const LOST: Self =
        Self { position_mm: [MISSING; 3], matrix: [MISSING; 9], residual_mm: MISSING };

    /// A body with this pose; without one it is lost.
    #[must_use]
    pub fn of_pose(pose: &Pose) -> Self {
        let Pose { status, position_mm, quaternion, residual_mm, .. } = *pose;
        match status {
            PoseStatus::Tracked => Self { position_mm, matrix: matrix_of(quaternion), residual_mm },
            _ => Self::LOST,
        }
    }

    /// The pose of the body with this number. Without a position it is lost; a matrix that is no rotation is rejected.
    pub(super) fn pose(&self, body: u16) -> Pose {
        if self.position_mm.iter().chain(&self.matrix).any(|value| value.is_nan()) {
            return Pose::without(body, PoseStatus::Lost);
        }
        let Some(quaternion) = quaternion_of(self.matrix) else {
            return Pose::without(body, PoseStatus::Rejected);
        };
        let position_mm = self.position_mm;
        let residual_mm = if self.residual_mm.is_finite() { self.residual_mm } else { f32::NAN };
        Pose { body, status: PoseStatus::Tracked, position_mm, quaternion, residual_mm }.checked()
    }
}

/// A component of rigid bodies with matrices.
#[derive(Debug, Clone, Copy)]
pub struct BodyComponent<'a> {
    /// What its bodies have: matrices.
    pub kind: BodyComponentKind,
    bodies: &'a [u8],
}

impl<'a> BodyComponent<'a> {
    /// Reads the content of a component with matrices; `None` when its size and its count differ.
    pub(super) fn read(kind: BodyComponentKind, content: &'a [u8]) -> Option<Self> {
        let mut content = Cursor::new(content);
        let count = usize::try_from(content.get::<u32>()?).ok()?;
        let _rates: [u16; 2] = [content.get()?, content.get()?];
        let bodies = content.bytes(count.checked_mul(kind.body_bytes())?)?;
        content.end(Self { kind, bodies })
    }

    /// Number of bodies.
    #[must_use]
    pub fn n_bodies(&self) -> usize {
        self.bodies.len() / self.kind.body_bytes()
    }

    /// The bodies.
    pub fn bodies(&self) -> impl Iterator<Item = ServedBody> + use<'a> {
        let kind = self.kind;
        self.bodies.chunks_exact(kind.body_bytes()).filter_map(move |body| {
            let mut body = Cursor::new(body);
            let position_mm = body.get()?;
            let mut matrix = [0.0; 9];
            for number in &mut matrix {
                *number = body.get()?;
            }
            let residual_mm = if kind.has_residuals() { body.get()? } else { f32::NAN };
            Some(ServedBody { position_mm, matrix, residual_mm })
        })
    }
}

/// What a server sends of one component of bodies.
#[derive(Debug, Clone, Copy)]
pub(super) struct BodiesToSend<'a> {
    pub(super) kind: BodyComponentKind,
    /// 2D frames lost, and out of sync, per thousand.
    pub(super) rates: [u16; 2],
    pub(super) bodies: &'a [ServedBody],
}

impl BodiesToSend<'_> {
    /// Its bytes in a packet.
    pub(super) fn bytes(&self) -> usize {
        COMPONENT_HEADER_BYTES + self.bodies.len() * self.kind.body_bytes()
    }

    pub(super) fn put(&self, out: &mut Vec<u8>) {
        let Self { kind, rates, bodies } = *self;
        (self.bytes() as u32).put(out);
        u32::from(kind as u8).put(out);
        (bodies.len() as u32).put(out);
        rates.into_iter().for_each(|rate| rate.put(out));
        for body in bodies {
            body.position_mm.put(out);
            if kind.has_matrices() {
                body.matrix.into_iter().for_each(|number| number.put(out));
            } else if body.matrix.iter().any(|number| number.is_nan()) {
                [MISSING; 3].put(out);
            } else {
                angles_of(body.matrix).put(out);
            }
            if kind.has_residuals() {
                body.residual_mm.put(out);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose() -> Pose {
        Pose {
            body: 3,
            status: PoseStatus::Tracked,
            position_mm: [1.0, -2.0, 0.5],
            // A quarter turn about z.
            quaternion: [f32::sqrt(0.5), 0.0, 0.0, f32::sqrt(0.5)],
            residual_mm: 0.25,
        }
    }

    fn put(kind: BodyComponentKind, bodies: &[ServedBody]) -> Vec<u8> {
        let mut out = Vec::new();
        BodiesToSend { kind, rates: [3, 0x0104], bodies }.put(&mut out);
        out
    }

    /// The layout of "6DOF components" in the documents, written out by hand.
    #[test]
    fn a_component_has_the_documented_bytes() {
        let mut body = ServedBody::of_pose(&pose());
        // What float32 makes of the cosine of a right angle.
        assert!(body.matrix.iter().all(|x| [0.0, 1.0, -1.0].iter().any(|y| (x - y).abs() < 1e-6)));
        body.matrix = body.matrix.map(|number| number.round() + 0.0);
        let (x, y, z) = ([0, 0, 0x80, 0x3F], [0, 0, 0, 0xC0], [0, 0, 0, 0x3F]);
        let (zero, one, minus) = ([0; 4], [0, 0, 0x80, 0x3F], [0, 0, 0x80, 0xBF]);
        let residual = [0, 0, 0x80, 0x3E];
        let matrix = [zero, one, zero, minus, zero, zero, zero, zero, one].concat();
        // 0, 0 and 90 degrees.
        let angles = [[0, 0, 0, 0x80], zero, [0, 0, 0xB4, 0x42]].concat();
        for (kind, size, rotation, residual) in [
            (BodyComponentKind::Matrices, 64, &matrix, &[][..]),
            (BodyComponentKind::Angles, 40, &angles, &[]),
            (BodyComponentKind::MatricesWithResiduals, 68, &matrix, &residual),
            (BodyComponentKind::AnglesWithResiduals, 44, &angles, &residual),
        ] {
            let head = [size, 0, 0, 0, kind as u8, 0, 0, 0, 1, 0, 0, 0, 3, 0, 4, 1];
            let expected = [&head[..], &x, &y, &z, rotation, residual].concat();
            assert_eq!(put(kind, &[body]), expected, "{kind:?}");
        }
    }

    #[test]
    fn poses_read_back_and_lost_bodies_are_lost() {
        let lost = Pose::without(4, PoseStatus::Lost);
        let bodies = [ServedBody::of_pose(&pose()), ServedBody::of_pose(&lost)];
        for kind in BodyComponentKind::ALL {
            let bytes = put(kind, &bodies);
            let content = &bytes[8..];
            if !kind.has_matrices() {
                // All bits of the lost body are set.
                let n = kind.body_bytes();
                assert!(bytes[bytes.len() - n..].iter().all(|byte| *byte == 0xFF));
                continue;
            }
            let component = BodyComponent::read(kind, content).unwrap();
            assert_eq!(component.n_bodies(), 2);
            let read: Vec<_> = component.bodies().zip([3, 4]).map(|(b, id)| b.pose(id)).collect();
            assert_eq!(
                (read[0].position_mm, read[0].status),
                (pose().position_mm, PoseStatus::Tracked)
            );
            let apart =
                read[0].quaternion.iter().zip(pose().quaternion).map(|(a, b)| (a - b).abs());
            assert!(apart.fold(0.0, f32::max) < 1e-6, "{read:?}");
            assert_eq!(read[0].residual_mm == 0.25, kind.has_residuals());
            assert_eq!(read[1].status, PoseStatus::Lost);
            for cut in 0..content.len() {
                assert!(BodyComponent::read(kind, &content[..cut]).is_none(), "{cut}");
            }
        }
    }

    #[test]
    fn a_matrix_that_is_no_rotation_is_rejected() {
        let mut body = ServedBody::of_pose(&pose());
        body.matrix[8] = -1.0;
        assert_eq!(body.pose(1).status, PoseStatus::Rejected);
        body.matrix[0] = f32::NAN;
        assert_eq!(body.pose(1).status, PoseStatus::Lost);
    }
}
