//! The traversal that encoder and decoder share: the state of a channel, and the order and prediction of the rows of a
//! run, which are stored axis by axis for vector instructions.
//!
//! All arithmetic is f32 in the order written here, so that every machine gets the same bits.

use super::model::{ANCHOR, Activity, LEVELS, ORIGIN};
use crate::{Position, Result};

/// x, y, z in millimetres or steps, and a lane that stays zero.
pub(super) type PaddedPoint = [f32; 4];

/// Rows of one vector operation. Values computed beyond the last row are not used.
pub(super) const LANES: usize = 8;
type Lanes = [f32; LANES];

/// The x, y and z of many rows.
#[derive(Debug, Default)]
pub(super) struct Planes(pub(super) [Vec<f32>; 3]);

impl Planes {
    pub(super) fn grow(&mut self, padded_len: usize) {
        self.0.iter_mut().for_each(|plane| plane.resize(plane.len().max(padded_len), 0.0));
    }

    #[inline(always)]
    pub(super) fn get(&self, i: usize) -> PaddedPoint {
        let [x, y, z] = &self.0;
        [x[i], y[i], z[i], 0.0]
    }

    #[inline(always)]
    fn set(&mut self, i: usize, point: PaddedPoint) {
        for (plane, value) in self.0.iter_mut().zip(point) {
            plane[i] = value;
        }
    }

    /// The three axes from row `from` on.
    #[inline(always)]
    pub(super) fn axes(&self, from: usize) -> [&[f32]; 3] {
        self.0.each_ref().map(|plane| &plane[from..])
    }
}

/// Moves the odd ones of the first `2 * n + 1` rows into `odd` and compacts the even ones. Works in whole vectors.
#[inline(always)]
pub(super) fn split(rows: &mut [f32], odd: &mut [f32], n: usize) {
    for (i, odd) in odd.as_chunks_mut::<LANES>().0[..n / LANES + 1].iter_mut().enumerate() {
        let mut both = [0.0; 2 * LANES];
        both.copy_from_slice(&rows[2 * LANES * i..][..2 * LANES]);
        *odd = std::array::from_fn(|j| both[2 * j + 1]);
        let even: Lanes = std::array::from_fn(|j| both[2 * j]);
        rows[LANES * i..][..LANES].copy_from_slice(&even);
    }
}

/// Interleaves `n + 1` even rows and the `n` odd rows between them. Works in whole vectors.
#[inline(always)]
fn join(even: &[f32], odd: &[f32], n: usize, rows: &mut [f32]) {
    let n = n / LANES + 1;
    let (even, odd) = (lanes(even, n), lanes(odd, n));
    for (i, rows) in rows.as_chunks_mut::<{ 2 * LANES }>().0[..n].iter_mut().enumerate() {
        let (even, odd) = (&even[i], &odd[i]);
        let mut both = [0.0; 2 * LANES];
        for j in 0..LANES {
            both[2 * j] = even[j];
            both[2 * j + 1] = odd[j];
        }
        *rows = both;
    }
}

/// The first `n` vectors of a plane. Explicit vectors, because most levels of a live block are shorter than the vector
/// loops of the compiler.
#[inline(always)]
fn lanes(plane: &[f32], n: usize) -> &[Lanes] {
    &plane.as_chunks().0[..n]
}

/// Interleaves the axes into positions; returns whether any coordinate is not finite.
#[inline(always)]
pub(super) fn gather(x: &[f32], y: &[f32], z: &[f32], positions: &mut [Position]) -> bool {
    let n = positions.len();
    let (x, y, z) = (&x[..n], &y[..n], &z[..n]);
    for (i, position) in positions.iter_mut().enumerate() {
        *position = [x[i], y[i], z[i]];
    }
    let mut not_finite = false;
    for i in 0..n {
        not_finite |= !x[i].is_finite() | !y[i].is_finite() | !z[i].is_finite();
    }
    not_finite
}

/// Separates positions into axes.
#[inline(always)]
pub(super) fn scatter(samples: &[Position], x: &mut [f32], y: &mut [f32], z: &mut [f32]) {
    for (((sample, x), y), z) in samples.iter().zip(x).zip(y).zip(z) {
        [*x, *y, *z] = *sample;
    }
}

/// Distance between anchors, in rows.
pub(super) const SPAN: usize = 32;

/// Rows before a run from which predictions are made, row 0 included.
const TAIL: usize = SPAN + 1;

/// Index of row 0, the last known row, in a channel's tail.
const ZERO: usize = TAIL - 1;

/// Index of row 0 in [`RunPoints::known`], after one earlier row.
pub(super) const LEAD: usize = 1;

/// The extrapolations of an anchor: (rows over which the velocity is measured at a run's first anchor, its weight).
///
/// Rows between anchors of one run are still unknown: later anchors measure over one span, or over two in place of 32
/// rows.
const EXTRAPOLATORS: [(usize, f32); 7] =
    [(1, 0.0), (2, 1.0), (4, 1.0), (8, 1.0), (8, 0.5), (32, 1.0), (32, 0.5)];

/// One point per extrapolation of an anchor.
type Predictions = [PaddedPoint; EXTRAPOLATORS.len()];

/// An anchor's error is clamped to this, in tolerances.
const MAX_ERROR: f32 = 1024.0;

/// The state of a channel; encoder and decoder have the same one after every block.
#[derive(Debug, Clone)]
pub(super) struct Channel {
    /// The last rows by axis, the newest last.
    tail: [[f32; TAIL]; 3],
    /// How many of the last rows directly precede the next block.
    pub(super) known: usize,
    pub(super) activity: [Activity; LEVELS],
    /// Recent errors of each extrapolation by axis: averages that forget an eighth per anchor.
    pub(super) errors: Predictions,
}

impl Channel {
    pub(super) const NEW: Self = Self {
        tail: [[0.0; TAIL]; 3],
        known: 0,
        activity: Activity::NEW,
        errors: [[0.0; 4]; EXTRAPOLATORS.len()],
    };

    /// The point `n_rows` rows before row 0 of the next run.
    #[inline(always)]
    pub(super) fn before(&self, n_rows: usize) -> PaddedPoint {
        let [x, y, z] = &self.tail;
        [x[ZERO - n_rows], y[ZERO - n_rows], z[ZERO - n_rows], 0.0]
    }
}

/// The part of coding a run that differs between encoder and decoder.
pub(super) trait RunCodec {
    /// Begins a level. A decoder reads the residuals of its coded rows here.
    fn begin_level(&mut self, rows: LevelRows, activity: &mut Activity) -> Result<()>;

    /// The final point of the next coded row, which is an origin or an anchor.
    fn reconstruct(&mut self, row: usize, prediction: PaddedPoint) -> PaddedPoint;

    /// Turns the predictions of the first `count` rows of a level, which are coded, into final points.
    fn reconstruct_level(&mut self, level: usize, count: usize, rows: &mut Planes);

    /// Ends a level, when all its points are final. An encoder writes the residuals here.
    fn end_level(&mut self, _rows: LevelRows, _activity: &mut Activity) {}
}

/// The coded rows of a level: `count` rows `first`, `first + step`, ..., none beyond `end`.
#[derive(Debug, Clone, Copy)]
pub(super) struct LevelRows {
    pub(super) first: usize,
    pub(super) step: usize,
    pub(super) end: usize,
    pub(super) count: usize,
}

impl LevelRows {
    #[inline(always)]
    pub(super) fn row(self, i: usize) -> usize {
        (self.first + i * self.step).min(self.end)
    }
}

/// The row of the last anchor, for `n` rows after row 0.
pub(super) fn extent(n: usize) -> usize {
    let full = n.saturating_sub(1) / SPAN * SPAN;
    full + (n - full).next_power_of_two()
}

/// Array length per axis for a run of `n_rows` rows: up to the last anchor, and padding for whole vectors.
pub(super) const fn padded_len(n_rows: usize) -> usize {
    LEAD + n_rows + SPAN + 4 * LANES
}

/// The points of a run during the traversal, from the anchors down to all rows. Its memory is reused.
#[derive(Debug, Default)]
pub(super) struct RunPoints {
    /// The rows known so far, one per current stride, from row 0 at index [`LEAD`] on.
    pub(super) known: Planes,
    /// The rows of one level, between the known ones.
    pub(super) rows: Planes,
    /// Both, interleaved.
    pub(super) next: Planes,
    /// The last anchor, which may lie between the known rows.
    pub(super) last: PaddedPoint,
}

impl RunPoints {
    pub(super) fn grow(&mut self, padded_len: usize) {
        let all = [&mut self.known, &mut self.rows, &mut self.next];
        all.into_iter().for_each(|planes| planes.grow(padded_len));
    }
}

/// Codes one run of `n_samples` present rows; the first is the origin if no row before it is known. `points`
/// has [`padded_len`] entries per axis, and afterwards holds the points of the run from row 0 on.
#[inline(always)]
pub(super) fn run<S: RunCodec>(
    codec: &mut S,
    channel: &mut Channel,
    points: &mut RunPoints,
    n_samples: usize,
    cap: f32,
) -> Result<()> {
    let mut n = n_samples;
    if channel.known == 0 {
        let rows = LevelRows { first: 0, step: 1, end: 0, count: 1 };
        let before = channel.before(0);
        let activity = &mut channel.activity[ORIGIN];
        codec.begin_level(rows, activity)?;
        let origin = codec.reconstruct(0, before);
        for (tail, origin) in channel.tail.iter_mut().zip(origin) {
            tail[ZERO] = origin;
        }
        codec.end_level(rows, activity);
        channel.known = 1;
        n -= 1;
    }
    if n == 0 {
        points.known.set(LEAD, channel.before(0));
        return Ok(());
    }
    let end = extent(n);
    anchors(codec, channel, points, end, cap)?;
    let mut stride = SPAN / 2;
    while stride > 0 {
        level(codec, channel, points, n, end, stride)?;
        stride /= 2;
    }
    // The tail of a short run includes rows before it.
    let old = TAIL.saturating_sub(n);
    for (tail, known) in channel.tail.iter_mut().zip(&points.known.0) {
        tail.copy_within(TAIL - old.., 0);
        tail[old..].copy_from_slice(&known[LEAD + n + old - ZERO..][..TAIL - old]);
    }
    channel.known = (channel.known + n).min(TAIL);
    Ok(())
}

/// The largest error of an anchor that counts, in millimetres.
pub(super) fn error_cap(tolerance_mm: f64) -> f32 {
    tolerance_mm as f32 * MAX_ERROR
}

// Anchors: each predicted by the extrapolation with the smallest recent error.

/// Extrapolates from `last` by `factor` times the movement from `before`.
#[inline(always)]
fn extrapolate(last: PaddedPoint, before: PaddedPoint, factor: f32) -> PaddedPoint {
    std::array::from_fn(|i| last[i] + (last[i] - before[i]) * factor)
}

/// The extrapolations of the first anchor of a run, `reach` rows away.
#[inline(always)]
fn first_extrapolations(channel: &Channel, reach: f32) -> Predictions {
    let last = channel.before(0);
    let mut extrapolations = [last; EXTRAPOLATORS.len()];
    for (extrapolated, (window, weight)) in extrapolations.iter_mut().zip(EXTRAPOLATORS).skip(1) {
        if window < channel.known {
            let before = channel.before(window);
            *extrapolated = extrapolate(last, before, reach * weight / window as f32);
        }
    }
    extrapolations
}

/// The extrapolations of an anchor `reach` rows after the anchor `last`, from it and up to two anchors before it.
#[inline(always)]
fn extrapolations(last: PaddedPoint, before: [Option<PaddedPoint>; 2], reach: f32) -> Predictions {
    let span = SPAN as f32;
    let near = before[0].unwrap_or(last);
    let (far, window) = before[1].map_or((near, span), |far| (far, 2.0 * span));
    let whole = extrapolate(last, near, reach / span);
    let half = extrapolate(last, near, reach * 0.5 / span);
    let far_whole = extrapolate(last, far, reach / window);
    let far_half = extrapolate(last, far, reach * 0.5 / window);
    [last, whole, whole, whole, half, far_whole, far_half]
}

/// On each axis the extrapolation with the smallest error, the first of equals.
#[inline(always)]
fn best(errors: &Predictions, extrapolations: &Predictions) -> PaddedPoint {
    let better = |a: (PaddedPoint, PaddedPoint), b: (PaddedPoint, PaddedPoint)| {
        let is_less: [bool; 4] = std::array::from_fn(|i| b.0[i] < a.0[i]);
        let pick = |a: PaddedPoint, b: PaddedPoint| -> PaddedPoint {
            std::array::from_fn(|i| if is_less[i] { b[i] } else { a[i] })
        };
        (pick(a.0, b.0), pick(a.1, b.1))
    };
    // Compared as a tree, because in sequence each comparison would wait for the one before.
    let of = |i: usize| (errors[i], extrapolations[i]);
    let first = better(better(of(0), of(1)), better(of(2), of(3)));
    better(first, better(better(of(4), of(5)), of(6))).1
}

/// Codes all anchors, up to row `end`. Errors count up to `cap`.
#[inline(always)]
fn anchors<S: RunCodec>(
    codec: &mut S,
    channel: &mut Channel,
    points: &mut RunPoints,
    end: usize,
    cap: f32,
) -> Result<()> {
    let count = end.div_ceil(SPAN);
    let rows = LevelRows { first: SPAN, step: SPAN, end, count };
    codec.begin_level(rows, &mut channel.activity[ANCHOR])?;
    let mut last = channel.before(0);
    points.known.set(LEAD, last);
    let mut before = [None; 2];
    for i in 0..count {
        let row = rows.row(i);
        let reach = (row - i * SPAN) as f32;
        let extrapolations = match i {
            0 => first_extrapolations(channel, reach),
            _ => extrapolations(last, before, reach),
        };
        let prediction = best(&channel.errors, &extrapolations);
        let point = codec.reconstruct(row, prediction);
        for (errors, extrapolated) in channel.errors.iter_mut().zip(&extrapolations) {
            let off: PaddedPoint = std::array::from_fn(|i| (extrapolated[i] - point[i]).abs());
            // Not `min`, which handles NaN at a cost.
            *errors = std::array::from_fn(|i| {
                errors[i] * 0.875 + if off[i] < cap { off[i] } else { cap }
            });
        }
        before = [Some(last), before[0]];
        last = point;
        points.known.set(LEAD + i + 1, point);
    }
    points.last = last;
    codec.end_level(rows, &mut channel.activity[ANCHOR]);
    Ok(())
}

// One stride: rows between known rows, predicted from the four nearest of them.

/// The cubic through values at -3, -1, 1 and 3, evaluated at 0.
#[inline(always)]
fn cubic(a: f32, b: f32, c: f32, d: f32) -> f32 {
    let near = b + c;
    0.5 * near + (near - (a + d)) * 0.0625
}

/// The parabola through three points, evaluated midway between `near` and `other`; `far` lies beyond `near`.
#[inline(always)]
fn parabola(far: PaddedPoint, near: PaddedPoint, other: PaddedPoint) -> PaddedPoint {
    std::array::from_fn(|i| ((near[i] * 6.0 + other[i] * 3.0) - far[i]) * 0.125)
}

/// Interpolates one axis by cubics between consecutive known rows, from the second one on. Works in whole vectors.
#[inline(always)]
fn cubics(known: &[f32], rows: &mut [f32], n: usize) {
    let n = n.div_ceil(LANES);
    let [a, b, c, d] = [0, 1, 2, 3].map(|i| lanes(&known[i..], n));
    for (i, rows) in rows.as_chunks_mut().0[..n].iter_mut().enumerate() {
        let (a, b, c, d) = (&a[i], &b[i], &c[i], &d[i]);
        let mut cubics = [0.0; LANES];
        for j in 0..LANES {
            cubics[j] = cubic(a[j], b[j], c[j], d[j]);
        }
        *rows = cubics;
    }
}

/// Predicts the first and the last row of a level, which lack an outer neighbour, from the neighbours that exist.
#[inline(always)]
fn predict_ends(known: &Planes, has_left: bool, n: usize, rows: &mut Planes) {
    // Index 0 is the known row before the first row of the level.
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

/// Codes the rows of one stride of a run of `n` rows whose last anchor is at `end`. `points.known` has every second
/// multiple of the stride before, and every multiple after.
#[inline(always)]
fn level<S: RunCodec>(
    codec: &mut S,
    channel: &mut Channel,
    points: &mut RunPoints,
    n: usize,
    end: usize,
    stride: usize,
) -> Result<()> {
    let level = stride.ilog2() as usize;
    let RunPoints { known, rows, next, last } = points;
    // Rows with a right neighbour; those beyond the samples have no residual.
    let n_rows = end / (2 * stride);
    if n_rows > 0 {
        let count = n_rows.min((n + stride) / (2 * stride));
        let coded = LevelRows { first: stride, step: 2 * stride, end, count };
        codec.begin_level(coded, &mut channel.activity[level])?;
        let has_left = 2 * stride < channel.known;
        known.set(LEAD - 1, channel.before(2 * stride));
        for (known, rows) in known.0.iter().zip(&mut rows.0) {
            cubics(known, rows, n_rows);
        }
        predict_ends(known, has_left, n_rows, rows);
        codec.reconstruct_level(level, count, rows);
        codec.end_level(coded, &mut channel.activity[level]);
    }
    for ((known, rows), next) in known.0.iter().zip(&rows.0).zip(&mut next.0) {
        join(&known[LEAD..], rows, n_rows, &mut next[LEAD..]);
    }
    // The last anchor joins the known rows where it is a multiple of the stride.
    if end / stride > 2 * n_rows {
        next.set(LEAD + 2 * n_rows + 1, *last);
    }
    std::mem::swap(known, next);
    Ok(())
}
