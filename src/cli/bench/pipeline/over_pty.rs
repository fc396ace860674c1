//! One recording over a pty: the simulated device, `record`, and this program beside them.

use std::{
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::Duration,
};

use anyhow::{Context, bail, ensure};
use mocapd_codec::{ResamplerKind, Settings};
use mocapd_drivers::uri::{DeviceUri, Location};
use mocapd_service::process;
use serde::Deserialize;

use super::{super::reference::bare_read_cpu_percent, Args, report::PtyRun};
use crate::cli::record::{LatencyReport, ProcessReport};

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

/// How long the bare loop reads.
const BARE_READ: Duration = Duration::from_secs(5);

/// A child that does not outlive its measurement.
struct Simulator(Child);

impl Drop for Simulator {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// A take that is gone when it was measured.
struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        std::fs::remove_file(&self.0).ok();
    }
}

pub(super) fn over_pty(args: &Args, codec: &Settings) -> anyhow::Result<PtyRun> {
    let own = std::env::current_exe().context("cannot find the program itself")?;
    let (simulator, uri) = simulate(&own, args)?;
    let bare_read = bare_read_cpu_percent(&uri, BARE_READ.min(args.seconds))?;
    let simulator_usage = || process::usage(Some(simulator.0.id())).unwrap_or_default();
    let before = simulator_usage();
    let take = Scratch(args.dir.join(format!(".mocapd-bench-{}.take", std::process::id())));
    let recorded = record(&own, &uri, &take.0, codec)?;
    let after = simulator_usage();
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

/// Starts the device, and reads from it where it is.
fn simulate(own: &Path, args: &Args) -> anyhow::Result<(Simulator, DeviceUri)> {
    let spawned = Command::new(own)
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
    Ok((simulator, DeviceUri { location, driver: None }))
}

fn record(
    own: &Path,
    uri: &DeviceUri,
    take: &Path,
    codec: &Settings,
) -> anyhow::Result<RecordJson> {
    let output = Command::new(own)
        .args(["record", "--json", "--device", &uri.to_string(), "--output"])
        .arg(take)
        .args(codec_words(codec))
        .stdin(Stdio::null())
        .output()
        .context("cannot start the recording")?;
    if output.stdout.is_empty() {
        let said = String::from_utf8_lossy(&output.stderr);
        let said = said.trim().trim_start_matches("mocapd: ");
        bail!("the recording failed with {}: {said}", output.status);
    }
    serde_json::from_slice(&output.stdout).context("the recording's report cannot be read")
}

fn codec_words(codec: &Settings) -> Vec<String> {
    match codec.kind {
        ResamplerKind::Lossless => vec!["--lossless".to_owned()],
        kind => {
            vec![format!("--resampler={kind}"), format!("--tolerance={}mm", codec.tolerance.mm())]
        }
    }
}
