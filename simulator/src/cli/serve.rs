//! `mocapd-sim serve`.

use std::fs::File;
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::Context;
use clap::{Args, ValueEnum};
use mocapd_drivers::link::FrameForm;
use mocapd_simulator::device::{Device, DeviceError, DeviceSettings, LineDevice, SentLog};
use mocapd_simulator::faults::{FaultyDevice, SCRIPT_BYTES_MAX, Script};
use mocapd_simulator::generator::{JumpSpec, Occlusion};
use mocapd_simulator::line::{Line, ServeOptions, serve};
use mocapd_simulator::ndi::{NdiDevice, NdiError, NdiSettings};
use mocapd_simulator::pty::{PtyError, PtyLine};
use mocapd_simulator::source::{self, Generated, SourceError};
use mocapd_take::motion::Motion;
use signal_hook::consts::TERM_SIGNALS;

mod logged;

use super::Failure;
use super::values::{length_mm, seconds};

/// The rate of a generated motion when none is given: the commonest of optical rigs.
const GENERATED_RATE_HZ: f64 = 120.0;

/// Mean length of generated gaps, seconds: a limb that passes in front of a marker.
const MEAN_GAP_S: f64 = 0.2;

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
    /// --faults also fate, again and faults.
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

/// What the device is connected by.
#[derive(Debug, Args)]
struct LineArgs {
    /// Serve on a pty; with LINK, a stable symbolic link to it.
    #[arg(long, value_name = "LINK", num_args = 0..=1, require_equals = true, required_unless_present_any = ["usb_gadget", "usb_serial"])]
    pty: Option<Option<PathBuf>>,
    /// Be a USB device with a bulk pair, on a machine that has a USB device controller; needs root.
    #[arg(long, conflicts_with_all = ["pty", "baud"])]
    usb_gadget: bool,
    /// Be a USB serial port (CDC-ACM), on a machine that has a USB device controller; needs root.
    #[arg(long, conflicts_with_all = ["pty", "usb_gadget"])]
    usb_serial: bool,
    /// The USB device controller, as /sys/class/udc names it; by default the first that is free.
    #[arg(long, value_name = "NAME", conflicts_with = "pty")]
    udc: Option<String>,
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
    // A second signal ends the program at once, should the first one not.
    let stop = Arc::new(AtomicBool::new(false));
    for signal in TERM_SIGNALS {
        signal_hook::flag::register_conditional_shutdown(*signal, 130, Arc::clone(&stop))?;
        signal_hook::flag::register(*signal, Arc::clone(&stop))?;
    }
    let (mut device, what): (Box<dyn LineDevice>, String) = match logged::read(args)? {
        Some(log) => logged::device(args, &log)?,
        None => device(args, motion(args)?, script(args)?)?,
    };
    let (mut line, name) = args.line.open(&args.serial)?;
    // Last: a start that is refused leaves no log behind.
    let log: Option<Box<dyn Write + Send>> = match &args.log {
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
    let options = ServeOptions { baud: args.baud, batch, once: args.once, log };
    let sent = serve(&mut *line, device.as_mut(), options, &stop)?;
    say(&summary(&sent, args.protocol));
    Ok(())
}

/// The device, and what it is in words.
fn device(
    args: &ServeArgs,
    motion: Motion,
    script: Option<Arc<Script>>,
) -> Result<(Box<dyn LineDevice>, String), Failure> {
    let usage = |words: &str| Err(Failure::usage(anyhow::anyhow!("{words}")));
    let n_markers = motion.info.markers.len();
    let device: (Box<dyn LineDevice>, u32) = match args.protocol {
        Spoken::Dvmc if !args.tool.is_empty() || args.no_bx2 => {
            return usage("--tool and --no-bx2 are for NDI systems: add --protocol ndi");
        }
        Spoken::Ndi if args.wire.is_some() => {
            return usage("--wire is for the link protocol: an NDI system sends f32");
        }
        Spoken::Ndi if script.is_some() => {
            return usage("--faults is for the link protocol: an NDI system has none here");
        }
        Spoken::Dvmc => {
            let settings = DeviceSettings { faults: script.clone(), ..settings(args) };
            let device = Device::new(motion, settings).map_err(refused)?;
            device.warnings().iter().for_each(|warning| say(warning));
            let rate_mhz = device.hello().rate_mhz;
            match script {
                Some(script) => (Box::new(FaultyDevice::new(device, &script)), rate_mhz),
                None => (Box::new(device), rate_mhz),
            }
        }
        Spoken::Ndi if args.drift_ppm != 0.0 => {
            return usage(
                "--drift-ppm is for the link protocol: an NDI system here keeps the host's time",
            );
        }
        Spoken::Ndi => {
            let device = NdiDevice::new(motion, ndi_settings(args)).map_err(ndi_refused)?;
            device.warnings().iter().for_each(|warning| say(warning));
            let rate_mhz = device.rate_mhz();
            (Box::new(device), rate_mhz)
        }
    };
    let (device, rate_mhz) = device;
    let hz = f64::from(rate_mhz) / 1000.0;
    Ok((device, format!("{n_markers} markers at {hz} Hz, Ctrl-C ends")))
}

/// What goes wrong.
fn script(args: &ServeArgs) -> Result<Option<Arc<Script>>, Failure> {
    let Some(path) = &args.faults else { return Ok(None) };
    let cannot_read = || format!("cannot read {}", path.display());
    let file = File::open(path).with_context(cannot_read)?;
    let mut text = String::new();
    // One byte more shows that it is too long.
    let at_most = SCRIPT_BYTES_MAX as u64 + 1;
    file.take(at_most).read_to_string(&mut text).with_context(cannot_read)?;
    let name = path.display().to_string();
    let script = Script::parse(&name, &text).map_err(Failure::usage)?;
    if script.unplugs() && !matches!(args.line.pty, Some(Some(_))) {
        let words = "a script that unplugs the device needs a name that lasts: give --pty=LINK";
        return Err(Failure::usage(anyhow::anyhow!("{}: {words}", path.display())));
    }
    Ok(Some(Arc::new(script)))
}

fn motion(args: &ServeArgs) -> Result<Motion, Failure> {
    if let Some(Generated { seed }) = args.generate {
        let rate_hz = args.rate.unwrap_or(GENERATED_RATE_HZ);
        let mut spec = JumpSpec { seconds: args.seconds, ..JumpSpec::new(seed, rate_hz) };
        spec.n_markers = args.markers.unwrap_or(spec.n_markers);
        spec.noise_mm = args.noise.unwrap_or(spec.noise_mm);
        spec.occlusion =
            args.occlusion.map(|fraction| Occlusion { fraction, mean_gap_s: MEAN_GAP_S });
        return Ok(spec.generate().map_err(Failure::usage)?.motion);
    }
    let path = args.take.as_deref().unwrap_or(Path::new(""));
    let (mut motion, warnings) = source::read(path).map_err(|error| match error {
        SourceError::Ending { .. } => Failure::usage(error),
        _ => Failure::from(error),
    })?;
    for warning in warnings {
        say(&format!("{}: {warning}", path.display()));
    }
    if let Some(seconds) = args.seconds {
        source::keep_first(&mut motion, seconds);
    }
    Ok(motion)
}

fn settings(args: &ServeArgs) -> DeviceSettings {
    let form = match (args.wire, args.baud) {
        (Some(Wire::F32), _) | (None, None) => FrameForm::Float,
        (Some(Wire::Um), _) => FrameForm::Micrometres,
        (Some(Wire::Compact), _) | (None, Some(_)) => FrameForm::Compact,
    };
    DeviceSettings {
        serial: args.serial.clone(),
        rate_hz: args.rate,
        speed: args.speed,
        drift_ppm: args.drift_ppm,
        looping: args.looping,
        form,
        line_bytes_per_s: args.baud.map_or(0, |baud| u64::from(baud) / 10),
        ..DeviceSettings::default()
    }
}

fn ndi_settings(args: &ServeArgs) -> NdiSettings {
    let settings = NdiSettings::default();
    NdiSettings {
        rate_hz: args.rate,
        speed: args.speed,
        looping: args.looping,
        tools: args.tool.clone(),
        bx2: !args.no_bx2,
        baud_max: args.baud.unwrap_or(settings.baud_max),
        ..settings
    }
}

fn ndi_refused(error: NdiError) -> Failure {
    match error {
        NdiError::Device(error) => refused(error),
        NdiError::NoSuchTool { .. } | NdiError::TooManyTools { .. } => Failure::usage(error),
        _ => Failure::from(error),
    }
}

/// A value of the command line is a usage error, the content of a file is not.
fn refused(error: DeviceError) -> Failure {
    match error {
        DeviceError::Rate { .. }
        | DeviceError::Speed { .. }
        | DeviceError::Product { .. }
        | DeviceError::Drift { .. } => Failure::usage(error),
        _ => Failure::from(error),
    }
}

impl LineArgs {
    /// The line, and what a host calls it.
    fn open(&self, serial: &str) -> Result<(Box<dyn Line>, String), Failure> {
        if self.usb_gadget || self.usb_serial {
            return self.plug_in(serial);
        }
        let line =
            PtyLine::open(self.pty.as_ref().and_then(Option::as_deref)).map_err(pty_failure)?;
        let path = line.path().display().to_string();
        Ok((Box::new(line), path))
    }

    #[cfg(target_os = "linux")]
    fn plug_in(&self, serial: &str) -> Result<(Box<dyn Line>, String), Failure> {
        use mocapd_simulator::gadget::{Bulk, GadgetSettings, Serial};

        let settings = GadgetSettings { serial: serial.to_owned(), controller: self.udc.clone() };
        if self.usb_gadget {
            let line = Bulk::plug_in(&settings).map_err(gadget_failure)?;
            let uri = line.uri();
            return Ok((Box::new(line), uri));
        }
        let line = Serial::plug_in(&settings).map_err(gadget_failure)?;
        let path = line.host_path().display().to_string();
        Ok((Box::new(line), path))
    }

    #[cfg(not(target_os = "linux"))]
    fn plug_in(&self, _serial: &str) -> Result<(Box<dyn Line>, String), Failure> {
        Err(anyhow::anyhow!("USB gadgets are Linux's: use --pty here").into())
    }
}

fn pty_failure(error: PtyError) -> Failure {
    match error {
        PtyError::LinkExists { .. } => Failure::usage(error),
        _ => Failure::from(error),
    }
}

#[cfg(target_os = "linux")]
fn gadget_failure(error: mocapd_simulator::gadget::GadgetError) -> Failure {
    use mocapd_simulator::gadget::GadgetError;

    match error {
        GadgetError::SerialNumber { .. } | GadgetError::NoSuchController { .. } => {
            Failure::usage(error)
        }
        _ => Failure::from(error),
    }
}

/// The account: what was produced is what comes after it.
fn summary(sent: &SentLog, spoken: Spoken) -> String {
    let SentLog { total, starts, frames_sent, bytes_sent, .. } = sent;
    if total.frames_produced == 0 && sent.bytes_sent > 0 {
        // A log: it has no frames, but bytes.
        return format!("{starts} runs: {} bytes of the log sent", sent.bytes_sent);
    }
    let why = match spoken {
        Spoken::Dvmc => "its queue was full",
        Spoken::Ndi => "not fetched before the next",
    };
    let mut said = format!(
        "{starts} runs: {} frames produced, {frames_sent} sent in {bytes_sent} bytes, {} dropped by the device \
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
        said = format!("{said}\nmocapd-sim: {}", faults.words());
    }
    said
}

/// A word on stderr. Nothing is lost when nobody reads it.
fn say(text: &str) {
    drop(writeln!(io::stderr(), "mocapd-sim: {text}"));
}
