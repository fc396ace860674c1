//! What thirty frames a second tell of a marker: how still it can be, and whether it changed places with another.

use mocapd_take::motion::{Position, is_gap};

use super::Inner;
use crate::{pipeline::lock, service::status::MarkerQuality};

/// Stillness is judged over so long.
const WINDOW_NS: u64 = 1_000_000_000;

/// Frames that a window must have: a marker that flickers is not still.
const WINDOW_FRAMES_MIN: u32 = 20;

/// What moves further than this within a window is not still, in millimetres: a swaying body moves some.
const STILL_MM: f64 = 5.0;

/// A marker that is where another was a frame ago, as near as this, in millimetres: what it moved in a thirtieth of a
/// second at a walk.
const SWAPPED_MM: f64 = 40.0;

/// And was so far from it then, in millimetres: nearer, nobody could tell.
const APART_MM: f64 = 120.0;

/// By slot.
#[derive(Debug, Default)]
pub(super) struct Judgements {
    rate_hz: f64,
    markers: Vec<Judged>,
    before: Vec<Position>,
    window_ns: u64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Judged {
    n: u32,
    mean: [f64; 3],
    squares: f64,
    first: Position,
    moved: bool,
    still_sigma_mm: Option<f64>,
    swaps: u64,
}

impl Judgements {
    pub(super) fn new(rate_hz: f64) -> Self {
        Self { rate_hz, ..Self::default() }
    }

    /// A frame that was shown.
    pub(super) fn frame(&mut self, arrival_ns: u64, positions: &[Position]) {
        self.markers.resize(positions.len(), Judged::default());
        if arrival_ns.saturating_sub(self.window_ns) >= WINDOW_NS {
            self.window_ns = arrival_ns;
            self.markers.iter_mut().for_each(Judged::end_window);
        }
        for (marker, &position) in self.markers.iter_mut().zip(positions) {
            marker.add(position);
        }
        self.find_swaps(positions);
        self.before.clear();
        self.before.extend_from_slice(positions);
    }

    /// Two that are each where the other was.
    fn find_swaps(&mut self, positions: &[Position]) {
        if self.before.len() != positions.len() {
            return;
        }
        for (slot, &now) in positions.iter().enumerate() {
            let was = self.before[slot];
            // Most markers end here: they moved little.
            if is_gap(now) || is_gap(was) || apart_mm(now, was) < APART_MM {
                continue;
            }
            let other = (0..positions.len()).find(|&other| {
                other != slot
                    && apart_mm(now, self.before[other]) < SWAPPED_MM
                    && (is_gap(positions[other]) || apart_mm(positions[other], was) < SWAPPED_MM)
            });
            self.markers[slot].swaps += u64::from(other.is_some());
        }
    }
}

impl Judged {
    fn add(&mut self, position: Position) {
        if is_gap(position) {
            return;
        }
        if self.n == 0 {
            self.first = position;
        }
        self.n += 1;
        self.moved |= apart_mm(position, self.first) > STILL_MM;
        for (mean, value) in self.mean.iter_mut().zip(position) {
            let off = f64::from(value) - *mean;
            *mean += off / f64::from(self.n);
            self.squares += off * (f64::from(value) - *mean);
        }
    }

    fn end_window(&mut self) {
        if self.n >= WINDOW_FRAMES_MIN && !self.moved {
            let sigma_mm = (self.squares / f64::from(self.n - 1)).sqrt();
            self.still_sigma_mm =
                Some(self.still_sigma_mm.map_or(sigma_mm, |least| least.min(sigma_mm)));
        }
        let (still_sigma_mm, swaps) = (self.still_sigma_mm, self.swaps);
        *self = Self { still_sigma_mm, swaps, ..Self::default() };
    }
}

/// Infinite where one of them is not seen.
fn apart_mm(a: Position, b: Position) -> f64 {
    let squares = a.iter().zip(b).map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2));
    let apart = squares.sum::<f64>().sqrt();
    if apart.is_nan() { f64::INFINITY } else { apart }
}

impl Inner {
    pub(super) fn quality(&self) -> Vec<MarkerQuality> {
        let core = self.core();
        let Some(session) = &core.session else { return Vec::new() };
        let (progress, seen) = (session.progress.clone(), session.seen.clone());
        drop(core);
        let channels = lock(&progress.channels).clone();
        let judgements = lock(&self.judgements);
        let of_slot = |(slot, channel): (usize, mocapd_take::record::Channel)| {
            let seen = seen.get(slot).unwrap_or_default();
            let judged = judgements.markers.get(slot).copied().unwrap_or_default();
            MarkerQuality {
                label: channel.label,
                labelled: channel.labelled,
                visible: seen.present as f64 / seen.rows.max(1) as f64,
                gaps: seen.gaps,
                longest_gap_s: seen.longest_gap as f64 / judgements.rate_hz.max(1e-3),
                still_sigma_mm: judged.still_sigma_mm,
                swaps_suspected: judged.swaps,
            }
        };
        channels.into_iter().enumerate().map(of_slot).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of three seconds at 30 Hz.
    fn judged(position: impl Fn(usize) -> Vec<Position>) -> Vec<Judged> {
        let mut judgements = Judgements::new(100.0);
        for frame in 0..90 {
            judgements.frame(1_000_000_000 + frame as u64 * 33_000_000, &position(frame));
        }
        judgements.markers
    }

    #[test]
    fn noise_is_measured_where_a_marker_is_still() {
        let noise = |frame: usize| if frame.is_multiple_of(2) { 0.1 } else { -0.1 };
        let markers = judged(|frame| {
            let moving = frame as f32 * 3.0;
            vec![[noise(frame), 5.0, 7.0], [moving, 0.0, 0.0], [f32::NAN; 3]]
        });
        let sigma_mm = markers[0].still_sigma_mm.unwrap();
        assert!((0.09..0.12).contains(&sigma_mm), "{sigma_mm}");
        assert_eq!((markers[1].still_sigma_mm, markers[2].still_sigma_mm), (None, None));
        assert!(markers.iter().all(|marker| marker.swaps == 0));
    }

    #[test]
    fn two_that_change_places_are_suspected_and_fast_ones_are_not() {
        let markers = judged(|frame| {
            let (a, b) = ([0.0, frame as f32, 0.0], [400.0, 0.0, frame as f32]);
            let fast = [frame as f32 * 150.0, 2000.0, 0.0];
            if frame < 40 { vec![a, b, fast] } else { vec![b, a, fast] }
        });
        let swaps: Vec<_> = markers.iter().map(|marker| marker.swaps).collect();
        assert_eq!(swaps, [1, 1, 0]);
    }
}
