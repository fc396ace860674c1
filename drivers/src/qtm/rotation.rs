//! Rotations as QTM sends them: matrices and angles, and the quaternions of the recorder.
//!
//! A matrix turns positions of the body into those of the laboratory. It is an array of nine numbers, column after column.

/// Largest deviation of lengths and products of a matrix's columns from those of a rotation. Matrices of float32 stay
/// within 1e-6, and those with three decimals within 2e-3.
const ROTATION_ERROR_MAX: f64 = 0.01;

/// Sine of the second angle from which on the first and the third turn about the same axis, as far as float32 can tell.
const SINE_MAX: f64 = 1.0 - 1e-9;

/// The matrix of a quaternion w, x, y, z, which may have another length than 1: devices send rounded ones.
pub(super) fn matrix_of(quaternion: [f32; 4]) -> [f32; 9] {
    let quaternion = quaternion.map(f64::from);
    let length = quaternion.iter().map(|number| number * number).sum::<f64>().sqrt();
    let [w, x, y, z] = quaternion.map(|number| number / length);
    let columns = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
    ];
    let mut matrix = [0.0; 9];
    for (number, value) in matrix.iter_mut().zip(columns.iter().flatten()) {
        *number = *value as f32;
    }
    matrix
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn cross([a, b, c]: [f64; 3], [d, e, f]: [f64; 3]) -> [f64; 3] {
    [b * f - c * e, c * d - a * f, a * e - b * d]
}

/// Whether three columns are a rotation: of length 1, at right angles, and right-handed. NaN is none.
fn is_rotation([x, y, z]: [[f64; 3]; 3]) -> bool {
    let near = |value: f64, wanted: f64| (value - wanted).abs() <= ROTATION_ERROR_MAX;
    [x, y, z].iter().all(|column| near(dot(*column, *column).sqrt(), 1.0))
        && [dot(x, y), dot(y, z), dot(x, z)].iter().all(|product| near(*product, 0.0))
        && dot(cross(x, y), z) > 0.0
}

/// The unit quaternion w, x, y, z of a matrix; `None` if it is no rotation. By the largest of its numbers (Shepperd 1978),
/// so that none is divided by a small one.
pub(super) fn quaternion_of(matrix: [f32; 9]) -> Option<[f32; 4]> {
    let [xx, xy, xz, yx, yy, yz, zx, zy, zz] = matrix.map(f64::from);
    if !is_rotation([[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]]) {
        return None;
    }
    let trace = xx + yy + zz;
    // Four times the quaternion's largest number, times the quaternion.
    let quaternion = if trace >= xx.max(yy).max(zz) {
        [1.0 + trace, yz - zy, zx - xz, xy - yx]
    } else if xx >= yy.max(zz) {
        [yz - zy, 1.0 + 2.0 * xx - trace, xy + yx, zx + xz]
    } else if yy >= zz {
        [zx - xz, xy + yx, 1.0 + 2.0 * yy - trace, yz + zy]
    } else {
        [xy - yx, zx + xz, yz + zy, 1.0 + 2.0 * zz - trace]
    };
    let length = quaternion.iter().map(|number| number * number).sum::<f64>().sqrt();
    Some(quaternion.map(|number| (number / length) as f32))
}

/// Roll, pitch and yaw of a matrix in degrees, by QTM's own definition: the matrix is that of the roll about x, times that of
/// the pitch about y, times that of the yaw about z.
pub(super) fn angles_of(matrix: [f32; 9]) -> [f32; 3] {
    let [xx, _, _, yx, yy, yz, zx, zy, zz] = matrix.map(f64::from);
    let pitch = zx.clamp(-1.0, 1.0).asin();
    let (roll, yaw) = match zx.abs() < SINE_MAX {
        true => ((-zy).atan2(zz), (-yx).atan2(xx)),
        // Both turn about the same axis: all of it is the roll.
        false => (yz.atan2(yy), 0.0),
    };
    [roll, pitch, yaw].map(|angle| angle.to_degrees() as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quaternions of all signs and sizes, with those whose numbers are small.
    fn quaternions() -> Vec<[f32; 4]> {
        let steps = [-1.0, -0.3, -1e-4, 0.0, 1e-4, 0.3, 1.0_f64];
        let mut found = Vec::new();
        for w in steps {
            for x in steps {
                for y in steps {
                    for z in steps {
                        let length = (w * w + x * x + y * y + z * z).sqrt();
                        if length > 1e-3 {
                            found.push([w, x, y, z].map(|number| (number / length) as f32));
                        }
                    }
                }
            }
        }
        found
    }

    fn angle_between(a: [f32; 4], b: [f32; 4]) -> f64 {
        let product: f64 = a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(b)).sum();
        let sign = product.signum();
        let apart = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - sign * f64::from(b)).powi(2));
        2.0 * apart.sum::<f64>().sqrt()
    }

    #[test]
    fn a_matrix_is_the_same_rotation_as_its_quaternion() {
        for quaternion in quaternions() {
            let again = quaternion_of(matrix_of(quaternion)).unwrap();
            assert!(angle_between(quaternion, again) < 5e-7, "{quaternion:?} {again:?}");
            // One with three decimals is the same rotation.
            let rounded = quaternion_of(matrix_of(quaternion.map(|number| number * 1.009)));
            assert!(angle_between(quaternion, rounded.unwrap()) < 5e-7, "{quaternion:?}");
        }
    }

    #[test]
    fn what_is_no_rotation_has_no_quaternion() {
        let good = matrix_of([0.5, 0.5, 0.5, 0.5]);
        assert!(quaternion_of(good).is_some());
        let mirrored = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0];
        let scaled = good.map(|number| number * 1.02);
        let skewed = [1.0, 0.0, 0.0, 0.1, 0.995, 0.0, 0.0, 0.0, 1.0];
        for matrix in [mirrored, scaled, skewed, [0.0; 9], [f32::NAN; 9], [f32::INFINITY; 9]] {
            assert_eq!(quaternion_of(matrix), None, "{matrix:?}");
        }
    }

    /// The documents' example of a definition: roll about x, then pitch about the new y, then yaw about the new z.
    #[test]
    fn angles_are_those_of_qtm() {
        let turn = |axis: usize, degrees: f32| {
            let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
            let mut quaternion = [cos, 0.0, 0.0, 0.0];
            quaternion[axis] = sin;
            matrix_of(quaternion)
        };
        let times = |a: [f32; 9], b: [f32; 9]| -> [f32; 9] {
            std::array::from_fn(|at| (0..3).map(|k| a[3 * k + at % 3] * b[at / 3 * 3 + k]).sum())
        };
        // A quarter turn about z takes x to y.
        let quarter = turn(3, 90.0);
        assert!((quarter[1] - 1.0).abs() < 1e-6 && (quarter[3] + 1.0).abs() < 1e-6, "{quarter:?}");
        for roll in [-170.0, -30.0, 0.0, 100.0] {
            for pitch in [-85.0, 0.0, 40.0] {
                for yaw in [-120.0, 0.0, 15.0] {
                    let matrix = times(times(turn(1, roll), turn(2, pitch)), turn(3, yaw));
                    let found = angles_of(matrix);
                    let apart = found.iter().zip([roll, pitch, yaw]).map(|(a, b)| (a - b).abs());
                    assert!(apart.fold(0.0, f32::max) < 1e-3, "{roll} {pitch} {yaw}: {found:?}");
                }
            }
            for pitch in [-90.0, 90.0] {
                let found = angles_of(times(turn(1, roll), turn(2, pitch)));
                let apart = [found[0] - roll, found[1] - pitch, found[2]];
                assert!(apart.iter().all(|angle| angle.abs() < 0.05), "{roll}: {found:?}");
            }
        }
    }
}
