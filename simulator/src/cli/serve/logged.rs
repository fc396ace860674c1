//! `mocapd-sim serve LOG`: a raw log instead of a motion.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use anyhow::Context;
use mocapd_drivers::raw_log::MAGIC;
use mocapd_simulator::device::LineDevice;
use mocapd_simulator::logged::{LogDevice, LogDeviceError};

use super::{ServeArgs, Spoken, say};
use crate::cli::Failure;

/// Bytes of a log: hours of a serial line, minutes of the fastest. It is held in memory.
const LOG_BYTES_MAX: u64 = 1 << 30;

/// The file, when it is a log.
pub(super) fn read(args: &ServeArgs) -> Result<Option<Vec<u8>>, Failure> {
    let Some(path) = &args.take else { return Ok(None) };
    // What cannot be read is told with what it should have been.
    let Ok(mut file) = File::open(path) else { return Ok(None) };
    let mut head = [0; MAGIC.len()];
    if file.read_exact(&mut head).is_err() || head != MAGIC {
        return Ok(None);
    }
    refuse_what_is_for_motions(args, path)?;
    let cannot_read = || format!("cannot read {}", path.display());
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
pub(super) fn device(
    args: &ServeArgs,
    log: &[u8],
) -> Result<(Box<dyn LineDevice>, String), Failure> {
    let device = LogDevice::new(log, args.speed).map_err(|error| match error {
        LogDeviceError::Speed { .. } | LogDeviceError::Driver { .. } => Failure::usage(error),
        _ => Failure::from(error),
    })?;
    if device.unplugs() && !matches!(args.line.pty, Some(Some(_))) {
        let words = "the cable is pulled in this log, and the device needs a name that lasts: give --pty=LINK";
        return Err(Failure::usage(anyhow::anyhow!("{words}")));
    }
    device.problems().iter().for_each(|problem| say(problem));
    Ok((Box::new(device), "a raw log, Ctrl-C ends".to_owned()))
}
