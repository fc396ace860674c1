//! A feature's outline moved and bent until the picture agrees with it best.

/// A point of the crop (pixels).
pub(crate) type Point = [f64; 2];

/// A way in which an outline may move.
#[derive(Debug, Clone)]
pub(crate) struct Motion {
    /// Displacement of each point for an amount of 1.
    pub(crate) field: Vec<Point>,
    /// Standard deviation of the amount: what deviates costs `HOLD * (amount / sd)^2`.
    pub(crate) sd: f64,
    /// The largest amount that the coarse search tries, and its step; none where the step is 0.
    pub(crate) reach: f64,
    pub(crate) step: f64,
}

/// Cost of a deviation by one standard deviation, in the energies' unit: the logarithm of a contrast.
const HOLD: f64 = 0.012;
/// Halvings of the step in the refinement.
const HALVINGS: u32 = 4;

/// The best outline, what it scored, and how much better it is than the one it started from.
#[derive(Debug, Clone)]
pub(crate) struct Found {
    pub(crate) points: Vec<Point>,
    pub(crate) score: f64,
    /// `score` less the cost of the deviation.
    pub(crate) held: f64,
}

/// Moves `start` where `score` is highest: a grid over the motions that have a step, then one motion at a time with
/// halving steps.
pub(crate) fn search(
    start: &[Point],
    motions: &[Motion],
    score: impl Fn(&[Point]) -> f64,
) -> Found {
    let place = |amounts: &[f64]| -> Vec<Point> {
        let mut points = start.to_vec();
        for (amount, motion) in amounts.iter().zip(motions) {
            for (p, d) in points.iter_mut().zip(&motion.field) {
                p[0] += amount * d[0];
                p[1] += amount * d[1];
            }
        }
        points
    };
    let total = |amounts: &[f64]| -> f64 {
        let hold: f64 = amounts.iter().zip(motions).map(|(a, m)| (a / m.sd).powi(2)).sum();
        score(&place(amounts)) - HOLD * hold
    };
    let mut best = vec![0.0; motions.len()];
    let mut best_score = total(&best);
    for amounts in grid(motions) {
        let s = total(&amounts);
        if s > best_score {
            (best, best_score) = (amounts, s);
        }
    }
    let mut share = 1.0;
    for _ in 0..HALVINGS {
        for _ in 0..2 {
            for (i, motion) in motions.iter().enumerate() {
                let step =
                    share * if motion.step > 0.0 { motion.step / 2.0 } else { motion.sd / 2.0 };
                for sign in [-1.0, 1.0] {
                    let mut tried = best.clone();
                    if let Some(a) = tried.get_mut(i) {
                        *a += sign * step;
                    }
                    let s = total(&tried);
                    if s > best_score {
                        (best, best_score) = (tried, s);
                    }
                }
            }
        }
        share /= 2.0;
    }
    let points = place(&best);
    Found { score: score(&points), held: best_score, points }
}

/// All amounts of the coarse search.
fn grid(motions: &[Motion]) -> Vec<Vec<f64>> {
    let mut all = vec![Vec::new()];
    for motion in motions {
        let n = if motion.step > 0.0 {
            (motion.reach / motion.step).floor().min(16.0) as i32
        } else {
            0
        };
        all = all
            .iter()
            .flat_map(|amounts: &Vec<f64>| {
                (-n..=n).map(|k| {
                    let mut longer = amounts.clone();
                    longer.push(f64::from(k) * motion.step);
                    longer
                })
            })
            .collect();
    }
    all
}

/// All points alike.
pub(crate) fn shift(n: usize, by: Point) -> Vec<Point> {
    vec![by; n]
}

/// Away from `about`, by the amount as a share of the distance, in x and in y times `share`.
pub(crate) fn stretch(points: &[Point], about: Point, share: Point) -> Vec<Point> {
    points.iter().map(|p| [share[0] * (p[0] - about[0]), share[1] * (p[1] - about[1])]).collect()
}

/// Turned about `about` (radians).
pub(crate) fn turn(points: &[Point], about: Point) -> Vec<Point> {
    points.iter().map(|p| [-(p[1] - about[1]), p[0] - about[0]]).collect()
}

/// Only the points named, by `by`.
pub(crate) fn only(n: usize, which: &[usize], by: Point) -> Vec<Point> {
    (0..n).map(|i| if which.contains(&i) { by } else { [0.0; 2] }).collect()
}
