//! What a take stores about the clocks.

use mocapd_acquire::clock::fit;
use mocapd_drivers::device::Frame;
use mocapd_take::record::{Event, EventKind};

use crate::support::{TICK_HZ, assert_mentions, chunks, config, dense, jump, samples, start};

/// Records 120 frames per second; `ticks` maps a frame's true time in microseconds to device time.
fn record(
    seconds: u64,
    ticks: impl Fn(u64) -> u64,
) -> (Vec<u8>, mocapd_acquire::pipeline::TakeAccount) {
    let motion = jump(8, 120.0, 2.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(1.0)), Vec::new());
    for seq in 0..120 * seconds {
        while intake.is_full() {
            std::thread::yield_now();
        }
        let us = seq * 1_000_000 / 120;
        let markers = samples(motion.frame(seq as usize % 240));
        let frame =
            Frame { seq: seq as u32, device_ticks: ticks(us), timecode: None, markers: &markers };
        // Late by 0.1 ms, and some frames by up to 8 ms more.
        let late_us = 100 + if seq % 7 == 0 { seq % 13 * 600 } else { 0 };
        intake.frame(&frame, (1_000_000_000 + us + late_us) * 1000);
        if seq % 120 < 8 {
            let sent_us = 1_000_000_000 + us + 2_000;
            let pong_ticks = ticks(us + 2_000 + 50);
            intake.probe(pong_ticks, sent_us * 1000, (sent_us + 100 + seq % 3) * 1000);
        }
    }
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    (take, written)
}

fn events(take: &[u8]) -> Vec<Event> {
    mocapd_acquire::inspect::Summary::read(take).unwrap().take.events
}

#[test]
fn the_round_trips_and_the_earliest_frames_are_in_the_take() {
    // The device's clock loses 100 ppm.
    let (take, written) = record(30, |us| 40_000_000 + us - us / 10_000);
    let found = chunks(&take);
    let probes: Vec<_> = found.clocks.iter().flat_map(|clock| clock.probes.clone()).collect();
    let points: Vec<_> = found.clocks.iter().flat_map(|clock| clock.points.clone()).collect();
    assert_eq!(probes.len(), 30 * 8);
    assert!((10..=20).contains(&points.len()), "{}", points.len());
    assert!(probes.iter().all(|probe| (100..=103).contains(&probe.round_trip_us)));

    let clock = found.clocks.last().unwrap();
    let line = clock.line.unwrap();
    assert_eq!((clock.segment, clock.tick_hz), (0, TICK_HZ));
    assert!((line.drift_ppb - 100_010).abs() < 1_000, "{line:?}");
    assert_eq!(written.clock.line, Some(line));
    let fit_of_ledger = written.ledger.clock.unwrap();
    assert!((fit_of_ledger.drift_ppm - 100.0).abs() < 1.0, "{fit_of_ledger:?}");
    // Tick 0 was 40 s before the first frame.
    let expected_ns = 1_000_000_000_000 - 40_000_000_000 * 10_001 / 10_000;
    assert!((fit_of_ledger.offset_ns - expected_ns).abs() < 60_000, "{fit_of_ledger:?}");
    assert!((100..150).contains(&clock.jitter.p50_us), "{:?}", clock.jitter);
    assert!((6_000..7_500).contains(&clock.jitter.p99_us), "{:?}", clock.jitter);
    assert!((7_200..7_500).contains(&clock.jitter.max_us), "{:?}", clock.jitter);

    // Arrivals alone, refitted from the take: late by the shortest delay of the frames.
    let (alone, _) = fit(&points, &[], TICK_HZ as f64).unwrap();
    assert!((alone.drift_ppm - 100.0).abs() < 2.0, "{alone:?}");
    assert_eq!(found.bytes.sum(), take.len() as u64);
    assert!(found.bytes.clock > 0);
}

#[test]
fn a_jump_is_an_event_and_a_segment_and_loses_no_frame() {
    let (take, written) = record(30, |us| if us < 15_000_000 { us } else { us + 5_000_000 });
    assert_eq!(written.ledger.recorded, 30 * 120);
    assert!(written.ledger.closes(), "{:?}", written.ledger);
    let [event] = &events(&take)[..] else { panic!("{:?}", events(&take)) };
    assert_eq!(event.kind, EventKind::Host);
    assert_mentions(&event.text, &["5.000 s"]);
    assert!((1800..1810).contains(&event.row), "{event:?}");
    let clocks = chunks(&take).clocks;
    let segments: Vec<_> = clocks.iter().map(|clock| clock.segment).collect();
    assert_eq!(segments, [0, 1]);
    // Both lines are reported, each true in its segment.
    let lines: Vec<_> = clocks.iter().map(|clock| (clock.segment, clock.line.unwrap())).collect();
    assert_eq!(written.clock_lines, lines);
    assert_eq!(mocapd_acquire::inspect::Summary::read(&take[..]).unwrap().take.clock_lines, lines);
    for (segment, line) in lines {
        let jumped_us = if segment == 0 { 0 } else { 5_000_000 };
        let host_us = 1_000_000_000 + line.device_ticks - jumped_us;
        assert!((line.host_ns / 1000).abs_diff(host_us) < 100, "{segment}: {line:?}");
    }
}

#[test]
fn a_long_silence_is_an_event_at_the_frame_that_ends_it() {
    let motion = jump(9, 120.0, 2.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(1.0)), Vec::new());
    // Held up for 2.5 s after frame 100, without loss; a pause of 0.9 s later is not an event.
    for seq in 0..240_u64 {
        let delay_ns = match seq {
            ..100 => 0,
            100..200 => 2_500_000_000,
            _ => 3_400_000_000,
        };
        let device_ticks = seq * TICK_HZ / 120;
        let markers = &samples(motion.frame(seq as usize));
        let frame = Frame { seq: seq as u32, device_ticks, timecode: None, markers };
        intake.frame(&frame, 1_000_000_000 + device_ticks * 1000 + delay_ns);
    }
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    assert!(written.ledger.closes(), "{:?}", written.ledger);
    let [event] = &events(&take)[..] else { panic!("{:?}", events(&take)) };
    assert_eq!((event.row, event.kind), (100, EventKind::Host));
    assert_mentions(&event.text, &["2.508 s"]);
}

#[test]
fn a_clock_that_jumps_with_every_frame_is_reported_and_does_not_flood_the_take() {
    let noise = |us: u64| us.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 20;
    let (take, written) = record(10, noise);
    assert_eq!(written.ledger.recorded, 1200);
    assert!(events(&take).len() <= 32);
    assert!(written.clock.segment > 32);
    let bytes = chunks(&take).bytes;
    assert!(bytes.clock < 60 * 1200, "{bytes:?}");
}
