//! Kills `mocapd record` with SIGKILL at any instant: the take can be read, nothing older than a stretch and a sync
//! is lost, and every frame in it is the one that was sent. The reference is the simulator's log.
//!
//! Each `cargo test` runs a few kills; this command runs five hundred, or as many as `MOCAPD_KILLS` says:
//!
//! ```text
//! cargo test --release --test integration -- --ignored --nocapture kills::five_hundred
//! ```

use std::{
    collections::HashMap,
    fmt::Write as _,
    io::{Cursor, Write},
    path::Path,
    process::{Child, Command, Stdio},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, sleep},
    time::{Duration, Instant},
};

use mocapd_acquire::{host_clock::monotonic_ns, inspect::Summary};
use mocapd_drivers::device::PoseStatus;
use mocapd_simulator::{
    device::{Device, DeviceSettings, TICK_HZ},
    generator::{JumpSpec, Occlusion, RigidBodies, Rng},
    pty::{ServeOptions, serve_pty},
    sampled::SampledSource,
    source::Residuals,
};
use mocapd_take::{
    TakeEvent, TakeFrames, TakeMap,
    damage::Problem,
    motion::{FrameSource, GAP, Motion, is_gap},
    poses::{Pose as StoredPose, PoseState},
    reader::read_events,
    recovery::RecoveryScan,
    sampled::{GroupSamples, Recording},
};

use crate::support::distance_mm;

const RATE_HZ: f64 = 1000.0;
const MARKERS: usize = 64;
const TOLERANCE_MM: f64 = 0.5;

/// Longest time from the first byte of the take to the kill.
const KILLED_WITHIN: Duration = Duration::from_millis(2500);

/// Options of the recorder besides device and take, and the permitted loss: stretch plus sync, in milliseconds.
const MODES: [(&[&str], u64); 4] = [
    (&[], 1000),
    (&["--lossless"], 1000),
    (&["--stretch", "100ms", "--sync", "200ms"], 300),
    (&["--resampler", "fast"], 1000),
];

/// Delay by a machine that does other things at the same time: it schedules the recorder's threads late. Beyond that,
/// only late arrivals of frames and the duration of a sync are allowed for.
const SCHEDULING_DELAY_MAX: Duration = Duration::from_millis(500);

fn motion() -> Motion {
    let occlusion = Some(Occlusion { fraction: 0.05, mean_gap_s: 0.1 });
    let spec =
        JumpSpec { seconds: Some(2.0), occlusion, n_markers: MARKERS, ..JumpSpec::new(1, RATE_HZ) };
    spec.generate().unwrap().motion
}

/// Sampled channels sent beside the frames.
fn electrodes() -> SampledSource {
    SampledSource::electrodes(1, "4@1kHz".parse().unwrap(), 7).unwrap()
}

/// Rigid bodies, whose poses are sent behind each frame.
fn bodies() -> RigidBodies {
    let occlusion = Some(Occlusion { fraction: 0.05, mean_gap_s: 0.1 });
    RigidBodies::new(&JumpSpec { occlusion, ..JumpSpec::new(1, RATE_HZ) }, 3).unwrap()
}

/// The residuals of the markers.
fn residuals(motion: &Motion) -> Residuals {
    Residuals::generated(11, motion)
}

/// A log that is read while it is written.
#[derive(Debug, Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A frame as it was sent: its sequence number, and when.
#[derive(Debug, Clone, Copy)]
struct Sent {
    seq: usize,
    host_ns: u64,
    dropped: bool,
}

impl Log {
    /// The frames sent, by device time.
    fn frames(&self) -> HashMap<u64, Sent> {
        let bytes = self.0.lock().unwrap();
        let frame = |line: &str| {
            let cells: Vec<u64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
            let sent = Sent { seq: cells[1] as usize, host_ns: cells[5], dropped: cells[4] == 1 };
            (cells[2], sent)
        };
        std::str::from_utf8(&bytes).unwrap().lines().skip(1).map(frame).collect()
    }
}

/// The cost of one kill.
#[derive(Debug, Default, Clone, Copy)]
struct Cost {
    /// Age of the oldest lost frame when the recorder was killed; 0 when none was lost.
    lost_ms: f64,
    /// Age of the oldest lost sample of the sampled channels, of the poses or of the residuals.
    lost_sampled_ms: f64,
    /// The largest delay of a frame on its way to the recorder in the last second: caused by the machine.
    late_ms: f64,
    /// The longest time that a thread which sleeps for 1 ms at a time was not run, in the last second before the kill.
    stall_ms: f64,
    /// The longest sync of another file on the same disk: no stretch is written meanwhile.
    sync_ms: f64,
    frames: usize,
    samples: usize,
    sampled: u64,
    max_error_mm: f64,
}

/// Records, kills the recorder at the seed's instant, and compares the take with what was sent.
fn kill(motion: &Motion, folder: &Path, seed: u64) -> Cost {
    let mut rng = Rng::new(seed);
    let (options, allowed_ms) = MODES[seed as usize % MODES.len()];
    let take = folder.join(format!("{seed}.take"));
    let log = Log::default();
    let (stall_ms, sync_ms);
    let killed_ns = {
        let settings = DeviceSettings {
            looping: true,
            sampled: vec![electrodes()],
            bodies: Some(Arc::new(bodies())),
            residuals: Some(Arc::new(residuals(motion))),
            queue_bytes: Some(64 << 20),
            ..DeviceSettings::default()
        };
        let mut device = Device::new(motion.clone(), settings).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let (stopped, logged) = (Arc::clone(&stop), log.clone());
        let (path_in, path) = crossbeam_channel::bounded(1);
        let served = thread::Builder::new()
            .name("simulator".to_owned())
            .spawn(move || {
                let log: Option<Box<dyn Write + Send>> = Some(Box::new(logged));
                let options = ServeOptions { log, ..ServeOptions::default() };
                let on_ready = |path: &Path| path_in.send(path.to_owned()).unwrap();
                serve_pty(&mut device, None, options, &stopped, on_ready).unwrap();
            })
            .unwrap();
        let uri = format!("serial:{}", path.recv().unwrap().display());
        let mut recorder = Recorder::start(&uri, &take, options);
        recorder.wait_for(&take);
        let until = Instant::now() + KILLED_WITHIN.mul_f64(rng.unit());
        (stall_ms, sync_ms) = thread::scope(|scope| {
            let syncs = scope.spawn(|| sync_until(folder, until));
            (sleep_until(until), syncs.join().unwrap())
        });
        let killed_ns = recorder.kill();
        // Include the frames on their way in the log.
        sleep(Duration::from_millis(20));
        stop.store(true, Ordering::Relaxed);
        served.join().unwrap();
        killed_ns
    };
    let cost = Cost {
        stall_ms,
        sync_ms,
        ..check(motion, &std::fs::read(&take).unwrap(), &log.frames(), killed_ns, seed)
    };
    let machine_ms = cost.late_ms.max(cost.stall_ms) + cost.sync_ms;
    let most_ms = allowed_ms as f64 + machine_ms + SCHEDULING_DELAY_MAX.as_secs_f64() * 1e3;
    assert!(cost.lost_ms.max(cost.lost_sampled_ms) <= most_ms, "seed {seed}: {cost:?}");
    std::fs::remove_file(&take).ok();
    cost
}

/// Sleeps until then, and returns the longest time it was not run in the last second, in milliseconds.
fn sleep_until(until: Instant) -> f64 {
    let mut stall_ms: f64 = 0.0;
    while let Some(left) = until.checked_duration_since(Instant::now()).filter(|t| !t.is_zero()) {
        let before = Instant::now();
        sleep(left.min(Duration::from_millis(1)));
        if left < Duration::from_secs(1) {
            stall_ms = stall_ms.max(before.elapsed().as_secs_f64() * 1e3 - 1.0);
        }
    }
    stall_ms
}

/// Syncs a file of its own ten times a second until then, and returns the longest sync in milliseconds.
fn sync_until(folder: &Path, until: Instant) -> f64 {
    let mut file = tempfile::tempfile_in(folder).unwrap();
    let mut sync_ms: f64 = 0.0;
    while Instant::now() < until {
        let before = Instant::now();
        file.write_all(&[0; 512]).unwrap();
        file.sync_data().unwrap();
        sync_ms = sync_ms.max(before.elapsed().as_secs_f64() * 1e3);
        sleep(Duration::from_millis(100).min(until.saturating_duration_since(Instant::now())));
    }
    sync_ms
}

fn check(
    motion: &Motion,
    take: &[u8],
    sent: &HashMap<u64, Sent>,
    killed_ns: u64,
    seed: u64,
) -> Cost {
    let summary = Summary::read(take).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
    let torn = |problem: &Problem| match problem {
        Problem::Damaged { offset, len, .. } => offset + len == take.len() as u64,
        other => *other == Problem::CutOff,
    };
    assert!(summary.take.problems.iter().all(torn), "seed {seed}: {:?}", summary.take.problems);
    assert_eq!(summary.contradictions(), [""; 0], "seed {seed}");
    assert!(!summary.take.finished, "seed {seed}");

    let mut recorded = Vec::new();
    read_events(take, |event| {
        if let TakeEvent::Stretch(stretch) = event {
            let times = stretch.timeline.iter().flat_map(mocapd_take::timeline::Timeline::recorded);
            recorded.extend(times.map(|(row, t)| (row, t.device_ticks, t.arrival_10us)));
        }
        Ok(())
    })
    .unwrap();
    let mut frames = TakeFrames::open(Cursor::new(take)).unwrap();
    let mut row = vec![GAP; frames.info().markers.len()];
    let mut rows = Vec::new();
    while frames.next_frame(&mut row).unwrap() {
        rows.push(row.clone());
    }
    let mut cost = Cost { frames: recorded.len(), ..Cost::default() };
    let mut last = None;
    let recent = recorded.len().saturating_sub(RATE_HZ as usize);
    for (i, &(index, ticks, arrival_10us)) in recorded.iter().enumerate() {
        let Some(Sent { seq, dropped, host_ns }) = sent.get(&ticks) else {
            panic!("seed {seed}: no frame of tick {ticks} was sent");
        };
        assert!(!dropped, "seed {seed}: frame {seq} never left");
        if i >= recent {
            let late_ns = (arrival_10us * 10_000).saturating_sub(*host_ns);
            cost.late_ms = cost.late_ms.max(late_ns as f64 / 1e6);
        }
        // Rows follow the device's counter.
        let first = last.get_or_insert((index, *seq));
        assert_eq!(index - first.0, (seq - first.1) as u64, "seed {seed}: row {index}");
        let original = motion.frame(seq % motion.n_frames());
        for (&got, &expected) in rows[index as usize].iter().zip(original) {
            assert_eq!(is_gap(got), is_gap(expected), "seed {seed}: row {index}");
            if !is_gap(got) {
                cost.max_error_mm = cost.max_error_mm.max(distance_mm(got, expected));
                cost.samples += 1;
            }
        }
    }
    assert!(cost.max_error_mm <= TOLERANCE_MM, "seed {seed}: {} mm", cost.max_error_mm);
    assert_eq!(summary.samples(), cost.samples as u64, "seed {seed}");

    // The oldest frame sent after the last one in the take, or the first of all.
    let next_seq = recorded.last().map_or(0, |(_, ticks, _)| sent[ticks].seq + 1);
    let next = sent.values().find(|frame| frame.seq == next_seq);
    cost.lost_ms = next.map_or(0.0, |next| killed_ns.saturating_sub(next.host_ns) as f64 / 1e6);

    cost.sampled = check_sampled(take, seed);
    cost.sampled += check_poses(take, seed);
    let map = TakeMap::scan(&mut Cursor::new(take)).unwrap();
    for group in map.sample_groups() {
        cost.lost_sampled_ms = cost.lost_sampled_ms.max(lost_ms((group, take), sent, killed_ns));
    }
    let seqs: Vec<(u64, usize)> =
        recorded.iter().map(|(row, ticks, _)| (*row, sent[ticks].seq)).collect();
    cost.sampled += check_residuals((motion, take), &seqs, seed);

    let scan = RecoveryScan::read(take).unwrap();
    let mut new = Vec::new();
    scan.write(Cursor::new(take), &mut new, "tests").unwrap();
    let new = Summary::read(&new[..]).unwrap();
    assert_eq!(new.take.problems, [], "seed {seed}");
    assert_eq!(new.contradictions(), [""; 0], "seed {seed}");
    assert_eq!(new.samples(), summary.samples(), "seed {seed}");
    let groups = new.take.sample_ledger.clone().map_or(Vec::new(), |ledger| ledger.groups);
    let stored: u64 = groups.iter().map(|group| group.stored).sum();
    assert_eq!(stored, cost.sampled, "seed {seed}: {groups:?}");
    let ledger = new.take.ledger.unwrap();
    assert!(ledger.closes() && ledger.recorded == cost.frames as u64, "seed {seed}: {ledger:?}");
    cost
}

/// Every sample is the one that was sent, and none lies between two that is missing. Returns how many there are.
fn check_sampled(take: &[u8], seed: u64) -> u64 {
    let map = TakeMap::scan(&mut Cursor::new(take)).unwrap();
    let Some(group) = map.recorded_groups().next() else { return 0 };
    let mut recorded: Vec<(u64, Vec<f32>)> = Vec::new();
    let undecodable = group
        .read(&mut Cursor::new(take), |first, n, decoded| {
            let decoded = decoded.unwrap_or_else(|| panic!("seed {seed}: lost samples"));
            for row in 0..n {
                let columns = decoded.chunks_exact(n as usize);
                let values = columns.map(|column| column[row as usize]).collect();
                recorded.push((first + row, values));
            }
            Ok(())
        })
        .unwrap();
    assert_eq!(undecodable, [], "seed {seed}");
    let (Some((first, _)), Some((last, _))) = (recorded.first(), recorded.last()) else {
        return 0;
    };
    assert_eq!(last + 1 - first, recorded.len() as u64, "seed {seed}");
    // The take counts from its first sample, the device from its start.
    let mut source = Vec::new();
    electrodes().samples(0, last + 5_000, &mut source);
    let n_channels = group.group.channels.len();
    let equal = |skipped: usize| {
        let rows = source.chunks_exact(n_channels).skip(skipped);
        rows.zip(&recorded).all(|(row, (_, values))| row == values)
    };
    assert!((0..4_000).any(equal), "seed {seed}: samples that were not sent");

    recorded.len() as u64
}

/// The age of the oldest lost sample of a group, in milliseconds: that of the first frame sent behind the group's last sample.
fn lost_ms(
    (group, take): (&GroupSamples, &[u8]),
    sent: &HashMap<u64, Sent>,
    killed_ns: u64,
) -> f64 {
    let mut last = None;
    let read = |first, n, decoded: Option<&[f32]>| {
        last = decoded.map(|_| first + n - 1).or(last);
        Ok(())
    };
    group.read(&mut Cursor::new(take), read).unwrap();
    let end = last.and_then(|last| group.clock(TICK_HZ).at(last)).map(|time| time.device_ticks);
    let is_lost = |ticks: &u64| end.is_none_or(|end| *ticks > end);
    let after = sent.iter().filter(|(ticks, _)| is_lost(ticks)).map(|(_, frame)| frame.host_ns);
    let lost_ns = after.min().map_or(0, |oldest| killed_ns.saturating_sub(oldest));
    lost_ns as f64 / 1e6
}

/// Every pose is the one that was sent, bit for bit or within its bounds, and none lies between two that is missing. Returns
/// how many frames have them.
fn check_poses(take: &[u8], seed: u64) -> u64 {
    let map = TakeMap::scan(&mut Cursor::new(take)).unwrap();
    let Some(group) = map.pose_groups().next() else { return 0 };
    let [bound_mm, _] = group.group.pose_bounds().unwrap_or_default();
    let mut recorded: Vec<Vec<StoredPose>> = Vec::new();
    let undecodable = group
        .read_poses(&mut Cursor::new(take), |first, _, poses| {
            assert_eq!(first, recorded.len() as u64, "seed {seed}: lost poses");
            recorded.extend(poses.unwrap().chunks_exact(3).map(<[StoredPose]>::to_vec));
            Ok(())
        })
        .unwrap();
    assert_eq!(undecodable, [], "seed {seed}");
    let (bodies, mut sent) = (bodies(), Vec::new());
    let mut equal = |number: u64, stored: &[StoredPose]| {
        bodies.poses(number, RATE_HZ, &mut sent);
        (1..).zip(stored).all(|(id, stored)| {
            let pose = sent.iter().find(|pose| pose.body == id);
            let pose = pose.filter(|pose| pose.status == PoseStatus::Tracked);
            match (pose, stored.state == PoseState::Tracked) {
                (Some(pose), true) => distance_mm(pose.position_mm, stored.position_mm) <= bound_mm,
                (pose, is_tracked) => pose.is_some() == is_tracked,
            }
        })
    };
    // The take counts from its first frame, the device from its start.
    let all = |from: u64, equal: &mut dyn FnMut(u64, &[StoredPose]) -> bool| {
        (from..).zip(&recorded).all(|(number, stored)| equal(number, stored))
    };
    assert!((0..1_000).any(|from| all(from, &mut equal)), "seed {seed}: poses that were not sent");
    recorded.len() as u64
}

/// The residuals of every row are those of its frame, and up to some row every row has them. `seqs` has the rows and the numbers
/// of their frames. Returns how many samples there are.
fn check_residuals((motion, take): (&Motion, &[u8]), seqs: &[(u64, usize)], seed: u64) -> u64 {
    let map = TakeMap::scan(&mut Cursor::new(take)).unwrap();
    let group = map.recorded_groups().find(|group| group.group.has_residuals());
    let Some(group) = group else { return 0 };
    let mut n_stored = 0;
    let count = |_, n, decoded: Option<&[f32]>| {
        n_stored += if decoded.is_some() { n } else { 0 };
        Ok(())
    };
    assert_eq!(group.read(&mut Cursor::new(take), count).unwrap(), [], "seed {seed}");
    let recording = Recording::open(&map, Cursor::new(take.to_vec())).unwrap().unwrap();
    let mut rows = recording.residuals(&(0..map.n_rows), MARKERS).unwrap();
    let residuals = residuals(motion);
    let rows: Vec<Vec<u8>> = (0..map.n_rows).map(|_| rows.next_row().unwrap().to_vec()).collect();
    let mut n_reported = 0;
    for &(row, seq) in seqs {
        let original = motion.frame(seq % motion.n_frames());
        let sent = residuals.frame((seq % motion.n_frames()) as u64);
        let found = &rows[row as usize];
        for ((&found, &sent), &position) in found.iter().zip(sent).zip(original) {
            let is_missing = is_gap(position) || row >= group.n_samples();
            assert_eq!(found, if is_missing { 0 } else { sent }, "seed {seed}: row {row}");
            n_reported += u64::from(found > 0);
        }
    }
    assert!(n_reported > 0 || n_stored == 0 || seqs.is_empty(), "seed {seed}");
    n_stored
}

/// A running `mocapd record`, killed on drop.
struct Recorder(Child);

impl Recorder {
    fn start(uri: &str, take: &Path, options: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_mocapd"));
        command.args(["record", "--residuals", "-d", uri, "-o"]).arg(take).args(options);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        Self(command.spawn().unwrap())
    }

    /// Waits for the first byte.
    fn wait_for(&mut self, take: &Path) {
        let since = Instant::now();
        while std::fs::metadata(take).map_or(0, |meta| meta.len()) == 0 {
            assert_eq!(self.0.try_wait().unwrap(), None, "it ended before the first byte");
            assert!(since.elapsed() < Duration::from_secs(60), "no byte is written");
            sleep(Duration::from_millis(1));
        }
    }

    /// Kills the recorder, and returns the host's monotonic time just before.
    fn kill(&mut self) -> u64 {
        let killed_ns = monotonic_ns();
        self.0.kill().unwrap();
        self.0.wait().unwrap();
        killed_ns
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// Runs the kills of these seeds, `at_once` at a time, and reports their cost.
fn kills(seeds: std::ops::Range<u64>, at_once: usize) -> String {
    let motion = motion();
    let folder = tempfile::tempdir().unwrap();
    let since = Instant::now();
    let next = AtomicU64::new(seeds.start);
    let costs = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..at_once {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= seeds.end {
                        return;
                    }
                    let cost = kill(&motion, folder.path(), seed);
                    costs.lock().unwrap().push((seed, cost));
                }
            });
        }
    });
    let costs = costs.into_inner().unwrap();
    assert_eq!(costs.len() as u64, seeds.end - seeds.start);
    let mut report = String::new();
    for (mode, (options, allowed_ms)) in MODES.iter().enumerate() {
        let of_mode = |cost: &&(u64, Cost)| cost.0 as usize % MODES.len() == mode;
        let mut lost: Vec<f64> = costs.iter().filter(of_mode).map(|cost| cost.1.lost_ms).collect();
        lost.sort_by(f64::total_cmp);
        let over = lost.iter().filter(|lost_ms| **lost_ms > *allowed_ms as f64).count();
        writeln!(
            report,
            "{options:?}: {} kills, lost {:.0} ms (median) to {:.0} ms (most); {over} more than {allowed_ms} ms",
            lost.len(),
            lost.get(lost.len() / 2).unwrap_or(&0.0),
            lost.last().unwrap_or(&0.0)
        )
        .unwrap();
        for (seed, cost) in
            costs.iter().filter(of_mode).filter(|c| c.1.lost_ms > *allowed_ms as f64)
        {
            writeln!(report, "  seed {seed}: {cost:?}").unwrap();
        }
    }
    let frames: usize = costs.iter().map(|(_, cost)| cost.frames).sum();
    let samples: usize = costs.iter().map(|(_, cost)| cost.samples).sum();
    let sampled: u64 = costs.iter().map(|(_, cost)| cost.sampled).sum();
    let sampled_ms = costs.iter().map(|(_, cost)| cost.lost_sampled_ms).fold(0.0, f64::max);
    let max_error_mm = costs.iter().map(|(_, cost)| cost.max_error_mm).fold(0.0, f64::max);
    writeln!(
        report,
        "{} takes, all readable; {frames} frames, {samples} samples, none wrong (max error {max_error_mm:.4} mm); {sampled} of sampled channels, none wrong, lost {sampled_ms:.0} ms at most; {:.0} s",
        costs.len(),
        since.elapsed().as_secs_f64()
    )
    .unwrap();
    report
}

#[test]
fn a_few() {
    eprintln!("{}", kills(0..8, 2));
}

#[test]
#[ignore = "minutes: see the command above"]
fn five_hundred() {
    let n: u64 = std::env::var("MOCAPD_KILLS").map_or(500, |n| n.parse().expect("MOCAPD_KILLS"));
    eprintln!("{}", kills(1000..1000 + n, 2));
}
