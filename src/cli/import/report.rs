//! What `import` says when it is done, as docs/json.md has it, and for people.

use std::path::{Path, PathBuf};

use mocapd_acquire::{inspect::size_ratio, pipeline::Written};
use mocapd_codec::Settings;
use mocapd_take::motion::Motion;
use serde::Serialize;

use crate::cli::{
    codec_args::tolerance_mm,
    numbers::{bytes, count, thousands},
    output::shown,
};

#[derive(Debug, Serialize)]
pub(super) struct Report {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    frames: u64,
    frames_missing: u64,
    seconds: f64,
    markers: usize,
    rate_hz: f64,
    samples: u64,
    samples_missing: u64,
    raw_bytes: u64,
    file_bytes: u64,
    ratio: f64,
    resampler: String,
    tolerance_mm: f64,
    max_error_mm: f64,
    foreign_dropped: Vec<String>,
    warnings: Vec<String>,
}

impl Report {
    pub(super) fn new(
        take: &Path,
        motion: &Motion,
        codec: &Settings,
        written: &Written,
        foreign_dropped: Vec<String>,
    ) -> Self {
        let info = &motion.info;
        let frames = motion.n_frames() as u64;
        Self {
            take: take.to_owned(),
            frames,
            frames_missing: info.source.frames_missing,
            seconds: frames as f64 / info.rate_hz,
            markers: info.markers.len(),
            rate_hz: info.rate_hz,
            samples: written.samples,
            samples_missing: (motion.positions_mm.len() as u64).saturating_sub(written.samples),
            raw_bytes: 12 * written.samples,
            file_bytes: written.file_bytes,
            ratio: size_ratio(written.samples, written.file_bytes),
            resampler: codec.kind.to_string(),
            tolerance_mm: tolerance_mm(codec),
            max_error_mm: written.max_error_mm,
            foreign_dropped,
            warnings: info.source.warnings.clone(),
        }
    }

    pub(super) fn words(&self) -> String {
        let bound = if self.tolerance_mm > 0.0 {
            format!("max error {:.4} mm <= {} mm", self.max_error_mm, self.tolerance_mm)
        } else {
            "every bit kept".to_owned()
        };
        let gaps = match self.samples_missing {
            0 => String::new(),
            n => format!(" ({} samples missing)", thousands(n)),
        };
        format!(
            "{}: {} of {}{gaps} at {} Hz, {} as float32, {} on disk ({:.1}:1), {bound}\n",
            shown(&self.take),
            count(self.frames, "frame"),
            count(self.markers as u64, "marker"),
            self.rate_hz,
            bytes(self.raw_bytes),
            bytes(self.file_bytes),
            self.ratio,
        )
    }
}
