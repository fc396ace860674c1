//! Search of a feature's outline: moved and bent for the best score.

use crate::plane::Point;

/// A degree of freedom of an outline.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion<const N: usize> {
    /// Displacement of each point per unit.
    pub(crate) field: [Point; N],
    /// Standard deviation of the amount; a deviation costs `DEVIATION_COST * (amount / sd)^2`.
    pub(crate) sd: f64,
    /// Range and step of the coarse search; a step of 0 disables it.
    pub(crate) reach: f64,
    pub(crate) step: f64,
}

impl<const N: usize> Motion<N> {
    pub(crate) fn new(field: [Point; N], sd: f64, reach: f64, step: f64) -> Self {
        Self { field, sd, reach, step }
    }
}

/// Cost of one standard deviation, in the unit of scores: the logarithm of a contrast.
const DEVIATION_COST: f64 = 0.012;
/// Number of step halvings in the refinement.
const HALVINGS: u32 = 4;
/// Maximum number of steps of the coarse search to either side.
const STEPS_MAX: f64 = 16.0;

/// The best outline and its score.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SearchResult<const N: usize> {
    pub(crate) points: [Point; N],
    pub(crate) score: f64,
    /// `score` less the cost of the deviation.
    pub(crate) penalised: f64,
}

/// Moves `start` to the highest `score`: a grid over the motions that have a step, then coordinate descent with halving
/// steps.
pub(crate) fn search<const N: usize, const M: usize>(
    start: &[Point; N],
    motions: &[Motion<N>; M],
    score: impl Fn(&[Point; N]) -> f64,
) -> SearchResult<N> {
    let place = |amounts: &[f64; M]| {
        let mut points = *start;
        for (amount, motion) in amounts.iter().zip(motions) {
            if *amount != 0.0 {
                for (p, d) in points.iter_mut().zip(&motion.field) {
                    p[0] += amount * d[0];
                    p[1] += amount * d[1];
                }
            }
        }
        points
    };
    let total = |amounts: &[f64; M]| {
        let excess: f64 = amounts.iter().zip(motions).map(|(a, m)| (a / m.sd) * (a / m.sd)).sum();
        score(&place(amounts)) - DEVIATION_COST * excess
    };
    let sides = motions
        .map(|m| if m.step > 0.0 { (m.reach / m.step).floor().min(STEPS_MAX) as u32 } else { 0 });
    let mut best = [0.0; M];
    let mut best_score = total(&best);
    for place in 0..sides.iter().map(|n| 2 * n + 1).product() {
        let amounts = grid(place, &sides, motions);
        let s = total(&amounts);
        if s > best_score {
            (best, best_score) = (amounts, s);
        }
    }
    let mut share = 1.0;
    for _ in 0..HALVINGS {
        for i in (0..M).chain(0..M) {
            let Some(motion) = motions.get(i) else { continue };
            let step = share * if motion.step > 0.0 { motion.step } else { motion.sd } / 2.0;
            for sign in [-1.0, 1.0] {
                let mut tried = best;
                if let Some(amount) = tried.get_mut(i) {
                    *amount += sign * step;
                }
                let s = total(&tried);
                if s > best_score {
                    (best, best_score) = (tried, s);
                    break;
                }
            }
        }
        share /= 2.0;
    }
    let points = place(&best);
    SearchResult { score: score(&points), penalised: best_score, points }
}

/// The amounts at one grid place, the first motion fastest.
fn grid<const N: usize, const M: usize>(
    place: u32,
    sides: &[u32; M],
    motions: &[Motion<N>; M],
) -> [f64; M] {
    let mut rest = place;
    let mut amounts = [0.0; M];
    for ((amount, n), motion) in amounts.iter_mut().zip(sides).zip(motions) {
        let count = 2 * n + 1;
        *amount = (f64::from(rest % count) - f64::from(*n)) * motion.step;
        rest /= count;
    }
    amounts
}

/// Translation of all points.
pub(crate) fn shift<const N: usize>(by: Point) -> [Point; N] {
    [by; N]
}

/// Scaling about `about`, weighted by `share` in x and y.
pub(crate) fn stretch<const N: usize>(
    points: &[Point; N],
    about: Point,
    share: Point,
) -> [Point; N] {
    points.map(|p| [share[0] * (p[0] - about[0]), share[1] * (p[1] - about[1])])
}

/// Rotation about `about` (radians).
pub(crate) fn turn<const N: usize>(points: &[Point; N], about: Point) -> [Point; N] {
    points.map(|p| [-(p[1] - about[1]), p[0] - about[0]])
}

/// Translation of the named points alone.
pub(crate) fn only<const N: usize>(which: &[usize], by: Point) -> [Point; N] {
    std::array::from_fn(|i| if which.contains(&i) { by } else { [0.0; 2] })
}
