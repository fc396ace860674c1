//! A simulated device on a pty, recorded by the daemon's own reader: the ledger against the simulator's log.

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

use mocapd_acquire::{
    record::{RecordOptions, Recorded, record},
    rig::Rig,
};
use mocapd_codec::Settings;
use mocapd_drivers::uri::DeviceUri;
use mocapd_simulator::{
    device::{Device, DeviceSettings, SentLog, TICK_HZ},
    pty::{ServeOptions, serve_pty},
};
use mocapd_take::compare::compare;
use mocapd_take::{
    TakeFrames,
    interchange::Format,
    motion::{Motion, MotionFrames},
    record::EndingKind,
};

use mocapd_testkit::recorded::RecordedData;

use crate::support::{chunks, dense, jump, lossless};

struct Simulated {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<SentLog>,
    uri: DeviceUri,
}

impl Simulated {
    fn start(motion: Motion, settings: DeviceSettings) -> Self {
        Self::on_line(motion, settings, ServeOptions::default())
    }

    fn on_line(motion: Motion, settings: DeviceSettings, options: ServeOptions) -> Self {
        let mut device =
            Device::new(motion, DeviceSettings { log_frames: true, ..settings }).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let (path_in, path) = crossbeam_channel::bounded::<PathBuf>(1);
        let stopped = Arc::clone(&stop);
        let thread = std::thread::Builder::new()
            .name("simulator".to_owned())
            .spawn(move || {
                let log = serve_pty(&mut device, None, options, &stopped, |path| {
                    path_in.send(path.to_owned()).unwrap();
                });
                log.unwrap()
            })
            .unwrap();
        let uri = format!("serial:{}", path.recv().unwrap().display()).parse().unwrap();
        Self { stop, thread, uri }
    }

    fn record(&self, codec: Settings, length: Option<Duration>) -> (Recorded, Vec<u8>) {
        let folder = tempfile::tempdir().unwrap();
        let take = folder.path().join("a.take");
        let mut options = RecordOptions {
            keep_free_bytes: 0,
            take: &take,
            codec,
            subject: None,
            length,
            stop: &AtomicBool::new(false),
            // On a loaded machine there may be notices of late frames.
            notify: &|_| {},
            how_to_end: "",
            how_to_set: |_| String::new(),
            started: &mut |_| {},
        };
        let recorded = record(Rig::open(&self.uri).unwrap(), &mut options).unwrap();
        (recorded, std::fs::read(&take).unwrap())
    }

    fn stop(self) -> SentLog {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

/// Asserts that the ledger agrees with the simulator's log, and that the rows are its frames.
fn assert_ledger(recorded: &Recorded, take: &[u8], log: &SentLog) {
    let ledger = &recorded.written.ledger;
    assert!(ledger.closes(), "{ledger:?}");
    assert_eq!(ledger.frames_sent, log.run.frames_produced);
    assert_eq!(ledger.dropped_by_device, log.run.frames_dropped);
    assert_eq!((ledger.lost_on_link, ledger.lost_ring_full, ledger.duplicates), (0, 0, 0));
    let run: Vec<_> = log.frames.iter().filter(|frame| frame.run == log.starts).collect();
    let rows: Vec<_> =
        chunks(take).timelines.iter().flat_map(mocapd_take::timeline::Timeline::recorded).collect();
    let sent = run.iter().filter(|frame| !frame.dropped).map(|frame| frame.device_ticks);
    assert!(rows.iter().map(|(_, time)| time.device_ticks).eq(sent), "other frames than were sent");
    let present: u64 = run.iter().filter(|f| !f.dropped).map(|f| u64::from(f.present)).sum();
    assert_eq!(ledger.samples_present, present);
}

#[test]
fn every_frame_of_a_replay_is_recorded() {
    let motion = jump(1, 200.0, 2.0);
    let simulated = Simulated::start(motion.clone(), DeviceSettings::default());
    let (recorded, take) = simulated.record(dense(0.5), None);
    assert_eq!(recorded.recording.ending, EndingKind::DeviceEnded);
    assert_ledger(&recorded, &take, &simulated.stop());
    let frames = TakeFrames::open(std::io::Cursor::new(&take)).unwrap();
    let difference = compare(frames, MotionFrames::new(&motion)).unwrap();
    assert!(difference.is_within(0.5), "{difference:?}");
}

#[test]
fn ten_times_faster_and_a_second_time() {
    let motion = jump(2, 100.0, 8.0);
    let settings = DeviceSettings { speed: 10.0, ..DeviceSettings::default() };
    let simulated = Simulated::start(motion.clone(), settings);
    simulated.record(lossless(), None);
    let (recorded, take) = simulated.record(lossless(), None);
    assert!((recorded.rate_hz - 1000.0).abs() < 1e-9);
    assert_ledger(&recorded, &take, &simulated.stop());
    let frames = TakeFrames::open(std::io::Cursor::new(&take)).unwrap();
    let difference = compare(frames, MotionFrames::new(&motion)).unwrap();
    assert!(difference.is_within(0.0), "{difference:?}");
}

#[test]
fn a_looped_replay_is_stopped_when_the_time_is_up() {
    let settings = DeviceSettings { looping: true, ..DeviceSettings::default() };
    let simulated = Simulated::start(jump(3, 250.0, 0.5), settings);
    let (recorded, take) = simulated.record(dense(0.5), Some(Duration::from_secs(1)));
    assert_eq!(recorded.recording.ending, EndingKind::Length);
    let frames = recorded.written.ledger.recorded;
    assert!((250..500).contains(&frames), "{frames}");
    assert_ledger(&recorded, &take, &simulated.stop());
}

/// The limits leave room for a machine that is busy with other tests: on an idle one the line is off by some
/// tens of microseconds.
#[test]
fn a_clock_that_drifts_on_a_line_that_sends_in_batches_is_followed() {
    for drift_ppm in [200.0, -200.0] {
        let settings = DeviceSettings { drift_ppm, looping: true, ..DeviceSettings::default() };
        let batch = Some(Duration::from_millis(16));
        let options = ServeOptions { batch, ..ServeOptions::default() };
        let simulated = Simulated::on_line(jump(4, 100.0, 1.0), settings, options);
        let (recorded, take) = simulated.record(dense(1.0), Some(Duration::from_secs(6)));
        let sent = simulated.stop();
        assert_eq!(recorded.written.ledger.lost_on_link, 0);

        let clocks = chunks(&take).clocks;
        let probes: usize = clocks.iter().map(|clock| clock.probes.len()).sum();
        assert!(clocks.iter().all(|clock| clock.segment == 0));
        assert!(probes >= 16, "{probes} round trips");
        let line = clocks.last().unwrap().line.unwrap();
        assert_eq!(Some(line), recorded.written.clock.line);
        // The truth: the host's clock at the ticks of a frame.
        for frame in sent.frames.iter().rev().take(200) {
            let ticks = frame.device_ticks.wrapping_sub(line.device_ticks).cast_signed() as f64;
            let passed_ns = ticks * 1e9 / TICK_HZ as f64 * (1.0 + line.drift_ppb as f64 * 1e-9);
            let found_ns = line.host_ns as f64 + passed_ns;
            let off_us = (found_ns - frame.host_ns as f64) / 1e3;
            assert!(off_us.abs() < 1_500.0, "{off_us} us off: {line:?}");
        }
        let found_ppm = line.drift_ppb as f64 * 1e-3;
        assert!((found_ppm - drift_ppm).abs() < 150.0, "{found_ppm} ppm instead of {drift_ppm}");
        // Batches are late by up to their length, and the arrival times are stored unchanged.
        let jitter = recorded.written.clock.jitter;
        assert!(jitter.p99_us > 8_000, "{jitter:?}");
    }
}

#[test]
fn a_real_run_is_recorded_at_its_own_rate_and_ten_times_faster() {
    let Some(folder) = RecordedData::Takes.folder() else { return };
    let file = std::fs::read(folder.join("treadmill_run_44m_200hz.trc")).unwrap();
    let motion = Format::Trc.read(&file).unwrap();
    for speed in [1.0, 10.0] {
        let settings = DeviceSettings { speed, ..DeviceSettings::default() };
        let simulated = Simulated::start(motion.clone(), settings);
        let (recorded, take) = simulated.record(dense(0.5), None);
        assert_eq!(recorded.written.ledger.recorded, 2105);
        assert_ledger(&recorded, &take, &simulated.stop());
        let frames = TakeFrames::open(std::io::Cursor::new(&take)).unwrap();
        let difference = compare(frames, MotionFrames::new(&motion)).unwrap();
        assert!(difference.is_within(0.5), "{difference:?}");
    }
}
