//! Local minima of a curve, the deepest first.

/// Where a curve has local minima, and how deep each is: how far the curve climbs on its lower side before a deeper one.
///
/// The deepest first; of a curve's two ends, neither counts.
pub(super) fn minima(curve: &[f64]) -> Vec<(usize, f64)> {
    let mut found = Vec::new();
    for at in 1..curve.len().saturating_sub(1) {
        // On a level stretch, its first.
        if !(curve[at] < curve[at - 1] && curve[at] <= curve[at + 1]) {
            continue;
        }
        let climb = |side: &mut dyn Iterator<Item = &f64>| {
            let until_deeper = side.take_while(|value| **value >= curve[at]);
            until_deeper.copied().fold(curve[at], f64::max) - curve[at]
        };
        let left = climb(&mut curve[..at].iter().rev());
        let right = climb(&mut curve[at + 1..].iter());
        found.push((at, left.min(right)));
    }
    found.sort_by(|one, other| other.1.total_cmp(&one.1).then(one.0.cmp(&other.0)));
    found
}

/// The mean of each value and its neighbours.
pub(super) fn smoothed(curve: &[f64]) -> Vec<f64> {
    let windows = (0..curve.len()).map(|at| {
        let window = &curve[at.saturating_sub(1)..curve.len().min(at + 2)];
        window.iter().sum::<f64>() / window.len() as f64
    });
    windows.collect()
}
