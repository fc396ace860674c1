//! The anchors of a run: each predicted by the guess that did best lately.

use super::{
    levels::LEAD,
    model::ANCHOR,
    walk::{Channel, Grid, Point, Rows, SPAN, Side, lanes},
};
use crate::CodecError;

/// (rows that the velocity is measured over at the first anchor of a run, its weight).
///
/// Between anchors of one run nothing is known yet: those behind it measure over one span, or over two where the
/// first does over one.
pub(super) const GUESSES: [(usize, f32); 7] =
    [(1, 0.0), (2, 1.0), (4, 1.0), (8, 1.0), (8, 0.5), (32, 1.0), (32, 0.5)];

/// On from `last` as it went from `before`, times a factor.
#[inline(always)]
fn onward(last: Point, before: Point, factor: f32) -> Point {
    lanes(|i| last[i] + (last[i] - before[i]) * factor)
}

/// The guesses of the first anchor of a run, so many rows away.
#[inline(always)]
fn first_guesses(channel: &Channel, reach: f32) -> [Point; GUESSES.len()] {
    let last = channel.before(0);
    let mut guesses = [last; GUESSES.len()];
    for (guess, (window, weight)) in guesses.iter_mut().zip(GUESSES).skip(1) {
        if window < channel.known {
            *guess = onward(last, channel.before(window), reach * weight / window as f32);
        }
    }
    guesses
}

/// The guesses of an anchor `reach` rows behind `last`, from it and the two anchors before it. There may be
/// one only.
#[inline(always)]
fn guesses(last: Point, before: [Option<Point>; 2], reach: f32) -> [Point; GUESSES.len()] {
    let span = SPAN as f32;
    let near = before[0].unwrap_or(last);
    let (far, window) = before[1].map_or((near, span), |far| (far, 2.0 * span));
    let whole = onward(last, near, reach / span);
    let half = onward(last, near, reach * 0.5 / span);
    let far_whole = onward(last, far, reach / window);
    let far_half = onward(last, far, reach * 0.5 / window);
    [last, whole, whole, whole, half, far_whole, far_half]
}

/// Axis by axis the guess with the smallest error, the first of equals.
#[inline(always)]
fn best(errors: &[Point; GUESSES.len()], guesses: &[Point; GUESSES.len()]) -> Point {
    let better = |a: (Point, Point), b: (Point, Point)| {
        let is_less: [bool; 4] = std::array::from_fn(|i| b.0[i] < a.0[i]);
        let pick = |a: Point, b: Point| lanes(|i| if is_less[i] { b[i] } else { a[i] });
        (pick(a.0, b.0), pick(a.1, b.1))
    };
    // In pairs, and pairs of these: one after another, each would wait for those before it.
    let of = |i: usize| (errors[i], guesses[i]);
    let first = better(better(of(0), of(1)), better(of(2), of(3)));
    better(first, better(better(of(4), of(5)), of(6))).1
}

/// All anchors, up to row `end`. An error counts as `cap` at most.
#[inline(always)]
pub(super) fn anchors<S: Side>(
    side: &mut S,
    channel: &mut Channel,
    grid: &mut Grid,
    end: usize,
    cap: f32,
) -> Result<(), CodecError> {
    let count = end.div_ceil(SPAN);
    let rows = Rows { first: SPAN, step: SPAN, end, count };
    side.enter(ANCHOR, rows, &mut channel.activity[ANCHOR])?;
    let mut last = channel.before(0);
    grid.known.set(LEAD, last);
    let mut before = [None; 2];
    for i in 0..count {
        let row = rows.row(i);
        let reach = (row - i * SPAN) as f32;
        let guesses =
            if i == 0 { first_guesses(channel, reach) } else { guesses(last, before, reach) };
        let prediction = best(&channel.errors, &guesses);
        let point = side.settle(row, prediction);
        for (errors, guess) in channel.errors.iter_mut().zip(&guesses) {
            let off = lanes(|i| (guess[i] - point[i]).abs());
            // Not `min`, which looks for NaN.
            *errors = lanes(|i| errors[i] * 0.875 + if off[i] < cap { off[i] } else { cap });
        }
        before = [Some(last), before[0]];
        last = point;
        grid.known.set(LEAD + i + 1, point);
    }
    grid.last = last;
    side.leave(ANCHOR, rows, &mut channel.activity[ANCHOR]);
    Ok(())
}
