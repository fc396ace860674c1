//! `mocapd-sim serve`: serves a simulated device on a line.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use clap::{Args, ValueEnum};
use line::LineArgs;
use mocapd_simulator::device::{LineDevice, SentLog};
use mocapd_simulator::line::{ServeOptions, serve};
use mocapd_simulator::source::Generated;
use mocapd_take::escape::visible;

use super::{Failure, length_mm, seconds};

mod device;
mod input;
mod line;
mod stop;

#[derive(Debug, Args)]
pub(super) struct ServeArgs {
    /// The motion to play, a .take, .c3d, .trc, .tsv or .csv file; or a log of `mocapd record --raw` to replay.
    #[arg(required_unless_present = "generate", conflicts_with = "generate")]
    take: Option<PathBuf>,
    /// Generate the motion: standing long jumps, `jump` or `jump:SEED`.
    #[arg(long, value_name = "jump[:SEED]")]
    generate: Option<Generated>,
    #[command(flatten)]
    line: LineArgs,
    /// The device's protocol.
    #[arg(long, value_enum, value_name = "NAME", default_value_t = DeviceProtocol::Dvmc)]
    protocol: DeviceProtocol,
    /// With --protocol ndi: the marker with this label is a tool (repeatable); all others are strays.
    #[arg(long, value_name = "LABEL")]
    tool: Vec<String>,
    /// With --protocol ndi: do not support BX2, like systems before the Vega.
    #[arg(long)]
    no_bx2: bool,
    /// The device's serial number.
    #[arg(long, value_name = "TEXT", default_value = "SIM0001")]
    serial: String,
    /// Resample the motion to this rate, 1 to 10000 Hz.
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// Play this many times faster; the device's rate scales with it.
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    speed: f64,
    /// Limit the line to this speed, and refuse frame rates that do not fit; an NDI system refuses higher line speeds.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(50..))]
    baud: Option<u32>,
    /// Drift of the device's clock against the host's, ppm: positive is slow, negative is fast.
    ///
    /// `mocapd info` reports the same number as the clock's drift.
    #[arg(long, value_name = "P", default_value_t = 0.0, allow_hyphen_values = true)]
    drift_ppm: f64,
    /// Hand over waiting bytes every M milliseconds only, as an FTDI adapter does with 16; 0 for at once.
    #[arg(long, value_name = "M", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=1000))]
    batch_ms: u64,
    /// Inject the faults of this script, in TOML as described in docs/faults.md.
    #[arg(long, value_name = "SCRIPT")]
    faults: Option<PathBuf>,
    /// Restart after the last frame, and never end.
    #[arg(long = "loop")]
    looping: bool,
    /// Encoding of positions; by default f32, or compact with --baud.
    #[arg(long, value_enum, value_name = "FORM")]
    wire: Option<WireFormat>,
    /// Log what became of every frame, to a new CSV file.
    ///
    /// The columns are run, seq, `device_ticks`, present, dropped (the frame never left the device), `host_ns` (the
    /// host's monotonic clock at `device_ticks`) and unasked (an NDI system's frame after the last request); with
    /// --faults also fate, again, faults and frames.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Duration of the generated motion (default: one jump), or play only the first N seconds of a file.
    #[arg(long, value_name = "N", value_parser = seconds)]
    seconds: Option<f64>,
    /// Number of generated markers.
    #[arg(long, value_name = "N", conflicts_with = "take")]
    markers: Option<usize>,
    /// Standard deviation of the generated noise on each axis [default: 0.05mm].
    #[arg(long, value_name = "LENGTH", conflicts_with = "take", value_parser = length_mm)]
    noise: Option<f64>,
    /// Fraction of the generated samples that is occluded, 0 to 0.9.
    #[arg(long, value_name = "PART", conflicts_with = "take")]
    occlusion: Option<f64>,
    /// Exit after one run, once the host has read everything.
    #[arg(long, conflicts_with = "looping")]
    once: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum DeviceProtocol {
    /// The link protocol of mocapd.
    Dvmc,
    /// The Combined API of NDI Polaris and Vega systems.
    Ndi,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum WireFormat {
    /// Millimetres as f32, unchanged.
    F32,
    /// Whole micrometres.
    Um,
    /// Whole micrometres, as differences between markers: the fewest bytes.
    Compact,
}

pub(super) fn run(args: &ServeArgs) -> Result<(), Failure> {
    let stop = stop::on_signal()?;
    let log = input::log(args)?;
    let (mut device, description): (Box<dyn LineDevice>, String) = match &log {
        Some(log) => input::log_device(args, log)?,
        None => device::device(args, input::motion(args)?, input::script(args)?)?,
    };
    let (mut line, name) = args.line.open(&args.serial)?;
    // Created last, so that a failed start leaves no log behind.
    let mut frames: Option<Box<dyn Write + Send>> = None;
    if let Some(path) = &args.log {
        // Recordings are checked against a log: never overwrite one.
        let file = File::create_new(path).with_context(|| {
            format!("cannot write {}: choose the name of a new file", path.display())
        })?;
        frames = Some(Box::new(BufWriter::new(file)));
    }
    log_line(&description);
    let mut stdout = io::stdout();
    let printed = writeln!(stdout, "{name}").and_then(|()| stdout.flush());
    printed.context("cannot print the line's name")?;
    let batch = Some(args.batch_ms).filter(|ms| *ms > 0).map(Duration::from_millis);
    let options = ServeOptions { baud: args.baud, batch, once: args.once, log: frames };
    let sent = serve(&mut *line, device.as_mut(), options, &stop)?;
    if device.is_gone() {
        log_line(
            "the log has no end of stream, so the device is gone: serve it again to record again",
        );
    }
    let summary = match log {
        Some(_) => summary_of_log(&sent),
        None => summary_of_motion(&sent, args.protocol),
    };
    summary.lines().for_each(log_line);
    Ok(())
}

/// Writes a line to stderr, and ignores errors: it may be closed.
fn log_line(text: &str) {
    drop(writeln!(io::stderr(), "mocapd-sim: {}", visible(text)));
}

/// Summary of a replayed log, in which frames are unknown.
fn summary_of_log(sent: &SentLog) -> String {
    format!("{}: {} bytes of the log sent", runs(sent), sent.bytes_sent)
}

fn runs(sent: &SentLog) -> String {
    let starts = sent.starts;
    format!("{starts} {}", if starts == 1 { "run" } else { "runs" })
}

/// Summary of a played motion: produced frames and their sum by fate; with faults, a second line.
fn summary_of_motion(sent: &SentLog, protocol: DeviceProtocol) -> String {
    let SentLog { total, frames_sent, bytes_sent, .. } = sent;
    let runs = runs(sent);
    let why = match protocol {
        DeviceProtocol::Dvmc => "queue full",
        DeviceProtocol::Ndi => "not fetched before the next",
    };
    let mut text = format!(
        "{runs}: {} frames produced, {frames_sent} sent in {bytes_sent} bytes, {} dropped by the device \
         ({why}), {} not sent",
        total.frames_produced,
        total.frames_dropped,
        sent.frames_waiting + sent.frames_discarded
    );
    if protocol == DeviceProtocol::Ndi {
        let unasked = total.frames_unasked;
        text.push_str(&format!(", {unasked} after the last request (unknown to any recorder)"));
    }
    if let Some(faults) = &sent.faults {
        text = format!("{text}\n{}", faults.summary());
    }
    text
}
