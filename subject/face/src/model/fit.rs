//! Fit of pose and shape to points of a picture, by damped Gauss-Newton steps.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector2, Vector3};
use thiserror::Error;

use super::{Anchor, Camera, FeatureId, Landmark, Model, OUTER_EYES_MM};

/// How far the points are trusted relative to the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitOptions {
    /// Standard deviation of a point of weight 1, as a fraction of the outer interocular distance. Two careful
    /// annotators differ by 0.03 to 0.04.
    pub noise_interocular: f64,
    /// Standard deviation of an outline point, as a fraction of the outer interocular distance; hair and chin make it
    /// less certain.
    pub contour_noise_interocular: f64,
    /// Residual, in standard deviations, beyond which a point's pull stays constant (Huber 1964).
    pub huber: f64,
    /// Prior standard deviation of pitch. Without it, a long face and one that looks down are hard to distinguish.
    pub pitch_sd_deg: f64,
    /// Number of modes that are fitted, in order; the others stay 0. 0 fits the pose alone.
    pub modes: usize,
    /// Maximum number of iterations from each start.
    pub steps: usize,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            noise_interocular: 0.03,
            contour_noise_interocular: 0.08,
            huber: 1.5,
            pitch_sd_deg: 15.0,
            modes: usize::MAX,
            steps: 12,
        }
    }
}

impl FitOptions {
    /// Standard deviation of a point of weight 1, as a fraction of the outer interocular distance.
    pub(crate) fn noise_of(&self, id: FeatureId) -> f64 {
        if id.is_contour() { self.contour_noise_interocular } else { self.noise_interocular }
    }
}

/// Why a model was not fitted.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FitError {
    /// Too few points: pose and scale alone are six numbers.
    #[error("{0} points have a weight, a face needs at least 6")]
    TooFew(usize),
    /// A coordinate or weight that is not finite, or a negative weight.
    #[error("{name} at ({x}, {y}) with weight {weight}: expected finite numbers, weights from 0")]
    NotFinite {
        /// Name of the point.
        name: &'static str,
        /// Its x.
        x: f64,
        /// Its y.
        y: f64,
        /// Its weight.
        weight: f64,
    },
    /// The points coincide, or lie on one line.
    #[error("the points coincide or lie on one line, which no face does")]
    Degenerate,
}

/// A model fitted to points of a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeFit {
    /// Pose of the head in the picture.
    pub camera: Camera,
    /// Coefficient of each mode, in standard deviations.
    pub coefficients: Vec<f64>,
    /// The fitted face in the model's frame, facing forward, in the model's millimetres.
    pub vertices_mm: Vec<[f64; 3]>,
    /// Fitted positions of the 53 points by [`FeatureId::index`]: x, y and depth, in pixels.
    pub points_px: Vec<[f64; 3]>,
}

impl Model {
    /// Fits pose and shape to points of a picture, weighted by confidence: 1 uses the standard deviation of the
    /// options, 4 would halve it, 0 ignores the point. Points may be missing, and a few may be wrong.
    ///
    /// Damped Gauss-Newton least squares with Huber weights and a normal prior on each mode. Pose and shape are fitted
    /// together, since each can imitate the other; three initial yaws avoid local minima. Of several points with one
    /// name the last counts.
    ///
    /// # Errors
    /// [`FitError`] if there are too few points, non-finite values, or all points lie on one line.
    pub fn fit_shape(
        &self,
        points: &[Landmark],
        options: &FitOptions,
    ) -> Result<ShapeFit, FitError> {
        let observed = observed(points, options)?;
        let solver = Solver::new(self, &observed, options);
        let state = solver.solve().ok_or(FitError::Degenerate)?;
        let camera = state.camera();
        let vertices_mm = self.shape(&state.coefficients);
        let places = self.feature_points(&vertices_mm, &camera.rotation());
        let points_px = camera.project(&places);
        Ok(ShapeFit { camera, coefficients: state.coefficients, vertices_mm, points_px })
    }
}

fn observed(points: &[Landmark], options: &FitOptions) -> Result<Vec<Observed>, FitError> {
    let mut by_id = vec![None; FeatureId::COUNT];
    for &Landmark { id, xy_px: at, confidence: weight } in points {
        if !(at[0].is_finite() && at[1].is_finite() && weight.is_finite() && weight >= 0.0) {
            return Err(FitError::NotFinite { name: id.name(), x: at[0], y: at[1], weight });
        }
        let noise = options.noise_of(id);
        by_id[id.index()] = (weight > 0.0).then_some(Observed { id, at, weight, noise });
    }
    let observed: Vec<_> = by_id.into_iter().flatten().collect();
    if observed.len() < 6 { Err(FitError::TooFew(observed.len())) } else { Ok(observed) }
}

/// An observed point.
#[derive(Debug, Clone, Copy)]
struct Observed {
    id: FeatureId,
    at: [f64; 2],
    weight: f64,
    /// Standard deviation as a fraction of the outer interocular distance.
    noise: f64,
}

/// Pose parameters: rotation (3), logarithm of the scale, translation (2).
const POSE: usize = 6;
/// Initial yaws, in degrees. A head turned by less than 50 is within reach of one of them.
const STARTS_DEG: [f64; 3] = [0.0, -30.0, 30.0];
/// Iterations on the pose alone, from each start.
const POSE_STEPS: usize = 6;
/// Convergence threshold: a hundredth of a standard deviation, or of a degree.
const SMALL_STEP: f64 = 1e-4;

/// Pose and shape.
#[derive(Debug, Clone)]
struct State {
    rotation: Matrix3<f64>,
    scale: f64,
    origin: [f64; 2],
    coefficients: Vec<f64>,
}

impl State {
    fn camera(&self) -> Camera {
        let [yaw_deg, pitch_deg, roll_deg] = Camera::angles_deg(&self.rotation);
        let (scale_px_per_mm, origin_px) = (self.scale, self.origin);
        Camera { scale_px_per_mm, yaw_deg, pitch_deg, roll_deg, origin_px }
    }
}

/// Residuals of one point, in standard deviations, with its Huber weight.
struct Row {
    off: [f64; 2],
    pull: f64,
    per_px: f64,
    anchor: Anchor,
    turned: Vector3<f64>,
}

struct Solver<'a> {
    model: &'a Model,
    observed: &'a [Observed],
    options: &'a FitOptions,
    modes: usize,
    /// Interocular distance in pixels, the unit of the noise. It is fixed by the points, so no fit improves by
    /// shrinking.
    interocular_px: f64,
}

impl<'a> Solver<'a> {
    fn new(model: &'a Model, observed: &'a [Observed], options: &'a FitOptions) -> Self {
        let modes = options.modes.min(model.modes.len());
        Self { model, observed, options, modes, interocular_px: 1.0 }
    }

    /// The best fit; none if the points are degenerate.
    fn solve(mut self) -> Option<State> {
        let first = similarity(self.model, self.observed, 0.0)?;
        self.interocular_px = first.scale * OUTER_EYES_MM;
        let mut best: Option<(f64, State)> = None;
        for yaw_deg in STARTS_DEG {
            let start = similarity(self.model, self.observed, yaw_deg);
            let found = start.and_then(|start| self.descend(start, 0, POSE_STEPS));
            let Some((cost, state)) = found else { continue };
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, state));
            }
        }
        let (_, pose) = best?;
        let (_, state) = self.descend(pose, self.modes, self.options.steps)?;
        state.scale.is_finite().then_some(state)
    }

    /// Minimises over the pose and the first `modes` modes. Returns cost and state.
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

    /// Twice the negative log posterior up to constants, and its rows.
    fn rows(&self, state: &State) -> (f64, Vec<Row>) {
        // Places on the shape, without computing all of its vertices.
        let place = |anchor: &Anchor| {
            let mut at = Vector3::from(anchor.on(&self.model.vertices));
            for (mode, &amount) in self.model.modes.iter().zip(&state.coefficients) {
                if amount != 0.0 {
                    at += Vector3::from(anchor.on(&mode.displacements)) * amount;
                }
            }
            at
        };
        let average = &self.model.vertices;
        let mut cost = state.coefficients.iter().map(|c| c * c).sum::<f64>();
        let pitch = Camera::angles_deg(&state.rotation)[1];
        cost += (pitch / self.options.pitch_sd_deg).powi(2);
        let rows = self.observed.iter().map(|o| {
            // Which place forms the outline hardly depends on the shape, so the average serves.
            let anchor = self.model.anchor(o.id, average, &state.rotation);
            let turned = state.rotation * place(&anchor) * state.scale;
            let per_px = o.weight.sqrt() / (o.noise * self.interocular_px);
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
                // Only the lower half, which Cholesky reads.
                for (line, cell) in normal.column_mut(column).iter_mut().enumerate().skip(column) {
                    *cell += wx * x[line] + wy * y[line];
                }
            }
        }
        for i in 0..modes {
            normal[(POSE + i, POSE + i)] += 1.0;
            gradient[POSE + i] -= state.coefficients[i];
        }
        // A small rotation about the camera's x axis is pitch, closely enough for a prior.
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

/// Points on one line have a scatter matrix of rank 1: its determinant is below this fraction of the squared trace.
const FLAT: f64 = 1e-6;

/// The similarity that maps the average face, rotated by `yaw_deg`, onto the points (weighted least squares).
fn similarity(model: &Model, observed: &[Observed], yaw_deg: f64) -> Option<State> {
    let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), yaw_deg.to_radians()).into_inner();
    let places = model.feature_points(&model.vertices, &turn);
    let pair = |o: &Observed| {
        let seen = turn * Vector3::from(places[o.id.index()]);
        let weight = o.weight / (o.noise * o.noise);
        (weight, Vector2::new(seen.x, seen.y), Vector2::new(o.at[0], -o.at[1]))
    };
    let pairs: Vec<_> = observed.iter().map(pair).collect();
    let total: f64 = pairs.iter().map(|(weight, ..)| weight).sum();
    let from = pairs.iter().map(|(weight, a, _)| a * *weight).sum::<Vector2<f64>>() / total;
    let to = pairs.iter().map(|(weight, _, b)| b * *weight).sum::<Vector2<f64>>() / total;
    let (mut along, mut across, mut spread) = (0.0, 0.0, 0.0);
    let mut scatter = [0.0; 3];
    for (weight, a, b) in &pairs {
        let (a, b) = (a - from, b - to);
        along += weight * (a[0] * b[0] + a[1] * b[1]);
        across += weight * (a[0] * b[1] - a[1] * b[0]);
        spread += weight * (a[0] * a[0] + a[1] * a[1]);
        scatter[0] += weight * b[0] * b[0];
        scatter[1] += weight * b[0] * b[1];
        scatter[2] += weight * b[1] * b[1];
    }
    let flat = scatter[0] * scatter[2] - scatter[1] * scatter[1];
    let size = scatter[0] + scatter[2];
    let scale = along.hypot(across) / spread;
    if !(flat > FLAT * size * size && scale > 0.0 && scale.is_finite()) {
        return None;
    }
    let (sin, cos) = across.atan2(along).sin_cos();
    let roll = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
    let x = to[0] - scale * (cos * from[0] - sin * from[1]);
    let y = to[1] - scale * (sin * from[0] + cos * from[1]);
    let coefficients = vec![0.0; model.modes.len()];
    Some(State { rotation: roll * turn, scale, origin: [x, -y], coefficients })
}
