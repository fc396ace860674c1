//! Where a run may have come from.
//!
//! Its own channel's last sample, moved as the nearest marker moved since; the last samples of other
//! channels whose runs have ended and not been taken up: unlabelled markers change channels; or, at
//! worst, where another marker is.

use super::{
    lattice::Point,
    layout as is,
    layout::CANDIDATES,
    model::Model,
    track::{MEMORY, Track},
};
use crate::coding::range::BinaryCoder;

/// Rows after which the end of another channel's run is forgotten.
const FORGOTTEN_ROWS: u64 = 200;

/// Candidates for a first row: the nearby one (always there) first, then the own, then the ends.
#[derive(Debug)]
pub(super) struct Ways {
    points: [Point; CANDIDATES + 2],
    n: usize,
    own: Option<u64>,
    ends: [usize; CANDIDATES],
    n_ends: usize,
}

impl Ways {
    pub(super) fn find(
        tracks: &[Track],
        channel: usize,
        at: usize,
        first_row: u64,
        present: &[Option<&[bool]>],
    ) -> Self {
        let mut found = Self {
            points: [[0; 3]; CANDIDATES + 2],
            n: 1,
            own: None,
            ends: [0; CANDIDATES],
            n_ends: 0,
        };
        if let Some(before) = tracks[..channel].iter().rev().find(|track| track.known[at]) {
            found.points[0] = before.point(at);
        }
        let now = first_row + (at - MEMORY) as u64;
        if let Some(end) = tracks[channel].end {
            found.points[1] = moved(tracks, channel, at, end.point, now - end.row);
            found.n = 2;
            found.own = Some(now - end.row);
        }
        found.find_ends(tracks, channel, (now, first_row), present);
        for i in 0..found.n_ends {
            found.points[found.n] = tracks[found.ends[i]].end.map_or([0; 3], |end| end.point);
            found.n += 1;
        }
        found
    }

    /// The latest first; of equals the one of the lower channel.
    fn find_ends(
        &mut self,
        tracks: &[Track],
        channel: usize,
        (now, first_row): (u64, u64),
        present: &[Option<&[bool]>],
    ) {
        let mut rows = [0; CANDIDATES];
        for (k, track) in tracks.iter().enumerate().take(present.len()) {
            let Some(end) = track.end.filter(|_| k != channel) else { continue };
            let goes_on = (end.row + 1).checked_sub(first_row).is_some_and(|next| {
                present[k].is_some_and(|present| present.get(next as usize).is_some_and(|&p| p))
            });
            if end.taken || goes_on || end.row >= now || end.row + FORGOTTEN_ROWS <= now {
                continue;
            }
            let place = (0..self.n_ends).find(|&i| end.row > rows[i]).unwrap_or(self.n_ends);
            if place == CANDIDATES {
                continue;
            }
            self.n_ends = (self.n_ends + 1).min(CANDIDATES);
            rows[place..self.n_ends].rotate_right(1);
            self.ends[place..self.n_ends].rotate_right(1);
            (rows[place], self.ends[place]) = (end.row, k);
        }
    }

    pub(super) fn points(&self) -> &[Point] {
        &self.points[..self.n]
    }

    /// Codes which of the candidates it is.
    pub(super) fn code(
        &self,
        coder: &mut impl BinaryCoder,
        model: &mut Model,
        choice: usize,
    ) -> usize {
        let first_end = self.n - self.n_ends;
        if let Some(age) = self.own {
            let class = age.max(1).ilog2().min(7) as usize;
            if model.single(coder, is::ORIGIN_OWN.at(class), choice == 1) {
                return 1;
            }
        }
        if self.n_ends == 0 || model.single(coder, is::ORIGIN_NONE.at(0), choice == 0) {
            return 0;
        }
        let rank = (0..self.n_ends - 1).find(|&rank| {
            model.single(coder, is::ORIGIN_RANK.at(rank), choice == first_end + rank)
        });
        first_end + rank.unwrap_or(self.n_ends - 1)
    }

    /// The contexts of the residual: nearby, own, or an end.
    pub(super) fn class(&self, choice: usize) -> usize {
        match (choice, self.own) {
            (0, _) => 0,
            (1, Some(_)) => 1,
            _ => 2,
        }
    }

    /// The channel whose end is taken up.
    pub(super) fn taken(&self, choice: usize) -> Option<usize> {
        let first_end = self.n - self.n_ends;
        self.ends[..self.n_ends].get(choice.checked_sub(first_end)?).copied()
    }
}

/// A point of `rows` rows ago, moved as its nearest neighbour of then has moved since.
fn moved(tracks: &[Track], channel: usize, at: usize, point: Point, rows: u64) -> Point {
    let Some(then) = usize::try_from(rows).ok().and_then(|rows| at.checked_sub(rows)) else {
        return point;
    };
    let mut best = (f64::INFINITY, point);
    for (k, track) in tracks.iter().enumerate() {
        if k == channel || !track.known[at] || !track.known[then] {
            continue;
        }
        let (old, new) = (track.point(then), track.point(at));
        let square = |axis: usize| {
            let off = old[axis].wrapping_sub(point[axis]) as f64;
            off * off
        };
        let squares = square(0) + square(1) + square(2);
        if squares < best.0 {
            let axes = |axis: usize| point[axis].wrapping_add(new[axis]).wrapping_sub(old[axis]);
            best = (squares, std::array::from_fn(axes));
        }
    }
    best.1
}
