//! Poses in the axes after a rotation of the laboratory.

use super::Pose;

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
    use super::*;
    use crate::poses::PoseState;

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
