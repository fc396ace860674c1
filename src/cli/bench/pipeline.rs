//! `bench pipeline`: simulator -> pty -> record -> disk, each in a process of its own, and the pipeline
//! alone; each figure the median of the runs, with a reference from the same run beside it.

use std::{
    io::{BufRead, BufReader},
    path::PathBuf,
    process::{Child, Command, Stdio},
    time::Duration,
};

use anyhow::{Context, ensure};
use mocapd::{outcome::Outcome, process, units};
use mocapd_codec::{ResamplerKind, Settings};
use mocapd_drivers::uri::{DeviceUri, Location};
use serde::{Deserialize, Serialize};

use super::{device, in_process, median, reference::bare_read_cpu_percent};
use crate::cli::{
    codec_args::CodecArgs,
    output::{print, print_json, say},
    record::{LatencyReport, ProcessReport},
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Markers of the simulated device
    #[arg(long, value_name = "N", default_value = "200", value_parser = clap::value_parser!(u16).range(1..=10_000))]
    markers: u16,
    /// Its frame rate
    #[arg(long, value_name = "HZ", default_value = "1000", value_parser = units::rate_hz)]
    rate: f64,
    /// Length of each recording
    #[arg(long, value_name = "TIME", default_value = "60", value_parser = units::duration)]
    seconds: Duration,
    /// Runs; the medians are told
    #[arg(long, value_name = "N", default_value = "5", value_parser = clap::value_parser!(u16).range(1..=99))]
    runs: u16,
    /// Where the takes are written; they are removed again
    #[arg(long, value_name = "DIR", default_value = ".")]
    dir: PathBuf,
    #[command(flatten)]
    codec: CodecArgs,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// What `record --json` says, as far as it is needed here.
#[derive(Debug, Deserialize)]
struct RecordJson {
    frames: u64,
    seconds: f64,
    raw_bytes: u64,
    file_bytes: u64,
    max_error_mm: f64,
    ring_latency_us: LatencyReport,
    process: ProcessReport,
    ledger: LedgerJson,
}

#[derive(Debug, Deserialize)]
struct LedgerJson {
    closes: bool,
    frames_sent: u64,
}

#[derive(Debug, Clone, Serialize)]
struct PtyRun {
    frames_sent: u64,
    frames_recorded: u64,
    ledger_closes: bool,
    record_cpu_percent: f64,
    record_peak_memory_mb: f64,
    bare_read_cpu_percent: f64,
    simulator_cpu_percent: f64,
    ring_latency_us: LatencyReport,
    ratio: f64,
    max_error_mm: f64,
}

#[derive(Debug, Serialize)]
struct InProcessReport {
    wire_bytes: u64,
    frames_lost: u64,
    times_real_time: Vec<f64>,
    copy_gb_per_s: Vec<f64>,
}

#[derive(Debug, Serialize)]
struct Report {
    markers: u16,
    rate_hz: f64,
    seconds: f64,
    runs: u16,
    resampler: String,
    tolerance_mm: f64,
    cores: usize,
    pty: Vec<PtyRun>,
    in_process: InProcessReport,
}

/// Length of the in-process motion: long enough to be past the start, short enough for memory.
const IN_PROCESS_S: f64 = 10.0;

/// How long the bare loop reads.
const BARE_READ: Duration = Duration::from_secs(5);

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let codec = args.codec.live_settings()?;
    let motion = device::motion(args.markers.into(), args.rate, IN_PROCESS_S)?;
    let wire = in_process::wire(&motion)?;
    let mut alone = Vec::new();
    for _ in 0..args.runs {
        alone.push(in_process::run(&motion, &wire, codec)?);
    }
    drop(motion);
    let mut pty = Vec::new();
    for run in 1..=args.runs {
        say(&format!("recording {} s, {run} of {}", args.seconds.as_secs(), args.runs));
        pty.push(over_pty(args, &codec)?);
    }
    let report = Report {
        markers: args.markers,
        rate_hz: args.rate,
        seconds: args.seconds.as_secs_f64(),
        runs: args.runs,
        resampler: codec.kind.to_string(),
        tolerance_mm: codec.tolerance.mm(),
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        pty,
        in_process: InProcessReport {
            wire_bytes: alone.first().map_or(0, |run| run.wire_bytes),
            frames_lost: alone.iter().map(|run| run.frames_lost).sum(),
            times_real_time: alone.iter().map(|run| run.times_real_time).collect(),
            copy_gb_per_s: alone.iter().map(|run| run.copy_gb_per_s).collect(),
        },
    };
    if args.json { print_json(&report)? } else { print(&words(&report))? }
    let lost = report.pty.iter().any(|run| run.frames_recorded < run.frames_sent);
    Ok(Outcome::of(lost || report.in_process.frames_lost > 0))
}

/// A child that does not outlive its measurement.
struct Simulator(Child);

impl Drop for Simulator {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

fn over_pty(args: &Args, codec: &Settings) -> anyhow::Result<PtyRun> {
    let own = std::env::current_exe().context("cannot find the program itself")?;
    let spawned = Command::new(&own)
        .args(["bench", "device", "--markers", &args.markers.to_string()])
        .args(["--rate", &args.rate.to_string()])
        .args(["--seconds", &args.seconds.as_secs_f64().to_string()])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .context("cannot start the simulated device")?;
    let mut simulator = Simulator(spawned);
    let stdout = simulator.0.stdout.take().context("the simulated device has no output")?;
    let mut path = String::new();
    BufReader::new(stdout).read_line(&mut path)?;
    let path = path.trim();
    ensure!(!path.is_empty(), "the simulated device did not start");

    let location = Location::Serial { path: path.into(), baud: None };
    let uri = DeviceUri { location, driver: None };
    let bare_read = bare_read_cpu_percent(&uri, BARE_READ.min(args.seconds))?;
    let simulator_usage = || process::usage(Some(simulator.0.id())).unwrap_or_default();
    let before = simulator_usage();
    let take = args.dir.join(format!(".mocapd-bench-{}.take", std::process::id()));
    let output = Command::new(&own)
        .args(["record", "--json", "--device", &uri.to_string(), "--output"])
        .arg(&take)
        .args(codec_words(codec))
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()
        .context("cannot start the recording")?;
    let after = simulator_usage();
    std::fs::remove_file(&take).ok();
    let recorded: RecordJson = serde_json::from_slice(&output.stdout)
        .with_context(|| format!("the recording ended with {}", output.status))?;
    let percent = |cpu_s: f64| 100.0 * cpu_s / recorded.seconds;
    Ok(PtyRun {
        frames_sent: recorded.ledger.frames_sent,
        frames_recorded: recorded.frames,
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

fn codec_words(codec: &Settings) -> Vec<String> {
    match codec.kind {
        ResamplerKind::Lossless => vec!["--lossless".to_owned()],
        kind => vec![
            format!("--resampler={kind}"),
            format!("--tolerance={}mm", codec.tolerance.mm()),
        ],
    }
}

fn words(report: &Report) -> String {
    let of = |figure: fn(&PtyRun) -> f64| median(report.pty.iter().map(figure));
    let sent: u64 = report.pty.iter().map(|run| run.frames_sent).sum();
    let recorded: u64 = report.pty.iter().map(|run| run.frames_recorded).sum();
    let open = report.pty.iter().filter(|run| !run.ledger_closes).count();
    let alone = &report.in_process;
    format!(
        "{} markers at {} Hz, {} s, {} {} mm, {} cores; medians of {} runs\n\
         over a pty to disk\n\
         \x20 frames lost                   {:>9}   of {sent} sent; ledgers that do not close: {open}\n\
         \x20 record, processor             {:>9.1} % of one core; reference: {:.1} % for reading the line alone\n\
         \x20 simulator, processor          {:>9.1} % of one core\n\
         \x20 record, peak memory           {:>9.1} MB\n\
         \x20 last byte of a frame to rings {:>9.1} us at p99; p50 {:.1} us, max {:.1} us\n\
         \x20 ratio, max error              {:>9.1} :1, {:.4} mm\n\
         in one process, no pty, {:.1} MB of frames\n\
         \x20 speed                         {:>9.1} times real time; reference: {:.1} GB/s for copying the frames; {} frames lost\n",
        report.markers,
        report.rate_hz,
        report.seconds,
        report.resampler,
        report.tolerance_mm,
        report.cores,
        report.runs,
        sent - recorded,
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
