//! Active contours, solved greedily (Yang et al. 2004, equation 5).
//!
//! Energies are normalised over the neighbourhood of each point (Williams and Shah 1992); of the eight neighbours the four
//! beside and the four across are tried by turns, which halves the work and ends in the same place (Lam and Yan 1994).

use super::boxes::value;
use crate::Plane;

/// Weights of continuity, curvature and image in equation (5). The paper gives none: those of (Williams and Shah 1992).
const WEIGHTS: [f64; 3] = [1.0, 1.0, 1.2];
/// Rounds at most.
const ROUNDS_MAX: usize = 120;

/// Pixels that a point may go to: itself and the four beside it, or the four across.
const BESIDE: [(i32, i32); 5] = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)];
const ACROSS: [(i32, i32); 5] = [(0, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)];

/// Lets a curve settle on the edges of `strength` (the larger, the better). An open curve keeps its ends.
pub(super) fn settle(strength: &Plane, curve: &mut [(i32, i32)], closed: bool) {
    let n = curve.len();
    if n < 3 {
        return;
    }
    let mut still = 0;
    for round in 0..ROUNDS_MAX {
        let spacing = spacing(curve, closed);
        let pattern = if round % 2 == 0 { BESIDE } else { ACROSS };
        let mut moved = 0;
        let range = if closed { 0..n } else { 1..n - 1 };
        for i in range {
            let (Some(&here), Some(&before), Some(&after)) =
                (curve.get(i), curve.get((i + n - 1) % n), curve.get((i + 1) % n))
            else {
                continue;
            };
            let places = pattern.map(|(dx, dy)| (here.0 + dx, here.1 + dy));
            let continuity = places.map(|p| (spacing - distance(p, before)).abs());
            let curvature = places.map(|p| {
                let x = f64::from(before.0 - 2 * p.0 + after.0);
                let y = f64::from(before.1 - 2 * p.1 + after.1);
                x * x + y * y
            });
            let image = places.map(|p| -value(strength, p.0, p.1));
            let terms = [scaled(continuity, 0.0), scaled(curvature, 0.0), scaled(image, 1e-3)];
            let energy = |k: usize| -> f64 {
                terms.iter().zip(WEIGHTS).map(|(t, w)| w * t.get(k).copied().unwrap_or(0.0)).sum()
            };
            let mut best = 0;
            for k in 1..places.len() {
                if energy(k) < energy(best) - 1e-12 {
                    best = k;
                }
            }
            if best != 0
                && let (Some(point), Some(&place)) = (curve.get_mut(i), places.get(best))
            {
                *point = place;
                moved += 1;
            }
        }
        // Both patterns must have had their turn without a move.
        still = if moved * 20 <= n { still + 1 } else { 0 };
        if still == 2 {
            break;
        }
    }
}

/// From 0 to 1 over the neighbourhood; a range below `floor` is no difference.
fn scaled(energy: [f64; 5], floor: f64) -> [f64; 5] {
    let low = energy.iter().copied().fold(f64::INFINITY, f64::min);
    let high = energy.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let range = (high - low).max(floor).max(1e-12);
    energy.map(|e| (e - low) / range)
}

fn distance(a: (i32, i32), b: (i32, i32)) -> f64 {
    f64::from(a.0 - b.0).hypot(f64::from(a.1 - b.1))
}

/// Mean distance of neighbours.
fn spacing(curve: &[(i32, i32)], closed: bool) -> f64 {
    let pairs = curve.iter().zip(curve.iter().cycle().skip(1));
    let n = if closed { curve.len() } else { curve.len() - 1 };
    pairs.take(n).map(|(a, b)| distance(*a, *b)).sum::<f64>() / n as f64
}
