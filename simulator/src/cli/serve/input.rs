//! What the device plays: a motion, and what goes wrong with it.

use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use mocapd_drivers::plain_file;
use mocapd_simulator::faults::{SCRIPT_BYTES_MAX, Script};
use mocapd_simulator::generator::{JumpSpec, Occlusion};
use mocapd_simulator::source::{self, Generated, SourceError};
use mocapd_take::motion::Motion;

use super::{ServeArgs, say};
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
