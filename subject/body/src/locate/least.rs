//! Where along a limb a cost is least.

/// Distance between two places that are tried, in body scales.
const TRY_EVERY: f64 = 0.004;
/// At most so many places are tried; the windows hold some thirty.
const MOST_TRIED: usize = 200;

/// The place of the least cost.
#[derive(Debug, Clone, Copy)]
pub(super) struct Least {
    /// Where, in body scales from the end of the limb.
    pub(super) level: f64,
    /// How sharply the cost rises to both sides: its second derivative.
    pub(super) sharpness: f64,
}

/// Tries places from `low` to `high`, and takes the lowest point of the parabola through the best and its neighbours.
///
/// Nothing if there is no place to try.
pub(super) fn least([low, high]: [f64; 2], cost: impl Fn(f64) -> f64) -> Option<Least> {
    let tries = (((high - low) / TRY_EVERY).ceil().max(0.0) as usize).min(MOST_TRIED);
    let place = |index: usize| low + index as f64 * TRY_EVERY;
    let costs: Vec<f64> = (0..tries).map(|index| cost(place(index))).collect();
    let (best, _) = costs.iter().enumerate().min_by(|one, other| one.1.total_cmp(other.1))?;
    let (offset, curvature) = vertex_of_parabola(&costs, best);
    Some(Least {
        level: place(best) + TRY_EVERY * offset,
        sharpness: curvature / (TRY_EVERY * TRY_EVERY),
    })
}

/// Where between the neighbours of `index` the parabola through the three is least or greatest, in steps, and its second
/// difference there. At an end of `values`, and where they are on a line, 0.
fn vertex_of_parabola(values: &[f64], index: usize) -> (f64, f64) {
    let three = index.checked_sub(1).and_then(|before| values.get(before..before + 3));
    let Some([before, at, after]) = three else { return (0.0, 0.0) };
    let curvature = before - 2.0 * at + after;
    if curvature.abs() < f64::EPSILON * at.abs() {
        return (0.0, 0.0);
    }
    (((before - after) / (2.0 * curvature)).clamp(-1.0, 1.0), curvature)
}
