//! `demo`: records, verifies and exports a simulated device, without any hardware.

use std::{
    fs,
    io::BufReader,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

use anyhow::{Context, anyhow, ensure};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{
    files, inspect::Summary, pipeline::check_disk_space, record::Recorded, rig::Rig, setting,
    threads,
};
use mocapd_codec::{ResamplerKind, Settings, Tolerance};
use mocapd_drivers::uri::{DeviceUri, Location};
use mocapd_service::units;
use mocapd_simulator::{
    device::{Device, DeviceSettings, SentLog},
    generator::JumpSpec,
    pty::{PtyError, ServeOptions, serve_pty},
};
use mocapd_take::{
    TakeFrames,
    compare::compare,
    interchange::Format,
    motion::{Motion, MotionFrames},
    record::EndingKind,
};

use super::{
    export::write,
    output::{notify, plain_path, print},
    record::{Limits, RecordReport, record_and_watch},
    stop::stop_on_signal,
    values::{self, bytes, count, rate, thousands},
    verify::AgainstReport,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Length of the motion: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = values::length,
          allow_hyphen_values = true)]
    seconds: Duration,
    /// Folder for the take and its exports; created if it does not exist
    #[arg(long, value_name = "DIR", default_value = "mocapd-demo")]
    out: PathBuf,
    /// Largest allowed distance between a sample and its reconstruction: 0.5mm, 100um, 2cm
    #[arg(long, value_name = "LENGTH", default_value = "0.5mm", value_parser = values::tolerance,
          allow_hyphen_values = true)]
    tolerance: Tolerance,
    /// Frame rate of the simulated device: 240, 240Hz, 1kHz
    #[arg(long, value_name = "HZ", default_value = "120Hz", value_parser = units::rate_hz,
          allow_hyphen_values = true)]
    rate: f64,
}

/// Fixed, so that everyone records the same motion and figures can be compared.
const SEED: u64 = 1;

/// The formats that the take is exported to, and their extensions.
const EXPORTS: [(Format, &str); 3] =
    [(Format::C3d, "c3d"), (Format::Trc, "trc"), (Format::Csv, "csv")];

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let seconds = args.seconds.as_secs_f64();
    let spec = JumpSpec { seconds: Some(seconds), ..JumpSpec::new(SEED, args.rate) };
    let generated = spec.generate().map_err(|error| UsageError(error.to_string()))?;
    let motion = Arc::new(generated.motion);
    fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot create the folder {}", args.out.display()))?;
    let take = free_name(&args.out);
    check_disk_space(&take, 0).map_err(|error| {
        let message = setting::message(&error, |_| "name another folder with --out".to_owned());
        anyhow::Error::msg(message)
    })?;
    let codec = Settings { kind: ResamplerKind::Dense, tolerance: args.tolerance };
    let stop = stop_on_signal()?;

    let device = Device::new(Arc::clone(&motion), DeviceSettings::default())?;
    let simulated = SimulatedDevice::start(device)?;
    print(&format!(
        "1. a simulated device with {} at {}, {seconds} s of a standing long jump, on {}\n\
         2. recording it over that line, each marker resampled within {} mm ...\n",
        count(motion.info.markers.len() as u64, "marker"),
        rate(args.rate),
        simulated.path.display(),
        args.tolerance.mm(),
    ))?;
    let location = Location::Serial { path: simulated.path.clone(), baud: None };
    let rig = Rig::open(&DeviceUri { location, driver: None })?;
    let limits = Limits { length: None, keep_free_bytes: 0, raw_log_bytes: None, subject: None };
    let recorded = record_and_watch(rig, &take, codec, &limits, &stop)?;
    let sent = simulated.stop()?;
    let report = RecordReport::new(&take, &recorded, &codec);
    print(&report.text())?;

    show_take(&take)?;
    verify(&take, &motion, &recorded, &sent, args.tolerance.mm())?;
    let exports = export(&take)?;
    print(&format!(
        "\nThe take:            {0}\nShow its contents:   mocapd info {0}\nOpen in other tools: {exports}\n",
        plain_path(&take),
    ))?;
    if let Some(losses) = report.losses() {
        notify(&format!("not in the take: {losses}"));
    }
    Ok(Outcome::of(recorded.written.ledger.lost_anything()))
}

/// `jump-001.take`, or the next number for which neither the take nor an export exists.
fn free_name(folder: &Path) -> PathBuf {
    let name = |n: u32| folder.join(format!("jump-{n:03}.take"));
    let is_free = |take: &PathBuf| {
        let exports = EXPORTS.iter().map(|export| take.with_extension(export.1));
        exports.chain([take.clone()]).all(|path| path.symlink_metadata().is_err())
    };
    (1..).map(name).find(is_free).unwrap_or_else(|| name(0))
}

fn show_take(take: &Path) -> anyhow::Result<()> {
    let summary = Summary::read(BufReader::new(files::open(take)?))?;
    let gaps: u64 = summary.per_channel.iter().map(|channel| channel.gaps).sum();
    print(&format!(
        "3. in the take: {} of {} kept; {} in the trajectories\n",
        thousands(summary.statistics.knots()),
        count(summary.samples(), "sample"),
        count(gaps, "gap")
    ))
}

/// Compares the take with what the device really sent.
fn verify(
    take: &Path,
    motion: &Motion,
    recorded: &Recorded,
    sent: &SentLog,
    tolerance_mm: f64,
) -> anyhow::Result<()> {
    let frames = TakeFrames::open(BufReader::new(files::open(take)?))?;
    let difference = compare(frames, MotionFrames::new(motion))?;
    let report = AgainstReport::new(difference, tolerance_mm);
    print(&format!("4. {}", report.text(tolerance_mm)))?;
    let ledger = &recorded.written.ledger;
    ensure!(ledger.closes(), "the ledger does not close: please report this bug");
    ensure!(
        sent.run.frames_produced == ledger.frames_sent,
        "the device sent {} frames, the ledger has {}: please report this bug",
        sent.run.frames_produced,
        ledger.frames_sent
    );
    // After Ctrl-C the take holds only a part of the motion.
    let cut_short = recorded.recording.ending == EndingKind::Stopped;
    ensure!(
        report.is_within() || ledger.lost_anything() || cut_short,
        "the take is not within its tolerance: please report this bug"
    );
    Ok(())
}

/// Exports the take to each format, in its folder. Returns the names and sizes of the files.
fn export(take: &Path) -> anyhow::Result<String> {
    let mut names = Vec::new();
    for (format, extension) in EXPORTS {
        let path = take.with_extension(extension);
        let mut frames = TakeFrames::open(BufReader::new(files::open(take)?))?;
        write(&mut frames, format, &path)?;
        let size = fs::metadata(&path).map_or(0, |meta| meta.len());
        names.push(format!("{} ({})", plain_path(&path), bytes(size)));
    }
    Ok(names.join(", "))
}

/// A simulated device on a pty, run by its own thread.
pub(super) struct SimulatedDevice {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<SentLog, PtyError>>,
    /// The pty to open.
    pub(super) path: PathBuf,
}

impl SimulatedDevice {
    pub(super) fn start(mut device: Device) -> anyhow::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let (path_in, path) = crossbeam_channel::bounded(1);
        let stopped = Arc::clone(&stop);
        let thread = threads::spawn("mocapd-sim", move || {
            serve_pty(&mut device, None, ServeOptions::default(), &stopped, |path| {
                path_in.send(path.to_owned()).ok();
            })
        })?;
        match path.recv() {
            Ok(path) => Ok(Self { stop, thread, path }),
            Err(_) => Err(match threads::join(thread)? {
                Err(error) => anyhow!(error).context("cannot simulate a device"),
                Ok(_) => anyhow!("the simulated device ended before it was opened"),
            }),
        }
    }

    /// Stops the device and returns the log of what it sent.
    pub(super) fn stop(self) -> anyhow::Result<SentLog> {
        self.stop.store(true, Ordering::Relaxed);
        threads::join(self.thread)?.context("the simulated device failed")
    }
}
