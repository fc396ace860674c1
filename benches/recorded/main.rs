//! What a recorded minute's bytes are for: a simulated device on a pty, `mocapd record`, `mocapd info`.
//!
//! `cargo bench --bench recorded -- [--seconds 60] [--tolerance 1mm] [TAKE:HZ...]`
//!
//! Without takes, generated motion: 15 markers at 60 Hz, and 64 at 240 Hz. A take is resampled to HZ
//! and begins again when it ends. Each runs for as long as it records.

#![expect(clippy::print_stdout, reason = "a tool that prints its result")]
#![expect(clippy::print_stderr, reason = "a tool that tells how far it is")]

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
/// Markers and rate of what is generated: the published study's, and one group of channels.
const GENERATED: [(usize, f64); 2] = [(15, 60.0), (64, 240.0)];
/// What the first row of the table says.
const KINDS: [&str; 8] =
    ["blocks", "time_line", "framing", "header", "index", "ledgers", "clock", "events"];

struct Subject {
    name: String,
    motion: Motion,
    rate_hz: f64,
}

fn main() -> anyhow::Result<()> {
    let (mut seconds, mut tolerance, mut subjects) = (60.0, "1mm".to_owned(), Vec::new());
    let mut args = std::env::args().skip(1).filter(|arg| arg != "--bench");
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--seconds" => seconds = args.next().context("--seconds needs a number")?.parse()?,
            "--tolerance" => tolerance = args.next().context("--tolerance needs a length")?,
            word if word.starts_with('-') => bail!("unknown option {word}"),
            word => subjects.push(recorded(word)?),
        }
    }
    if subjects.is_empty() {
        for (n_markers, rate_hz) in GENERATED {
            let spec = JumpSpec { n_markers, seconds: Some(seconds), ..JumpSpec::new(1, rate_hz) };
            let motion = spec.generate()?.motion;
            subjects.push(Subject { name: "generated jumps".to_owned(), motion, rate_hz });
        }
    }
    let mut table = format!(
        "| {seconds} s at {tolerance} | markers | Hz | file, bytes | {} | time line and framing | arrivals off, us |\n|{}\n",
        KINDS.join(" | ").replace('_', " "),
        "---|".repeat(KINDS.len() + 6)
    );
    for subject in subjects {
        eprintln!("{} at {} Hz", subject.name, subject.rate_hz);
        table += &measure(subject, seconds, &tolerance)?;
    }
    println!("{table}");
    Ok(())
}

/// `TAKE:HZ`.
fn recorded(word: &str) -> anyhow::Result<Subject> {
    let (path, rate_hz) = word.rsplit_once(':').with_context(|| format!("{word}: no :HZ"))?;
    let path = Path::new(path);
    let rate_hz = rate_hz.parse().with_context(|| format!("{word}: no rate after the colon"))?;
    let (motion, _) = source::read(path)?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Ok(Subject { name, motion, rate_hz })
}

/// A row of the table.
fn measure(subject: Subject, seconds: f64, tolerance: &str) -> anyhow::Result<String> {
    let Subject { name, motion, rate_hz } = subject;
    let folder = tempfile::tempdir()?;
    let take = folder.path().join("minute.take");
    let settings =
        DeviceSettings { rate_hz: Some(rate_hz), looping: true, ..DeviceSettings::default() };
    let line = PtyLine::open(None)?;
    let uri = format!("serial:{}", line.path().display());
    let stop = Arc::new(AtomicBool::new(false));
    let served = simulate(Device::new(motion, settings)?, line, Arc::clone(&stop))?;
    let length = format!("{seconds}s");
    let words = ["record", "--json", "--device", &uri, "--seconds", &length];
    let recording = Command::new(MOCAPD)
        .args(words)
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
    let file_bytes = info["file_bytes"].as_u64().context("info tells no file_bytes")?;
    ensure!(KINDS.iter().map(|kind| bytes(kind)).sum::<u64>() == file_bytes, "other bytes: {info}");
    let cells: Vec<String> = KINDS.iter().map(|kind| bytes(kind).to_string()).collect();
    let share = 100.0 * (bytes("time_line") + bytes("framing")) as f64 / file_bytes as f64;
    // What the time line's bytes follow: how far arrivals lie from the line through the device's time.
    let residual_us = info["ledger"]["clock"]["residual_us"].as_f64().unwrap_or(f64::NAN);
    let markers = &info["markers"];
    let cells = cells.join(" | ");
    Ok(format!(
        "| {name} | {markers} | {rate_hz} | {file_bytes} | {cells} | **{share:.1} %** | {residual_us:.0} |\n"
    ))
}

/// The device, until it is told to stop.
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
