//! The line through all observations: which round trips of a burst count depends on the rate, and the rate on these.

use mocapd_take::record::ClockPoint;

use super::{
    fit::{Line, fit},
    probes::Bursts,
};

/// Rounds at most. Two are mostly enough, because a rate hardly changes; where few round trips were held up, the choice
/// can go on between two or three.
const ROUNDS_MAX: usize = 8;

/// A rate that is so near is the same: within a burst of half a second it is 0.005 us.
const SAME_PPM: f64 = 0.01;

/// The line through the best round trips at the rate `from_ppm`, then through the best ones at its own rate, and so on
/// until these are the same: the last one is the line. From its rate on, the same lines come again: so it can be found
/// from what a take stores.
pub(super) fn lines(
    points: &[ClockPoint],
    bursts: &Bursts,
    from_ppm: f64,
    tick_hz: f64,
) -> impl Iterator<Item = Line> {
    let mut next = Some((from_ppm, bursts.best(from_ppm, tick_hz)));
    (0..ROUNDS_MAX).map_while(move |_| {
        let (ppm, best) = next.take()?;
        let (line, _) = fit(points, best.all(), tick_hz)?;
        let better = bursts.best(line.drift_ppm, tick_hz);
        let is_same = (line.drift_ppm - ppm).abs() < SAME_PPM && better.are_of(&best);
        next = (!is_same).then_some((line.drift_ppm, better));
        Some(line)
    })
}
