//! One stride of a run: rows between rows that are known, from the four nearest of these.

use super::{
    planes::{self, LANES, Planes, join},
    walk::{Channel, Grid, Point, Rows, Side, lanes},
};
use crate::CodecError;

/// Where row 0 is in the rows that are known: one that is further left comes before.
pub(super) const LEAD: usize = 1;

/// The cubic through rows at -3, -1, 1 and 3, at 0.
#[inline(always)]
fn cubic(a: f32, b: f32, c: f32, d: f32) -> f32 {
    let near = b + c;
    0.5 * near + (near - (a + d)) * 0.0625
}

/// The parabola through rows at -1, 1 and the far one, at 0; `near` is on the far one's side.
#[inline(always)]
fn parabola(far: Point, near: Point, other: Point) -> Point {
    lanes(|i| ((near[i] * 6.0 + other[i] * 3.0) - far[i]) * 0.125)
}

/// The cubic between each two of the known rows of one axis, from the second of them on. In whole lanes.
#[inline(always)]
fn cubics(known: &[f32], rows: &mut [f32], n: usize) {
    let n = n.div_ceil(LANES);
    let [a, b, c, d] = [0, 1, 2, 3].map(|i| planes::lanes(&known[i..], n));
    for (i, rows) in rows.as_chunks_mut().0[..n].iter_mut().enumerate() {
        let (a, b, c, d) = (&a[i], &b[i], &c[i], &d[i]);
        let mut cubics = [0.0; LANES];
        for j in 0..LANES {
            cubics[j] = cubic(a[j], b[j], c[j], d[j]);
        }
        *rows = cubics;
    }
}

/// The first and the last row have no neighbour further out: from those that there are.
#[inline(always)]
fn mend_ends(known: &Planes, has_left: bool, n: usize, rows: &mut Planes) {
    // The known row before a row of the level, and those after it.
    let at = |i: usize| known.get(LEAD + i);
    if n == 1 {
        let (left, right) = (at(0), at(1));
        rows.set(
            0,
            match has_left {
                true => parabola(known.get(LEAD - 1), left, right),
                false => lanes(|i| 0.5 * (left[i] + right[i])),
            },
        );
        return;
    }
    if !has_left {
        rows.set(0, parabola(at(2), at(1), at(0)));
    }
    rows.set(n - 1, parabola(at(n - 2), at(n - 1), at(n)));
}

/// The rows of one stride, of a run of `n` rows whose last anchor is at `end`. `grid` goes from every second
/// stride to every stride.
#[inline(always)]
pub(super) fn level<S: Side>(
    side: &mut S,
    channel: &mut Channel,
    grid: &mut Grid,
    (n, end): (usize, usize),
    stride: usize,
) -> Result<(), CodecError> {
    let level = stride.ilog2() as usize;
    let Grid { known, rows, next, last } = grid;
    // Rows that have a right neighbour; beyond the samples there are rows that carry nothing.
    let n_rows = end / (2 * stride);
    if n_rows > 0 {
        let count = n_rows.min((n + stride) / (2 * stride));
        let coded = Rows { first: stride, step: 2 * stride, end, count };
        side.enter(level, coded, &mut channel.activity[level])?;
        let has_left = 2 * stride < channel.known;
        known.set(LEAD - 1, channel.before(2 * stride));
        for (known, rows) in known.0.iter().zip(&mut rows.0) {
            cubics(known, rows, n_rows);
        }
        mend_ends(known, has_left, n_rows, rows);
        side.settle_level(level, count, rows);
        side.leave(level, coded, &mut channel.activity[level]);
    }
    for ((known, rows), next) in known.0.iter().zip(&rows.0).zip(&mut next.0) {
        join(&known[LEAD..], rows, n_rows, &mut next[LEAD..]);
    }
    // The last anchor joins where it is a row of the stride.
    if end / stride > 2 * n_rows {
        next.set(LEAD + 2 * n_rows + 1, *last);
    }
    std::mem::swap(known, next);
    Ok(())
}
