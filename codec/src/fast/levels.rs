//! One stride of a run: rows between rows that are known, from the four nearest of these.

use super::walk::{Channel, Point, Rows, Side, ZERO, lanes};
use crate::CodecError;

/// The cubic through rows at -3, -1, 1 and 3, at 0.
#[inline(always)]
fn cubic(a: Point, b: Point, c: Point, d: Point) -> Point {
    lanes(|i| {
        let near = b[i] + c[i];
        0.5 * near + (near - (a[i] + d[i])) * 0.0625
    })
}

/// The parabola through rows at -1, 1 and the far one, at 0; `near` is on the far one's side.
#[inline(always)]
fn parabola(far: Point, near: Point, other: Point) -> Point {
    lanes(|i| ((near[i] * 6.0 + other[i] * 3.0) - far[i]) * 0.125)
}

/// The rows of one stride, of a run of `n` rows whose last anchor is at `end`.
#[inline(always)]
pub(super) fn level<S: Side>(
    side: &mut S,
    channel: &mut Channel,
    points: &mut [Point],
    (n, end): (usize, usize),
    stride: usize,
) -> Result<(), CodecError> {
    let level = stride.ilog2() as usize;
    // Rows that have a right neighbour; beyond the samples there are rows that carry nothing.
    let stop = (end + 1).saturating_sub(stride);
    if stop <= stride {
        return Ok(());
    }
    let count = (n.min(stop - 1) + stride) / (2 * stride);
    let rows = Rows { first: stride, step: 2 * stride, end, count };
    side.enter(level, rows, &mut channel.activity[level])?;
    let mut row = stride;
    let one = |side: &mut S, points: &mut [Point], row: usize, known: usize| {
        let at = ZERO + row;
        let (left, right) = (points[at - stride], points[at + stride]);
        let outer_left = row >= 3 * stride || 3 * stride - row < known;
        let outer_right = row + 3 * stride <= end;
        let prediction = match (outer_left, outer_right) {
            (true, true) => cubic(points[at - 3 * stride], left, right, points[at + 3 * stride]),
            (true, false) => parabola(points[at - 3 * stride], left, right),
            (false, true) => parabola(points[at + 3 * stride], right, left),
            (false, false) => lanes(|i| 0.5 * (left[i] + right[i])),
        };
        points[at] = if row <= n { side.settle(row, prediction) } else { prediction };
    };
    one(side, points, row, channel.known);
    row += 2 * stride;
    let inner = n.min(end.saturating_sub(3 * stride));
    while row <= inner {
        let at = ZERO + row;
        let window = &mut points[at - 3 * stride..=at + 3 * stride];
        let (left, right) = (window[2 * stride], window[4 * stride]);
        let prediction = cubic(window[0], left, right, window[6 * stride]);
        window[3 * stride] = side.settle(row, prediction);
        row += 2 * stride;
    }
    while row < stop {
        one(side, points, row, channel.known);
        row += 2 * stride;
    }
    side.leave(level, rows, &mut channel.activity[level]);
    Ok(())
}
