//! `SAMPLE_TIMES`: round trips, damage, and the clock that it gives.

use super::super::*;
use crate::timeline::LossCauses;

fn anchor(number: u64, run_start: u64, device_ticks: u64) -> SampleAnchor {
    SampleAnchor { number, run_start, device_ticks, segment: run_start as u32 }
}

fn seconds(clock: &SampleClock<'_>, number: u64) -> Option<f64> {
    let time = clock.at(number)?;
    Some((time.device_ticks as f64 + time.fraction) / 1000.0)
}

#[test]
fn a_chunk_round_trips_and_every_cut_is_an_error() {
    for found in [anchor(0, 0, 0), anchor(900, 300, u64::MAX), anchor(SAMPLES_MAX, 7, 5)] {
        let mut payload = Vec::new();
        SampleTimes::put(3, &found, None, &mut payload);
        let times = SampleTimes::from_payload(&payload, 0).unwrap();
        assert_eq!(times, SampleTimes { group: 3, anchors: vec![found] });
        for cut in 0..payload.len() {
            assert!(SampleTimes::from_payload(&payload[..cut], 0).is_err(), "{cut}");
        }
        payload[0] = 2;
        let later = SampleTimes::from_payload(&payload, 0);
        assert!(matches!(later, Err(TakeError::Unsupported { .. })));
    }
}

#[test]
fn a_chunk_with_several_anchors_is_read_as_documented() {
    let mut payload = Vec::new();
    // 5 samples and 49 ticks later, and 1 sample later at 10 ticks before that.
    SampleTimes::put(0, &anchor(10, 10, 1000), Some((15, 1049)), &mut payload);
    payload.extend([1, 19]);
    let times = SampleTimes::from_payload(&payload, 0).unwrap();
    let expected = [anchor(10, 10, 1000), anchor(15, 10, 1049), anchor(16, 10, 1039)];
    assert_eq!(times.anchors, expected);
    let mut documented = Vec::new();
    SampleTimes::put(0, &anchor(40, 0, 20_000), Some((60, 30_010)), &mut documented);
    let text = include_str!("../../../../docs/take-format.md");
    let (_, example) = text.split_once("A SAMPLE_TIMES of group 0").unwrap();
    let lines = example.lines().skip(2).map_while(|line| line.strip_prefix("    "));
    let words = lines.flat_map(|line| line.split("  ").next().unwrap().split_whitespace());
    let bytes: Vec<u8> = words.map(|word| u8::from_str_radix(word, 16).unwrap()).collect();
    assert_eq!(documented, bytes);
    payload.extend([0, 2]);
    assert!(SampleTimes::from_payload(&payload, 0).is_err(), "the same sample again");
}

/// 100 Hz by a clock of 1000 Hz that runs 1 % fast from the second anchor on; then the clock jumps back, and the third
/// run is too short to measure the rate.
#[test]
fn times_lie_on_the_lines_between_anchors_and_jump_between_runs() {
    let anchors = [
        anchor(0, 0, 5000),
        anchor(1000, 0, 15_000),
        anchor(2000, 0, 25_100),
        anchor(2500, 2500, 100),
        anchor(2550, 2500, 700),
    ];
    let clock = SampleClock::new(&anchors, &[], 100.0, 1000);
    let at = |number| seconds(&clock, number).unwrap();
    assert_eq!([at(0), at(500), at(1000)], [5.0, 10.0, 15.0]);
    assert!((at(1500) - 20.05).abs() < 1e-9);
    // Behind the last anchor of a run, over all of which a sample took 10.05 ticks.
    assert!((at(2400) - (25.1 + 400.0 * 0.010_05)).abs() < 1e-9);
    assert_eq!([at(2500), at(2525), at(2550), at(2560)], [0.1, 0.4, 0.7, 0.8]);
    assert_eq!(clock.at(2499).unwrap().segment, 0);
    assert_eq!(clock.at(2500).unwrap().segment, 2500);
}

#[test]
fn a_lost_anchor_never_joins_two_runs() {
    // The anchor of sample 250, which begins the second run, is lost.
    let anchors = [anchor(0, 0, 5000), anchor(100, 0, 6000), anchor(300, 250, 600)];
    let clock = SampleClock::new(&anchors, &[], 100.0, 1000);
    assert_eq!(seconds(&clock, 249), Some(7.49));
    assert_eq!(seconds(&clock, 250), Some(0.1));
    let clock = SampleClock::new(&anchors[2..], &[], 100.0, 1000);
    assert_eq!((seconds(&clock, 249), seconds(&clock, 250)), (None, Some(0.1)));
}

#[test]
fn a_block_without_its_anchors_has_times_only_where_others_show_its_run() {
    let chunk = |(first, n, content)| SamplesChunk {
        span: SampleSpan { group: 0, first, n, content },
        offset: 0,
        block_at: 0,
        block_bytes: 0,
    };
    let lost = SampleContent::Lost(LossCauses::NOT_RECEIVED);
    let chunks = [
        (0, 100, SampleContent::Key),
        // Its anchors are lost; the ones before and behind it are of one run.
        (100, 100, SampleContent::Key),
        (200, 100, SampleContent::Key),
        (300, 50, lost),
        // Its anchors are lost, and with them where the next run begins.
        (350, 50, SampleContent::Key),
        (400, 100, SampleContent::Key),
        (500, 100, SampleContent::Key),
    ]
    .map(chunk);
    let anchors = [anchor(0, 0, 0), anchor(200, 0, 2000), anchor(400, 380, 90_000)];
    let clock = SampleClock::new(&anchors, &chunks, 100.0, 1000);
    let runs = [150, 299, 320, 350, 379, 380, 499, 500].map(|number| clock.at(number));
    let runs = runs.map(|time| time.map(|time| time.run_start));
    let expected = [Some(0), Some(0), Some(0), None, None, Some(380), Some(380), None];
    assert_eq!(runs, expected);
    assert_eq!((seconds(&clock, 150), seconds(&clock, 380)), (Some(1.5), Some(89.8)));
}
