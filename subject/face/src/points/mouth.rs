//! The mouth: the outlines of both lips and the line or the gap between them.
//! Order of the points: outer outline clockwise from the left corner (12), middle of the upper lip's inner edge, middle
//! of the lower lip's.

use super::maps::{Maps, along, at, cubic, direction, up};
use super::search::{Found, Motion, Point, only, search, shift, stretch};

const STEPS: [f64; 7] = [0.12, 0.25, 0.38, 0.5, 0.62, 0.75, 0.88];

/// The mouth nearest to `start`.
pub(crate) fn find(maps: &Maps, start: &[Point; 14], reach: f64) -> Found<14> {
    let right = direction(start[0], start[6]);
    let n = up(right);
    let middle = [(start[0][0] + start[6][0]) / 2.0, (start[0][1] + start[6][1]) / 2.0];
    // The corners up and the middle where it is.
    let half = ((start[6][0] - start[0][0]).hypot(start[6][1] - start[0][1]) / 2.0).max(1.0);
    let smile = start.map(|p| {
        let t = ((p[0] - middle[0]) * right[0] + (p[1] - middle[1]) * right[1]) / half;
        [n[0] * t * t, n[1] * t * t]
    });
    let motion = |field, sd, reach, step| Motion { field, sd, reach, step };
    let motions = [
        motion(shift(right), reach / 1.5, 0.6 * reach, 3.0),
        motion(shift(n), reach / 1.5, reach, 3.0),
        motion(stretch(start, middle, [1.0, 0.0]), 0.15, 0.2, 0.1),
        // The jaw: what opens the mouth.
        motion(only(&[7, 8, 9, 10, 11, 13], n), 5.0, 9.0, 4.5),
        motion(only(&[1, 2, 3, 4, 5], n), 2.0, 0.0, 0.0),
        motion(only(&[7, 8, 9, 10, 11], n), 2.5, 0.0, 0.0),
        motion(only(&[12], n), 1.5, 0.0, 0.0),
        motion(only(&[13], n), 2.5, 0.0, 0.0),
        motion(smile, 2.5, 0.0, 0.0),
    ];
    search(start, &motions, |p| score(maps, 2.0 * half, p))
}

fn score(maps: &Maps, width: f64, p: &[Point; 14]) -> f64 {
    let &[a, b, c, d, e, f, g, h, i, j, k, l, top, bottom] = p;
    let right = direction(a, g);
    let n = up(right);
    let luma = |p| at(&maps.fine, p);
    let red = |p| at(&maps.red, p);
    let cap = |v: f64| v.clamp(-0.3, 0.5);
    let outline = |t: f64, q: [Point; 7]| -> Point {
        if t < 0.5 {
            cubic([q[0], q[1], q[2], q[3]], 2.0 * t)
        } else {
            cubic([q[3], q[4], q[5], q[6]], 2.0 * t - 1.0)
        }
    };
    let (mut outer, mut inner) = (0.0, 0.0);
    for t in STEPS {
        let upper = outline(t, [a, b, c, d, e, f, g]);
        let lower = outline(t, [a, l, k, j, i, h, g]);
        outer += 2.0 * cap(red(along(upper, n, -2.5)) - red(along(upper, n, 3.0)));
        outer += cap(luma(along(upper, n, 3.0)) - luma(along(upper, n, -2.0)));
        outer += 2.0 * cap(red(along(lower, n, 2.5)) - red(along(lower, n, -3.0)));
        outer += 0.3 * cap(luma(along(lower, n, -3.0)) - luma(along(lower, n, 1.0)));
        // Both inner edges: parabolas from corner to corner. The line between the lips is dark.
        let bow = 4.0 * t * (1.0 - t);
        let chord = [a[0] + t * (g[0] - a[0]), a[1] + t * (g[1] - a[1])];
        let middle = [(a[0] + g[0]) / 2.0, (a[1] + g[1]) / 2.0];
        let edge =
            |m: Point| [chord[0] + bow * (m[0] - middle[0]), chord[1] + bow * (m[1] - middle[1])];
        let (u, v) = (edge(top), edge(bottom));
        // Lips part over teeth as over the dark: those are no lips' colour either.
        let line = cap(luma(along(u, n, 3.5)) - luma(along(u, n, -0.5)))
            + 0.6 * cap(luma(along(v, n, -3.5)) - luma(along(v, n, 0.5)));
        let parted = 1.6
            * (cap(red(along(u, n, 2.5)) - red(along(u, n, -2.5)))
                + cap(red(along(v, n, -2.5)) - red(along(v, n, 2.5))));
        let open = ((v[1] - u[1]) / 5.0).clamp(0.0, 1.0);
        inner += line.max(open * parted);
    }
    // A short line is easily dark all along: what counts is how much of it there is.
    inner *= (((g[0] - a[0]).powi(2) + (g[1] - a[1]).powi(2)).sqrt() / width).clamp(0.5, 1.5);
    let gap = ((bottom[0] - top[0]) * -n[0] + (bottom[1] - top[1]) * -n[1]).min(0.0);
    let corners = cap(luma(along(a, right, -4.0)) - luma(along(a, right, 2.0)))
        + cap(luma(along(g, right, 4.0)) - luma(along(g, right, -2.0)));
    let n_steps = STEPS.len() as f64;
    outer / (2.6 * n_steps) + inner / (1.2 * n_steps) + 0.15 * corners + 0.1 * gap
}
