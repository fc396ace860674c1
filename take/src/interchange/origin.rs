//! Samples exactly at the origin: some software writes `0 0 0` for an occluded marker.

use crate::motion::{Ambiguity, Notes, Position, is_gap};

/// The origin.
pub(super) const ORIGIN: Position = [0.0; 3];
/// Written instead of the origin in formats where `0 0 0` means, or may mean, a missing sample: one nanometre off.
const NEAR_ORIGIN: Position = [1e-6, 0.0, 0.0];
/// A marker whose neighbouring sample is within this many of its median steps from the origin passes through the
/// origin.
pub(super) const STEPS: f64 = 10.0;

/// The position to write in a format where `0 0 0` may mean a missing sample.
pub(super) fn off_origin(position: Position) -> Position {
    if position == ORIGIN { NEAR_ORIGIN } else { position }
}

/// Finds the samples at the origin, row by row.
///
/// A marker's samples at the origin are missing ones, rather than positions, if it is there for two frames or more, or
/// if it is far away before and after. "Far away" is relative to the median of its steps. Only a comparison with the
/// median is needed, so a second pass over the rows counts the shorter and the longer steps instead of sorting them.
#[derive(Debug)]
pub(super) struct OriginScan {
    markers: Vec<MarkerScan>,
    n_present: u64,
    n_at_origin: u64,
}

/// What is known of a marker.
#[derive(Debug, Clone, Copy, Default)]
struct MarkerScan {
    /// Its first position other than the origin.
    first: Option<Position>,
    /// Whether it has another one.
    moves: bool,
    last: Option<Position>,
    /// Number of its last samples that are all at the origin.
    run: u64,
    /// Distance from the origin of its sample before that run.
    before: Option<f64>,
    is_long: bool,
    /// The largest distance of a single sample at the origin to the nearer one of its neighbours; infinite if it
    /// has none.
    farthest_single: Option<f64>,
    last_of_steps: Option<Position>,
    n_steps: u64,
    /// Steps so short that the farthest single sample is not within the marker's path.
    n_short_steps: u64,
}

impl OriginScan {
    pub(super) fn new(n_markers: usize) -> Self {
        Self { markers: vec![MarkerScan::default(); n_markers], n_present: 0, n_at_origin: 0 }
    }

    /// Adds the positions of the next frame.
    pub(super) fn add_row(&mut self, row: &[Position]) {
        for (marker, &at) in self.markers.iter_mut().zip(row).filter(|(_, at)| !is_gap(**at)) {
            self.n_present += 1;
            self.n_at_origin += u64::from(at == ORIGIN);
            marker.add(at);
        }
    }

    /// The markers whose samples at the origin may be missing ones: another marker moves, or the only marker does.
    pub(super) fn suspects(&self) -> impl Iterator<Item = usize> {
        let n_moving = self.markers.iter().filter(|marker| marker.moves).count();
        let is_single = self.markers.len() == 1;
        let markers = self.markers.iter().enumerate();
        markers.filter_map(move |(index, marker)| {
            let others_move = n_moving > usize::from(marker.moves);
            let is_suspect = others_move || (is_single && marker.moves);
            (is_suspect && marker.is_at_origin()).then_some(index)
        })
    }

    /// Whether a marker has a single sample at the origin.
    pub(super) fn has_single(&self, marker: usize) -> bool {
        self.markers.get(marker).is_some_and(|marker| marker.farthest().is_some())
    }

    /// Whether [`note`](Self::note) depends on steps, for which all rows must be [added again](Self::add_steps).
    pub(super) fn needs_steps(&self) -> bool {
        let mut suspects = self.suspects().peekable();
        suspects.peek().is_some() && !suspects.any(|marker| self.markers[marker].is_long)
    }

    /// Adds the positions of the next frame once more.
    pub(super) fn add_steps(&mut self, row: &[Position]) {
        for (marker, &at) in self.markers.iter_mut().zip(row).filter(|(_, at)| !is_gap(**at)) {
            marker.add_step(at);
        }
    }

    /// Notes the samples at the origin.
    pub(super) fn note(&self, notes: &mut Notes) {
        let (samples, n_present) = (self.n_at_origin, self.n_present);
        if samples == 0 {
            return;
        }
        if self.suspects().any(|marker| self.markers[marker].has_missing()) {
            notes.ambiguous(Ambiguity::Origin { samples, gaps: false });
        } else {
            notes.warnings.push(format!(
                "At the origin and not marked as missing, kept as positions: {samples} of {n_present} samples."
            ));
        }
    }
}

impl MarkerScan {
    fn is_at_origin(&self) -> bool {
        self.run > 0 || self.is_long || self.farthest_single.is_some()
    }

    #[inline]
    fn add(&mut self, at: Position) {
        if self.moves && self.run == 0 && at != ORIGIN {
            // Nearly all samples.
            self.last = Some(at);
        } else if at == ORIGIN {
            if self.run == 0 {
                self.before = self.last.map(|last| distance(last, ORIGIN));
            }
            self.run += 1;
            self.is_long |= self.run > 1;
        } else {
            if self.run > 0 {
                self.end_run(Some(distance(at, ORIGIN)));
            }
            match self.first {
                None => self.first = Some(at),
                Some(first) => self.moves |= at != first,
            }
        }
        self.last = Some(at);
    }

    /// Ends a run at the origin. The sample after it is at the distance `after`.
    fn end_run(&mut self, after: Option<f64>) {
        if self.run == 1 {
            let nearer = [self.before, after].into_iter().flatten().fold(f64::INFINITY, f64::min);
            let before = self.farthest_single.unwrap_or(0.0);
            self.farthest_single = Some(nearer.max(before));
        }
        self.run = 0;
    }

    /// The largest distance of a single sample at the origin to the nearer one of its neighbours.
    fn farthest(&self) -> Option<f64> {
        let mut ended = *self;
        ended.end_run(None);
        ended.farthest_single
    }

    fn add_step(&mut self, at: Position) {
        let before = self.last_of_steps.replace(at);
        if let (Some(before), Some(farthest)) = (before.filter(|&at| at != ORIGIN), self.farthest())
            && at != ORIGIN
        {
            self.n_steps += 1;
            self.n_short_steps += u64::from(farthest > STEPS * distance(before, at));
        }
    }

    /// Whether some of its samples at the origin are missing ones: the same as `OriginGaps` finds.
    fn has_missing(&self) -> bool {
        // The (upper) median is too short if more than half of the steps are too short.
        let median_is_short = self.n_steps == 0 || self.n_short_steps > self.n_steps / 2;
        self.is_long || self.farthest().is_some_and(|farthest| farthest > 0.0 && median_is_short)
    }
}

/// The distance of two positions in millimetres.
pub(super) fn distance(a: Position, b: Position) -> f64 {
    let squares = a.iter().zip(b).map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2));
    squares.sum::<f64>().sqrt()
}
