//! `mocapd-sim serve LOG`: a raw log instead of a motion.

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use anyhow::Context;
use mocapd_drivers::plain_file::{self, NotAFile};
use mocapd_drivers::raw_log::MAGIC;
use mocapd_simulator::device::LineDevice;
use mocapd_simulator::logged::{LogDevice, LogDeviceError};
use mocapd_simulator::source::is_motion;

use super::{ServeArgs, Spoken, say};
use crate::cli::Failure;

/// Bytes of a log: hours of a serial line, minutes of the fastest. It is held in memory.
const LOG_BYTES_MAX: u64 = 1 << 30;

/// So many bytes of a log's first eight are no accident.
const HEAD_ALIKE: usize = 4;

/// The file, when it is a log.
pub(super) fn read(args: &ServeArgs) -> Result<Option<Vec<u8>>, Failure> {
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
pub(super) fn device(
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
    device.problems().iter().for_each(|problem| say(problem));
    Ok((Box::new(device), "a raw log, Ctrl-C ends".to_owned()))
}
