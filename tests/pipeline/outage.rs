//! A device that goes away and comes back.

use mocapd::pipeline::Intake;
use mocapd_drivers::device::Status;
use mocapd_take::{
    motion::{Motion, is_gap},
    record::Ledger,
    timeline::{Causes, Run},
};

use crate::support::{chunks, config, dense, feed, feed_samples, jump, rows, samples, start};

/// Gives these frames to the pipeline, waiting for full rings.
fn feed_all(intake: &mut Intake, motion: &Motion, wanted: impl Iterator<Item = usize>) {
    for seq in wanted {
        while intake.is_full() {
            std::thread::yield_now();
        }
        feed(intake, motion, seq);
    }
}

fn status(frames_produced: u64, frames_dropped: u64) -> Status {
    Status { frames_produced, frames_dropped, ..Status::default() }
}

fn closes(ledger: &Ledger) {
    assert!(ledger.closes() && ledger.contradictions.is_empty(), "{ledger:?}");
}

#[test]
fn what_the_counter_skipped_is_unknown_and_has_its_rows() {
    let motion = jump(1, 100.0, 6.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    feed_all(&mut intake, &motion, (0..200).filter(|seq| *seq != 100));
    intake.status(status(150, 1), false);
    intake.rejoin();
    // Its reports begin anew with Start, and the first may come before a frame.
    intake.status(status(0, 0), false);
    feed_all(&mut intake, &motion, (350..600).filter(|seq| *seq != 400));
    intake.status(status(250, 1), true);
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    let ledger = written.ledger;
    closes(&ledger);
    assert_eq!((ledger.frames_sent, ledger.recorded), (600, 448));
    assert_eq!(ledger.unknown_after_disconnect, 150);
    assert_eq!((ledger.dropped_by_device, ledger.lost_on_link), (2, 0));

    let (rows, problems) = rows(&take);
    assert!(problems.is_empty(), "{problems:?}");
    assert_eq!(rows.len(), 600);
    let is_lost = |seq| (200..350).contains(&seq) || seq == 100 || seq == 400;
    for (seq, row) in rows.iter().enumerate() {
        for (&got, &wanted) in row.iter().zip(motion.frame(seq)) {
            assert_eq!(is_gap(got), is_lost(seq) || is_gap(wanted), "{seq}");
        }
    }
    let gone = Causes::NOT_RECEIVED.union(Causes::DISCONNECTED);
    let runs: Vec<Run> = chunks(&take).timelines.iter().flat_map(|t| t.runs.clone()).collect();
    let rows_gone = runs.iter().filter(|run| run.lost == Some(gone)).map(|run| run.rows);
    assert_eq!(rows_gone.sum::<u64>(), 150);
}

#[test]
fn a_device_that_lost_its_power_goes_on_from_zero_without_a_contradiction() {
    let motion = jump(2, 100.0, 4.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    feed_all(&mut intake, &motion, 0..30);
    intake.rejoin();
    // As early as those before by its counter and clock: no frame of them is a late one.
    feed_all(&mut intake, &motion, 0..200);
    intake.status(status(200, 0), true);
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    let ledger = written.ledger;
    closes(&ledger);
    assert_eq!((ledger.frames_sent, ledger.recorded, ledger.duplicates), (230, 230, 0));
    assert_eq!(rows(&take).0.len(), 230);
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
    closes(&written.ledger);
    assert_eq!((written.ledger.recorded, written.ledger.frames_sent), (100, 3_600_050));
    assert_eq!(written.ledger.unknown_after_disconnect, 3_599_950);
    let runs: Vec<Run> = chunks(&take).timelines.iter().flat_map(|t| t.runs.clone()).collect();
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
