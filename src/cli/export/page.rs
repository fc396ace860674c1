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
    interchange::page_motion,
    motion::{FrameSource, frame_at, is_gap},
};
use serde::Serialize;
use serde_json::json;

use super::ExportPlan;
use crate::cli::{batch::Job, remote};

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
}

impl fmt::Display for PageAccuracy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { tolerance_mm, take_tolerance_mm, added_mm, max_added_mm } = self;
        write!(
            f,
            "positions within {tolerance_mm:.4} mm of the original: {take_tolerance_mm:.4} mm by the take, {added_mm:.4} mm \
             by the page (measured: {max_added_mm:.4} mm)"
        )
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
        let overview = TakeOverview::of_export(&name, map, info);
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
        };
        SharedPage::new()?.write(out, |out| -> anyhow::Result<String> {
            let coded = page_motion::write(frames, lattice, out, |frame, positions| {
                let row = first_row + frame;
                while lost.next_if(|run| run.end <= row).is_some() {}
                let is_lost = lost.peek().is_some_and(|run| run.contains(&row));
                let missing = positions.iter().filter(|position| is_gap(**position)).count();
                gaps.add_frame(frame, missing as u64, is_lost);
            })?;
            accuracy.max_added_mm = coded.max_added_mm;
            let mut overview = serde_json::to_value(&overview)?;
            overview["page"] = json!({
                "tolerance_mm": accuracy.tolerance_mm,
                "added_mm": accuracy.added_mm,
                "max_added_mm": accuracy.max_added_mm,
                "step_mm": lattice.step_mm,
                "block_frames": coded.block_frames,
                "gaps": gaps,
            });
            Ok(overview.to_string())
        })?;
        Ok(accuracy)
    }
}
