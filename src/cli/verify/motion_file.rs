//! `verify` of a motion file of another tool: reads all of it, as an import does, and reports what is wrong or unclear.

use std::path::PathBuf;

use mocapd_take::motion::is_gap;
use serde::Serialize;

use crate::cli::{
    batch::{Figures, FileReport, Job},
    motion_files::read_motion_input,
    output::plain_path,
    values::{count, rate},
};

/// The report of `verify` for a motion file, documented in docs/json.md.
#[derive(Debug, Serialize)]
struct VerifiedMotionFile {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    file: PathBuf,
    format: String,
    /// Whether every announced frame is there.
    intact: bool,
    frames: u64,
    frames_missing: u64,
    seconds: f64,
    markers: usize,
    rate_hz: f64,
    samples: u64,
    /// Defects and how they were read, one sentence each.
    warnings: Vec<String>,
}

/// Reads a motion file and reports what is wrong with it.
///
/// # Errors
/// If it cannot be read.
pub(super) fn verify(job: &Job<'_>) -> anyhow::Result<FileReport> {
    let (motion, file_bytes) = read_motion_input(job)?;
    let (info, frames) = (&motion.info, motion.n_frames() as u64);
    let report = VerifiedMotionFile {
        file: job.input.name.clone(),
        format: info.source.format.clone(),
        intact: info.source.frames_missing == 0,
        frames,
        frames_missing: info.source.frames_missing,
        seconds: frames as f64 / info.rate_hz,
        markers: info.markers.len(),
        rate_hz: info.rate_hz,
        samples: motion.positions_mm.iter().filter(|&&position| !is_gap(position)).count() as u64,
        warnings: info.source.warnings.clone(),
    };
    if !job.is_json {
        report.warnings.iter().for_each(|warning| job.notify(warning));
    }
    let line = report.line();
    Ok(FileReport {
        data_lost: !report.intact,
        text: line.clone(),
        line,
        json: job.json(&report)?,
        figures: Figures {
            frames,
            seconds: report.seconds,
            bytes_read: file_bytes,
            ..Figures::default()
        },
        ..FileReport::default()
    })
}

impl VerifiedMotionFile {
    fn line(&self) -> String {
        let state = match self.frames_missing {
            0 => "whole".to_owned(),
            n => format!("TRUNCATED, {} missing", count(n, "frame")),
        };
        let warnings = match self.warnings.len() {
            0 => String::new(),
            n => format!(", {}", count(n as u64, "warning")),
        };
        format!(
            "{}: {state}, {} of {} at {}, {}{warnings}\n",
            plain_path(&self.file),
            count(self.frames, "frame"),
            count(self.markers as u64, "marker"),
            rate(self.rate_hz),
            count(self.samples, "sample")
        )
    }
}
