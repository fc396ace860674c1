//! `mocapd-sim serve`: serves a simulated device on a line, which its options choose.

mod input;
mod network;
mod report;

use std::io::{BufWriter, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use clap::{Args, ValueEnum};
use mocapd_cli::numbers::count;
use mocapd_cli::stop::stop_on_signal;
use mocapd_drivers::link::FrameForm;
use mocapd_simulator::NetworkOptions;
use mocapd_simulator::device::{Device, DeviceError, DeviceSettings, LineDevice, SentLog};
use mocapd_simulator::faults::{FaultyDevice, Script};
use mocapd_simulator::line::{Line, ServeOptions, serve};
use mocapd_simulator::ndi::{NdiDevice, NdiError, NdiSettings};
use mocapd_simulator::pty::{PtyError, PtyLine};
use mocapd_simulator::sampled::Electrodes;
use mocapd_simulator::source::{Generated, RecordedSignals, is_motion};
use mocapd_take::motion::Motion;
use mocapd_take::quantity::{duration, duration_above_zero, length_mm, rate_hz};
use network::NatNetArgs;
use report::{LineReport, SentReport};

use super::{Failure, notify, print, print_json_line};

pub(super) const EXAMPLES: &str = "\
Examples:
  mocapd-sim serve jump.c3d --pty /tmp/rig
  mocapd-sim serve --generate jump --rate 240Hz --loop --pty /tmp/rig
  mocapd record --device serial:/tmp/rig --output jump.take     in another terminal
  mocapd-sim serve jump.c3d --protocol qtm --tcp=22223
  mocapd record --device qtm:127.0.0.1 --output jump.take       in another terminal
  mocapd-sim serve jump.c3d --protocol natnet --udp 1510 --multicast
  mocapd record --device natnet:127.0.0.1 --output jump.take    in another terminal
  mocapd-sim serve --generate jump --loop --protocol lsl
  mocapd record --device lsl:mocapd-sim-SIM0001 --output jump.take     in another terminal";

#[derive(Debug, Args)]
pub(super) struct ServeArgs {
    /// The motion to play, a .take, .c3d, .trc, .tsv (QTM) or .csv file; or a log of `mocapd record --raw` to replay
    #[arg(conflicts_with = "generate")]
    take: Option<PathBuf>,
    /// Generate the motion instead: standing long jumps, `jump` or `jump:SEED`
    #[arg(long, value_name = "jump[:SEED]")]
    generate: Option<Generated>,
    #[command(flatten)]
    line: LineArgs,
    #[command(flatten)]
    natnet: NatNetArgs,
    /// Protocol of the device
    #[arg(long, value_enum, value_name = "NAME", default_value_t = DeviceProtocol::Dvmc)]
    protocol: DeviceProtocol,
    /// With --protocol ndi: the marker with this label is a tool (repeatable); all others are strays
    #[arg(long, value_name = "LABEL")]
    tool: Vec<String>,
    /// With --protocol ndi: do not support BX2, like systems before the Vega
    #[arg(long)]
    no_bx2: bool,
    /// Serial number of the device
    #[arg(long, value_name = "TEXT", default_value = "SIM0001")]
    serial: String,
    /// Resample the motion to this frame rate: 240, 240Hz, 1kHz [default: the motion's own, 120Hz with --generate]
    #[arg(long, value_name = "HZ", value_parser = rate_hz, allow_hyphen_values = true)]
    rate: Option<f64>,
    /// Play this many times faster, 0.001 to 1000; the device's rate scales with it
    #[arg(long, value_name = "X", default_value_t = 1.0, value_parser = number, allow_hyphen_values = true)]
    speed: f64,
    /// Limit the line to this speed in baud, and refuse frame rates that do not fit; an NDI system refuses higher line
    /// speeds
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(50..))]
    baud: Option<u32>,
    /// Drift of the device's clock against the host's, ppm: positive is slow, negative is fast
    ///
    /// `mocapd info` reports the same number as the clock's drift.
    #[arg(long, value_name = "PPM", default_value_t = 0.0, value_parser = number, allow_hyphen_values = true)]
    drift_ppm: f64,
    /// Send bytes in batches at this interval, up to 1s, as an FTDI adapter does every 16ms
    #[arg(long, value_name = "TIME", default_value = "0s", value_parser = batch, allow_hyphen_values = true)]
    batch: Duration,
    /// The earlier spelling of --batch, in milliseconds
    #[arg(long, value_name = "MS", hide = true, conflicts_with = "batch", value_parser = clap::value_parser!(u64).range(0..=1000))]
    batch_ms: Option<u64>,
    /// Inject the faults of this script, in TOML as described in docs/faults.md
    #[arg(long, value_name = "SCRIPT")]
    faults: Option<PathBuf>,
    /// Restart after the last frame, and never end
    #[arg(long = "loop")]
    looping: bool,
    /// Encoding of positions; by default f32, or compact with --baud
    #[arg(long, value_enum, value_name = "FORM")]
    wire: Option<WireFormat>,
    /// Log what became of every frame to this CSV file; it must not exist
    ///
    /// The columns are run, seq, `device_ticks`, present, dropped (the frame never left the device), `host_ns` (the
    /// host's monotonic clock at `device_ticks`) and unasked (an NDI system's frame after the last request); with
    /// --faults also fate, again, faults and frames, which docs/faults.md describes.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Play only this much of the motion: 10s, 500ms, 2min; with --generate, its length [default: one jump]
    #[arg(long, value_name = "TIME", value_parser = duration_above_zero, allow_hyphen_values = true)]
    seconds: Option<Duration>,
    /// With --generate: number of markers [default: 15]
    #[arg(long, value_name = "N")]
    markers: Option<usize>,
    /// With --generate: standard deviation of the noise on each axis: 0.05mm, 100um [default: 0.05mm]
    #[arg(long, value_name = "LENGTH", value_parser = length_mm, allow_hyphen_values = true)]
    noise: Option<f64>,
    /// With --generate: fraction of samples that are occluded, 0 to 0.9 [default: 0]
    #[arg(long, value_name = "FRACTION", value_parser = number, allow_hyphen_values = true)]
    occlusion: Option<f64>,
    /// With --generate: send the samples of two force plates under the jumps, 6 channels each, at this rate; not with
    /// --loop or --speed [default: 1kHz]
    #[arg(long, value_name = "HZ", num_args = 0..=1, default_missing_value = "1kHz", value_parser = rate_hz)]
    plates: Option<f64>,
    /// Send a stream like that of electrodes, such as 16@2kHz: the number of channels and their rate (repeatable)
    #[arg(long, value_name = "N@HZ")]
    emg: Vec<Electrodes>,
    /// With --generate: send the poses of this many rigid bodies, which move with the segments of the body, up to 128;
    /// not with --loop or --speed
    #[arg(long, value_name = "N")]
    bodies: Option<usize>,
    /// Send the residuals of the markers: those of the file, or random ones with --generate; by default the link protocol has
    /// none, and other systems have the same for all markers
    #[arg(long)]
    residuals: bool,
    /// Log what became of every batch of samples, and of the poses of every frame, to this CSV file; it must not exist (docs/faults.md)
    #[arg(long, value_name = "FILE")]
    batch_log: Option<PathBuf>,
    /// Exit once the motion has ended or the host has stopped it, and the host has read everything
    #[arg(long, conflicts_with = "looping")]
    once: bool,
    /// Print JSON: one document with the path to open, and at the end one with what was sent
    #[arg(long)]
    json: bool,
}

impl ServeArgs {
    /// Finds out what to play. Where `--pty` is followed by the only file, that is the file to play, and not the link.
    fn find_take(&mut self) -> Result<(), Failure> {
        let is_given = self.take.is_some() || self.generate.is_some();
        match self.line.file_after_pty() {
            Some(file) if is_given => Err(Failure::usage_message(format!(
                "{0} is a motion or a log, and --pty takes the path of a link to create: give --pty another path, or put \
                 it last without one",
                file.display()
            ))),
            None if !is_given => Err(Failure::usage_message(
                "nothing to play: name a take, another motion file or a raw log, or give --generate jump",
            )),
            Some(file) => {
                self.take = Some(file);
                self.line.pty = Some(None);
                Ok(())
            }
            None => Ok(()),
        }
    }

    /// Refuses options of generated motions without one.
    fn check_generated(&self) -> Result<(), Failure> {
        let options = [
            ("--markers", self.markers.is_some()),
            ("--noise", self.noise.is_some()),
            ("--occlusion", self.occlusion.is_some()),
            ("--plates", self.plates.is_some()),
            ("--bodies", self.bodies.is_some()),
        ];
        match options.iter().find(|(_, is_set)| *is_set && self.generate.is_none()) {
            Some((option, _)) => Err(Failure::usage_message(format!(
                "{option} applies to generated motions only: give --generate jump and no file"
            ))),
            None => Ok(()),
        }
    }

    /// How long bytes wait, if they do.
    fn batch(&self) -> Option<Duration> {
        let batch = self.batch_ms.map_or(self.batch, Duration::from_millis);
        Some(batch).filter(|batch| !batch.is_zero())
    }
}

/// Parses a number without a unit; the device checks its range.
fn number(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite());
    number.ok_or_else(|| format!("'{text}' is not a number: give one such as 0.5"))
}

/// The longest time for which bytes wait.
const BATCH_MAX: Duration = Duration::from_secs(1);

/// Parses the time for which bytes wait.
fn batch(text: &str) -> Result<Duration, String> {
    let batch = duration(text)?;
    if batch <= BATCH_MAX {
        return Ok(batch);
    }
    Err(format!("an interval of '{text}' is out of range: give 0s to 1s"))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum DeviceProtocol {
    /// The link protocol of mocapd.
    Dvmc,
    /// The Combined API of NDI Polaris and Vega systems.
    Ndi,
    /// The RT protocol of Qualisys Track Manager, with --tcp.
    Qtm,
    /// The NatNet protocol of OptiTrack's Motive.
    Natnet,
    /// Streams of the Lab Streaming Layer.
    Lsl,
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

/// Serves a system on the network by `serve`: prints its URI, and at the end what it sent.
fn serve_at<E>(
    args: &ServeArgs,
    uri: &str,
    (n_markers, rate_millihertz): (usize, u32),
    serve: impl FnOnce(NetworkOptions) -> Result<SentLog, E>,
) -> Result<(), Failure>
where
    Failure: From<E>,
{
    let mut options = NetworkOptions { once: args.once, log: None };
    if let Some(path) = &args.log {
        // Recordings are checked against a log: never overwrite one.
        options.log = Some(Box::new(BufWriter::new(super::create_file(path)?)));
    }
    let hz = f64::from(rate_millihertz) / 1000.0;
    notify(&format!("{} at {hz} Hz, Ctrl-C to stop", count(n_markers as u64, "marker")));
    if args.json {
        print_json_line(&LineReport { path: uri })?;
    } else {
        print(&format!("{uri}\n"))?;
    }
    let report = SentReport::new(&serve(options)?, true);
    if args.json {
        print_json_line(&report)?;
    } else {
        report.text(args.protocol).lines().for_each(notify);
    }
    Ok(())
}

pub(super) fn run(mut args: ServeArgs) -> Result<(), Failure> {
    args.find_take()?;
    args.check_generated()?;
    let args = &args;
    network::check_natnet_options(args)?;
    if args.protocol == DeviceProtocol::Natnet {
        return network::run_natnet(args);
    }
    if args.protocol == DeviceProtocol::Lsl {
        return network::run_lsl(args);
    }
    if args.protocol == DeviceProtocol::Qtm || args.line.tcp.is_some() {
        return network::run_qtm(args);
    }
    if !args.line.is_chosen() {
        let message = "the device needs a line: give --pty, --usb-gadget or --usb-serial";
        return Err(Failure::usage_message(message.to_owned()));
    }
    let log = input::log(args)?;
    let (mut device, description): (Box<dyn LineDevice>, String) = match &log {
        Some(log) => input::log_device(args, log)?,
        None => device(args, input::motion(args)?, input::script(args)?)?,
    };
    // Not before: until now there is nothing to end in order, and Ctrl-C ends the program at once.
    let stop = stop_on_signal()?;
    let (mut line, name) = args.line.open(&args.serial)?;
    // Created last, so that a failed start leaves no log behind.
    let mut frames: Option<Box<dyn Write + Send>> = None;
    if let Some(path) = &args.log {
        // Recordings are checked against a log: never overwrite one.
        frames = Some(Box::new(BufWriter::new(super::create_file(path)?)));
    }
    let mut batches: Option<Box<dyn Write + Send>> = None;
    if let Some(path) = &args.batch_log {
        batches = Some(Box::new(BufWriter::new(super::create_file(path)?)));
    }
    notify(&description);
    if args.json {
        print_json_line(&LineReport { path: &name })?;
    } else {
        print(&format!("{name}\n"))?;
    }
    let options = ServeOptions {
        baud: args.baud,
        batch: args.batch(),
        once: args.once,
        log: frames,
        batch_log: batches,
    };
    let sent = serve(&mut *line, device.as_mut(), options, &stop)?;
    if device.is_gone() {
        notify(
            "the log has no end of stream, so the device has disconnected: run this command again for another recording",
        );
    }
    let report = SentReport::new(&sent, log.is_none());
    if args.json {
        print_json_line(&report)?;
    } else {
        report.text(args.protocol).lines().for_each(notify);
    }
    Ok(())
}

/// The device, and its description.
fn device(
    args: &ServeArgs,
    motion: Motion,
    script: Option<Arc<Script>>,
) -> Result<(Box<dyn LineDevice>, String), Failure> {
    let usage = |message: &str| Err(Failure::usage_message(message));
    let n_markers = motion.info.markers.len();
    let (device, rate_millihertz): (Box<dyn LineDevice>, u32) = match args.protocol {
        DeviceProtocol::Dvmc if !args.tool.is_empty() || args.no_bx2 => {
            return usage("--tool and --no-bx2 need an NDI system: add --protocol ndi");
        }
        DeviceProtocol::Ndi if args.wire.is_some() => {
            return usage("--wire applies to the link protocol only: an NDI system sends f32");
        }
        DeviceProtocol::Ndi
            if args.plates.is_some() || !args.emg.is_empty() || args.bodies.is_some() =>
        {
            return usage(
                "--plates, --emg and --bodies do not apply to an NDI system: remove --protocol ndi",
            );
        }
        DeviceProtocol::Ndi if args.residuals => {
            return usage("--residuals does not apply to an NDI system: remove it");
        }
        DeviceProtocol::Ndi if script.is_some() => {
            return usage("--faults applies to the link protocol only: remove --protocol ndi");
        }
        DeviceProtocol::Dvmc => {
            let kinds = script.iter().flat_map(|script| &script.faults);
            if let Some(kind) = kinds.map(|f| f.fault.kind()).find(|kind| kind.is_of_network()) {
                let name = kind.name();
                return usage(&format!(
                    "{name} happens to a system on the network: add --protocol natnet or qtm"
                ));
            }
            let RecordedSignals { sampled, bodies, .. } = input::signals(args)?;
            let faults = script.clone();
            let residuals = input::residuals(args, &motion)?;
            let settings = DeviceSettings { faults, sampled, bodies, residuals, ..settings(args) };
            let device = Device::new(motion, settings).map_err(refused)?;
            device.warnings().iter().for_each(|warning| notify(warning));
            let rate_millihertz = device.hello().rate_millihertz;
            match script {
                Some(script) => (Box::new(FaultyDevice::new(device, &script)), rate_millihertz),
                None => (Box::new(device), rate_millihertz),
            }
        }
        DeviceProtocol::Ndi if args.drift_ppm != 0.0 => {
            return usage(
                "--drift-ppm needs the link protocol: the NDI system keeps the host's time",
            );
        }
        // It is on no line.
        DeviceProtocol::Qtm | DeviceProtocol::Natnet | DeviceProtocol::Lsl => {
            return usage("it is on the network, not on a line");
        }
        DeviceProtocol::Ndi => {
            let RecordedSignals { sampled, bodies, .. } = input::signals(args)?;
            if !sampled.is_empty() || bodies.is_some() {
                notify("an NDI system sends markers: what else the take has is not sent");
            }
            let device = NdiDevice::new(motion, ndi_settings(args)).map_err(ndi_refused)?;
            device.warnings().iter().for_each(|warning| notify(warning));
            let rate_millihertz = device.rate_millihertz();
            (Box::new(device), rate_millihertz)
        }
    };
    let hz = f64::from(rate_millihertz) / 1000.0;
    let markers = count(n_markers as u64, "marker");
    Ok((device, format!("{markers} at {hz} Hz, Ctrl-C to stop")))
}

fn settings(args: &ServeArgs) -> DeviceSettings {
    let form = match (args.wire, args.baud) {
        (Some(WireFormat::F32), _) | (None, None) => FrameForm::Float,
        (Some(WireFormat::Um), _) => FrameForm::Micrometres,
        (Some(WireFormat::Compact), _) | (None, Some(_)) => FrameForm::Compact,
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
        serial: args.serial.clone(),
        rate_hz: args.rate,
        speed: args.speed,
        looping: args.looping,
        tools: args.tool.clone(),
        bx2: !args.no_bx2,
        baud_max: args.baud.unwrap_or(settings.baud_max),
    }
}

fn ndi_refused(error: NdiError) -> Failure {
    match error {
        NdiError::Device(error) => refused(error),
        NdiError::NoSuchTool { .. } | NdiError::TooManyTools { .. } => Failure::usage(error),
        _ => Failure::from(error),
    }
}

/// A bad value on the command line is a usage error; bad content of a file is not.
fn refused(error: DeviceError) -> Failure {
    match error {
        DeviceError::Rate { .. }
        | DeviceError::Speed { .. }
        | DeviceError::Product { .. }
        | DeviceError::Drift { .. } => Failure::usage(error),
        _ => Failure::from(error),
    }
}

/// The line between device and host.
#[derive(Debug, Args)]
struct LineArgs {
    /// Serve on a pty; with PATH, also create a symbolic link PATH to it, whose name stays the same
    ///
    /// `--pty PATH` and `--pty=PATH` are the same. A file that can be played is never taken for the link:
    /// `--pty jump.c3d` plays jump.c3d on a pty without a link.
    #[arg(long, value_name = "PATH", num_args = 0..=1)]
    pty: Option<Option<PathBuf>>,
    /// Act as a USB device with bulk endpoints; needs root and a USB device controller
    #[arg(long, conflicts_with_all = ["pty", "baud"])]
    usb_gadget: bool,
    /// Act as a USB serial port (CDC-ACM); needs root and a USB device controller
    #[arg(long, conflicts_with_all = ["pty", "usb_gadget"])]
    usb_serial: bool,
    /// With --protocol qtm, which implies it: listen on this TCP port of this machine only, by default on any free one
    #[arg(long, value_name = "PORT", num_args = 0..=1, conflicts_with_all = ["pty", "usb_gadget", "usb_serial", "udc", "baud"])]
    tcp: Option<Option<u16>>,
    /// Name of the USB device controller in /sys/class/udc [default: the first free one]
    #[arg(long, value_name = "NAME", conflicts_with = "pty")]
    udc: Option<String>,
}

impl LineArgs {
    /// The value of `--pty`, if it is a file to play: it has the extension of a motion, or is a file already.
    fn file_after_pty(&self) -> Option<PathBuf> {
        let path = self.pty.as_ref()?.as_ref()?;
        // A link to a pty is not a regular file, whether or not the pty still exists.
        (is_motion(path) || path.is_file()).then(|| path.clone())
    }

    /// Whether one was chosen that is not on the network.
    fn is_chosen(&self) -> bool {
        self.pty.is_some() || self.usb_gadget || self.usb_serial
    }

    /// Whether a host finds the device again after its cable was pulled and plugged in.
    fn has_stable_name(&self) -> bool {
        matches!(self.pty, Some(Some(_))) || self.tcp.is_some()
    }

    /// Opens the line; returns it with the path or URI that a host opens.
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
        Err(anyhow::anyhow!("USB gadgets need Linux: use --pty").into())
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
