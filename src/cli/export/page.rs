//! A page that plays a take in a browser, without mocapd and without a network.

use std::{
    fmt,
    io::{BufReader, Write},
};

use anyhow::Context;
use mocapd_service::{
    page::SharedPage,
    playback::{GapBins, TakeOverview, lost_runs},
};
use mocapd_take::{
    TakeMap,
    interchange::page_motion::{self, Lattice},
    motion::{FrameSource, MotionInfo, frame_at, is_gap},
    poses::PoseBody,
};
use serde::Serialize;
use serde_json::json;

use super::ExportPlan;
use crate::cli::{batch::Job, remote};

/// Longest name of a rigid body on a page, in characters.
const NAME_CHARS_MAX: usize = 200;

/// How far positions on a page can be from those of the recording or the imported file, in millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct PageAccuracy {
    /// The largest distance: the sum of the following two.
    tolerance_mm: f64,
    /// The tolerance of the take.
    take_tolerance_mm: f64,
    /// What coding for the page may add.
    added_mm: f64,
    /// What it added at most, measured.
    max_added_mm: f64,
    /// For rigid bodies; null without any.
    angles: Option<AngleAccuracy>,
}

/// How far rotations of rigid bodies on a page can be from those that the device sent, in degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct AngleAccuracy {
    /// The largest angle: the sum of the following two.
    tolerance_degrees: f64,
    /// The largest angle that the take allows.
    take_tolerance_degrees: f64,
    /// What coding for the page may add.
    added_degrees: f64,
    /// What it added at most, measured.
    max_added_degrees: f64,
}

impl AngleAccuracy {
    /// The bounds for a take with rigid bodies; `None` without any.
    fn of(map: &TakeMap, info: &MotionInfo, lattice: Lattice) -> Option<Self> {
        info.recording.as_ref().filter(|recording| !recording.bodies().is_empty())?;
        let bounds = map.pose_groups().filter_map(|samples| samples.group.pose_bounds());
        let take_tolerance_degrees = bounds.map(|[_, degrees]| degrees).fold(0.0, f64::max);
        let added_degrees = lattice.added_degrees();
        Some(Self {
            tolerance_degrees: take_tolerance_degrees + added_degrees,
            take_tolerance_degrees,
            added_degrees,
            max_added_degrees: 0.0,
        })
    }
}

impl fmt::Display for PageAccuracy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { tolerance_mm, take_tolerance_mm, added_mm, max_added_mm, angles } = self;
        write!(
            f,
            "positions within {} mm of the original: those of the take within {} mm, and the page adds at most {} mm (the largest \
             that it added is {} mm)",
            rounded_up(*tolerance_mm, BOUND_DIGITS),
            rounded_up(*take_tolerance_mm, BOUND_DIGITS),
            rounded_up(*added_mm, BOUND_DIGITS),
            rounded_up(*max_added_mm, MEASURED_DIGITS)
        )?;
        let Some(angles) = angles else { return Ok(()) };
        write!(
            f,
            "; rotations of rigid bodies within {} degrees, of which the page adds at most {} (the largest that it added is {})",
            rounded_up(angles.tolerance_degrees, BOUND_DIGITS),
            rounded_up(angles.added_degrees, BOUND_DIGITS),
            rounded_up(angles.max_added_degrees, MEASURED_DIGITS)
        )
    }
}

/// Significant digits of a bound, and of what was measured, which is often just below it.
const BOUND_DIGITS: i32 = 3;
const MEASURED_DIGITS: i32 = 4;

/// A bound with so many significant digits: never rounded down, since it would be wrong then.
fn rounded_up(mm: f64, digits: i32) -> String {
    if mm <= 0.0 {
        return "0".to_owned();
    }
    let digits = digits - 1 - mm.log10().floor() as i32;
    let scale = 10_f64.powi(digits);
    // A bound that is computed from decimal numbers is not meant to be above them by the last bit.
    let text = format!("{:.*}", digits.max(0) as usize, (mm * scale - 1e-9).ceil() / scale);
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

impl ExportPlan<'_> {
    /// Writes a page with all frames of a source.
    pub(super) fn write_page(
        &self,
        frames: &mut dyn FrameSource,
        job: &Job<'_>,
        out: &mut impl Write,
    ) -> anyhow::Result<PageAccuracy> {
        let map = frames.take().context("a page can be made of a take only")?;
        let info = frames.info();
        let name = job.input.name.file_stem().unwrap_or_default().to_string_lossy();
        let mut overview = TakeOverview::of_export(&name, map, info);
        let take_tolerance_mm = overview.tolerance_mm;
        let lattice = self.args.format.lattice(take_tolerance_mm)?;
        let first_row = self.args.from.map_or(0, |time| frame_at(time, info.rate_hz));
        let mut input = BufReader::new(remote::open(&job.input.path)?);
        let lost = lost_runs(&mut input).context("cannot read the lost frames of the take")?;
        let mut lost = lost.into_iter().peekable();
        let mut gaps = GapBins::new(info.n_frames);
        let mut accuracy = PageAccuracy {
            tolerance_mm: take_tolerance_mm + lattice.added_mm,
            take_tolerance_mm,
            added_mm: lattice.added_mm,
            max_added_mm: 0.0,
            angles: AngleAccuracy::of(map, info, lattice),
        };
        let bodies = info.recording.as_ref().map_or(&[][..], |recording| recording.bodies());
        let name_of = |body: &PoseBody| body.name.chars().take(NAME_CHARS_MAX).collect();
        let bodies: Vec<String> = bodies.iter().map(name_of).collect();
        SharedPage::new()?.write(out, |out| -> anyhow::Result<String> {
            let coded =
                page_motion::write(frames, lattice, out, |frame, positions, is_damaged| {
                    let row = first_row + frame;
                    while lost.next_if(|run| run.end <= row).is_some() {}
                    let is_lost = is_damaged || lost.peek().is_some_and(|run| run.contains(&row));
                    let missing = positions.iter().filter(|position| is_gap(**position)).count();
                    gaps.add_frame(frame, missing as u64, is_lost);
                })?;
            accuracy.max_added_mm = coded.max_added_mm;
            if let Some(angles) = &mut accuracy.angles {
                angles.max_added_degrees = coded.max_added_degrees;
            }
            if let Some(map) = frames.take() {
                // What was found while the frames were decoded, too.
                overview.set_problems(&map.problems);
            }
            let mut overview = serde_json::to_value(&overview)?;
            overview["page"] = json!({
                "tolerance_mm": accuracy.tolerance_mm,
                "added_mm": accuracy.added_mm,
                "max_added_mm": accuracy.max_added_mm,
                "step_mm": lattice.step_mm,
                "block_frames": coded.block_frames,
                "bodies": bodies,
                "angles": accuracy.angles,
                "gaps": gaps,
            });
            Ok(overview.to_string())
        })?;
        Ok(accuracy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stated_bound_is_never_smaller_than_the_bound() {
        for (mm, text) in [
            (0.0, "0"),
            (0.004, "0.004"),
            (0.1125, "0.113"),
            (0.5 + 0.5, "1"),
            (0.1 + 0.2, "0.3"),
            (1.004, "1.01"),
            (0.49991, "0.5"),
            (39.96, "40"),
            (1234.5, "1240"),
        ] {
            assert_eq!(rounded_up(mm, BOUND_DIGITS), text);
        }
        assert_eq!(rounded_up(0.499_79, MEASURED_DIGITS), "0.4998");
    }
}
