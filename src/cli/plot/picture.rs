//! Where a picture goes, and what it is drawn from.

use std::path::Path;

use mocapd::outcome::{Outcome, UsageError};
use mocapd_codec::Settings;
use mocapd_report::{coded::Coded, plot::png};
use mocapd_take::motion::Motion;

use crate::cli::{
    output::say,
    paths,
    whole::{read_original, write_new},
};

/// Says early what writing there would meet.
///
/// # Errors
/// A usage error for an ending that is no picture's.
pub(crate) fn check_output(path: &Path) -> anyhow::Result<()> {
    if !is(path, "svg") && !is(path, "png") {
        return Err(UsageError(format!(
            "{}: the ending tells the format: use .svg or .png",
            path.display()
        ))
        .into());
    }
    paths::check_output(path)
}

fn is(path: &Path, ending: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending))
}

/// Writes the picture in the format of its ending.
///
/// # Errors
/// When it cannot be drawn or written.
pub(crate) fn write(path: &Path, svg: &str) -> anyhow::Result<()> {
    if is(path, "png") { write_new(path, &png(svg)?) } else { write_new(path, svg.as_bytes()) }
}

/// What the take was made of, and what that itself was coded with where it is a take.
///
/// # Errors
/// Why it cannot be read.
pub(super) fn original(
    take: &Path,
    coded: &Coded,
    path: &Path,
) -> anyhow::Result<(Motion, Option<Settings>)> {
    let (motion, settings) = read_original(take, path)?;
    let labels = |motion: &Motion| -> Vec<String> {
        motion.info.markers.iter().map(|marker| marker.label.clone()).collect()
    };
    if labels(&motion) != labels(&coded.motion) {
        say(&format!("{}: its labels are not those of {}", path.display(), take.display()));
    }
    if motion.n_frames() != coded.motion.n_frames() {
        say(&format!(
            "{} has {} frames, {} has {}: drawn from the first on",
            path.display(),
            motion.n_frames(),
            take.display(),
            coded.motion.n_frames()
        ));
    }
    Ok((motion, settings))
}

/// A picture of a damaged take shows what is left of it.
pub(super) fn outcome(coded: &Coded) -> Outcome {
    Outcome::of(!coded.problems.is_empty())
}
