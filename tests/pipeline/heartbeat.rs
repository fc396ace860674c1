//! What the watchdog sees of a pipeline: who moves, who waits, and who has hung.

use std::{
    io::{self, Write},
    sync::mpsc::{Receiver, sync_channel},
    time::{Duration, Instant},
};

use mocapd_acquire::{
    heartbeat::{Watch, Who},
    pipeline::TakeOutput,
};

use crate::support::{config, fast, feed, jump, start};

/// Longer than the writer waits for parts.
const A_WHILE: Duration = Duration::from_millis(1200);

const LIMIT: Duration = Duration::from_secs(10);

/// Whether somebody is overdue after `seconds` of silence from now on.
fn overdue_after(watch: &mut Watch, seconds: u64) -> Option<Who> {
    // What moved until now is seen, and whoever moves meanwhile is alive.
    watch.overdue(Instant::now(), LIMIT);
    std::thread::sleep(A_WHILE);
    let later = Instant::now() + Duration::from_secs(seconds);
    watch.overdue(later, LIMIT).map(|overdue| overdue.role)
}

#[test]
fn a_reader_that_hangs_is_seen_and_workers_without_work_are_not() {
    let motion = jump(31, 100.0, 2.0);
    let config = config(&motion, fast(1.0));
    let mut watch = config.heartbeat.watch(Instant::now());
    let (mut intake, pipeline) = start(&config, Vec::new());
    for seq in 0..100 {
        feed(&mut intake, &motion, seq);
    }
    assert_eq!(overdue_after(&mut watch, 20), Some(Who::Reader));
    // A device that sends nothing is read all the same, and the writer moves by itself.
    std::thread::sleep(A_WHILE);
    intake.tick(0);
    assert_eq!(watch.overdue(Instant::now() + LIMIT, LIMIT), None);
    intake.finish();
    pipeline.finish().unwrap();
    assert_eq!(overdue_after(&mut watch, 1000), None, "who has ended is forgotten");
}

/// A disk that takes the header, and nothing more until it is told.
struct Stalling {
    begins: Receiver<()>,
    writes: usize,
}

impl Write for Stalling {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writes += 1;
        if self.writes == 3 {
            self.begins.recv().ok();
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl TakeOutput for Stalling {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_disk_may_stall_for_as_long_as_memory_lasts_and_then_the_writer_has_hung() {
    let motion = jump(32, 100.0, 2.0);
    let config = config(&motion, fast(1.0));
    let mut watch = config.heartbeat.watch(Instant::now());
    let (goes_on, begins) = sync_channel(1);
    let (mut intake, pipeline) = start(&config, Stalling { begins, writes: 0 });
    for seq in 0..100 {
        feed(&mut intake, &motion, seq);
    }
    assert_eq!(overdue_after(&mut watch, 0), None);
    let mut reader_alive = |seconds| {
        intake.tick(0);
        let later = Instant::now() + Duration::from_secs(seconds);
        watch.overdue(later, LIMIT).map(|overdue| overdue.role)
    };
    assert_eq!(reader_alive(32), None, "no frame is lost yet, and a restart would lose some");
    assert_eq!(reader_alive(80), Some(Who::Writer));
    goes_on.send(()).unwrap();
    intake.finish();
    pipeline.finish().unwrap();
}
