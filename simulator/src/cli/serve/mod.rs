//! `mocapd-sim serve`.

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
    /// The motion: a .take, .c3d, .trc, .tsv or .csv file; or a log of `mocapd record --raw`, to be that device again.
    #[arg(required_unless_present = "generate", conflicts_with = "generate")]
    take: Option<PathBuf>,
    /// Generate the motion: a standing long jump, `jump` or `jump:SEED`.
    #[arg(long, value_name = "jump[:SEED]")]
    generate: Option<Generated>,
    #[command(flatten)]
    line: LineArgs,
    /// What the device speaks.
    #[arg(long, value_enum, value_name = "NAME", default_value_t = Spoken::Dvmc)]
    protocol: Spoken,
    /// With --protocol ndi: this marker is a tool; give it again for more. All others are strays.
    #[arg(long, value_name = "LABEL")]
    tool: Vec<String>,
    /// With --protocol ndi: know no BX2, as systems before the Vega.
    #[arg(long)]
    no_bx2: bool,
    /// The device's serial number.
    #[arg(long, value_name = "TEXT", default_value = "SIM0001")]
    serial: String,
    /// Resample the motion to this rate, 1 to 10000 Hz.
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// Play this many times faster; the device's rate grows with it.
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    speed: f64,
    /// Carry no more than a serial line of this speed, and refuse rates that do not fit; an NDI system
    /// refuses higher speeds of its line.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(50..))]
    baud: Option<u32>,
    /// The device's clock loses this many ppm against the host's, or gains them when negative.
    ///
    /// `mocapd info` tells the same number as the clock's drift.
    #[arg(long, value_name = "P", default_value_t = 0.0, allow_hyphen_values = true)]
    drift_ppm: f64,
    /// Hand over what waits only every M milliseconds, as an FTDI adapter does with 16; 0 for at once.
    #[arg(long, value_name = "M", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=1000))]
    batch_ms: u64,
    /// What goes wrong, and when: a script in TOML, as docs/faults.md has it.
    #[arg(long, value_name = "SCRIPT")]
    faults: Option<PathBuf>,
    /// Begin again after the last frame, and never end.
    #[arg(long = "loop")]
    looping: bool,
    /// How positions travel; by default f32, and compact when --baud is given.
    #[arg(long, value_enum, value_name = "FORM")]
    wire: Option<Wire>,
    /// Write what became of every frame to a CSV file.
    ///
    /// Its columns: run, seq, `device_ticks`, present, dropped (it never left the device), `host_ns`, the
    /// host's monotonic clock at `device_ticks`, and unasked: an NDI system's frame after the last request; with
    /// --faults also fate, again, faults and frames.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Length of the generated motion (default: one jump); of a file, only its beginning.
    #[arg(long, value_name = "N", value_parser = seconds)]
    seconds: Option<f64>,
    /// Number of generated markers.
    #[arg(long, value_name = "N", conflicts_with = "take")]
    markers: Option<usize>,
    /// Noise of the generated samples on each axis, standard deviation [default: 0.05mm].
    #[arg(long, value_name = "LENGTH", conflicts_with = "take", value_parser = length_mm)]
    noise: Option<f64>,
    /// Part of the generated samples that is hidden, 0 to 0.9.
    #[arg(long, value_name = "PART", conflicts_with = "take")]
    occlusion: Option<f64>,
    /// Exit after one run, when the host has read everything.
    #[arg(long, conflicts_with = "looping")]
    once: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Spoken {
    /// The link protocol of mocapd.
    Dvmc,
    /// The Combined API of NDI Polaris and Vega systems.
    Ndi,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Wire {
    /// Millimetres as f32, bit for bit.
    F32,
    /// Whole micrometres.
    Um,
    /// Whole micrometres, marker from marker: the fewest bytes.
    Compact,
}

pub(super) fn run(args: &ServeArgs) -> Result<(), Failure> {
    let stop = stop::on_signal()?;
    let log = input::log(args)?;
    let (mut device, what): (Box<dyn LineDevice>, String) = match &log {
        Some(log) => input::log_device(args, log)?,
        None => device::device(args, input::motion(args)?, input::script(args)?)?,
    };
    let (mut line, name) = args.line.open(&args.serial)?;
    // Last: a start that is refused leaves no log behind.
    let frames: Option<Box<dyn Write + Send>> = match &args.log {
        Some(path) => {
            // A log is what a recording is held against: an earlier one stays.
            let file = File::create_new(path).with_context(|| {
                format!("cannot write {}: choose a name that is not taken", path.display())
            })?;
            Some(Box::new(BufWriter::new(file)))
        }
        None => None,
    };
    say(&what);
    let mut stdout = io::stdout();
    writeln!(stdout, "{name}")
        .and_then(|()| stdout.flush())
        .context("cannot print the line's name")?;
    let batch = Some(args.batch_ms).filter(|ms| *ms > 0).map(Duration::from_millis);
    let options = ServeOptions { baud: args.baud, batch, once: args.once, log: frames };
    let sent = serve(&mut *line, device.as_mut(), options, &stop)?;
    if device.is_gone() {
        say(
            "the log is over, and has no end of stream: the cable is pulled; serve it again for another recording",
        );
    }
    let summary = match log {
        Some(_) => summary_of_log(&sent),
        None => summary_of_motion(&sent, args.protocol),
    };
    summary.lines().for_each(say);
    Ok(())
}

/// A word on stderr. Nothing is lost when nobody reads it.
fn say(text: &str) {
    drop(writeln!(io::stderr(), "mocapd-sim: {}", visible(text)));
}

/// Of a log, which has bytes and knows no frames.
fn summary_of_log(sent: &SentLog) -> String {
    format!("{}: {} bytes of the log sent", runs(sent), sent.bytes_sent)
}

fn runs(sent: &SentLog) -> String {
    let starts = sent.starts;
    format!("{starts} {}", if starts == 1 { "run" } else { "runs" })
}

/// The account, and what faults did of it, on a line of its own: what was produced is what comes after it.
fn summary_of_motion(sent: &SentLog, spoken: Spoken) -> String {
    let SentLog { total, frames_sent, bytes_sent, .. } = sent;
    let runs = runs(sent);
    let why = match spoken {
        Spoken::Dvmc => "its queue was full",
        Spoken::Ndi => "not fetched before the next",
    };
    let mut said = format!(
        "{runs}: {} frames produced, {frames_sent} sent in {bytes_sent} bytes, {} dropped by the device \
         ({why}), {} never taken",
        total.frames_produced,
        total.frames_dropped,
        sent.frames_waiting + sent.frames_discarded
    );
    if spoken == Spoken::Ndi {
        let unasked = total.frames_unasked;
        said.push_str(&format!(", {unasked} after the last request (on no recorder's account)"));
    }
    if let Some(faults) = &sent.faults {
        said = format!("{said}\n{}", faults.summary());
    }
    said
}
