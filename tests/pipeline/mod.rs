//! The pipeline in memory: every frame that goes in is in the take, or counted as lost.

mod channels;
mod clocks;
mod failing_disk;
mod framing;
mod heartbeat;
mod long;
mod loss;
mod lossy_disk;
mod outage;
mod overload;
mod pose_rows;
mod poses;
mod publish;
mod residuals;
mod sampled;
mod splits;
mod statistics;
mod takes;
mod takes_outage;

use mocapd_take::motion::is_gap;

use crate::support::{
    chunks, config, crowd, dense, distance_mm, fast, jump, lossless, record, rows,
};

#[test]
fn every_sample_is_within_the_tolerance_and_every_gap_in_place() {
    let motion = jump(1, 240.0, 3.0);
    for codec in [dense(0.1), dense(5.0), lossless()] {
        let bound_mm = if codec.kind.is_lossless() { 0.0 } else { codec.tolerance.mm() };
        let (written, take, _) = record(&motion, &config(&motion, codec), 0..motion.n_frames());
        assert!(written.ledger.closes() && written.ledger.finished, "{:?}", written.ledger);
        assert!(written.max_error_mm <= bound_mm);
        let (rows, problems) = rows(&take);
        assert!(problems.is_empty(), "{problems:?}");
        assert_eq!(rows.len(), motion.n_frames());
        for (index, row) in rows.iter().enumerate() {
            for (&got, &expected) in row.iter().zip(motion.frame(index)) {
                assert_eq!(is_gap(got), is_gap(expected));
                assert!(is_gap(got) || distance_mm(got, expected) <= bound_mm);
            }
        }
    }
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let motion = crowd(2, 200.0, 12.0);
    let blocks = |workers| {
        let config =
            mocapd_acquire::pipeline::PipelineConfig { workers, ..config(&motion, fast(1.0)) };
        let found = chunks(&record(&motion, &config, 0..motion.n_frames()).1);
        (found.keys, found.timelines, found.blocks)
    };
    let one = blocks(1);
    assert_eq!(one, blocks(2));
    assert_eq!(one, blocks(7));
}

#[test]
fn stretches_are_short_at_first_and_keys_come_every_ten_seconds() {
    let motion = jump(3, 60.0, 25.0);
    let found = chunks(&record(&motion, &config(&motion, dense(1.0)), 0..motion.n_frames()).1);
    let first_rows: Vec<_> = found.keys.iter().map(|key| key.0).collect();
    assert_eq!(first_rows[..4], [0, 6, 36, 66]);
    let keys: Vec<_> = found.keys.iter().filter(|key| key.1).map(|key| key.0).collect();
    assert_eq!(keys, [0, 576, 1176], "never more than ten seconds");
    assert!(found.finished);
}

#[test]
fn the_timeline_keeps_ticks_and_arrivals() {
    let motion = jump(4, 120.0, 2.0);
    let found = chunks(&record(&motion, &config(&motion, dense(1.0)), 0..motion.n_frames()).1);
    let times: Vec<_> =
        found.timelines.iter().flat_map(mocapd_take::timeline::Timeline::recorded).collect();
    assert_eq!(times.len(), motion.n_frames());
    for (seq, (row, time)) in times.into_iter().enumerate() {
        let ticks = (seq as f64 * 1e6 / 120.0).round() as u64;
        assert_eq!((row, time.device_ticks), (seq as u64, ticks));
        // To within half a step of 320 us.
        let arrival_10us = (5_000_000 + ticks * 1000) / 10_000;
        assert!(time.arrival_10us.abs_diff(arrival_10us) <= 16, "{seq}: {time:?}");
    }
}

#[test]
fn stretches_of_one_row_pass_every_group_between_workers_and_lose_none() {
    let motion = jump(5, 1000.0, 20.0);
    let config = mocapd_acquire::pipeline::PipelineConfig {
        workers: 5,
        stretch: std::time::Duration::ZERO,
        ..config(&motion, dense(1.0))
    };
    // A lost wake-up would leave a group asleep and stop the recording.
    let (written, take, _) = record(&motion, &config, 0..motion.n_frames());
    assert_eq!(written.ledger.recorded, 20_000);
    assert_eq!(chunks(&take).keys.len(), 20_000);
}
