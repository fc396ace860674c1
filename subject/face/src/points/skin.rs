//! The skin of this face, by the cheeks: its colour needs no table.

use super::maps::Maps;
use super::search::Point;
use crate::Plane;

/// Least standard deviations of brightness, ln(R/G) and ln(B/G): light varies over a face more than its colour does.
const FLOORS: [f32; 3] = [0.20, 0.05, 0.06];

/// How unlike the skin of the cheeks a pixel is (0 like it, 1 unlike), for every other pixel of the crop.
pub(crate) fn unlike(maps: &Maps, places: &[Point]) -> Plane {
    let stats: [(f32, f32); 3] = std::array::from_fn(|c| {
        let mut v: Vec<f32> = Vec::new();
        for p in places {
            for k in 0..49 {
                let (dx, dy) = (f64::from(k % 7) - 3.0, f64::from(k / 7) - 3.0);
                v.push(maps.raw[c].sample((p[0] / 2.0 + dx) as f32, (p[1] / 2.0 + dy) as f32));
            }
        }
        v.sort_by(f32::total_cmp);
        let q = |s: f32| v.get((s * (v.len().max(1) - 1) as f32) as usize).copied().unwrap_or(0.0);
        (q(0.5), ((q(0.84) - q(0.16)) / 2.0).max(FLOORS[c]))
    });
    let [a, b, c] = &maps.raw;
    let values = a.values().iter().zip(b.values()).zip(c.values()).map(|((a, b), c)| {
        let [(ma, sa), (mb, sb), (mc, sc)] = stats;
        let (x, y, z) = ((a - ma) / sa, (b - mb) / sb, (c - mc) / sc);
        1.0 - (-(x * x + y * y + z * z) / 12.0).exp()
    });
    Plane::from_values(a.width(), a.height(), values.collect()).blurred(0.75)
}
