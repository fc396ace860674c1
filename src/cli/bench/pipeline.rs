//! `bench pipeline`: simulator -> pty -> record -> disk, each in its own process, and the pipeline alone.
//!
//! Each figure is the median of the runs, with a reference measured in the same runs.

use std::{
    io::{self, BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use anyhow::{Context, bail, ensure};
use mocapd::outcome::Outcome;
use mocapd_acquire::{
    header,
    ledger::{GroupLedgerDocument, LedgerDocument, SampleLedgerDocument},
    pipeline::{NewTake, Pipeline, PipelineConfig},
};
use mocapd_codec::Settings;
use mocapd_drivers::{
    device::{DeviceEvent, Frame, MarkerSample, Protocol},
    link::{DeviceLink, FrameForm, HostLink},
    uri::{DeviceUri, Location},
};
use mocapd_service::{process, units};
use mocapd_simulator::{device::TICK_HZ, sampled::Electrodes};
use mocapd_take::motion::{Motion, is_gap};
use serde::{Deserialize, Serialize};

use super::{bare_read_cpu_percent, check, copy_gb_per_s, median};
use crate::cli::{
    output::{notify, print, print_json},
    record::{LatencyReport, ProcessReport},
    stop::stop_on_signal,
    values::{self, CodecArgs, tolerance_mm},
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Number of markers of the simulated device
    #[arg(long, value_name = "N", default_value = "200", value_parser = clap::value_parser!(u16).range(1..=10_000))]
    markers: u16,
    /// Frame rate of the simulated device: 240, 240Hz, 1kHz
    #[arg(long, value_name = "HZ", default_value = "1000Hz", value_parser = units::rate_hz,
          allow_hyphen_values = true)]
    rate: f64,
    /// Sampled channels of the simulated device, such as 16@2kHz: their number and rate (repeatable)
    #[arg(long, value_name = "N@HZ")]
    emg: Vec<Electrodes>,
    /// Length of each recording: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = values::length,
          allow_hyphen_values = true)]
    seconds: Duration,
    /// Number of runs; the medians are reported
    #[arg(long, value_name = "N", default_value = "5", value_parser = clap::value_parser!(u16).range(1..=99))]
    runs: u16,
    /// Folder for the temporary takes, which are removed again
    #[arg(long, value_name = "DIR", default_value = ".")]
    dir: PathBuf,
    #[command(flatten)]
    codec: CodecArgs,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Length of the in-process motion, s: long enough to outweigh the start, short enough for memory.
const IN_PROCESS_S: f64 = 10.0;

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let codec = args.codec.live_settings()?;
    ensure!(args.dir.is_dir(), "{} is not a folder: create it first", args.dir.display());
    check(args.markers, args.rate, args.seconds.as_secs_f64().max(IN_PROCESS_S))?;
    let stop = stop_on_signal()?;
    let motion = super::motion(args.markers.into(), args.rate, IN_PROCESS_S)?;
    let wire = wire(&motion)?;
    let mut in_process =
        InProcessReport { wire_bytes: wire.len() as u64, ..InProcessReport::default() };
    let mut pty = Vec::new();
    for run in 1..=args.runs {
        if !args.json {
            notify(&format!("run {run}/{}: recording {} s", args.runs, args.seconds.as_secs_f64()));
        }
        in_process.copy_gb_per_s.push(copy_gb_per_s(&wire));
        run_in_process(&motion, &wire, codec, &mut in_process)?;
        pty.push(over_pty(args, codec)?);
        if stop.load(Ordering::Relaxed) {
            bail!("interrupted after {run} of {} runs: no results", args.runs);
        }
    }
    let report = PipelineBenchReport {
        markers: args.markers,
        rate_hz: args.rate,
        emg: args.emg.iter().map(ToString::to_string).collect(),
        seconds: args.seconds.as_secs_f64(),
        runs: args.runs,
        resampler: codec.kind.to_string(),
        tolerance_mm: tolerance_mm(&codec),
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        pty,
        in_process,
    };
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.text())?;
    }
    Ok(Outcome::of(report.lost_anything()))
}

/// The frames of `motion` as link messages.
fn wire(motion: &Motion) -> anyhow::Result<Vec<u8>> {
    let mut link = DeviceLink::new();
    let mut out = Vec::new();
    for index in 0..motion.n_frames() {
        let markers: Vec<_> = motion.frame(index).iter().enumerate().map(sample).collect();
        let device_ticks = (index as f64 * TICK_HZ as f64 / motion.info.rate_hz).round() as u64;
        let frame = Frame { seq: index as u32, device_ticks, timecode: None, markers: &markers };
        link.frame(FrameForm::Float, &frame, &mut out)?;
    }
    Ok(out)
}

fn sample((column, &position_mm): (usize, &[f32; 3])) -> MarkerSample {
    let occluded = is_gap(position_mm);
    MarkerSample { id: column as u16, occluded, position_mm, ..MarkerSample::default() }
}

/// Feeds `wire` as fast as the rings accept it; unlike a recording it waits for a full ring, so that nothing is lost.
fn run_in_process(
    motion: &Motion,
    wire: &[u8],
    codec: Settings,
    report: &mut InProcessReport,
) -> anyhow::Result<()> {
    let rate_hz = motion.info.rate_hz;
    let config =
        PipelineConfig::new(codec, rate_hz, TICK_HZ, header::channels(&motion.info.markers));
    let mut header = header::new(&codec, rate_hz)?;
    header.channels.clone_from(&config.channels);
    let (mut intake, pipeline) = Pipeline::start(&config, NewTake::new(io::sink(), header))?;
    let mut link = HostLink::new();
    let started = Instant::now();
    // The size of a read from a pty.
    for bytes in wire.chunks(4095) {
        link.push(bytes, &mut |event| {
            if let DeviceEvent::Frame(frame) = event {
                while intake.is_full() {
                    std::thread::yield_now();
                }
                intake.frame(&frame, started.elapsed().as_nanos() as u64);
            }
        });
    }
    intake.set_link_counters(link.counters());
    intake.finish();
    let (written, _) = pipeline.finish().map_err(|failed| failed.error)?;
    let seconds = started.elapsed().as_secs_f64();
    report.times_real_time.push(motion.n_frames() as f64 / rate_hz / seconds);
    report.frames_lost += motion.n_frames() as u64 - written.ledger.recorded;
    Ok(())
}

/// The fields of `record --json` that benchmarks need.
#[derive(Debug, Deserialize)]
pub(super) struct RecordJson {
    pub(super) frames: u64,
    seconds: f64,
    raw_bytes: u64,
    file_bytes: u64,
    max_error_mm: f64,
    pub(super) ring_latency_us: LatencyReport,
    process: ProcessReport,
    pub(super) ledger: LedgerDocument,
    sample_ledger: Option<SampleLedgerDocument>,
}

/// How long the bare read loop runs.
const BARE_READ: Duration = Duration::from_secs(5);

/// A process, killed when dropped: the simulated device, or a service.
pub(super) struct KilledProcess(pub(super) Child);

impl Drop for KilledProcess {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// A take that is deleted when dropped.
pub(super) struct TemporaryTake(pub(super) PathBuf);

impl TemporaryTake {
    pub(super) fn in_folder(folder: &Path) -> Self {
        Self(folder.join(format!(".mocapd-bench-{}.take", std::process::id())))
    }
}

impl Drop for TemporaryTake {
    fn drop(&mut self) {
        std::fs::remove_file(&self.0).ok();
    }
}

fn over_pty(args: &Args, codec: Settings) -> anyhow::Result<PtyRun> {
    let own = std::env::current_exe().context("cannot find the mocapd executable")?;
    let device = ["--markers".to_owned(), args.markers.to_string(), "--rate".to_owned()];
    let length =
        [args.rate.to_string(), "--seconds".to_owned(), args.seconds.as_secs_f64().to_string()];
    let emg = args.emg.iter().flat_map(|electrodes| ["--emg".to_owned(), electrodes.to_string()]);
    let (simulator, path) = simulate(&own, device.into_iter().chain(length).chain(emg))?;
    let location = Location::Serial { path: path.into(), baud: None };
    let uri = DeviceUri { location, driver: None };
    let bare_read = bare_read_cpu_percent(&uri, BARE_READ.min(args.seconds))?;
    let simulator_usage = || process::usage(Some(simulator.0.id())).unwrap_or_default();
    let before = simulator_usage();
    let take = TemporaryTake::in_folder(&args.dir);
    let recorded = record(&own, &uri.to_string(), &take.0, &codec_args(codec))?;
    let after = simulator_usage();
    let groups = recorded.sample_ledger.as_ref().map_or(&[][..], |ledger| &ledger.groups);
    let samples = |of: fn(&GroupLedgerDocument) -> u64| groups.iter().map(of).sum();
    let percent = |cpu_s: f64| 100.0 * cpu_s / recorded.seconds;
    Ok(PtyRun {
        frames_sent: recorded.ledger.frames_sent,
        frames_recorded: recorded.frames,
        samples_taken: samples(|group| group.taken),
        samples_recorded: samples(|group| group.stored),
        ledger_closes: recorded.ledger.closes,
        record_cpu_percent: percent(recorded.process.cpu_s),
        record_peak_memory_mb: recorded.process.peak_memory_bytes as f64 / 1e6,
        bare_read_cpu_percent: bare_read,
        simulator_cpu_percent: percent(after.cpu_s - before.cpu_s),
        ring_latency_us: recorded.ring_latency_us,
        ratio: recorded.raw_bytes as f64 / recorded.file_bytes.max(1) as f64,
        max_error_mm: recorded.max_error_mm,
    })
}

/// Starts the simulated device, and reads from its output where it is: the path of a pty, or a URI.
pub(super) fn simulate(
    own: &Path,
    words: impl IntoIterator<Item = String>,
) -> anyhow::Result<(KilledProcess, String)> {
    let spawned = Command::new(own)
        .args(["bench", "device"])
        .args(words)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .context("cannot start the simulated device")?;
    let mut simulator = KilledProcess(spawned);
    let stdout = simulator.0.stdout.take().context("the simulated device has no output pipe")?;
    let mut place = String::new();
    BufReader::new(stdout).read_line(&mut place)?;
    let place = place.trim();
    ensure!(!place.is_empty(), "the simulated device did not start");
    Ok((simulator, place.to_owned()))
}

pub(super) fn record(
    own: &Path,
    uri: &str,
    take: &Path,
    codec: &[String],
) -> anyhow::Result<RecordJson> {
    let output = Command::new(own)
        .args(["record", "--json", "--device", uri, "--output"])
        .arg(take)
        .args(codec)
        .stdin(Stdio::null())
        .output()
        .context("cannot start the recording")?;
    if output.stdout.is_empty() {
        let message = String::from_utf8_lossy(&output.stderr);
        let message = message.trim().trim_start_matches("mocapd: ");
        bail!("the recording failed with {}: {message}", output.status);
    }
    serde_json::from_slice(&output.stdout).context("cannot parse the report of the recording")
}

fn codec_args(codec: Settings) -> Vec<String> {
    match codec.kind {
        kind if kind.is_lossless() => vec![format!("--resampler={kind}")],
        kind => {
            vec![format!("--resampler={kind}"), format!("--tolerance={}mm", codec.tolerance.mm())]
        }
    }
}

#[derive(Debug, Clone, Serialize)]
struct PtyRun {
    frames_sent: u64,
    frames_recorded: u64,
    samples_taken: u64,
    samples_recorded: u64,
    ledger_closes: bool,
    record_cpu_percent: f64,
    record_peak_memory_mb: f64,
    bare_read_cpu_percent: f64,
    simulator_cpu_percent: f64,
    ring_latency_us: LatencyReport,
    ratio: f64,
    max_error_mm: f64,
}

#[derive(Debug, Default, Serialize)]
struct InProcessReport {
    wire_bytes: u64,
    frames_lost: u64,
    times_real_time: Vec<f64>,
    copy_gb_per_s: Vec<f64>,
}

#[derive(Debug, Serialize)]
struct PipelineBenchReport {
    markers: u16,
    rate_hz: f64,
    emg: Vec<String>,
    seconds: f64,
    runs: u16,
    resampler: String,
    tolerance_mm: f64,
    cores: usize,
    pty: Vec<PtyRun>,
    in_process: InProcessReport,
}

impl PipelineBenchReport {
    /// Whether any frame or sample was lost.
    fn lost_anything(&self) -> bool {
        let lost = self.pty.iter().any(|run| {
            run.frames_recorded < run.frames_sent || run.samples_recorded < run.samples_taken
        });
        lost || self.in_process.frames_lost > 0
    }

    fn text(&self) -> String {
        let of = |figure: fn(&PtyRun) -> f64| median(self.pty.iter().map(figure));
        let sent: u64 = self.pty.iter().map(|run| run.frames_sent).sum();
        let recorded: u64 = self.pty.iter().map(|run| run.frames_recorded).sum();
        let taken: u64 = self.pty.iter().map(|run| run.samples_taken).sum();
        let stored: u64 = self.pty.iter().map(|run| run.samples_recorded).sum();
        let unbalanced = self.pty.iter().filter(|run| !run.ledger_closes).count();
        let alone = &self.in_process;
        format!(
            "{} markers at {}, {} s, {} {} mm, {} cores; medians of {} runs\n\
             over a pty to disk\n\
             \x20 frames lost                   {:>9}   of {sent} sent; ledgers that do not close: {unbalanced}\n\
             \x20 samples lost                  {:>9}   of {taken} of each channel\n\
             \x20 record, processor             {:>9.1} % of one core; reference: {:.1} % for reading the line alone\n\
             \x20 simulator, processor          {:>9.1} % of one core\n\
             \x20 record, peak memory           {:>9.1} MB\n\
             \x20 last byte of a frame to rings {:>9.1} us at p99; p50 {:.1} us, max {:.1} us\n\
             \x20 ratio, max error              {:>9.1} :1, {:.4} mm\n\
             in one process, no pty, {:.1} MB of frames\n\
             \x20 speed                         {:>9.1} times real time; reference: {:.1} GB/s for copying the frames; {} frames lost\n",
            self.markers,
            values::rate(self.rate_hz),
            self.seconds,
            self.resampler,
            self.tolerance_mm,
            self.cores,
            self.runs,
            sent.saturating_sub(recorded),
            taken.saturating_sub(stored),
            of(|run| run.record_cpu_percent),
            of(|run| run.bare_read_cpu_percent),
            of(|run| run.simulator_cpu_percent),
            of(|run| run.record_peak_memory_mb),
            of(|run| run.ring_latency_us.p99),
            of(|run| run.ring_latency_us.p50),
            of(|run| run.ring_latency_us.max),
            of(|run| run.ratio),
            of(|run| run.max_error_mm),
            alone.wire_bytes as f64 / 1e6,
            median(alone.times_real_time.iter().copied()),
            median(alone.copy_gb_per_s.iter().copied()),
            alone.frames_lost,
        )
    }
}
