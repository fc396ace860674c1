//! `info` of a motion file of another tool, before it is imported.

use std::{fmt::Write, path::PathBuf};

use mocapd_take::motion::{Motion, is_gap};
use serde::Serialize;

use super::LABEL_COLUMNS_MAX;
use crate::cli::{
    batch::{Figures, FileReport, Job},
    motion_files::read_motion_input,
    output::{plain, plain_path},
    values::{bytes, count, length_of_time, rate, thousands},
};

/// The report of `info` for a motion file, documented in docs/json.md.
#[derive(Debug, Serialize)]
struct MotionFileInfo {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    file: PathBuf,
    format: String,
    file_bytes: u64,
    frames: u64,
    frames_missing: u64,
    first_frame: u64,
    seconds: f64,
    markers: usize,
    rate_hz: f64,
    samples: u64,
    /// Bytes of the samples as float32: 12 each.
    raw_bytes: u64,
    /// The unit of length as the file states it; empty if it states none.
    unit: String,
    /// What its coordinates are multiplied by to get millimetres.
    factor: f64,
    up_axis: Option<&'static str>,
    foreign_parts: Vec<SourcePartReport>,
    events: Vec<SourceEventReport>,
    /// Defects and how they are read, one sentence each.
    warnings: Vec<String>,
    channels: Vec<TrajectoryReport>,
}

/// Content besides trajectories.
#[derive(Debug, Serialize)]
struct SourcePartReport {
    kind: String,
    bytes: u64,
}

#[derive(Debug, Serialize)]
struct SourceEventReport {
    kind: &'static str,
    frame: u64,
    text: String,
}

#[derive(Debug, Serialize)]
struct TrajectoryReport {
    label: String,
    labelled: bool,
    samples: u64,
    gaps: u64,
}

/// Reads a motion file and reports what is in it.
///
/// # Errors
/// If it cannot be read.
pub(super) fn info(job: &Job<'_>) -> anyhow::Result<FileReport> {
    let (motion, file_bytes) = read_motion_input(job)?;
    let report = MotionFileInfo::new(job, &motion, file_bytes);
    if !job.is_json {
        report.warnings.iter().for_each(|warning| job.notify(warning));
    }
    Ok(FileReport {
        data_lost: report.frames_missing > 0,
        text: report.text(),
        line: report.line(),
        json: job.json(&report)?,
        figures: Figures {
            frames: report.frames,
            seconds: report.seconds,
            bytes_read: report.file_bytes,
            ..Figures::default()
        },
        ..FileReport::default()
    })
}

impl MotionFileInfo {
    fn new(job: &Job<'_>, motion: &Motion, file_bytes: u64) -> Self {
        let (info, source) = (&motion.info, &motion.info.source);
        let frames = motion.n_frames() as u64;
        let channels: Vec<TrajectoryReport> =
            (0..info.markers.len()).map(|column| TrajectoryReport::new(motion, column)).collect();
        let samples = channels.iter().map(|channel| channel.samples).sum();
        let foreign = info.foreign.iter();
        let events = info.events.iter();
        Self {
            file: job.input.name.clone(),
            format: source.format.clone(),
            file_bytes,
            frames,
            frames_missing: source.frames_missing,
            first_frame: source.first_frame,
            seconds: frames as f64 / info.rate_hz,
            markers: info.markers.len(),
            rate_hz: info.rate_hz,
            samples,
            raw_bytes: 12 * samples,
            unit: source.unit.clone(),
            factor: source.factor,
            up_axis: info.up.name(),
            foreign_parts: foreign
                .map(|part| SourcePartReport { kind: part.kind.clone(), bytes: part.data.len() })
                .collect(),
            events: events
                .map(|event| SourceEventReport {
                    kind: event.kind.name(),
                    frame: event.frame,
                    text: event.text.clone(),
                })
                .collect(),
            warnings: source.warnings.clone(),
            channels,
        }
    }

    fn line(&self) -> String {
        let missing = match self.frames_missing {
            0 => String::new(),
            n => format!(", {} missing", count(n, "frame")),
        };
        format!(
            "{}: {}, {} of {} at {}, {}{missing}\n",
            plain_path(&self.file),
            length_of_time(self.seconds),
            count(self.frames, "frame"),
            count(self.markers as u64, "marker"),
            rate(self.rate_hz),
            bytes(self.file_bytes)
        )
    }

    fn text(&self) -> String {
        let mut out = String::new();
        let mut line = |name: &str, value: &str| {
            writeln!(out, "{name:<10} {}", plain(value)).ok();
        };
        line("file", &self.file.display().to_string());
        line("format", &format!("{}, {}", self.format, bytes(self.file_bytes)));
        let (frames, markers) = (count(self.frames, "frame"), count(self.markers as u64, "marker"));
        let length = length_of_time(self.seconds);
        line("motion", &format!("{frames} of {markers} at {}, {length}", rate(self.rate_hz)));
        let unit = if self.unit.is_empty() { "not stated" } else { &self.unit };
        line("unit", &format!("{unit}, {} mm", self.factor));
        line("up", self.up_axis.unwrap_or("not stated"));
        let (samples, raw) = (count(self.samples, "sample"), bytes(self.raw_bytes));
        line("samples", &format!("{samples}, {raw} as float32"));
        for part in &self.foreign_parts {
            line("also has", &format!("{}, {}", part.kind, bytes(part.bytes)));
        }
        for event in &self.events {
            line("event", &format!("frame {}: {} {}", event.frame, event.kind, event.text));
        }
        let labels = self.channels.iter().map(|channel| channel.label.chars().count());
        let width = labels.max().unwrap_or(0).clamp(6, LABEL_COLUMNS_MAX);
        writeln!(out, "{:<width$} {:>12} {:>8}", "marker", "samples", "gaps").ok();
        for TrajectoryReport { label, samples, gaps, .. } in &self.channels {
            let (label, samples, gaps) = (plain(label), thousands(*samples), thousands(*gaps));
            writeln!(out, "{label:<width$} {samples:>12} {gaps:>8}").ok();
        }
        out
    }
}

impl TrajectoryReport {
    fn new(motion: &Motion, column: usize) -> Self {
        let marker = &motion.info.markers[column];
        let (mut samples, mut gaps, mut in_gap) = (0, 0, false);
        for frame in 0..motion.n_frames() {
            let is_gap = is_gap(motion.frame(frame)[column]);
            samples += u64::from(!is_gap);
            gaps += u64::from(is_gap && !in_gap);
            in_gap = is_gap;
        }
        Self { label: marker.label.clone(), labelled: marker.labelled, samples, gaps }
    }
}
