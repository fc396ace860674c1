//! Damped Gauss-Newton steps on pose and shape.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};

use super::OUTER_EYES_MM;
use super::camera::Camera;
use super::feature::FeatureId;
use super::fit::FitOptions;
use super::shape::{Anchor, Model};
use super::start::similarity;

/// A point of a picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Observed {
    pub(super) id: FeatureId,
    pub(super) at: [f64; 2],
    pub(super) weight: f64,
    /// Standard deviation as a share of the outer eye corners' distance.
    pub(super) noise_io: f64,
}

/// Rotation (3), logarithm of the scale, translation (2).
const POSE: usize = 6;
/// Yaws that a fit begins from, in degrees. A head turned by less than 50 is within the reach of one of them.
const STARTS_DEG: [f64; 3] = [0.0, -30.0, 30.0];
/// Steps on the pose alone, from each start.
const POSE_STEPS: usize = 6;
/// Enough for the last digit that matters: a hundredth of a standard deviation, or of a degree.
const SMALL_STEP: f64 = 1e-4;

/// A pose and a shape.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub(super) rotation: Matrix3<f64>,
    pub(super) scale: f64,
    pub(super) origin: [f64; 2],
    pub(super) coefficients: Vec<f64>,
}

impl State {
    pub(super) fn camera(&self) -> Camera {
        let [yaw_deg, pitch_deg, roll_deg] = Camera::angles_deg(&self.rotation);
        let (scale_px_per_mm, origin_px) = (self.scale, self.origin);
        Camera { scale_px_per_mm, yaw_deg, pitch_deg, roll_deg, origin_px }
    }
}

/// One observed point's equations: what its two coordinates are off by, in standard deviations, and Huber's weight.
struct Row {
    off: [f64; 2],
    pull: f64,
    per_px: f64,
    anchor: Anchor,
    turned: Vector3<f64>,
}

pub(super) struct Solver<'a> {
    model: &'a Model,
    observed: &'a [Observed],
    options: &'a FitOptions,
    modes: usize,
    /// What a pixel is in standard deviations of a point with a noise of 1 io: fixed by the points themselves, so that no
    /// fit grows better by shrinking.
    io_px: f64,
}

impl<'a> Solver<'a> {
    pub(super) fn new(model: &'a Model, observed: &'a [Observed], options: &'a FitOptions) -> Self {
        let modes = options.modes.min(model.modes.len());
        Self { model, observed, options, modes, io_px: 1.0 }
    }

    /// The best fit, or none where the points are degenerate.
    pub(super) fn solve(mut self) -> Option<State> {
        let first = similarity(self.model, self.observed, 0.0)?;
        self.io_px = first.scale * OUTER_EYES_MM;
        let mut best: Option<(f64, State)> = None;
        for yaw_deg in STARTS_DEG {
            let Some((cost, state)) = similarity(self.model, self.observed, yaw_deg)
                .and_then(|s| self.descend(s, 0, POSE_STEPS))
            else {
                continue;
            };
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, state));
            }
        }
        let (_, pose) = best?;
        let (_, state) = self.descend(pose, self.modes, self.options.steps)?;
        state.scale.is_finite().then_some(state)
    }

    /// Steps downhill on the pose and the first `modes` modes. Gives the cost, too.
    fn descend(&self, mut state: State, modes: usize, steps: usize) -> Option<(f64, State)> {
        let mut damping = 1e-3;
        let (mut cost, mut rows) = self.rows(&state);
        for _ in 0..steps {
            let (normal, gradient) = self.normal_equations(&state, &rows, modes);
            let mut damped = normal;
            for i in 0..damped.nrows() {
                damped[(i, i)] *= 1.0 + damping;
            }
            let step = damped.cholesky()?.solve(&gradient);
            let next = stepped(&state, &step);
            let (next_cost, next_rows) = self.rows(&next);
            if next_cost <= cost {
                (state, cost, rows) = (next, next_cost, next_rows);
                damping *= 0.2;
                if step.amax() < SMALL_STEP {
                    break;
                }
            } else {
                damping = (damping * 20.0).max(1e-3);
            }
        }
        cost.is_finite().then_some((cost, state))
    }

    /// Twice the negative logarithm of the posterior, but for constants, and what it is made of.
    fn rows(&self, state: &State) -> (f64, Vec<Row>) {
        let vertices = Shape { model: self.model, coefficients: &state.coefficients };
        let average = &self.model.vertices;
        let mut cost = state.coefficients.iter().map(|c| c * c).sum::<f64>();
        let pitch = Camera::angles_deg(&state.rotation)[1];
        cost += (pitch / self.options.pitch_sd_deg).powi(2);
        let rows = self.observed.iter().map(|o| {
            // Which place is outline hardly depends on the shape; the average is at hand.
            let anchor = self.model.anchor(o.id, average, &state.rotation);
            let turned = state.rotation * vertices.place(&anchor) * state.scale;
            let per_px = o.weight.sqrt() / (o.noise_io * self.io_px);
            let off = [
                (o.at[0] - state.origin[0] - turned.x) * per_px,
                (o.at[1] - state.origin[1] + turned.y) * per_px,
            ];
            let size = off[0].hypot(off[1]);
            let huber = self.options.huber;
            let pull = if size <= huber { 1.0 } else { huber / size };
            cost += if size <= huber { size * size } else { huber * (2.0 * size - huber) };
            Row { off, pull, per_px, anchor, turned }
        });
        let rows = rows.collect();
        (cost, rows)
    }

    /// The normal equations of a step: matrix and right-hand side.
    fn normal_equations(
        &self,
        state: &State,
        rows: &[Row],
        modes: usize,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let n = POSE + modes;
        let mut normal = DMatrix::zeros(n, n);
        let mut gradient = DVector::zeros(n);
        let turn = state.rotation * state.scale;
        let mut x = vec![0.0; n];
        let mut y = vec![0.0; n];
        for row in rows {
            let (p, k) = (row.turned, row.per_px);
            x[..POSE].copy_from_slice(&[0.0, p.z, -p.y, p.x, 1.0, 0.0].map(|d| d * k));
            y[..POSE].copy_from_slice(&[p.z, 0.0, -p.x, -p.y, 0.0, 1.0].map(|d| d * k));
            for (i, mode) in self.model.modes[..modes].iter().enumerate() {
                let by = turn * Vector3::from(row.anchor.on(&mode.displacements));
                (x[POSE + i], y[POSE + i]) = (by.x * k, -by.y * k);
            }
            for column in 0..n {
                let (wx, wy) = (row.pull * x[column], row.pull * y[column]);
                gradient[column] += wx * row.off[0] + wy * row.off[1];
                // The lower half, which is all that Cholesky reads.
                for (line, cell) in normal.column_mut(column).iter_mut().enumerate().skip(column) {
                    *cell += wx * x[line] + wy * y[line];
                }
            }
        }
        for i in 0..modes {
            normal[(POSE + i, POSE + i)] += 1.0;
            gradient[POSE + i] -= state.coefficients[i];
        }
        // A small rotation about the camera's x axis is pitch, as nearly as a prior needs it.
        let roll = Camera::angles_deg(&state.rotation)[2].to_radians();
        let axis = [roll.cos(), roll.sin()];
        let strength = self.options.pitch_sd_deg.to_radians().powi(-2);
        let pitch = Camera::angles_deg(&state.rotation)[1].to_radians();
        for i in 0..2 {
            gradient[i] -= strength * pitch * axis[i];
            for j in 0..=i {
                normal[(i, j)] += strength * axis[i] * axis[j];
            }
        }
        (normal, gradient)
    }
}

/// Places on a shape, without all of its vertices being worked out.
struct Shape<'a> {
    model: &'a Model,
    coefficients: &'a [f64],
}

impl Shape<'_> {
    fn place(&self, anchor: &Anchor) -> Vector3<f64> {
        let mut at = Vector3::from(anchor.on(&self.model.vertices));
        for (mode, &amount) in self.model.modes.iter().zip(self.coefficients) {
            if amount != 0.0 {
                at += Vector3::from(anchor.on(&mode.displacements)) * amount;
            }
        }
        at
    }
}

fn stepped(state: &State, step: &DVector<f64>) -> State {
    let turn = Rotation3::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    let mut coefficients = state.coefficients.clone();
    for (coefficient, by) in coefficients.iter_mut().zip(step.iter().skip(POSE)) {
        *coefficient += by;
    }
    State {
        rotation: turn.into_inner() * state.rotation,
        scale: state.scale * step[3].exp(),
        origin: [state.origin[0] + step[4], state.origin[1] + step[5]],
        coefficients,
    }
}
