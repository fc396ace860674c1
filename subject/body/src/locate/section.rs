//! Level-set curves of a distance field, all levels in one pass.

use crate::Mesh;
use crate::mesh::Point;

/// Distance between two levels, in body scales.
pub(super) const STEP: f64 = 0.006;
/// Number of levels: up to 1.08 body scales from the end, past the far end of the trunk.
pub(super) const LEVELS: usize = 180;

/// Level-set curves of one extremity, in body scales: level `i` is `(i + 1) * STEP` from the end.
#[derive(Debug, Clone)]
pub struct Sections {
    /// Length of the curve at each level.
    pub perimeter: Vec<f64>,
    /// Centre of the curve, weighted by its length and by the weights of the vertices that it passes.
    pub centre: Vec<Point>,
}

#[derive(Clone, Copy, Default)]
struct Sum {
    perimeter: f64,
    weight: f64,
    moment: Point,
}

#[derive(Clone, Copy)]
struct Corner {
    level: f64,
    weight: f64,
    position: Point,
}

impl Sections {
    /// Cuts `mesh` by `field` (mesh's unit, one value per vertex; infinite if unreachable): (3) and (4) of (Yu et al.
    /// 2008), with points weighted by curve length, so that the size of triangles does not matter.
    ///
    /// `weights`, one per vertex, are 0 where the surface belongs to another limb. Levels farther than `reach` from the
    /// end, in body scales, stay empty. None if no level has a curve.
    pub(super) fn new(
        mesh: &Mesh,
        field: &[f64],
        weights: &[f64],
        scale: f64,
        reach: f64,
    ) -> Option<Self> {
        let mut sums = vec![Sum::default(); LEVELS];
        let end = ((reach / STEP).ceil() as usize).min(LEVELS);
        let corner = |vertex: usize| {
            let position = Point::from(*mesh.positions.get(vertex)?) / scale;
            let level = field.get(vertex)? / (scale * STEP);
            let weight = *weights.get(vertex)?;
            level.is_finite().then_some(Corner { level, weight, position })
        };
        let corners: Vec<Option<Corner>> = (0..mesh.positions.len()).map(corner).collect();
        for triangle in &mesh.triangles {
            let corner = |vertex: u32| corners.get(vertex as usize).copied().flatten();
            let [Some(a), Some(b), Some(c)] = triangle.map(corner) else { continue };
            if a.level.min(b.level).min(c.level) < end as f64 {
                cut([a, b, c], &mut sums[..end]);
            }
        }
        let perimeter: Vec<f64> = sums.iter().map(|sum| sum.perimeter).collect();
        let mut found = sums.iter().filter(|sum| sum.weight > 0.0);
        let mut last = found.next().map(|sum| sum.moment / sum.weight)?;
        let centres = sums.iter().map(|sum| {
            // An empty level repeats the previous centre.
            if sum.weight > 0.0 {
                last = sum.moment / sum.weight;
            }
            last
        });
        let centre: Vec<Point> = centres.collect();
        Some(Self {
            perimeter: smoothed(&perimeter, &[1.0, 2.0, 3.0, 2.0, 1.0]),
            centre: smoothed(&centre, &[1.0, 2.0, 1.0]),
        })
    }

    /// Centre of the curve at `level`, in body scales, interpolated.
    pub(super) fn centre_at(&self, level: f64) -> Point {
        let at = (level / STEP - 1.0).clamp(0.0, (LEVELS - 1) as f64 - 1e-9);
        let (below, part) = (at.floor() as usize, at.fract());
        match self.centre.get(below..below + 2) {
            Some([low, high]) => low.lerp(high, part),
            _ => Point::zeros(),
        }
    }
}

/// Position of level `index`, in body scales.
pub(super) fn level(index: usize) -> f64 {
    (index + 1) as f64 * STEP
}

/// The curves from one level up to another, the first included, with their indices.
pub(super) fn between(
    perimeter: &[f64],
    [from, to]: [f64; 2],
) -> impl Iterator<Item = (usize, f64)> {
    let curves = perimeter.iter().copied().enumerate();
    curves.filter(move |(index, _)| (from..to).contains(&level(*index)))
}

/// Adds the pieces of the curves in one triangle: one for each whole number in `(least, greatest]` of its corners.
fn cut(mut corners: [Corner; 3], sums: &mut [Sum]) {
    corners.sort_by(|one, other| one.level.total_cmp(&other.level));
    let [low, middle, high] = corners;
    // The first level is 1, at index 0.
    let first = low.level.floor().max(0.0) as usize;
    let end = (high.level.floor().max(0.0) as usize).min(sums.len());
    for (index, sum) in sums.iter_mut().enumerate().take(end).skip(first) {
        let at = (index + 1) as f64;
        let from = passing(low, high, at);
        let to =
            if middle.level < at { passing(middle, high, at) } else { passing(low, middle, at) };
        let length = (from.0 - to.0).norm();
        let weight = length * f64::midpoint(from.1, to.1);
        sum.perimeter += length;
        sum.weight += weight;
        sum.moment += (from.0 + to.0) * (weight / 2.0);
    }
}

/// The point where the side from `low` to `high` has the value `level`, and its weight.
fn passing(low: Corner, high: Corner, level: f64) -> (Point, f64) {
    let span = high.level - low.level;
    let part = if span > 0.0 { ((level - low.level) / span).clamp(0.0, 1.0) } else { 0.0 };
    (low.position.lerp(&high.position, part), low.weight + (high.weight - low.weight) * part)
}

/// `values` convolved with a symmetric kernel of odd length; end values continue beyond the ends.
fn smoothed<T>(values: &[T], kernel: &[f64]) -> Vec<T>
where
    T: Copy + std::ops::Add<Output = T> + std::ops::Mul<f64, Output = T>,
{
    let (reach, total) = (kernel.len() / 2, kernel.iter().sum::<f64>());
    let at = |index: usize| values.get(index.clamp(reach, values.len() + reach - 1) - reach);
    (0..values.len())
        .filter_map(|index| {
            let mut terms = kernel.iter().enumerate().filter_map(|(offset, weight)| {
                at(index + offset).map(|value| *value * (weight / total))
            });
            let first = terms.next()?;
            Some(terms.fold(first, |sum, term| sum + term))
        })
        .collect()
}
