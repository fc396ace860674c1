//! The samples of a run, laid out as they are coded: anchors, and level by level.

use super::{
    model::ANCHOR,
    planes::{LANES, Planes, split, whole},
    walk::{self, Point, SPAN},
};
use crate::Position;

/// Where the rows of a run should be.
#[derive(Debug, Default)]
pub(super) struct Targets {
    /// All rows at first, row 0 foremost; then every 32nd.
    anchors: Planes,
    /// The rows of the strides, one behind another.
    pub(super) levels: Planes,
    /// Where each stride's begin.
    pub(super) starts: [usize; ANCHOR],
    last: Point,
    end: usize,
}

/// Puts the axes apart.
#[inline(always)]
fn by_axis(samples: &[Position], x: &mut [f32], y: &mut [f32], z: &mut [f32]) {
    for (((sample, x), y), z) in samples.iter().zip(x).zip(y).zip(z) {
        [*x, *y, *z] = *sample;
    }
}

impl Targets {
    pub(super) fn grow(&mut self, room: usize) {
        self.anchors.grow(room);
        self.levels.grow(room + ANCHOR * LANES);
    }

    /// Takes the samples of a run, of which the first is row 0 where it is the `origin`, or else row 1.
    #[inline(always)]
    pub(super) fn take(&mut self, samples: &[Position], origin: usize) {
        let n = samples.len() - origin;
        let end = walk::extent(n);
        let [x, y, z] = self.anchors.axes_mut(1 - origin);
        by_axis(samples, x, y, z);
        self.last = ahead(samples, end - n);
        self.end = end;
        let mut start = 0;
        for (level, at) in self.starts.iter_mut().enumerate() {
            let n = end >> (level + 1);
            for (rows, levels) in self.anchors.0.iter_mut().zip(&mut self.levels.0) {
                split(rows, &mut levels[start..], n);
            }
            *at = start;
            start += whole(n + 1);
        }
    }

    /// Of the origin or an anchor.
    #[inline(always)]
    pub(super) fn row(&self, row: usize) -> Point {
        if row > 0 && row == self.end { self.last } else { self.anchors.get(row / SPAN) }
    }
}

/// The target of the last anchor, which may lie up to 15 rows beyond the samples: on a line.
#[inline(always)]
fn ahead(samples: &[Position], beyond: usize) -> Point {
    let point = |back: usize| {
        let [x, y, z] = samples[samples.len() - 1 - back];
        [x, y, z, 0.0]
    };
    let last = point(0);
    let window = (samples.len() - 1).min(4);
    if beyond == 0 || window == 0 {
        return last;
    }
    let before = point(window);
    let factor = (beyond as f32 / window as f32).min(4.0);
    walk::lanes(|i| last[i] + (last[i] - before[i]) * factor)
}
