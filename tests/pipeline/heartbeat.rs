//! What the watchdog finds in a pipeline: threads that work, threads that wait, and threads that hang.

use std::{
    io::{self, Write},
    sync::mpsc::{Receiver, sync_channel},
    time::{Duration, Instant},
};

use mocapd_acquire::{
    pipeline::TakeOutput,
    threads::{ThreadRole, Watchdog},
};

use crate::support::{config, fast, feed, jump, start};

/// Longer than the writer waits for parts.
const PAUSE: Duration = Duration::from_millis(1200);

const LIMIT: Duration = Duration::from_secs(10);

/// The role of a thread that is overdue after `seconds` of silence from now on.
fn overdue_after(watch: &mut Watchdog, seconds: u64) -> Option<ThreadRole> {
    // Registers all heartbeats so far; a thread that moves during the pause is alive.
    watch.overdue(Instant::now(), LIMIT);
    std::thread::sleep(PAUSE);
    let later = Instant::now() + Duration::from_secs(seconds);
    watch.overdue(later, LIMIT).map(|overdue| overdue.role)
}

#[test]
fn a_hung_reader_is_overdue_and_idle_workers_are_not() {
    let motion = jump(31, 100.0, 2.0);
    let config = config(&motion, fast(1.0));
    let mut watch = config.heartbeat.watchdog(Instant::now());
    let (mut intake, pipeline) = start(&config, Vec::new());
    for seq in 0..100 {
        feed(&mut intake, &motion, seq);
    }
    assert_eq!(overdue_after(&mut watch, 20), Some(ThreadRole::Reader));
    // The reader ticks although the device sends nothing, and the writer moves by itself.
    std::thread::sleep(PAUSE);
    intake.tick(0);
    assert_eq!(watch.overdue(Instant::now() + LIMIT, LIMIT), None);
    intake.finish();
    pipeline.finish().unwrap();
    assert_eq!(overdue_after(&mut watch, 1000), None, "ended threads are forgotten");
}

/// A disk that accepts the header, and blocks later writes until it is released.
struct Stalling {
    gate: Receiver<()>,
    writes: usize,
}

impl Write for Stalling {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writes += 1;
        if self.writes == 3 {
            self.gate.recv().ok();
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
fn a_stalled_disk_is_tolerated_while_memory_lasts_and_then_the_writer_has_hung() {
    let motion = jump(32, 100.0, 2.0);
    let config = config(&motion, fast(1.0));
    let mut watch = config.heartbeat.watchdog(Instant::now());
    let (release, gate) = sync_channel(1);
    let (mut intake, pipeline) = start(&config, Stalling { gate, writes: 0 });
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
    assert_eq!(reader_alive(80), Some(ThreadRole::Writer));
    release.send(()).unwrap();
    intake.finish();
    pipeline.finish().unwrap();
}
