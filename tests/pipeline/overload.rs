//! A disk that stalls or fails.

use std::{
    io::{self, Write},
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, bounded};
use mocapd_acquire::pipeline::{PipelineConfig, TakeOutput};
use mocapd_simulator::generator::JumpSpec;
use mocapd_take::{
    TakeFrames,
    damage::Problem,
    motion::{FrameSource, GAP, is_gap},
    timeline::LossCauses,
};

use crate::support::{chunks, config, dense, fast, feed, io_error_of, jump, rows, start};

/// Writes to memory. From the second write on, each write waits for the gate.
struct Gated {
    gate: Receiver<()>,
    writes: usize,
    bytes: Vec<u8>,
}

impl Write for Gated {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writes += 1;
        if self.writes > 1 {
            // Disconnected: the gate stays open.
            self.gate.recv().ok();
        }
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl TakeOutput for Gated {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_stall_of_thirty_seconds_loses_nothing_and_a_longer_one_only_whole_frames() {
    let motion = jump(1, 200.0, 4.0);
    let n = motion.n_frames();
    let (open, gate) = bounded(0);
    let (mut intake, pipeline) =
        start(&config(&motion, dense(1.0)), Gated { gate, writes: 0, bytes: Vec::new() });
    // Feeding is faster than real time: only rings that stay full mean a full queue.
    let has_space_within_a_second = |intake: &mut mocapd_acquire::pipeline::Intake| {
        let since = Instant::now();
        while intake.is_full() && since.elapsed() < Duration::from_secs(1) {
            std::thread::sleep(Duration::from_millis(1));
        }
        !intake.is_full()
    };
    let frame = |intake: &mut _, seq: usize| {
        crate::support::feed_samples(
            intake,
            200.0,
            seq,
            &crate::support::samples(motion.frame(seq % n)),
        );
    };
    for seq in 0..6_000 {
        has_space_within_a_second(&mut intake);
        frame(&mut intake, seq);
    }
    assert_eq!(intake.counts().ring_full, 0, "30 s fit into memory");
    let mut seq = 6_000;
    // Rings that have been full for a second stay full until the disk continues.
    let mut has_space = true;
    while intake.counts().ring_full < 100 {
        assert!(seq < 20_000, "the queues have no bound");
        has_space = has_space && has_space_within_a_second(&mut intake);
        frame(&mut intake, seq);
        seq += 1;
    }
    drop(open);
    for _ in 0..400 {
        has_space_within_a_second(&mut intake);
        frame(&mut intake, seq);
        seq += 1;
    }
    intake.finish();
    let (written, output) = pipeline.finish().unwrap();
    let ledger = written.ledger;
    assert!(ledger.closes(), "{ledger:?}");
    assert_eq!(ledger.frames_sent, seq as u64);
    assert_eq!(ledger.lost_ring_full, 100);
    let found = chunks(&output.bytes);
    let runs: Vec<_> = found.timelines.iter().flat_map(|t| &t.runs).collect();
    let lost: u64 =
        runs.iter().filter(|run| run.lost == Some(LossCauses::RING_FULL)).map(|run| run.rows).sum();
    assert_eq!(lost, 100);
    // Each frame is complete or missing.
    let recorded: std::collections::HashSet<u64> = found
        .timelines
        .iter()
        .flat_map(mocapd_take::timeline::Timeline::recorded)
        .map(|(row, _)| row)
        .collect();
    for (row, positions) in rows(&output.bytes).0.iter().enumerate() {
        let present = positions.iter().filter(|&&p| !is_gap(p)).count();
        let sent = motion.frame(row % n).iter().filter(|&&p| !is_gap(p)).count();
        assert_eq!(present, if recorded.contains(&(row as u64)) { sent } else { 0 }, "{row}");
    }
}

/// Feeds frames as fast as possible, even into full rings, while nothing can be written; then some more, waiting for
/// space.
fn flooded(n_markers: usize, rate_hz: f64, n_flood: usize) -> u64 {
    let n_after = 50;
    let spec = JumpSpec { n_markers, seconds: Some(0.5), ..JumpSpec::new(6, rate_hz.min(1000.0)) };
    let motion = spec.generate().unwrap().motion;
    let all: Vec<_> =
        (0..motion.n_frames()).map(|index| crate::support::samples(motion.frame(index))).collect();
    let config = PipelineConfig { rate_hz, ..config(&motion, fast(1.0)) };
    let (open, gate) = bounded(0);
    let (mut intake, pipeline) = start(&config, Gated { gate, writes: 0, bytes: Vec::new() });
    let mut open = Some(open);
    for seq in 0..n_flood + n_after {
        if seq == n_flood {
            open.take();
        }
        while seq >= n_flood && intake.is_full() {
            std::thread::sleep(Duration::from_millis(1));
        }
        crate::support::feed_samples(&mut intake, rate_hz, seq, &all[seq % all.len()]);
    }
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    let ledger = written.ledger;
    assert!(ledger.closes(), "{ledger:?}");
    assert_eq!(ledger.frames_sent, (n_flood + n_after) as u64);
    assert_eq!(ledger.recorded + ledger.lost_ring_full, ledger.frames_sent);
    // Frames are complete or missing, and after the overload all are there.
    let mut frames = TakeFrames::open(io::Cursor::new(&take.bytes[..])).unwrap();
    let mut row = vec![GAP; n_markers];
    let (mut seq, mut n_whole) = (0, 0);
    while frames.next_frame(&mut row).unwrap() {
        let present = row.iter().filter(|&&position| !is_gap(position)).count();
        assert!(present == 0 || present == n_markers, "{seq}: {present} of {n_markers}");
        assert!(present > 0 || seq < n_flood, "{seq} is lost, and nothing was full any more");
        n_whole += u64::from(present > 0);
        seq += 1;
    }
    assert!(frames.problems().is_empty(), "{:?}", frames.problems());
    assert_eq!((seq, n_whole), (n_flood + n_after, ledger.recorded));
    ledger.lost_ring_full
}

#[test]
fn frames_at_100_khz_are_dropped_whole_and_counted() {
    // The queues hold half a minute.
    assert!(flooded(2, 100_000.0, 3_600_000) > 0, "no overload");
}

#[test]
fn frames_of_ten_thousand_markers_are_whole_or_dropped() {
    flooded(10_000, 240.0, 600);
}

/// A disk that is full after a given number of bytes.
struct Full {
    space: usize,
    bytes: std::sync::Arc<std::sync::Mutex<Vec<u8>>>,
}

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = bytes.len().min(self.space);
        if n == 0 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.space -= n;
        self.bytes.lock().unwrap().extend_from_slice(&bytes[..n]);
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl TakeOutput for Full {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_is_an_error_and_what_was_written_can_be_read() {
    let motion = jump(2, 200.0, 10.0);
    let bytes = std::sync::Arc::default();
    let full = Full { space: 4_000, bytes: std::sync::Arc::clone(&bytes) };
    let (mut intake, pipeline) = start(&config(&motion, dense(1.0)), full);
    for seq in 0..motion.n_frames() {
        while intake.is_full() {
            std::thread::yield_now();
        }
        feed(&mut intake, &motion, seq);
    }
    let since = Instant::now();
    while !intake.has_failed() && since.elapsed() < Duration::from_secs(20) {
        std::thread::yield_now();
    }
    assert!(intake.has_failed(), "the failure was not reported");
    intake.finish();
    let failed = pipeline.finish().err().unwrap();
    assert_eq!(io_error_of(&failed), Some(io::ErrorKind::StorageFull), "{failed:#}");
    let (rows, problems) = rows(&bytes.lock().unwrap());
    assert!(rows.len() > 50, "{}", rows.len());
    assert!(problems.contains(&Problem::CutOff), "{problems:?}");
}

#[test]
fn slow_frames_go_to_disk_by_the_clock() {
    let motion = jump(3, 100.0, 1.0);
    let bytes = std::sync::Arc::default();
    let unlimited = Full { space: usize::MAX, bytes: std::sync::Arc::clone(&bytes) };
    let (mut intake, pipeline) = start(&config(&motion, dense(1.0)), unlimited);
    // Ten frames form the first stretch; nine more wait for a full stretch that does not come.
    for seq in 0..19 {
        feed(&mut intake, &motion, seq);
    }
    let arrival_ns = 5_000_000 + 180_000_000;
    intake.tick(arrival_ns);
    intake.tick(arrival_ns + 600_000_000);
    let since = Instant::now();
    let on_disk = || rows(&bytes.lock().unwrap()).0.len();
    while on_disk() < 19 && since.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(on_disk(), 19);
    intake.finish();
    pipeline.finish().unwrap();
}

#[test]
fn a_reader_that_is_dropped_early_leaves_a_whole_take() {
    let motion = jump(4, 100.0, 1.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(1.0)), Vec::new());
    (0..57).for_each(|seq| feed(&mut intake, &motion, seq));
    drop(intake);
    let (written, take) = pipeline.finish().unwrap();
    assert_eq!((written.ledger.recorded, rows(&take).0.len()), (57, 57));
}
