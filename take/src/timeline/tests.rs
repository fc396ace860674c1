//! Round trips of time lines with arbitrary clocks.

use proptest::prelude::{Just, Strategy, any, prop, prop_oneof, proptest};

use super::{LossCauses, RowTime, Timeline, TimelineDecoder, TimelineEncoder, take_times};
use crate::varint::Cursor;

/// The rows of one stretch.
#[derive(Debug, Clone)]
struct TestRows {
    key: bool,
    lost_before: Vec<u64>,
    lost_within: bool,
    times: Vec<RowTime>,
}

/// Steady or jumping clocks, arrivals in order or not, timecodes present or not.
fn time() -> impl Strategy<Value = RowTime> {
    let ticks = prop_oneof![4 => 0..2_000_000_u64, 1 => any::<u64>()];
    let arrival = prop_oneof![4 => 0..100_000_u64, 1 => any::<u64>()];
    let timecode = prop_oneof![3 => Just(None), 1 => any::<Option<[u8; 4]>>()];
    (ticks, arrival, timecode).prop_map(|(device_ticks, arrival_10us, timecode)| RowTime {
        device_ticks,
        arrival_10us,
        timecode,
    })
}

fn part() -> impl Strategy<Value = TestRows> {
    let lost_before = prop::collection::vec(0..1_000_u64, 0..4);
    let times = prop::collection::vec(time(), 0..40);
    (any::<bool>(), lost_before, any::<bool>(), times).prop_map(
        |(key, lost_before, lost_within, times)| TestRows { key, lost_before, lost_within, times },
    )
}

fn timeline(first_row: u64, part: &TestRows) -> Timeline {
    let mut timeline = Timeline::default();
    timeline.restart(first_row);
    for (i, &rows) in part.lost_before.iter().enumerate() {
        timeline.push_lost(
            rows,
            if i % 2 == 0 { LossCauses::NOT_RECEIVED } else { LossCauses::RING_FULL },
        );
    }
    for (i, &time) in part.times.iter().enumerate() {
        timeline.push(time);
        timeline.push_lost(u64::from(part.lost_within && i % 11 == 5), LossCauses::NOT_RECEIVED);
    }
    timeline
}

/// Encodes and decodes consecutive stretches; returns the bytes.
fn round_trip(parts: &[TestRows], tick_hz: u64, rate_hz: f64) -> Vec<Vec<u8>> {
    let mut encoder = TimelineEncoder::new(tick_hz, rate_hz);
    let mut decoder = TimelineDecoder::new(tick_hz);
    let half_step = (1 << encoder.shift) / 2;
    let mut coded = Vec::new();
    let mut row = 0;
    let mut decoded_key = false;
    for part in parts {
        let wanted = timeline(row, part);
        row += wanted.n_rows();
        let mut bytes = Vec::new();
        encoder.encode(&wanted, part.key, &mut bytes);
        let mut found = Timeline { times: Vec::new(), ..wanted.clone() };
        if wanted.times.is_empty() {
            assert!(bytes.is_empty());
        } else {
            let mut cursor = Cursor::new(&bytes);
            assert_eq!(take_times(&mut cursor, part.key), Some(&bytes[..]));
        }
        decoder.decode(&mut found, part.key, &bytes).unwrap();
        decoded_key = if part.key { !part.times.is_empty() } else { decoded_key };
        assert_eq!(found.runs, wanted.runs);
        for (found, wanted) in found.times.iter().zip(&wanted.times) {
            assert_eq!(found.device_ticks, wanted.device_ticks);
            assert_eq!(found.timecode, wanted.timecode);
            let off = found.arrival_10us.wrapping_sub(wanted.arrival_10us).cast_signed();
            let most = if decoded_key { half_step } else { 0 };
            assert!(off.unsigned_abs() <= most, "{found:?} {wanted:?}");
        }
        coded.push(bytes);
    }
    coded
}

proptest! {
    #[test]
    fn time_lines_round_trip(
        parts in prop::collection::vec(part(), 1..6),
        tick_hz in prop_oneof![Just(0), Just(1), Just(1_000_000_000), Just(u64::MAX), any::<u64>()],
        rate_hz in prop_oneof![Just(60.0), Just(239.76), Just(0.001), Just(1e6)],
    ) {
        round_trip(&parts, tick_hz, rate_hz);
    }

    #[test]
    fn any_bytes_are_times_or_none(
        bytes in prop::collection::vec(any::<u8>(), 0..80),
        key in any::<bool>(),
        n in 0..200_u64,
    ) {
        let mut decoder = TimelineDecoder::new(1_000_000);
        let mut timeline = Timeline::default();
        timeline.extend_run(n, None);
        if decoder.decode(&mut timeline, key, &bytes).is_some() {
            assert_eq!(timeline.times.len() as u64, n);
        }
    }
}

/// Stretches of half a second with keys every ten seconds; arrivals are late by `late_10us`.
fn steady(tick_hz: u64, rate_hz: f64, late_10us: impl Fn(u64) -> u64) -> Vec<TestRows> {
    let rows = (rate_hz / 2.0) as u64;
    let time = |row: u64| {
        // The counter started before the recording.
        let seconds = (row + 12_345) as f64 / rate_hz;
        RowTime {
            device_ticks: (seconds * tick_hz as f64).round() as u64,
            arrival_10us: 77_777_777 + (row as f64 / rate_hz * 1e5) as u64 + late_10us(row),
            timecode: None,
        }
    };
    let part = |i: u64| TestRows {
        key: i.is_multiple_of(20),
        lost_before: Vec::new(),
        lost_within: false,
        times: (i * rows..(i + 1) * rows).map(time).collect(),
    };
    (0..40).map(part).collect()
}

#[test]
fn a_steady_clock_of_any_period_costs_nothing() {
    for (tick_hz, rate_hz) in [
        (1_000_000, 60.0),
        (1_000_000, 240.0),
        (10_000_000, 60_000.0 / 1001.0),
        (240, 240.0),
        (1_000_000_000, 1000.0),
        (90_000, 120_000.0 / 1001.0),
    ] {
        let parts = steady(tick_hz, rate_hz, |_| 3);
        for (part, bytes) in parts.iter().zip(round_trip(&parts, tick_hz, rate_hz)) {
            // A key stretch states its clocks; the first rows locate the exposure between two ticks.
            let most = if part.key { 28 } else { 3 };
            assert!(bytes.len() <= most, "{tick_hz} at {rate_hz}: {} bytes", bytes.len());
        }
    }
}

#[test]
fn a_rate_that_differs_from_the_stated_one_is_measured() {
    // A divider that cannot produce 240 Hz: 4167 ticks per row, so the clock runs 80 ppm fast.
    let parts = steady(1_000_080, 240.0, |_| 3);
    for (part, bytes) in parts.iter().zip(round_trip(&parts, 1_000_000, 240.0)) {
        assert!(part.key || bytes.len() <= 6, "{} bytes", bytes.len());
    }
}

#[test]
fn batches_cost_little() {
    // Frames arrive in batches of four.
    let parts = steady(1_000_000, 240.0, |row| (3 - row % 4) * 417);
    let coded = round_trip(&parts, 1_000_000, 240.0);
    let bytes: usize = coded.iter().map(Vec::len).sum();
    assert!(bytes / coded.len() < 10, "{} bytes a stretch", bytes / coded.len());
}

#[test]
fn timecodes_that_count_cost_nothing() {
    let mut parts = steady(1_000_000, 120.0, |_| 3);
    for (row, time) in (0..).zip(parts.iter_mut().flat_map(|part| &mut part.times)) {
        let frame = 86_390 * 25 + row * 25 / 120;
        let (seconds, frames) = (frame / 25 % 86_400, frame % 25);
        let timecode = [seconds / 3600, seconds / 60 % 60, seconds % 60, frames];
        time.timecode = Some(timecode.map(|part: u64| part as u8));
    }
    let coded = round_trip(&parts, 1_000_000, 120.0);
    let bytes: usize = coded.iter().map(Vec::len).sum();
    assert!(bytes / coded.len() < 12, "{} bytes a stretch", bytes / coded.len());
}

#[test]
fn every_cut_and_every_mutation_gives_an_error_or_times() {
    let parts = steady(1_000_000, 240.0, |row| row * 37 % 23);
    let coded = round_trip(&parts[..1], 1_000_000, 240.0);
    let whole = timeline(0, &parts[0]);
    let decode = |bytes: &[u8]| {
        let mut found = Timeline { times: Vec::new(), ..whole.clone() };
        TimelineDecoder::new(1_000_000).decode(&mut found, true, bytes)
    };
    for cut in 0..coded[0].len() {
        assert!(decode(&coded[0][..cut]).is_none(), "{cut}");
    }
    for at in 0..coded[0].len() {
        for value in 0..=255 {
            let mut damaged = coded[0].clone();
            damaged[at] = value;
            decode(&damaged);
        }
    }
}
