//! The linear shape model of the landmarks and its weak-perspective fit.

use nalgebra::{DMatrix, DVector, Matrix2x3, Vector3};

use crate::model::{FeatureId, Model, OUTER_EYES_MM};
use crate::plane::{Point, mean};

/// Number of landmarks, in the order of iBUG-68. Those that the model lacks (the ridge of the nose, the inner lips
/// except their middles) lie at the nasion and are never searched.
pub(crate) const LANDMARKS: usize = 68;

/// Landmarks of the generic face and their modes, in outer interocular distances: x right, y down, z to the camera.
#[derive(Debug)]
pub(crate) struct Landmarks {
    mean: Vec<Vector3<f64>>,
    modes: Vec<Vec<Vector3<f64>>>,
}

impl Landmarks {
    pub(crate) fn of(model: &Model) -> Landmarks {
        let vertex = |name: &str| model.features.get(name).copied();
        let nasion = vertex("nasion").unwrap_or(0);
        let vertices: Vec<usize> = (0..LANDMARKS)
            .map(|i| {
                let named = match i {
                    0..=7 => vertex(&format!("right_jaw_{}", i + 1)),
                    8 => vertex("chin"),
                    9..=16 => vertex(&format!("left_jaw_{}", 17 - i)),
                    30 => vertex("nose_tip"),
                    _ => FeatureId::from_ibug(i).and_then(|id| vertex(id.name())),
                };
                named.unwrap_or(nasion)
            })
            .collect();
        let pick = |from: &[[f64; 3]]| -> Vec<Vector3<f64>> {
            let at = |v: &usize| from.get(*v).copied().unwrap_or_default();
            vertices
                .iter()
                .map(at)
                .map(|[x, y, z]| Vector3::new(x, -y, z) / OUTER_EYES_MM)
                .collect()
        };
        Landmarks {
            mean: pick(&model.vertices),
            modes: model.modes.iter().map(|mode| pick(&mode.displacements)).collect(),
        }
    }
}

/// Pose parameters: rotation, scale, shift.
const POSE: usize = 6;
/// Prior standard deviations of yaw and pitch over photographs (radians).
const YAW_SD_RAD: f64 = 0.6;
const PITCH_SD_RAD: f64 = 0.25;

/// A located landmark.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Target {
    pub(crate) landmark: usize,
    pub(crate) at: Point,
    /// Standard deviation (pixels of the crop).
    pub(crate) sd: f64,
}

/// The shape model in a pose.
#[derive(Debug, Clone)]
pub(crate) struct PosedModel<'a> {
    landmarks: &'a Landmarks,
    /// Rows: the image's x and y axes in the model's frame.
    pub(crate) rotation: Matrix2x3<f64>,
    /// Pixels per outer interocular distance.
    pub(crate) scale: f64,
    pub(crate) shift: Point,
    pub(crate) coefficients: Vec<f64>,
}

impl<'a> PosedModel<'a> {
    /// The frontal mean face with an outer interocular distance of `scale` pixels and the midpoint of its eyes at
    /// `eyes`.
    pub(crate) fn frontal(landmarks: &'a Landmarks, scale: f64, eyes: Point) -> Self {
        let mut pose = PosedModel {
            landmarks,
            rotation: Matrix2x3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0),
            scale,
            shift: [0.0; 2],
            coefficients: vec![0.0; landmarks.modes.len()],
        };
        let p = pose.project();
        let mid = mean(p[36..48].iter().copied());
        pose.shift = [eyes[0] - mid[0], eyes[1] - mid[1]];
        pose
    }

    /// The shape of the landmarks in the model's frame (outer interocular distances).
    pub(crate) fn shape(&self) -> Vec<Vector3<f64>> {
        let mut shape = self.landmarks.mean.clone();
        for (c, mode) in self.coefficients.iter().zip(&self.landmarks.modes) {
            shape.iter_mut().zip(mode).for_each(|(v, d)| *v += *c * d);
        }
        shape
    }

    /// The landmarks in the crop (pixels).
    pub(crate) fn project(&self) -> [Point; LANDMARKS] {
        let mut places = [[0.0; 2]; LANDMARKS];
        for (place, v) in places.iter_mut().zip(self.shape()) {
            let p = self.scale * (self.rotation * v);
            *place = [p.x + self.shift[0], p.y + self.shift[1]];
        }
        places
    }

    /// Yaw (degrees): positive when the face turns to the right of the picture.
    pub(crate) fn yaw_deg(&self) -> f64 {
        self.rotation[(0, 2)].clamp(-1.0, 1.0).asin().to_degrees()
    }

    /// Pitch (degrees).
    pub(crate) fn pitch_deg(&self) -> f64 {
        self.rotation[(1, 2)].clamp(-1.0, 1.0).asin().to_degrees()
    }

    /// Sum of the squared coefficients: how unusual the shape is.
    pub(crate) fn strain(&self) -> f64 {
        self.coefficients.iter().map(|c| c * c).sum()
    }

    /// Fits pose and shape to the targets from the present pose: Gauss-Newton steps on rotation, scale, shift and the
    /// modes' coefficients, which have a standard normal prior.
    pub(crate) fn fit(&mut self, targets: &[Target], rounds: usize) {
        for _ in 0..rounds {
            if self.step(targets).is_none() {
                return;
            }
        }
    }

    /// One Gauss-Newton step; none if the equations are singular.
    fn step(&mut self, targets: &[Target]) -> Option<()> {
        let modes = &self.landmarks.modes;
        let n = POSE + modes.len();
        let mut a = DMatrix::<f64>::zeros(n, n);
        let mut b = DVector::<f64>::zeros(n);
        let third = self.rotation.row(0).transpose().cross(&self.rotation.row(1).transpose());
        let shape = self.shape();
        let (mut jx, mut jy) = (vec![0.0; n], vec![0.0; n]);
        let s = self.scale;
        let turned = s * self.rotation;
        for t in targets {
            let Some(v) = shape.get(t.landmark) else { continue };
            let q = self.rotation * v;
            let (qx, qy, qz) = (q.x, q.y, third.dot(v));
            // Small rotations about x, y and z, logarithm of the scale, shift.
            let by = modes.iter().filter_map(|mode| mode.get(t.landmark)).map(|d| turned * d);
            let pose = [
                [0.0, -s * qz],
                [s * qz, 0.0],
                [-s * qy, s * qx],
                [s * qx, s * qy],
                [1.0, 0.0],
                [0.0, 1.0],
            ];
            let columns = pose.into_iter().chain(by.map(|d| [d.x, d.y]));
            for ((x, y), column) in jx.iter_mut().zip(&mut jy).zip(columns) {
                [*x, *y] = column;
            }
            // Beyond three standard deviations the pull stays constant: the target is likely something else.
            let (rx, ry) = (t.at[0] - s * qx - self.shift[0], t.at[1] - s * qy - self.shift[1]);
            let far = (rx * rx + ry * ry).sqrt() / t.sd;
            let w = 3.0 / far.max(3.0) / (t.sd * t.sd);
            // Only the lower half, which Cholesky reads.
            for (j, (x, y)) in jx.iter().zip(&jy).enumerate() {
                let (wx, wy) = (w * x, w * y);
                b[j] += wx * rx + wy * ry;
                let below = jx.iter().zip(&jy).skip(j);
                for (cell, (x, y)) in a.column_mut(j).iter_mut().skip(j).zip(below) {
                    *cell += wx * x + wy * y;
                }
            }
        }
        for (j, c) in self.coefficients.iter().take(modes.len()).enumerate() {
            a[(POSE + j, POSE + j)] += 1.0;
            b[POSE + j] -= c;
        }
        // Prior: a head is roughly upright and faces the camera.
        let yaw = self.rotation[(0, 2)].clamp(-1.0, 1.0).asin();
        let pitch = self.rotation[(1, 2)].clamp(-1.0, 1.0).asin();
        a[(1, 1)] += YAW_SD_RAD.powi(-2);
        b[1] -= yaw * YAW_SD_RAD.powi(-2);
        a[(0, 0)] += PITCH_SD_RAD.powi(-2);
        b[0] += pitch * PITCH_SD_RAD.powi(-2);
        for j in 0..POSE {
            a[(j, j)] += 1e-6;
        }
        let x = a.cholesky()?.solve(&b);
        let about = Vector3::new(x[0], x[1], x[2]);
        let about = about * (0.3 / about.norm().max(0.3));
        let turn = nalgebra::Rotation3::new(about);
        let mut full = nalgebra::Matrix3::zeros();
        full.set_row(0, &self.rotation.row(0));
        full.set_row(1, &self.rotation.row(1));
        full.set_row(2, &third.transpose());
        let full = turn.matrix() * full;
        self.rotation = full.fixed_rows::<2>(0).into_owned();
        self.scale *= x[3].clamp(-0.3, 0.3).exp();
        self.shift = [self.shift[0] + x[4], self.shift[1] + x[5]];
        for (c, by) in self.coefficients.iter_mut().zip(x.iter().skip(POSE)) {
            *c = (*c + by).clamp(-3.0, 3.0);
        }
        Some(())
    }
}
