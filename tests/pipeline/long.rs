//! Hours of recording in minutes, and a stall at full load. Run by name; they print their figures
//! (docs/reliability.md has the commands).

use std::{
    io::{self, Write},
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, bounded};
use mocapd_acquire::pipeline::{Intake, TakeOutput};
use mocapd_drivers::device::{Frame, MarkerSample};
use mocapd_simulator::generator::{JumpSpec, Occlusion};

use crate::support::{TICK_HZ, config, dense, lossless, samples, start};

/// Resident memory now, and its peak, in bytes.
fn resident_bytes() -> (u64, u64) {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let of = |name: &str| {
        let line = status.lines().find(|line| line.starts_with(name)).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() * 1024
    };
    (of("VmRSS:"), of("VmHWM:"))
}

/// Ten seconds of a crowd as samples per frame, played forwards and backwards so that nothing jumps.
struct Frames {
    rate_hz: f64,
    frames: Vec<Vec<MarkerSample>>,
}

impl Frames {
    fn new(n_markers: usize, rate_hz: f64) -> (Self, mocapd_take::motion::Motion) {
        let occlusion = Some(Occlusion { fraction: 0.05, mean_gap_s: 0.1 });
        let spec =
            JumpSpec { seconds: Some(5.0), occlusion, n_markers, ..JumpSpec::new(31, rate_hz) };
        let motion = spec.generate().unwrap().motion;
        let frames = (0..motion.n_frames()).map(|index| samples(motion.frame(index))).collect();
        (Self { rate_hz, frames }, motion)
    }

    fn feed(&self, intake: &mut Intake, seq: u64) {
        let n = self.frames.len() as u64;
        let index = match seq % (2 * n) {
            there if there < n => there,
            back => 2 * n - 1 - back,
        };
        let device_ticks = (seq as f64 * TICK_HZ as f64 / self.rate_hz).round() as u64;
        let markers = &self.frames[index as usize][..];
        let frame = Frame { seq: seq as u32, device_ticks, timecode: None, markers };
        intake.frame(&frame, 5_000_000 + device_ticks * 1000);
    }
}

/// Counts bytes. From the second write on, each write waits for the gate.
struct Gated {
    gate: Option<Receiver<()>>,
    writes: usize,
    bytes: u64,
}

impl Write for Gated {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writes += 1;
        if self.writes > 1
            && let Some(gate) = &self.gate
        {
            gate.recv().ok();
        }
        self.bytes += bytes.len() as u64;
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

/// Waits for space in the rings for at most a second: after that a queue is full and the workers are not to blame.
fn wait_for_room(intake: &mut Intake) {
    let since = Instant::now();
    while intake.is_full() && since.elapsed() < Duration::from_secs(1) {
        std::thread::sleep(Duration::from_micros(200));
    }
}

#[test]
#[ignore = "half a minute, and its memory is that of the process: docs/reliability.md"]
fn a_disk_that_stalls_thirty_seconds_at_200_markers_and_1000_hz() {
    let (frames, motion) = Frames::new(200, 1000.0);
    // Lossless last: its blocks are the largest.
    for codec in [dense(0.5), lossless()] {
        let before = resident_bytes().0;
        let (open, gate) = bounded(0);
        let output = Gated { gate: Some(gate), writes: 0, bytes: 0 };
        let (mut intake, pipeline) = start(&config(&motion, codec), output);
        for seq in 0..30_000 {
            wait_for_room(&mut intake);
            frames.feed(&mut intake, seq);
        }
        let lost = intake.counts().ring_full;
        drop(open);
        for seq in 30_000..32_000 {
            wait_for_room(&mut intake);
            frames.feed(&mut intake, seq);
        }
        intake.finish();
        let (written, output) = pipeline.finish().unwrap();
        let used = resident_bytes().1 - before;
        println!(
            "200 markers x 1000 Hz, {}, disk stalled 30 s: {lost} frames lost, {} recorded, {:.1} MB written, \
             at most {:.0} MB of memory",
            codec.kind,
            written.ledger.recorded,
            output.bytes as f64 / 1e6,
            used as f64 / 1e6
        );
        assert!(written.ledger.closes(), "{:?}", written.ledger);
        assert_eq!((lost, written.ledger.recorded), (0, 32_000));
        assert!(used < 300_000_000, "{used} bytes");
    }
}

#[test]
#[ignore = "minutes: docs/reliability.md"]
fn a_day_of_64_markers_at_240_hz_in_compressed_time() {
    let hours = std::env::var("MOCAPD_HOURS").ok().and_then(|hours| hours.parse().ok());
    let hours: u64 = hours.unwrap_or(24);
    let (frames, motion) = Frames::new(64, 240.0);
    let output = Gated { gate: None, writes: 0, bytes: 0 };
    let (mut intake, pipeline) = start(&config(&motion, dense(1.0)), output);
    let (mut after_a_minute, mut most) = (0, 0);
    let n_frames = hours * 3600 * 240;
    for seq in 0..n_frames {
        while intake.is_full() {
            std::thread::yield_now();
        }
        frames.feed(&mut intake, seq);
        // Every minute of the recording.
        if seq % (240 * 60) == 0 {
            let now = resident_bytes().0;
            most = most.max(now);
            if seq == 240 * 60 {
                after_a_minute = now;
            }
        }
    }
    intake.finish();
    let (written, output) = pipeline.finish().unwrap();
    let grown = most.saturating_sub(after_a_minute);
    println!(
        "{hours} h of 64 markers x 240 Hz: {} frames, {:.1} MB, memory {:.1} MB after a minute, {:.2} MB more at most",
        written.ledger.recorded,
        output.bytes as f64 / 1e6,
        after_a_minute as f64 / 1e6,
        grown as f64 / 1e6
    );
    assert!(written.ledger.closes(), "{:?}", written.ledger);
    assert_eq!(written.ledger.recorded, n_frames);
    assert!(grown < 5_000_000, "{grown} bytes");
}
