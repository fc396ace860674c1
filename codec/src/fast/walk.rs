//! What encoder and decoder share: the state of a channel, and in which order and from which rows a
//! run is predicted.
//!
//! All arithmetic is f32 in the order written here: the same on every machine.

use super::{
    model::{ANCHOR, Activity, LEVELS, ORIGIN},
    planes::{self, LANES, Planes, Point, join},
};
use crate::Result;

/// Distance of the anchors, in rows.
pub(super) const SPAN: usize = 32;

/// Rows before a run that predictions reach back to, row 0 included.
pub(super) const TAIL: usize = SPAN + 1;

/// Index of row 0, the last row already known, in a run's points.
const ZERO: usize = TAIL - 1;

/// Where row 0 is in the rows that are known: one that is further left comes before.
pub(super) const LEAD: usize = 1;

/// (rows that the velocity is measured over at the first anchor of a run, its weight).
///
/// Between anchors of one run nothing is known yet: those behind it measure over one span, or over two where the
/// first does over one.
const GUESSES: [(usize, f32); 7] =
    [(1, 0.0), (2, 1.0), (4, 1.0), (8, 1.0), (8, 0.5), (32, 1.0), (32, 0.5)];

/// An anchor's error beyond this many tolerances counts as this much.
const MAX_ERROR: f32 = 1024.0;

/// The state of a channel, the same on both sides after every block.
#[derive(Debug, Clone)]
pub(super) struct Channel {
    /// The last rows by axis, the newest last.
    tail: [[f32; TAIL]; 3],
    /// How many of them are right before the next block.
    pub(super) known: usize,
    pub(super) activity: [Activity; LEVELS],
    /// How far each guess was off lately: an average that forgets an eighth an anchor.
    pub(super) errors: [Point; GUESSES.len()],
}

impl Channel {
    pub(super) const NEW: Self = Self {
        tail: [[0.0; TAIL]; 3],
        known: 0,
        activity: Activity::NEW,
        errors: [[0.0; 4]; GUESSES.len()],
    };

    /// So many rows before row 0 of the next run.
    #[inline(always)]
    pub(super) fn before(&self, n_rows: usize) -> Point {
        let [x, y, z] = &self.tail;
        [x[ZERO - n_rows], y[ZERO - n_rows], z[ZERO - n_rows], 0.0]
    }
}

/// What an encoder and a decoder do differently.
pub(super) trait Side {
    /// Coded rows of a level, in order, before their points are asked for. A decoder reads them.
    fn enter(&mut self, rows: Rows, activity: &mut Activity) -> Result<()>;

    /// The final point of the next coded row, an origin or an anchor.
    fn settle(&mut self, row: usize, prediction: Point) -> Point;

    /// Makes final points of the predictions of a level's rows, the first `count`, which are coded.
    fn settle_level(&mut self, level: usize, count: usize, rows: &mut Planes);

    /// All rows of the level are settled. An encoder writes them.
    fn leave(&mut self, _rows: Rows, _activity: &mut Activity) {}
}

/// `first`, `first + step` ... `count` rows of a run, none beyond `end`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rows {
    pub(super) first: usize,
    pub(super) step: usize,
    pub(super) end: usize,
    pub(super) count: usize,
}

impl Rows {
    #[inline(always)]
    pub(super) fn row(self, i: usize) -> usize {
        (self.first + i * self.step).min(self.end)
    }
}

/// Rows up to the last anchor, for `n` rows after row 0.
pub(super) fn extent(n: usize) -> usize {
    let full = n.saturating_sub(1) / SPAN * SPAN;
    full + (n - full).next_power_of_two()
}

/// Room that a run of so many rows takes, by axis: up to the last anchor, and what whole lanes are more.
pub(super) const fn room(n_rows: usize) -> usize {
    LEAD + n_rows + SPAN + 4 * LANES
}

/// The points of a run, from the anchors to all rows. Memory that is used again.
#[derive(Debug, Default)]
pub(super) struct Grid {
    /// Every so many rows, from row 0 at [`LEAD`] on.
    pub(super) known: Planes,
    /// The rows between them, of one level.
    pub(super) rows: Planes,
    /// Both.
    pub(super) next: Planes,
    /// The last anchor, which may lie between the known rows.
    pub(super) last: Point,
}

impl Grid {
    pub(super) fn grow(&mut self, room: usize) {
        [&mut self.known, &mut self.rows, &mut self.next].into_iter().for_each(|p| p.grow(room));
    }
}

/// Walks one run: `n_samples` present rows, of which the first is the origin where nothing is known.
/// `grid` has [`room`] for the run, and then its rows, from row 0 on.
#[inline(always)]
pub(super) fn run<S: Side>(
    side: &mut S,
    channel: &mut Channel,
    grid: &mut Grid,
    n_samples: usize,
    cap: f32,
) -> Result<()> {
    let mut n = n_samples;
    if channel.known == 0 {
        let rows = Rows { first: 0, step: 1, end: 0, count: 1 };
        let before = channel.before(0);
        let activity = &mut channel.activity[ORIGIN];
        side.enter(rows, activity)?;
        let origin = side.settle(0, before);
        for (tail, origin) in channel.tail.iter_mut().zip(origin) {
            tail[ZERO] = origin;
        }
        side.leave(rows, activity);
        channel.known = 1;
        n -= 1;
    }
    if n == 0 {
        grid.known.set(LEAD, channel.before(0));
        return Ok(());
    }
    let end = extent(n);
    anchors(side, channel, grid, end, cap)?;
    let mut stride = SPAN / 2;
    while stride > 0 {
        level(side, channel, grid, n, end, stride)?;
        stride /= 2;
    }
    // Of a short run, rows before it are among the last, too.
    let old = TAIL.saturating_sub(n);
    for (tail, known) in channel.tail.iter_mut().zip(&grid.known.0) {
        tail.copy_within(TAIL - old.., 0);
        tail[old..].copy_from_slice(&known[LEAD + n + old - ZERO..][..TAIL - old]);
    }
    channel.known = (channel.known + n).min(TAIL);
    Ok(())
}

/// The cap of an anchor's error.
pub(super) fn error_cap(tolerance_mm: f64) -> f32 {
    tolerance_mm as f32 * MAX_ERROR
}

// Anchors: each predicted by the guess that did best lately.

/// On from `last` as it went from `before`, times a factor.
#[inline(always)]
fn onward(last: Point, before: Point, factor: f32) -> Point {
    std::array::from_fn(|i| last[i] + (last[i] - before[i]) * factor)
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
        let pick = |a: Point, b: Point| -> Point {
            std::array::from_fn(|i| if is_less[i] { b[i] } else { a[i] })
        };
        (pick(a.0, b.0), pick(a.1, b.1))
    };
    // In pairs, and pairs of these: one after another, each would wait for those before it.
    let of = |i: usize| (errors[i], guesses[i]);
    let first = better(better(of(0), of(1)), better(of(2), of(3)));
    better(first, better(better(of(4), of(5)), of(6))).1
}

/// All anchors, up to row `end`. An error counts as `cap` at most.
#[inline(always)]
fn anchors<S: Side>(
    side: &mut S,
    channel: &mut Channel,
    grid: &mut Grid,
    end: usize,
    cap: f32,
) -> Result<()> {
    let count = end.div_ceil(SPAN);
    let rows = Rows { first: SPAN, step: SPAN, end, count };
    side.enter(rows, &mut channel.activity[ANCHOR])?;
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
            let off: Point = std::array::from_fn(|i| (guess[i] - point[i]).abs());
            // Not `min`, which looks for NaN.
            *errors = std::array::from_fn(|i| {
                errors[i] * 0.875 + if off[i] < cap { off[i] } else { cap }
            });
        }
        before = [Some(last), before[0]];
        last = point;
        grid.known.set(LEAD + i + 1, point);
    }
    grid.last = last;
    side.leave(rows, &mut channel.activity[ANCHOR]);
    Ok(())
}

// One stride: rows between rows that are known, from the four nearest of these.

/// The cubic through rows at -3, -1, 1 and 3, at 0.
#[inline(always)]
fn cubic(a: f32, b: f32, c: f32, d: f32) -> f32 {
    let near = b + c;
    0.5 * near + (near - (a + d)) * 0.0625
}

/// The parabola through rows at -1, 1 and the far one, at 0; `near` is on the far one's side.
#[inline(always)]
fn parabola(far: Point, near: Point, other: Point) -> Point {
    std::array::from_fn(|i| ((near[i] * 6.0 + other[i] * 3.0) - far[i]) * 0.125)
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
        let middle = if has_left {
            parabola(known.get(LEAD - 1), left, right)
        } else {
            std::array::from_fn(|i| 0.5 * (left[i] + right[i]))
        };
        rows.set(0, middle);
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
fn level<S: Side>(
    side: &mut S,
    channel: &mut Channel,
    grid: &mut Grid,
    n: usize,
    end: usize,
    stride: usize,
) -> Result<()> {
    let level = stride.ilog2() as usize;
    let Grid { known, rows, next, last } = grid;
    // Rows that have a right neighbour; beyond the samples there are rows that carry nothing.
    let n_rows = end / (2 * stride);
    if n_rows > 0 {
        let count = n_rows.min((n + stride) / (2 * stride));
        let coded = Rows { first: stride, step: 2 * stride, end, count };
        side.enter(coded, &mut channel.activity[level])?;
        let has_left = 2 * stride < channel.known;
        known.set(LEAD - 1, channel.before(2 * stride));
        for (known, rows) in known.0.iter().zip(&mut rows.0) {
            cubics(known, rows, n_rows);
        }
        mend_ends(known, has_left, n_rows, rows);
        side.settle_level(level, count, rows);
        side.leave(coded, &mut channel.activity[level]);
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
