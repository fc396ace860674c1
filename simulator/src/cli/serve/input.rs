//! What the device plays: a motion, and what goes wrong with it; or a raw log.

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use mocapd_drivers::plain_file::{self, NotAFile};
use mocapd_drivers::raw_log::MAGIC;
use mocapd_simulator::device::LineDevice;
use mocapd_simulator::faults::{SCRIPT_BYTES_MAX, Script};
use mocapd_simulator::generator::{JumpSpec, Occlusion};
use mocapd_simulator::logged::{LogDevice, LogDeviceError};
use mocapd_simulator::source::{self, Generated, SourceError, is_motion};
use mocapd_take::motion::Motion;

use super::{ServeArgs, Spoken, say};
use crate::cli::Failure;

/// The rate of a generated motion when none is given: the commonest of optical rigs.
const GENERATED_RATE_HZ: f64 = 120.0;

/// Mean length of generated gaps, seconds: a limb that passes in front of a marker.
const MEAN_GAP_S: f64 = 0.2;

pub(super) fn motion(args: &ServeArgs) -> Result<Motion, Failure> {
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

/// What goes wrong.
pub(super) fn script(args: &ServeArgs) -> Result<Option<Arc<Script>>, Failure> {
    let Some(path) = &args.faults else { return Ok(None) };
    let cannot_read = || format!("cannot read {}", path.display());
    let file = plain_file::open(path).with_context(cannot_read)?;
    let mut text = String::new();
    // One byte more shows that it is too long.
    let at_most = SCRIPT_BYTES_MAX as u64 + 1;
    file.take(at_most).read_to_string(&mut text).with_context(cannot_read)?;
    let name = path.display().to_string();
    let script = Script::parse(&name, &text).map_err(Failure::usage)?;
    if script.unplugs() && !args.line.has_lasting_name() {
        let words = "a script that unplugs the device needs a name that lasts: give --pty=LINK";
        return Err(Failure::usage(anyhow::anyhow!("{}: {words}", path.display())));
    }
    Ok(Some(Arc::new(script)))
}

/// Bytes of a log: hours of a serial line, minutes of the fastest. It is held in memory.
const LOG_BYTES_MAX: u64 = 1 << 30;

/// So many bytes of a log's first eight are no accident.
const HEAD_ALIKE: usize = 4;

/// The file, when it is a log.
pub(super) fn log(args: &ServeArgs) -> Result<Option<Vec<u8>>, Failure> {
    let Some(path) = &args.take else { return Ok(None) };
    let mut file = match plain_file::open(path) {
        Ok(file) => file,
        Err(error) => match NotAFile::why(&error) {
            Some(what) => return Err(anyhow::anyhow!("{} is {what}", path.display()).into()),
            // What cannot be read is told with what it should have been.
            None => return Ok(None),
        },
    };
    let cannot_read = || format!("cannot read {}", path.display());
    let mut head = Vec::new();
    file.by_ref().take(MAGIC.len() as u64).read_to_end(&mut head).with_context(cannot_read)?;
    if head != MAGIC {
        return if is_motion(path) { Ok(None) } else { Err(is_nothing(path, &head)) };
    }
    refuse_what_is_for_motions(args, path)?;
    file.seek(SeekFrom::Start(0)).with_context(cannot_read)?;
    let mut log = Vec::new();
    file.take(LOG_BYTES_MAX + 1).read_to_end(&mut log).with_context(cannot_read)?;
    if log.len() as u64 > LOG_BYTES_MAX {
        return Err(
            anyhow::anyhow!("{}: a log of more than 1 GiB is too long", path.display()).into()
        );
    }
    Ok(Some(log))
}

/// Why a file that has no motion's ending is no log either, and what it may have been.
fn is_nothing(path: &Path, head: &[u8]) -> Failure {
    let path = path.display();
    let of_a_log = head.iter().zip(&MAGIC).filter(|(found, wanted)| found == wanted).count();
    match head.len() {
        0 => anyhow::anyhow!("{path} is empty: neither a motion nor a log of `mocapd record --raw`").into(),
        n if n < MAGIC.len() && of_a_log == n => {
            anyhow::anyhow!("{path} is a raw log that is cut off in its first bytes: there is nothing to replay").into()
        }
        _ if of_a_log >= HEAD_ALIKE => anyhow::anyhow!(
            "{path} begins nearly as a raw log does: its first {} bytes are damaged, or were sent as text",
            MAGIC.len()
        )
        .into(),
        _ => Failure::usage(anyhow::anyhow!(
            "{path}: unknown ending, expected .take, .c3d, .trc, .tsv or .csv, and it does not begin as a log of \
             `mocapd record --raw`"
        )),
    }
}

fn refuse_what_is_for_motions(args: &ServeArgs, path: &Path) -> Result<(), Failure> {
    let given = [
        ("--rate", args.rate.is_some()),
        ("--seconds", args.seconds.is_some()),
        ("--wire", args.wire.is_some()),
        ("--loop", args.looping),
        ("--faults", args.faults.is_some()),
        ("--log", args.log.is_some()),
        ("--drift-ppm", args.drift_ppm != 0.0),
        ("--protocol", args.protocol != Spoken::Dvmc),
        ("--tool", !args.tool.is_empty()),
        ("--no-bx2", args.no_bx2),
    ];
    match given.iter().find(|(_, given)| *given) {
        Some((option, _)) => Err(Failure::usage(anyhow::anyhow!(
            "{option} is for motions: {} is a raw log, and is sent as it is",
            path.display()
        ))),
        None => Ok(()),
    }
}

/// The device that a log is of, and what it is in words.
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
    if device.unplugs() && !args.line.has_lasting_name() {
        let words = "the cable is pulled in this log, and the device needs a name that lasts: give --pty=LINK";
        return Err(Failure::usage(anyhow::anyhow!("{words}")));
    }
    device.problems().iter().for_each(|problem| say(&problem.to_string()));
    Ok((Box::new(device), "a raw log, Ctrl-C ends".to_owned()))
}
