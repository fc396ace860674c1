//! Time lines there and back.

use super::{Causes, RowTime, Timeline};

fn jittered(n: u64, listed: bool) -> Timeline {
    let mut timeline = Timeline::default();
    timeline.restart(1000);
    for i in 0..n {
        if i % 7 == 3 {
            timeline.push_lost(i, Causes::NOT_RECEIVED);
            timeline.push_lost(2, Causes::RING_FULL);
        }
        let ticks = 5_000 + timeline.n_rows() * 1_000 + u64::from(listed) * (i * i % 5);
        let arrival_10us = 77 + ticks / 10 + i * 37 % 11;
        timeline.push(RowTime { device_ticks: ticks, arrival_10us, timecode: None });
    }
    timeline
}

#[test]
fn comes_back_and_every_cut_is_seen() {
    for (n, listed) in [(0, false), (1, false), (2, true), (50, false), (50, true)] {
        let timeline = jittered(n, listed);
        let mut out = Vec::new();
        timeline.encode(1_000_000, 1_000.0, &mut out);
        assert_eq!(Timeline::decode(&out, 1_000_000, 0).unwrap(), timeline, "{n} {listed}");
        for cut in 0..out.len() {
            assert!(Timeline::decode(&out[..cut], 1_000_000, 0).is_err(), "{n} {cut}");
        }
    }
}

#[test]
fn wild_clocks_come_back() {
    let mut timeline = Timeline::default();
    timeline.restart(u64::MAX - 10);
    for (device_ticks, arrival_10us) in [(u64::MAX, 5), (0, u64::MAX), (1 << 63, 0), (3, 9)] {
        timeline.push(RowTime { device_ticks, arrival_10us, timecode: Some([1, 2, 3, 4]) });
    }
    let mut out = Vec::new();
    timeline.encode(u64::MAX, 0.001, &mut out);
    assert_eq!(Timeline::decode(&out, u64::MAX, 0).unwrap(), timeline);
}

#[test]
fn a_quiet_second_is_small() {
    let mut timeline = Timeline::default();
    for i in 0..60_u64 {
        timeline.push(RowTime {
            device_ticks: i * 1000,
            arrival_10us: i * 100_000 / 60,
            timecode: None,
        });
    }
    let mut out = Vec::new();
    timeline.encode(60_000, 60.0, &mut out);
    assert!(out.len() < 12, "{}", out.len());
}

#[test]
fn mutations_never_panic() {
    let mut out = Vec::new();
    jittered(30, true).encode(1_000_000, 1_000.0, &mut out);
    for at in 0..out.len() {
        for value in 0..=255 {
            let mut damaged = out.clone();
            damaged[at] = value;
            drop(Timeline::decode(&damaged, 1_000_000, 0));
        }
    }
}
