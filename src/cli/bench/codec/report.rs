//! What `bench codec` tells, in words and as JSON.

use std::time::Duration;

use mocapd_acquire::inspect::{Summary, size_ratio};
use mocapd_codec::Settings;
use serde::Serialize;

use super::measure::Subject;
use crate::cli::output::plain;

/// The document.
#[derive(Debug, Default, Serialize)]
pub(super) struct Report {
    pub(super) files: Vec<FileReport>,
}

/// One file.
#[derive(Debug, Serialize)]
pub(super) struct FileReport {
    file: String,
    rate_hz: f64,
    frames: u64,
    markers: usize,
    samples: u64,
    raw_bytes: u64,
    pub(super) results: Vec<Measured>,
}

/// One setting on one file.
#[derive(Debug, Serialize)]
pub(super) struct Measured {
    resampler: String,
    tolerance_mm: f64,
    /// The file, everything included.
    bytes: u64,
    /// The blocks and the time line alone.
    block_bytes: u64,
    kept: u64,
    ratio: f64,
    bits_per_scalar: f64,
    max_error_mm: f64,
    encode_mb_s: f64,
    decode_mb_s: f64,
}

impl FileReport {
    pub(super) fn new(subject: &Subject<'_>) -> Self {
        let info = &subject.motion.info;
        let samples = subject.samples();
        Self {
            file: subject.file.display().to_string(),
            rate_hz: info.rate_hz,
            frames: subject.motion.n_frames() as u64,
            markers: info.markers.len(),
            samples,
            raw_bytes: 12 * samples,
            results: Vec::new(),
        }
    }

    /// The heading of its lines.
    pub(super) fn head(&self) -> String {
        format!(
            "{}: {} markers, {} frames at {} Hz, {} bytes of float32\n\
             {:20} {:>9} {:>10} {:>8} {:>7} {:>12} {:>10} {:>10}\n",
            plain(&self.file),
            self.markers,
            self.frames,
            self.rate_hz,
            self.raw_bytes,
            "resampler",
            "tolerance",
            "bytes",
            "ratio",
            "bits",
            "max error",
            "encode",
            "decode"
        )
    }
}

impl Measured {
    pub(super) fn new(
        codec: &Settings,
        summary: &Summary,
        bytes: u64,
        max_error_mm: f64,
        (encode, decode): (Duration, Duration),
    ) -> Self {
        let raw_bytes = summary.raw_bytes();
        let speed = |took: Duration| raw_bytes as f64 / 1e6 / took.as_secs_f64().max(1e-9);
        Self {
            resampler: codec.kind.to_string(),
            tolerance_mm: if codec.kind.is_lossless() { 0.0 } else { codec.tolerance.mm() },
            bytes,
            block_bytes: summary.bytes.blocks + summary.bytes.lengths + summary.bytes.time_line,
            kept: summary.knots(),
            ratio: size_ratio(summary.samples(), bytes),
            bits_per_scalar: bytes as f64 * 8.0 / (3 * summary.samples()).max(1) as f64,
            max_error_mm,
            encode_mb_s: speed(encode),
            decode_mb_s: speed(decode),
        }
    }

    /// One line of the table.
    pub(super) fn line(&self) -> String {
        let tolerance = format!("{} mm", self.tolerance_mm);
        format!(
            "{:20} {:>9} {:>10} {:>8.2} {:>7.3} {:>9.4} mm {:>5.0} MB/s {:>5.0} MB/s\n",
            self.resampler,
            tolerance,
            self.bytes,
            self.ratio,
            self.bits_per_scalar,
            self.max_error_mm,
            self.encode_mb_s,
            self.decode_mb_s
        )
    }
}
