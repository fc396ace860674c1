//! The same motion at every rate: the codec knows rows, not rates, and the bound holds at all rates.

use mocapd_codec::Position;

use super::{
    Channel,
    hard::{KINDS, TOLERANCES_MM, seen_where, stream},
};

/// `n_rows` rows of one motion at a rate; the third channel has many gaps.
fn at_rate(rate_hz: u32, n_rows: usize) -> Vec<Channel> {
    let path = |phase: f64| -> Vec<Position> {
        let at = |row: usize| {
            let t = row as f64 / f64::from(rate_hz) + phase;
            [350.0 * (4.0 * t).sin(), 1100.0 + 60.0 * (23.0 * t).cos(), 700.0 * t].map(|v| v as f32)
        };
        (0..n_rows).map(at).collect()
    };
    let seen = |phase| Channel { positions: path(phase), present: vec![true; n_rows] };
    let flicker = |row: usize| (row as u64 * 7 / u64::from(rate_hz)) % 3 != 1 && row % 11 != 5;
    vec![seen(0.0), seen(0.3), seen_where(seen(1.1), flicker)]
}

/// All rates, with few rows each: prediction alone depends on the rate.
#[test]
fn every_rate_from_1_to_10000_hz() {
    for rate_hz in 1..=10_000 {
        let kind = KINDS[rate_hz as usize % KINDS.len()];
        let tolerance_mm = TOLERANCES_MM[rate_hz as usize / KINDS.len() % TOLERANCES_MM.len()];
        stream(kind, tolerance_mm, &at_rate(rate_hz, 16), &[9, 1, 6], 0b100);
    }
}

/// The rates of devices, in the half-second stretches of a recording.
#[test]
fn usual_rates_in_whole_stretches() {
    for rate_hz in [1, 2, 15, 24, 25, 30, 50, 60, 100, 120, 200, 240, 333, 500, 1000, 2000, 10_000]
    {
        for kind in KINDS {
            let half_a_second = (rate_hz as usize).div_ceil(2);
            let lengths = [half_a_second.div_ceil(5), half_a_second, half_a_second];
            stream(kind, 0.5, &at_rate(rate_hz, lengths.iter().sum()), &lengths, 0b100);
        }
    }
}
