//! How the bytes of a recorded minute divide among blocks, time line, framing and the rest of the take: a simulated
//! device on a pseudo-terminal, `mocapd record`, `mocapd info`.
//!
//! `cargo bench --bench recorded -- [--seconds 60] [--tolerance 1mm] [TAKE:HZ...]`
//!
//! Without a TAKE the motion is generated: 15 markers at 60 Hz, and 64 at 240 Hz. A given take is resampled to HZ and
//! repeats when it ends. Each recording runs in real time.

#![expect(clippy::print_stdout, reason = "a tool that prints its result")]
#![expect(clippy::print_stderr, reason = "a tool that reports its progress")]

use std::{
    path::Path,
    process::Command,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
};

use anyhow::{Context, anyhow, bail, ensure};
use mocapd_simulator::{
    device::{Device, DeviceSettings, SentLog},
    generator::JumpSpec,
    pty::{PtyError, PtyLine, ServeOptions, serve},
    source,
};
use mocapd_take::motion::Motion;
use serde_json::Value;

const MOCAPD: &str = env!("CARGO_BIN_EXE_mocapd");
/// Markers and rate in Hz of the generated motions: those of the published study, and one full group of channels.
const GENERATED: [(usize, f64); 2] = [(15, 60.0), (64, 240.0)];
/// Columns of the table: the kinds of bytes in `bytes` of `mocapd info --json`.
const KINDS: [&str; 8] =
    ["blocks", "time_line", "framing", "header", "index", "ledgers", "clock", "events"];

struct BenchMotion {
    name: String,
    motion: Motion,
    rate_hz: f64,
}

fn main() -> anyhow::Result<()> {
    let (mut seconds, mut tolerance, mut motions) = (60.0, "1mm".to_owned(), Vec::new());
    let mut args = std::env::args().skip(1).filter(|arg| arg != "--bench");
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--seconds" => seconds = args.next().context("--seconds needs a number")?.parse()?,
            "--tolerance" => tolerance = args.next().context("--tolerance needs a length")?,
            option if option.starts_with('-') => bail!("unknown option {option}"),
            take => motions.push(recorded(take)?),
        }
    }
    if motions.is_empty() {
        for (n_markers, rate_hz) in GENERATED {
            let spec = JumpSpec { n_markers, seconds: Some(seconds), ..JumpSpec::new(1, rate_hz) };
            let motion = spec.generate()?.motion;
            motions.push(BenchMotion { name: "generated jumps".to_owned(), motion, rate_hz });
        }
    }
    let mut table = format!(
        "| {seconds} s at {tolerance} | markers | Hz | file, bytes | {} | time line and framing | arrivals off, us |\n|{}\n",
        KINDS.join(" | ").replace('_', " "),
        "---|".repeat(KINDS.len() + 6)
    );
    for motion in motions {
        eprintln!("{} at {} Hz", motion.name, motion.rate_hz);
        table += &measure(motion, seconds, &tolerance)?;
    }
    println!("{table}");
    Ok(())
}

/// Reads the take of an argument `TAKE:HZ`.
fn recorded(arg: &str) -> anyhow::Result<BenchMotion> {
    let (path, rate_hz) = arg.rsplit_once(':').with_context(|| format!("{arg}: no :HZ"))?;
    let path = Path::new(path);
    let rate_hz = rate_hz.parse().with_context(|| format!("{arg}: no rate after the colon"))?;
    let (motion, _) = source::read(path)?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Ok(BenchMotion { name, motion, rate_hz })
}

/// Records the motion in real time and returns its row of the table.
fn measure(motion: BenchMotion, seconds: f64, tolerance: &str) -> anyhow::Result<String> {
    let BenchMotion { name, motion, rate_hz } = motion;
    let folder = tempfile::tempdir()?;
    let take = folder.path().join("minute.take");
    let settings =
        DeviceSettings { rate_hz: Some(rate_hz), looping: true, ..DeviceSettings::default() };
    let line = PtyLine::open(None)?;
    let uri = format!("serial:{}", line.path().display());
    let stop = Arc::new(AtomicBool::new(false));
    let served = simulate(Device::new(motion, settings)?, line, Arc::clone(&stop))?;
    let length = format!("{seconds}s");
    let record = ["record", "--json", "--device", &uri, "--seconds", &length];
    let recording = Command::new(MOCAPD)
        .args(record)
        .args(["--tolerance", tolerance, "--output"])
        .arg(&take)
        .output();
    stop.store(true, Ordering::Relaxed);
    served.join().map_err(|_| anyhow!("the simulator panicked"))??;
    let report = json(&recording?.stdout, "record")?;
    ensure!(report["ledger"]["closes"] == true, "the ledger does not close: {report}");
    let info = Command::new(MOCAPD).args(["info", "--json"]).arg(&take).output()?;
    let info = json(&info.stdout, "info")?;
    let bytes = |kind: &str| info["bytes"][kind].as_u64().unwrap_or_default();
    let file_bytes = info["file_bytes"].as_u64().context("info --json has no file_bytes")?;
    let counted: u64 = KINDS.iter().map(|kind| bytes(kind)).sum();
    ensure!(counted == file_bytes, "{counted} of {file_bytes} bytes are accounted for: {info}");
    let cells: Vec<String> = KINDS.iter().map(|kind| bytes(kind).to_string()).collect();
    let share = 100.0 * (bytes("time_line") + bytes("framing")) as f64 / file_bytes as f64;
    // The size of the time line depends on this: the deviation of the arrival times from the fitted line.
    let residual_us = info["ledger"]["clock"]["residual_us"].as_f64().unwrap_or(f64::NAN);
    let markers = &info["markers"];
    let cells = cells.join(" | ");
    Ok(format!(
        "| {name} | {markers} | {rate_hz} | {file_bytes} | {cells} | **{share:.1} %** | {residual_us:.0} |\n"
    ))
}

/// Runs the device in a thread until `stop` is set.
fn simulate(
    mut device: Device,
    mut line: PtyLine,
    stop: Arc<AtomicBool>,
) -> anyhow::Result<JoinHandle<Result<SentLog, PtyError>>> {
    let run = move || serve(&mut line, &mut device, ServeOptions::default(), &stop);
    Ok(thread::Builder::new().name("simulator".to_owned()).spawn(run)?)
}

fn json(stdout: &[u8], command: &str) -> anyhow::Result<Value> {
    serde_json::from_slice(stdout).with_context(|| format!("mocapd {command} failed"))
}
