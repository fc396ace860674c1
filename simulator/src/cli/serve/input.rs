//! Reads what the device plays: a motion and a fault script, or a raw log.

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use mocapd_drivers::link::GROUPS_MAX;
use mocapd_drivers::raw_log::MAGIC;
use mocapd_simulator::device::LineDevice;
use mocapd_simulator::faults::{SCRIPT_BYTES_MAX, Script};
use mocapd_simulator::generator::{ForcePlates, JumpSpec, Occlusion, RigidBodies};
use mocapd_simulator::log_device::{LogDevice, LogDeviceError};
use mocapd_simulator::sampled::SampledSource;
use mocapd_simulator::source::{
    self, Generated, RecordedSignals, Residuals, SourceError, is_motion,
};
use mocapd_take::motion::Motion;

use super::{DeviceProtocol, ServeArgs};
use crate::cli::{self, Failure, notify};

/// Default rate of a generated motion: the most common one of optical systems.
const GENERATED_RATE_HZ: f64 = 120.0;

/// Mean length of generated gaps, seconds: the time that a limb takes to pass in front of a marker.
const MEAN_GAP_S: f64 = 0.2;

/// The generated motion, if one was asked for.
fn generated(args: &ServeArgs) -> Option<JumpSpec> {
    let Generated { seed } = args.generate?;
    let rate_hz = args.rate.unwrap_or(GENERATED_RATE_HZ);
    let seconds = args.seconds.as_ref().map(Duration::as_secs_f64);
    let mut spec = JumpSpec { seconds, ..JumpSpec::new(seed, rate_hz) };
    spec.n_markers = args.markers.unwrap_or(spec.n_markers);
    spec.noise_mm = args.noise.unwrap_or(spec.noise_mm);
    spec.occlusion = args.occlusion.map(|fraction| Occlusion { fraction, mean_gap_s: MEAN_GAP_S });
    Some(spec)
}

pub(super) fn motion(args: &ServeArgs) -> Result<Motion, Failure> {
    if let Some(spec) = generated(args) {
        return Ok(spec.generate().map_err(Failure::usage)?.motion);
    }
    let path = args.take.as_deref().unwrap_or(Path::new(""));
    let (mut motion, warnings) = source::read(path).map_err(|error| match error {
        SourceError::Extension { .. } => Failure::usage(error),
        SourceError::Read { path, source } => cli::cannot_read(&path, source).into(),
        _ => Failure::from(error),
    })?;
    for warning in warnings {
        notify(&format!("{}: {warning}", path.display()));
    }
    if let Some(seconds) = args.seconds {
        source::keep_first(&mut motion, seconds.as_secs_f64());
    }
    Ok(motion)
}

/// The residuals of the markers, if they are asked for.
pub(super) fn residuals(
    args: &ServeArgs,
    motion: &Motion,
) -> Result<Option<Arc<Residuals>>, Failure> {
    if !args.residuals {
        return Ok(None);
    }
    if let Some(Generated { seed }) = args.generate {
        return Ok(Some(Arc::new(Residuals::generated(seed, motion))));
    }
    let path = args.take.as_deref().unwrap_or(Path::new(""));
    let found = Residuals::read(path, motion).map_err(|error| match error {
        SourceError::Read { path, source } => cli::cannot_read(&path, source).into(),
        error => Failure::from(error),
    })?;
    let none = || {
        let message =
            "has no residuals: remove --residuals, or play a C3D file or a take that has them";
        Failure::usage_message(format!("{} {message}", path.display()))
    };
    Ok(Some(Arc::new(found.ok_or_else(none)?)))
}

/// The sampled channels and the rigid bodies of the device: those of the take, and those that the options add.
pub(super) fn signals(args: &ServeArgs) -> Result<RecordedSignals, Failure> {
    let mut signals = recorded(args)?;
    sampled(args, &mut signals.sampled)?;
    signals.bodies = match bodies(args)? {
        None => signals.bodies,
        generated => generated,
    };
    Ok(signals)
}

/// The sampled channels and the rigid bodies for a server on the network, which states the former otherwise than the link
/// protocol.
pub(super) fn network_signals(args: &ServeArgs) -> Result<RecordedSignals, Failure> {
    let RecordedSignals { sampled, bodies, left_out } = signals(args)?;
    let is_recorded = args.take.is_some();
    let mut kept = Vec::new();
    for source in sampled {
        if source.has_losses() {
            let id = source.info().id;
            notify(&format!(
                "group {id} of the take is not sent: samples are missing in it, which only the link protocol can state"
            ));
        } else {
            // The plates of a take may have any channels in any order.
            kept.push(if is_recorded { source.without_plates() } else { source });
        }
    }
    Ok(RecordedSignals { sampled: kept, bodies, left_out })
}

/// The sampled channels for a server that sends no rigid bodies.
pub(super) fn network_sampled(args: &ServeArgs) -> Result<Vec<SampledSource>, Failure> {
    if args.bodies.is_some() {
        return Err(Failure::usage_message(
            "--bodies needs the link protocol or --protocol qtm: remove it",
        ));
    }
    let RecordedSignals { sampled, bodies, .. } = network_signals(args)?;
    if bodies.is_some() {
        notify(
            "the rigid bodies of the take are not sent: the link protocol and --protocol qtm have them",
        );
    }
    Ok(sampled)
}

/// The sampled channels and rigid bodies of the take.
fn recorded(args: &ServeArgs) -> Result<RecordedSignals, Failure> {
    let is_take = |path: &&Path| {
        path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("take"))
    };
    let Some(path) = args.take.as_deref().filter(is_take) else {
        return Ok(RecordedSignals::default());
    };
    let seconds = args.seconds.map(|seconds| seconds.as_secs_f64());
    let mut found = source::read_signals(path, seconds).map_err(|error| match error {
        SourceError::Read { path, source } => cli::cannot_read(&path, source).into(),
        error => Failure::from(error),
    })?;
    let say = |what: &str| notify(&format!("{}: {what}", path.display()));
    found.left_out.iter().for_each(|why| say(&format!("not sent: {why}")));
    let has_any = !found.sampled.is_empty() || found.bodies.is_some();
    if has_any && (args.speed != 1.0 || args.looping) {
        say(
            "its sampled channels and rigid bodies are not sent: they need a take that is played once, at its own speed",
        );
        return Ok(RecordedSignals::default());
    }
    if found.bodies.is_some() && args.rate.is_some() {
        say("its rigid bodies are not sent at another rate: remove --rate");
        found.bodies = None;
    }
    Ok(found)
}

/// Adds the sampled channels of the options.
fn sampled(args: &ServeArgs, sources: &mut Vec<SampledSource>) -> Result<(), Failure> {
    let next_id = |sources: &[SampledSource]| {
        let is_free =
            |id: &usize| sources.iter().all(|source| usize::from(source.info().id) != *id);
        let message = format!("a device has at most {GROUPS_MAX} groups of sampled channels");
        (0..GROUPS_MAX).find(is_free).ok_or_else(|| Failure::usage_message(message))
    };
    if let (Some(rate_hz), Some(spec)) = (args.plates, generated(args)) {
        if args.speed != 1.0 || args.looping {
            return Err(Failure::usage_message(
                "--plates needs a motion that is played once, at its own speed: remove --speed and --loop",
            ));
        }
        let plates = Arc::new(ForcePlates::new(&spec).map_err(Failure::usage)?);
        sources.push(SampledSource::plates(0, plates, rate_hz).map_err(Failure::usage)?);
    }
    for electrodes in &args.emg {
        let (id, seed) = (next_id(sources)?, args.generate.map_or(0, |Generated { seed }| seed));
        let source = SampledSource::electrodes(id as u8, *electrodes, seed.wrapping_add(id as u64));
        sources.push(source.map_err(Failure::usage)?);
    }
    Ok(())
}

/// The rigid bodies of the options.
fn bodies(args: &ServeArgs) -> Result<Option<Arc<RigidBodies>>, Failure> {
    let (Some(n_bodies), Some(spec)) = (args.bodies, generated(args)) else { return Ok(None) };
    if args.speed != 1.0 || args.looping {
        return Err(Failure::usage_message(
            "--bodies needs a motion that is played once, at its own speed: remove --speed and --loop",
        ));
    }
    Ok(Some(Arc::new(RigidBodies::new(&spec, n_bodies).map_err(Failure::usage)?)))
}

/// Reads the fault script, if there is one.
pub(super) fn script(args: &ServeArgs) -> Result<Option<Arc<Script>>, Failure> {
    let Some(path) = &args.faults else { return Ok(None) };
    let cannot_read = || format!("cannot read {}", path.display());
    let file = cli::open_file(path)?;
    let mut text = String::new();
    // One byte more than allowed, to detect a file that is too long.
    let at_most = SCRIPT_BYTES_MAX as u64 + 1;
    file.take(at_most).read_to_string(&mut text).with_context(cannot_read)?;
    let name = path.display().to_string();
    let script = Script::parse(&name, &text).map_err(Failure::usage)?;
    let is_named = matches!(args.protocol, DeviceProtocol::Natnet | DeviceProtocol::Lsl);
    if script.unplugs() && !args.line.has_stable_name() && !is_named {
        let message = "the script unplugs the device, which needs a stable name: use --pty PATH";
        return Err(Failure::usage_message(format!("{}: {message}", path.display())));
    }
    Ok(Some(Arc::new(script)))
}

/// Maximum number of bytes in a raw log, which is held in memory: hours of a serial line, minutes of the fastest.
const LOG_BYTES_MAX: u64 = 1 << 30;

/// A file that matches this many of a raw log's first eight bytes is taken for a damaged log.
const MAGIC_BYTES_MATCHING: usize = 4;

/// Reads the file if it is a raw log; `None` if it is something else.
pub(super) fn log(args: &ServeArgs) -> Result<Option<Vec<u8>>, Failure> {
    let Some(path) = &args.take else { return Ok(None) };
    if !is_motion(path) && !path.exists() {
        // Reading it as a motion reports the extension.
        return Ok(None);
    }
    let mut file = cli::open_file(path)?;
    let cannot_read = || format!("cannot read {}", path.display());
    let mut head = Vec::new();
    file.by_ref().take(MAGIC.len() as u64).read_to_end(&mut head).with_context(cannot_read)?;
    if head != MAGIC {
        return if is_motion(path) { Ok(None) } else { Err(unknown_file(path, &head)) };
    }
    refuse_motion_options(args, path)?;
    file.seek(SeekFrom::Start(0)).with_context(cannot_read)?;
    let mut log = Vec::new();
    file.take(LOG_BYTES_MAX + 1).read_to_end(&mut log).with_context(cannot_read)?;
    if log.len() as u64 > LOG_BYTES_MAX {
        return Err(anyhow::anyhow!("{}: the log is longer than 1 GiB", path.display()).into());
    }
    Ok(Some(log))
}

/// The error for a file that is neither a motion nor a raw log, with a guess at what it was.
fn unknown_file(path: &Path, head: &[u8]) -> Failure {
    let path = path.display();
    let n_alike = head.iter().zip(&MAGIC).filter(|(found, expected)| found == expected).count();
    match head.len() {
        0 => anyhow::anyhow!("{path} is empty: expected a motion or a log of `mocapd record --raw`").into(),
        n if n < MAGIC.len() && n_alike == n => {
            anyhow::anyhow!("{path} is a raw log cut off in its first bytes: there is nothing to replay").into()
        }
        _ if n_alike >= MAGIC_BYTES_MATCHING => anyhow::anyhow!(
            "{path} looks like a raw log, but its first {} bytes are damaged; was it transferred as text?",
            MAGIC.len()
        )
        .into(),
        _ => Failure::usage_message(format!(
            "{path}: expected a motion (.take, .c3d, .trc, .tsv or .csv) or a log of `mocapd record --raw`"
        )),
    }
}

fn refuse_motion_options(args: &ServeArgs, path: &Path) -> Result<(), Failure> {
    let options = [
        ("--rate", args.rate.is_some()),
        ("--seconds", args.seconds.is_some()),
        ("--wire", args.wire.is_some()),
        ("--loop", args.looping),
        ("--faults", args.faults.is_some()),
        ("--log", args.log.is_some()),
        ("--batch-log", args.batch_log.is_some()),
        ("--emg", !args.emg.is_empty()),
        ("--residuals", args.residuals),
        ("--drift-ppm", args.drift_ppm != 0.0),
        ("--protocol", args.protocol != DeviceProtocol::Dvmc),
        ("--tool", !args.tool.is_empty()),
        ("--no-bx2", args.no_bx2),
    ];
    match options.iter().find(|(_, is_set)| *is_set) {
        Some((option, _)) => Err(Failure::usage_message(format!(
            "{option} applies to motions only: {} is a raw log, which is replayed unchanged",
            path.display()
        ))),
        None => Ok(()),
    }
}

/// The device that replays a log, and its description.
pub(super) fn log_device(
    args: &ServeArgs,
    log: &[u8],
) -> Result<(Box<dyn LineDevice>, String), Failure> {
    let name = args.take.as_deref().unwrap_or(Path::new("")).display();
    let device = LogDevice::new(log, args.speed).map_err(|error| match error {
        LogDeviceError::Speed { .. } => Failure::usage(error),
        LogDeviceError::Driver { .. } => Failure::usage(anyhow::anyhow!("{name}: {error}")),
        _ => anyhow::anyhow!("{name}: {error}").into(),
    })?;
    if device.unplugs() && !args.line.has_stable_name() {
        let message =
            "the cable is pulled in this log, so the device needs a stable name: use --pty PATH";
        return Err(Failure::usage_message(format!("{name}: {message}")));
    }
    device.problems().iter().for_each(|problem| notify(&problem.to_string()));
    Ok((Box::new(device), "replaying a raw log, Ctrl-C to stop".to_owned()))
}
