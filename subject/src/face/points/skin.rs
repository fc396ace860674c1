//! The skin of this face, by the cheeks: its colour needs no table.

use super::crop::Crop;
use super::search::Point;
use crate::face::Plane;

/// How unlike the skin of the cheeks a pixel is (0 like it, 1 unlike).
pub(crate) fn unlike(crop: &Crop, places: &[Point]) -> Plane {
    let floor = 12.0_f32;
    let channels = [
        crop.plane(|[r, g, b]| (floor + 0.299 * r + 0.587 * g + 0.114 * b).ln()),
        crop.plane(|[r, g, _]| ((floor + r) / (floor + g)).ln()),
        crop.plane(|[_, g, b]| ((floor + b) / (floor + g)).ln()),
    ];
    // Light varies over a face more than its colour does.
    let floors = [0.20_f32, 0.05, 0.06];
    let stats = [0, 1, 2].map(|c: usize| {
        let mut v: Vec<f32> = Vec::new();
        for p in places {
            for k in 0..49 {
                let (dx, dy) = (f64::from(k % 7) - 3.0, f64::from(k / 7) - 3.0);
                v.push(channels[c].sample((p[0] + 2.0 * dx) as f32, (p[1] + 2.0 * dy) as f32));
            }
        }
        v.sort_by(f32::total_cmp);
        let q = |s: f32| v.get((s * (v.len().max(1) - 1) as f32) as usize).copied().unwrap_or(0.0);
        (q(0.5), ((q(0.84) - q(0.16)) / 2.0).max(floors[c]))
    });
    let [a, b, c] = &channels;
    let values = a.values().iter().zip(b.values()).zip(c.values()).map(|((a, b), c)| {
        let d: f32 =
            [a, b, c].into_iter().zip(stats).map(|(v, (m, s))| ((v - m) / s).powi(2)).sum();
        1.0 - (-d / 12.0).exp()
    });
    Plane::from_values(a.width(), a.height(), values.collect()).blurred(1.5)
}
