//! Frames that are lost, repeated, or sent with a wrong counter.

use std::{thread::sleep, time::Duration};

use mocapd_acquire::inspect::Summary;
use mocapd_drivers::device::Status;
use mocapd_take::{
    motion::is_gap,
    record::{Event, EventKind},
    timeline::{LossCauses, RowRun},
};

use crate::support::{
    assert_mentions, chunks, config, dense, feed, feed_samples, jump, record, rows, samples, start,
};

#[test]
fn lost_frames_are_empty_rows_with_their_cause() {
    let motion = jump(1, 100.0, 6.0);
    // A few frames, many, and more than a whole stretch.
    let lost =
        |seq: &usize| (20..22).contains(seq) || (70..99).contains(seq) || (200..400).contains(seq);
    let kept: Vec<_> = (0..motion.n_frames()).filter(|seq| !lost(seq)).collect();
    let (written, take, _) = record(&motion, &config(&motion, dense(0.5)), kept.clone());
    let ledger = written.ledger;
    assert!(ledger.closes(), "{ledger:?}");
    assert_eq!(
        (ledger.frames_sent, ledger.recorded, ledger.lost_on_link),
        (600, kept.len() as u64, 231)
    );

    let (rows, problems) = rows(&take);
    assert!(problems.is_empty(), "{problems:?}");
    for (seq, row) in rows.iter().enumerate() {
        for (&got, &expected) in row.iter().zip(motion.frame(seq)) {
            assert_eq!(is_gap(got), lost(&seq) || is_gap(expected), "{seq}");
        }
    }
    let runs: Vec<RowRun> = chunks(&take).timelines.iter().flat_map(|t| t.runs.clone()).collect();
    let not_received: Vec<_> = runs
        .iter()
        .filter(|run| run.lost == Some(LossCauses::NOT_RECEIVED))
        .map(|run| run.rows)
        .collect();
    assert_eq!(not_received, [2, 29, 200]);
    assert_eq!(runs.iter().map(|run| run.rows).sum::<u64>(), 600);
}

/// A stream of events goes on while the camera waits: three times as many as the queue to the writer holds.
#[test]
fn events_are_recorded_while_no_frame_comes() {
    let motion = jump(5, 100.0, 1.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    (0..50).for_each(|seq| feed(&mut intake, &motion, seq));
    for piece in 0..6 {
        for n in 0..500 {
            let text = format!("event {}", piece * 500 + n);
            intake.event(Event::new(EventKind::Mark, 5_500_000_000, text));
        }
        sleep(Duration::from_secs(1));
    }
    (50..100).for_each(|seq| feed(&mut intake, &motion, seq));
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    assert!(written.ledger.closes(), "{:?}", written.ledger);
    let events = Summary::read(&take[..]).unwrap().take.events;
    let texts: Vec<_> = events.iter().map(|event| event.text.clone()).collect();
    let expected: Vec<_> = (0..3000).map(|n| format!("event {n}")).collect();
    assert_eq!(texts, expected);
    assert!(events.iter().all(|event| event.row == 50));
}

#[test]
fn repeated_and_late_frames_are_counted_and_not_recorded() {
    let motion = jump(2, 100.0, 1.0);
    let order = [0, 1, 2, 2, 1, 3, 6, 5, 4, 7].into_iter().chain(8..100);
    let (written, take, _) = record(&motion, &config(&motion, dense(0.5)), order);
    let ledger = written.ledger;
    assert!(ledger.closes(), "{ledger:?}");
    assert_eq!((ledger.duplicates, ledger.lost_on_link, ledger.recorded), (4, 2, 98));
    assert_eq!(rows(&take).0.len(), 100);
}

#[test]
fn drops_of_the_device_are_distinguished_from_loss_on_the_link() {
    let motion = jump(3, 100.0, 1.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    for seq in (5..95).filter(|seq| seq % 10 != 0) {
        feed(&mut intake, &motion, seq);
    }
    intake.status(Status { frames_produced: 100, frames_dropped: 8, ..Status::default() }, true);
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    let ledger = written.ledger;
    assert!(ledger.closes(), "{ledger:?}");
    assert_eq!((ledger.frames_sent, ledger.recorded), (100, 81));
    assert_eq!((ledger.dropped_by_device, ledger.lost_on_link), (8, 11));
    // Frames lost before the first one have rows at the end: their position is unknown.
    assert_eq!(rows(&take).0.len(), 100);
}

#[test]
fn counters_that_contradict_each_other_are_flagged() {
    let motion = jump(4, 100.0, 1.0);
    // The device's report, and the facts in the contradiction.
    for (frames_produced, frames_dropped, facts) in [(50, 0, ["50", "100"]), (100, 3, ["3", "0"])] {
        let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
        (0..100).for_each(|seq| feed(&mut intake, &motion, seq));
        intake.status(Status { frames_produced, frames_dropped, ..Status::default() }, true);
        intake.finish();
        let ledger = pipeline.finish().unwrap().0.ledger;
        assert!(!ledger.closes());
        let [contradiction] = &ledger.contradictions[..] else { panic!("{ledger:?}") };
        assert_mentions(contradiction, &facts);
        assert_eq!(ledger.frame_balance(), 0);
    }
}

#[test]
fn a_counter_that_restarts_loses_no_frame_and_is_flagged() {
    let motion = jump(5, 100.0, 1.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    for i in 0..100_usize {
        let markers = samples(motion.frame(i));
        let seq = if i < 40 { i as u32 } else { i as u32 - 40 };
        let device_ticks = i as u64 * 10_000;
        let frame =
            mocapd_drivers::device::Frame { seq, device_ticks, timecode: None, markers: &markers };
        intake.frame(&frame, device_ticks * 1000);
    }
    let counts = intake.finish();
    let ledger = pipeline.finish().unwrap().0.ledger;
    assert_eq!((ledger.recorded, ledger.duplicates), (100, 0));
    assert_eq!((counts.counter_jumps, ledger.contradictions.len()), (1, 1), "{ledger:?}");
}

#[test]
fn non_finite_samples_are_gaps_and_counted() {
    let motion = jump(6, 100.0, 0.5);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    let mut present = 0;
    for seq in 0..50 {
        let mut markers = samples(motion.frame(seq));
        markers[3].occluded = false;
        markers[3].position_mm = [1.0, f32::NAN, f32::INFINITY];
        present += markers.iter().filter(|m| !m.occluded).count() as u64 - 1;
        feed_samples(&mut intake, 100.0, seq, &markers);
    }
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    assert!(written.ledger.closes());
    assert_eq!((written.ledger.samples_not_finite, written.ledger.samples_present), (50, present));
    assert!(rows(&take).0.iter().all(|row| is_gap(row[3])));
}

#[test]
fn a_device_whose_counter_and_clock_restart_is_still_recorded() {
    let motion = jump(7, 100.0, 1.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    for i in (0..500).chain(0..400) {
        while intake.is_full() {
            std::thread::yield_now();
        }
        feed_samples(&mut intake, 100.0, i, &samples(motion.frame(i % 100)));
    }
    let counts = intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    let ledger = written.ledger;
    assert_eq!((ledger.recorded, ledger.duplicates, ledger.frame_balance()), (900, 0, 0));
    assert_eq!((counts.counter_jumps, counts.clock_jumps), (1, 1));
    assert_eq!(ledger.contradictions.len(), 2, "{ledger:?}");
    assert!(!ledger.closes());
    assert_eq!(rows(&take).0.len(), 900);
}

#[test]
fn frames_that_were_reported_before_the_device_went_away_are_on_the_ledger() {
    let motion = jump(8, 100.0, 1.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    (0..90).for_each(|seq| feed(&mut intake, &motion, seq));
    intake.status(Status { frames_produced: 97, frames_dropped: 0, ..Status::default() }, false);
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    let ledger = written.ledger;
    assert!(ledger.closes() && ledger.lost_anything(), "{ledger:?}");
    assert_eq!((ledger.frames_sent, ledger.recorded, ledger.unknown_after_disconnect), (97, 90, 7));
    assert_eq!(rows(&take).0.len(), 97);
}

#[test]
fn an_impossible_number_of_frames_is_a_contradiction_without_rows() {
    let motion = jump(9, 100.0, 1.0);
    for frames_produced in [1 << 62, u64::MAX] {
        let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
        (0..100).for_each(|seq| feed(&mut intake, &motion, seq));
        intake.status(Status { frames_produced, ..Status::default() }, true);
        intake.finish();
        let (written, take) = pipeline.finish().unwrap();
        assert_eq!(written.ledger.frames_sent, 100);
        let [contradiction] = &written.ledger.contradictions[..] else { panic!() };
        assert_mentions(contradiction, &[&frames_produced.to_string()]);
        assert_eq!(rows(&take).0.len(), 100);
    }
}

#[test]
fn a_clock_that_goes_back_drops_no_frame_and_is_flagged() {
    let motion = jump(10, 100.0, 1.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    for i in 0..100_usize {
        let markers = samples(motion.frame(i));
        let device_ticks = 20_000_000 + i as u64 * 10_000 - if i < 50 { 0 } else { 10_000_000 };
        let frame = mocapd_drivers::device::Frame {
            seq: i as u32,
            device_ticks,
            timecode: None,
            markers: &markers,
        };
        intake.frame(&frame, i as u64 * 10_000_000);
    }
    let counts = intake.finish();
    let ledger = pipeline.finish().unwrap().0.ledger;
    assert_eq!((ledger.recorded, ledger.duplicates, ledger.frame_balance()), (100, 0, 0));
    assert_eq!((counts.clock_jumps, ledger.contradictions.len()), (1, 1), "{ledger:?}");
    assert!(ledger.clock.unwrap().drift_ppm.abs() < 1.0, "{ledger:?}");
}
