//! What encoder and decoder share: the state of a channel, and in which order and from which rows a
//! run is predicted.
//!
//! All arithmetic is f32 in the order written here: the same on every machine.

use super::{
    anchors::{GUESSES, anchors},
    levels::{LEAD, level},
    model::{Activity, LEVELS, ORIGIN},
    planes::{LANES, Planes},
};
use crate::CodecError;

/// x, y, z and a lane that stays zero.
pub(super) type Point = [f32; 4];

/// Distance of the anchors, in rows.
pub(super) const SPAN: usize = 32;

/// Rows before a run that predictions reach back to, row 0 included.
pub(super) const TAIL: usize = SPAN + 1;

/// Index of row 0, the last row already known, in a run's points.
const ZERO: usize = TAIL - 1;

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
    fn enter(
        &mut self,
        level: usize,
        rows: Rows,
        activity: &mut Activity,
    ) -> Result<(), CodecError>;

    /// The final point of the next coded row, an origin or an anchor.
    fn settle(&mut self, row: usize, prediction: Point) -> Point;

    /// Makes final points of the predictions of a level's rows, the first `count`, which are coded.
    fn settle_level(&mut self, level: usize, count: usize, rows: &mut Planes);

    /// All rows of the level are settled. An encoder writes them.
    fn leave(&mut self, level: usize, rows: Rows, activity: &mut Activity);
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

#[inline(always)]
pub(super) fn lanes(f: impl Fn(usize) -> f32) -> Point {
    [f(0), f(1), f(2), f(3)]
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
) -> Result<(), CodecError> {
    let mut n = n_samples;
    if channel.known == 0 {
        let rows = Rows { first: 0, step: 1, end: 0, count: 1 };
        let before = channel.before(0);
        let activity = &mut channel.activity[ORIGIN];
        side.enter(ORIGIN, rows, activity)?;
        let origin = side.settle(0, before);
        for (tail, origin) in channel.tail.iter_mut().zip(origin) {
            tail[ZERO] = origin;
        }
        side.leave(ORIGIN, rows, activity);
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
        level(side, channel, grid, (n, end), stride)?;
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
