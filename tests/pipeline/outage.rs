//! A device that is disconnected and comes back.

use mocapd_acquire::pipeline::Intake;
use mocapd_drivers::device::{Frame, Status};
use mocapd_take::{
    motion::{Motion, is_gap},
    record::Ledger,
    timeline::{LossCauses, RowRun},
};

use crate::support::{
    TICK_HZ, chunks, config, dense, feed, feed_samples, jump, rows, samples, start,
};

/// Feeds these frames to the pipeline, waiting while the rings are full.
fn feed_all(intake: &mut Intake, motion: &Motion, seqs: impl Iterator<Item = usize>) {
    for seq in seqs {
        while intake.is_full() {
            std::thread::yield_now();
        }
        feed(intake, motion, seq);
    }
}

fn status(frames_produced: u64, frames_dropped: u64) -> Status {
    Status { frames_produced, frames_dropped, ..Status::default() }
}

fn assert_closes(ledger: &Ledger) {
    assert!(ledger.closes() && ledger.contradictions.is_empty(), "{ledger:?}");
}

#[test]
fn frames_skipped_by_the_counter_are_unknown_and_have_rows() {
    let motion = jump(1, 100.0, 6.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    feed_all(&mut intake, &motion, (0..200).filter(|seq| *seq != 100));
    intake.status(status(150, 1), false);
    intake.rejoin();
    // Its reports restart with Start, and the first one may come before a frame.
    intake.status(status(0, 0), false);
    feed_all(&mut intake, &motion, (350..600).filter(|seq| *seq != 400));
    intake.status(status(250, 1), true);
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    let ledger = written.ledger;
    assert_closes(&ledger);
    assert_eq!((ledger.frames_sent, ledger.recorded), (600, 448));
    assert_eq!(ledger.unknown_after_disconnect, 150);
    assert_eq!((ledger.dropped_by_device, ledger.lost_on_link), (2, 0));

    let (rows, problems) = rows(&take);
    assert!(problems.is_empty(), "{problems:?}");
    assert_eq!(rows.len(), 600);
    let is_lost = |seq| (200..350).contains(&seq) || seq == 100 || seq == 400;
    for (seq, row) in rows.iter().enumerate() {
        for (&got, &expected) in row.iter().zip(motion.frame(seq)) {
            assert_eq!(is_gap(got), is_lost(seq) || is_gap(expected), "{seq}");
        }
    }
    let gone = LossCauses::NOT_RECEIVED.union(LossCauses::DISCONNECTED);
    let runs: Vec<RowRun> = chunks(&take).timelines.iter().flat_map(|t| t.runs.clone()).collect();
    let rows_gone = runs.iter().filter(|run| run.lost == Some(gone)).map(|run| run.rows);
    assert_eq!(rows_gone.sum::<u64>(), 150);
}

/// A frame of a device whose counter and clock restarted, `later_s` after it was first switched on.
fn feed_restarted(intake: &mut Intake, motion: &Motion, seq: usize, later_s: f64) {
    while intake.is_full() {
        std::thread::yield_now();
    }
    let device_ticks = (seq as f64 * TICK_HZ as f64 / motion.info.rate_hz).round() as u64;
    let markers = &samples(motion.frame(seq));
    let frame = Frame { seq: seq as u32, device_ticks, timecode: None, markers };
    intake.frame(&frame, 5_000_000 + device_ticks * 1000 + (later_s * 1e9) as u64);
}

#[test]
fn a_device_that_lost_its_power_restarts_at_zero_and_the_take_keeps_time() {
    let motion = jump(2, 100.0, 4.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    feed_all(&mut intake, &motion, 0..30);
    intake.rejoin();
    // Counter and clock values repeat earlier ones, but none of these frames is a late one. By the host's clock the
    // first frame comes 2.71 s after the last one before the outage: 270 were due.
    (0..200).for_each(|seq| feed_restarted(&mut intake, &motion, seq, 3.0));
    intake.status(status(200, 0), true);
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    let ledger = written.ledger;
    assert_closes(&ledger);
    assert_eq!((ledger.frames_sent, ledger.recorded, ledger.duplicates), (500, 230, 0));
    assert_eq!((ledger.unknown_after_disconnect, ledger.lost_on_link), (270, 0));
    let (rows, problems) = rows(&take);
    assert!(problems.is_empty(), "{problems:?}");
    assert_eq!(rows.len(), 500);
    assert!(rows[30..300].iter().flatten().all(|&position| is_gap(position)));
    assert!(rows[300..].iter().flatten().any(|&position| !is_gap(position)));
    let runs: Vec<RowRun> = chunks(&take).timelines.iter().flat_map(|t| t.runs.clone()).collect();
    let gone = runs.iter().filter(|run| run.lost == Some(LossCauses::DISCONNECTED));
    assert_eq!(gone.map(|run| run.rows).sum::<u64>(), 270);
}

#[test]
fn frames_lost_between_its_start_and_its_first_frame_are_counted_once() {
    let motion = jump(5, 100.0, 6.0);
    for (restarted, rows_sent) in [(false, 600), (true, 600)] {
        let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
        feed_all(&mut intake, &motion, 0..200);
        intake.rejoin();
        // Its counter continues at frame 350 or restarts; five of its frames are lost before the first one arrives,
        let first = if restarted { 0 } else { 350 };
        let feed_one = |intake: &mut Intake, seq| match restarted {
            true => feed_restarted(intake, &motion, seq, 3.5),
            false => feed_all(intake, &motion, seq..seq + 1),
        };
        (first + 5..first + 100).for_each(|seq| feed_one(&mut intake, seq));
        intake.status(status(100, 0), false);
        (first + 100..first + 247).for_each(|seq| feed_one(&mut intake, seq));
        // and three at the end.
        intake.status(status(250, 0), true);
        intake.finish();
        let (written, take) = pipeline.finish().unwrap();
        let ledger = written.ledger;
        assert_closes(&ledger);
        assert_eq!((ledger.frames_sent, ledger.recorded), (rows_sent, 442), "{ledger:?}");
        assert_eq!((ledger.unknown_after_disconnect, ledger.lost_on_link), (155, 3), "{ledger:?}");
        assert_eq!(rows(&take).0.len(), 600);
    }
}

#[test]
fn an_outage_of_an_hour_has_its_rows_too() {
    let motion = jump(4, 1000.0, 1.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    let frame = samples(motion.frame(0));
    (0..50).for_each(|seq| feed_samples(&mut intake, 1000.0, seq, &frame));
    intake.rejoin();
    (3_600_000..3_600_050).for_each(|seq| feed_samples(&mut intake, 1000.0, seq, &frame));
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    assert_closes(&written.ledger);
    assert_eq!((written.ledger.recorded, written.ledger.frames_sent), (100, 3_600_050));
    assert_eq!(written.ledger.unknown_after_disconnect, 3_599_950);
    let runs: Vec<RowRun> = chunks(&take).timelines.iter().flat_map(|t| t.runs.clone()).collect();
    assert_eq!(runs.iter().map(|run| run.rows).sum::<u64>(), 3_600_050);
}

#[test]
fn a_counter_that_jumps_by_itself_still_contradicts() {
    let motion = jump(3, 100.0, 4.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    let frame = samples(motion.frame(0));
    for seq in (200..300).chain(0..10) {
        feed_samples(&mut intake, 100.0, seq, &frame);
    }
    intake.finish();
    let ledger = pipeline.finish().unwrap().0.ledger;
    assert!(!ledger.contradictions.is_empty(), "{ledger:?}");
}
