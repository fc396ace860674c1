//! A device, its line, its host and its disk in virtual time, in front of the pipeline of a service: one of them
//! stalls.

use std::{
    io::{self, Write},
    sync::{Arc, Condvar, Mutex},
    time::{Duration, Instant},
};

use mocapd_acquire::{
    clock::Prober,
    header,
    pipeline::{
        ArmedHandles, Intake, NewTake, Pipeline, PipelineConfig, PreRollConfig, TakeAccount,
        TakeHandle, TakeOutput,
    },
};
use mocapd_drivers::device::{Frame, MarkerSample};
use mocapd_take::record::{Channel, Device, EndingKind, Header};

use crate::support::{Seeded, TICK_HZ, fast, output_of};

const RATE_HZ: f64 = 25.0;
const SECOND_NS: f64 = 1e9;

/// The host's monotonic clock at the start: a day of uptime.
const BEGUN_NS: f64 = 86_400e9;

/// Frames that a pty buffers for an absent reader: 4 KiB, 40 bytes each.
const LINE_FRAMES: usize = 100;

/// How long a read waits for data.
const READ_NS: f64 = 20e6;

/// Time that the pipeline's threads get after a stall of the whole process, in virtual seconds.
const CATCH_UP_S: f64 = 0.3;

/// What stalls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stalled {
    /// The disk: a write takes that long.
    Disk,
    /// Every thread, as by SIGSTOP.
    Process,
    /// The thread that reads the device.
    Reader,
    /// The device: it sends its frames and answers when it resumes.
    Device,
}

/// One run.
#[derive(Debug, Clone, Copy)]
pub(super) struct World {
    pub(super) seed: u64,
    pub(super) stalled: Stalled,
    /// When the stall begins and ends, in seconds.
    pub(super) stall_s: (f64, f64),
    pub(super) start_s: f64,
    /// Requested pre-roll in seconds.
    pub(super) pre_roll_s: f64,
    pub(super) save_s: Option<f64>,
    pub(super) stop_s: f64,
    /// Whether another take begins where that one ends, until the end of the run.
    pub(super) splits: bool,
    /// When the device's clock jumps ahead by 5 s.
    pub(super) jump_s: Option<f64>,
    pub(super) drift_ppm: f64,
    /// Interval at which the line sends its data; at once if 0.
    pub(super) batch_ms: f64,
    /// Mean delay that a busy machine adds to the minimum of 40 us, each way.
    pub(super) jitter_us: f64,
}

/// A take that was closed.
pub(super) struct Ended {
    pub(super) name: &'static str,
    pub(super) take: Vec<u8>,
    pub(super) written: TakeAccount,
    /// The host's clock when the reader ended it.
    pub(super) until_ns: u64,
}

/// Writes to memory; waits while the disk stalls.
pub(super) struct Gated {
    disk: Arc<Disk>,
    bytes: Vec<u8>,
}

#[derive(Default)]
struct Disk {
    stalls: Mutex<bool>,
    moved: Condvar,
}

impl Disk {
    fn stall(&self, stalls: bool) {
        *self.stalls.lock().unwrap() = stalls;
        self.moved.notify_all();
    }

    fn wait(&self) {
        let stalls = self.stalls.lock().unwrap();
        drop(self.moved.wait_while(stalls, |stalls| *stalls).unwrap());
    }
}

impl Write for Gated {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.disk.wait();
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl TakeOutput for Gated {
    fn sync(&mut self) -> io::Result<()> {
        self.disk.wait();
        Ok(())
    }
}

fn between(rng: &mut Seeded, from: f64, to: f64) -> f64 {
    from + (to - from) * (rng.next() as f64 / u64::MAX as f64)
}

#[derive(Debug, Clone, Copy)]
enum Command {
    /// With this pre-roll in seconds.
    Start(f64),
    SaveLast,
    Stop,
}

/// Data in transit to the host.
enum Sent {
    Frame { seq: u32, device_ticks: u64 },
    Pong { ping_ns: u64, device_ticks: u64 },
}

impl World {
    /// Each kind of stall around each command, in turn; the rest by the seed.
    pub(super) fn of(seed: u64) -> Self {
        let mut rng = Seeded::new(seed);
        let stalled =
            [Stalled::Disk, Stalled::Process, Stalled::Reader, Stalled::Device][seed as usize % 4];
        let from_s = between(&mut rng, 1.0, 60.0);
        let to_s = from_s + between(&mut rng, 1.0, 30.0);
        // Shortly before it, in it, or shortly after it.
        let around_s = match rng.below(4) {
            0 => from_s - between(&mut rng, 0.0, 1.0),
            3 => to_s + between(&mut rng, 0.0, 1.0),
            _ => between(&mut rng, from_s, to_s),
        };
        let earlier_s = between(&mut rng, 0.2, from_s.min(around_s));
        let later_s = to_s.max(around_s) + between(&mut rng, 0.5, 8.0);
        let any_s = between(&mut rng, earlier_s, later_s);
        let jump_s = between(&mut rng, from_s - 1.0, later_s);
        let (start_s, save_s, stop_s) = match seed / 4 % 4 {
            0 => (around_s, None, later_s),
            1 => (earlier_s, Some(around_s), later_s),
            2 => (earlier_s, None, around_s),
            _ => (earlier_s, Some(any_s), between(&mut rng, any_s, later_s)),
        };
        Self {
            seed,
            stalled,
            stall_s: (from_s, to_s),
            start_s,
            pre_roll_s: [0.0, 0.0, 4.0][rng.below(3)],
            save_s,
            stop_s,
            splits: rng.below(2) == 0,
            jump_s: (rng.below(4) == 0).then_some(jump_s),
            drift_ppm: [-200.0, -37.0, 0.0, 200.0][rng.below(4)],
            batch_ms: [0.0, 1.0, 16.0][rng.below(3)],
            jitter_us: [30.0, 300.0, 3_000.0][rng.below(3)],
        }
    }

    fn at_ns(s: f64) -> f64 {
        BEGUN_NS + s * SECOND_NS
    }

    fn device_ticks(&self, host_ns: f64) -> u64 {
        let passed_s = (host_ns - BEGUN_NS) / SECOND_NS;
        let jumped_s = if self.jump_s.is_some_and(|at_s| passed_s >= at_s) { 5.0 } else { 0.0 };
        let device_s = 1_000.0 + passed_s / (1.0 + self.drift_ppm * 1e-6) + jumped_s;
        (device_s * TICK_HZ as f64) as u64
    }

    /// When the stalled component resumes.
    fn resumed_ns(&self, stalled: &[Stalled], ns: f64) -> f64 {
        let (from_ns, to_ns) = (Self::at_ns(self.stall_s.0), Self::at_ns(self.stall_s.1));
        if stalled.contains(&self.stalled) && (from_ns..to_ns).contains(&ns) { to_ns } else { ns }
    }

    fn delay_ns(&self, rng: &mut Seeded) -> f64 {
        40e3 - 1e3 * self.jitter_us * between(rng, 1e-9, 1.0).ln()
    }

    /// When the data that the device has at that time reaches the host.
    fn arrival_ns(&self, ready_ns: f64, rng: &mut Seeded) -> f64 {
        let batch_ns = self.batch_ms * 1e6;
        let ready_ns = self.resumed_ns(&[Stalled::Device], ready_ns);
        let sent_ns =
            if batch_ns > 0.0 { (ready_ns / batch_ns).ceil() * batch_ns } else { ready_ns };
        sent_ns + self.delay_ns(rng)
    }

    /// Whether the disk stalls at that time.
    fn disk_stalls(&self, now_ns: f64) -> bool {
        let catch_up_s = if self.stalled == Stalled::Process { CATCH_UP_S } else { 0.0 };
        let (from_s, to_s) = self.stall_s;
        matches!(self.stalled, Stalled::Disk | Stalled::Process)
            && (Self::at_ns(from_s)..Self::at_ns(to_s + catch_up_s)).contains(&now_ns)
    }

    /// When the run ends.
    fn end_s(&self) -> f64 {
        self.stop_s.max(self.stall_s.1) + 2.0
    }

    fn commands(&self) -> Vec<(f64, Command)> {
        let mut commands =
            vec![(self.start_s, Command::Start(self.pre_roll_s)), (self.stop_s, Command::Stop)];
        commands.extend(self.save_s.map(|save_s| (save_s, Command::SaveLast)));
        if self.splits {
            commands.push((self.stop_s, Command::Start(0.0)));
        }
        // A stop comes before the start at the same time.
        commands.sort_by(|a, b| a.0.total_cmp(&b.0));
        commands
    }

    /// The takes that were closed, in the order in which they were.
    pub(super) fn run(&self) -> Vec<Ended> {
        let mut rng = Seeded::new(self.seed ^ 0x5eed);
        let disk = Arc::new(Disk::default());
        let (mut intake, pipeline, mut armed) = arm();
        let mut prober = Prober::new();
        let mut under_way: Vec<(f64, Sent)> = Vec::new();
        let (mut now_ns, mut in_order_ns, mut next_seq) = (BEGUN_NS, 0.0_f64, 0_u32);
        let mut due = self.commands();
        let (mut live, mut closed) = (None, Vec::new());
        let end_s = self.end_s();
        while now_ns < Self::at_ns(end_s) {
            while let ready_ns = BEGUN_NS + f64::from(next_seq) / RATE_HZ * SECOND_NS
                && ready_ns < now_ns + 2.0 * READ_NS
            {
                in_order_ns = self.arrival_ns(ready_ns, &mut rng).max(in_order_ns);
                let device_ticks = self.device_ticks(ready_ns);
                under_way.push((in_order_ns, Sent::Frame { seq: next_seq, device_ticks }));
                next_seq += 1;
            }
            under_way.sort_by(|a, b| a.0.total_cmp(&b.0));
            let next_ns = under_way.first().map_or(f64::INFINITY, |sent| sent.0);
            now_ns = now_ns.max(next_ns.min(now_ns + READ_NS));
            now_ns = self.resumed_ns(&[Stalled::Process, Stalled::Reader], now_ns);
            disk.stall(self.disk_stalls(now_ns));

            // Commands come on a separate thread; if the process is stopped, after it resumes.
            while let Some(&(_, command)) = due.first().filter(|due| Self::at_ns(due.0) <= now_ns) {
                due.remove(0);
                match command {
                    Command::Start(pre_roll_s) => {
                        let take = || new_take(&disk, pre_roll_s, now_ns);
                        live = Some(patiently(|| armed.takes.begin(take())));
                    }
                    Command::SaveLast => {
                        let take = || new_take(&disk, 5.0, now_ns);
                        let saved = patiently(|| armed.takes.save(take()));
                        closed.push(("the saved take", saved, now_ns as u64));
                    }
                    Command::Stop => {
                        patiently(|| armed.takes.end(EndingKind::Stopped));
                        closed.extend(live.take().map(|live| ("the take", live, now_ns as u64)));
                    }
                }
            }

            let here = under_way.partition_point(|sent| sent.0 <= now_ns);
            for (index, (_, sent)) in under_way.drain(..here).enumerate() {
                match sent {
                    Sent::Frame { .. } if index >= LINE_FRAMES => {}
                    Sent::Frame { seq, device_ticks } => {
                        while !self.disk_stalls(now_ns) && intake.is_full() {
                            std::thread::yield_now();
                        }
                        give(&mut intake, seq, device_ticks, now_ns as u64);
                    }
                    Sent::Pong { ping_ns, device_ticks } => {
                        if prober.answered(ping_ns, now_ns as u64) {
                            intake.probe(device_ticks, ping_ns, now_ns as u64);
                        }
                    }
                }
            }
            intake.tick(now_ns as u64);
            if intake.wants_probes() {
                prober.restart_schedule();
            }
            if let Some(due_ns) = prober.due(now_ns as u64) {
                now_ns = now_ns.max(due_ns as f64);
                let ping_ns = now_ns as u64;
                prober.sent(ping_ns);
                let heard_ns = now_ns + self.delay_ns(&mut rng);
                let heard_ns = self.resumed_ns(&[Stalled::Device], heard_ns);
                let device_ticks = self.device_ticks(heard_ns);
                let arrival_ns = self.arrival_ns(heard_ns, &mut rng);
                under_way.push((arrival_ns, Sent::Pong { ping_ns, device_ticks }));
            }
        }
        disk.stall(false);
        closed.extend(live.map(|live| ("the last take", live, now_ns as u64)));
        drop(intake);
        let ended = closed.iter().map(|(name, begun, until_ns)| {
            let (written, output) = end_of(begun);
            Ended { name, take: output.bytes, written, until_ns: *until_ns }
        });
        let ended = ended.collect();
        pipeline.join().unwrap();
        ended
    }
}

/// The writer works in real time and lags the virtual clock.
fn patiently<T>(mut order: impl FnMut() -> anyhow::Result<T>) -> T {
    let since = Instant::now();
    loop {
        match order() {
            Ok(done) => return done,
            Err(error) => assert!(since.elapsed() < Duration::from_secs(30), "{error}"),
        }
        std::thread::yield_now();
    }
}

fn end_of(begun: &TakeHandle) -> (TakeAccount, Gated) {
    let (written, output) = begun.ended.recv_timeout(Duration::from_secs(30)).unwrap().unwrap();
    (written, output_of(output))
}

fn config() -> PipelineConfig {
    let channel = Channel { marker_id: 0, label: "head".to_owned(), labelled: true };
    let pre_roll = PreRollConfig { time: Duration::from_secs(5), bytes_max: 1 << 20 };
    PipelineConfig {
        pre_roll: Some(pre_roll),
        workers: 1,
        ..PipelineConfig::new(fast(1.0), RATE_HZ, TICK_HZ, vec![channel])
    }
}

fn header() -> Header {
    let config = config();
    let mut header = header::new(&config.codec, config.rate_hz).unwrap();
    header.stretch_rows = config.stretch_rows();
    header.device = Some(Device { tick_hz: TICK_HZ, ..Device::default() });
    header
}

fn arm() -> (Intake, Pipeline, ArmedHandles) {
    Pipeline::arm(&config(), &header()).unwrap()
}

fn new_take(disk: &Arc<Disk>, pre_roll_s: f64, requested_ns: f64) -> NewTake {
    let output = Gated { disk: Arc::clone(disk), bytes: Vec::new() };
    NewTake {
        pre_roll: Duration::from_secs_f64(pre_roll_s),
        requested_ns: requested_ns as u64,
        ..NewTake::new(output, header())
    }
}

fn give(intake: &mut Intake, seq: u32, device_ticks: u64, arrival_ns: u64) {
    let at = f64::from(seq) / RATE_HZ;
    let position_mm = [100.0 * at.sin() as f32, 100.0 * at.cos() as f32, 1500.0];
    let markers = [MarkerSample { position_mm, ..MarkerSample::default() }];
    intake.frame(&Frame { seq, device_ticks, timecode: None, markers: &markers }, arrival_ns);
}

/// Round trips that [`flooded`] measures: twice as many as wait for the writer.
pub(super) const FLOOD: u64 = 2_048;

/// A take whose disk stalls while there are more clock observations than the queue holds.
pub(super) fn flooded() -> (Vec<u8>, TakeAccount) {
    let disk = Arc::new(Disk::default());
    let (mut intake, pipeline, mut armed) = arm();
    let mut next_seq = 0;
    let mut read = |intake: &mut Intake, n_frames: u32, trips: u64| {
        for _ in 0..n_frames {
            let at_ns = 1_000_000_000 + u64::from(next_seq) * 40_000_000;
            let ticks = at_ns / 1000;
            give(intake, next_seq, ticks, at_ns + 90_000);
            for trip in 0..trips {
                // Each gives a slightly tighter bound than the previous one.
                let requested_ns = at_ns + trip * 200_000;
                intake.probe(
                    ticks + trip * 200 + 50,
                    requested_ns,
                    requested_ns + 200_000 - trip * 1_000,
                );
            }
            next_seq += 1;
        }
    };
    read(&mut intake, 1, 0);
    let begun = armed.takes.begin(new_take(&disk, 0.0, 1e9)).unwrap();
    read(&mut intake, 50, 0);
    begun.first.recv_timeout(Duration::from_secs(30)).unwrap();
    disk.stall(true);
    read(&mut intake, FLOOD as u32 / 8, 8);
    disk.stall(false);
    armed.takes.end(EndingKind::Stopped).unwrap();
    read(&mut intake, 1, 0);
    let (written, output) = end_of(&begun);
    drop(intake);
    pipeline.join().unwrap();
    (output.bytes, written)
}
