//! `info` and `verify` of a motion file of another tool, before it is imported.

use std::{fmt::Write, path::PathBuf};

use anyhow::Context;
use mocapd_take::{
    interchange::MotionReader,
    motion::{FrameSource, GAP, Marker, MotionInfo, is_gap},
};
use serde::Serialize;

use super::{
    batch::{Figures, FileReport, Job},
    motion_files::open_motion_input,
    output::{plain, plain_path},
    values::{LABEL_COLUMNS_MAX, bytes, count, length_of_time, rate, thousands},
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
    let (mut motion, file_bytes) = open_motion_input(job)?;
    let channels = count_samples(job, &mut motion)?;
    let report = MotionFileInfo::new(job, motion.info(), channels, file_bytes);
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
    fn new(
        job: &Job<'_>,
        info: &MotionInfo,
        channels: Vec<TrajectoryReport>,
        file_bytes: u64,
    ) -> Self {
        let (source, frames) = (&info.source, info.n_frames);
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
        line("unit", &format!("{unit} (factor to mm: {})", self.factor));
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

impl From<&Marker> for TrajectoryReport {
    fn from(marker: &Marker) -> Self {
        Self { label: marker.label.clone(), labelled: marker.labelled, samples: 0, gaps: 0 }
    }
}

/// Reads all frames, and counts the samples and gaps of each marker.
fn count_samples(
    job: &Job<'_>,
    motion: &mut MotionReader<'_>,
) -> anyhow::Result<Vec<TrajectoryReport>> {
    let markers = &motion.info().markers;
    let mut channels: Vec<TrajectoryReport> = markers.iter().map(Into::into).collect();
    let mut row = vec![GAP; channels.len()];
    let mut in_gap = vec![false; channels.len()];
    let reading = || format!("cannot read {}", job.input.name.display());
    while motion.next_frame(&mut row).with_context(reading)? {
        for ((channel, &at), in_gap) in channels.iter_mut().zip(&row).zip(&mut in_gap) {
            channel.samples += u64::from(!is_gap(at));
            channel.gaps += u64::from(is_gap(at) && !*in_gap);
            *in_gap = is_gap(at);
        }
    }
    Ok(channels)
}

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
    let (mut motion, file_bytes) = open_motion_input(job)?;
    let channels = count_samples(job, &mut motion)?;
    let (info, frames) = (motion.info(), motion.info().n_frames);
    let report = VerifiedMotionFile {
        file: job.input.name.clone(),
        format: info.source.format.clone(),
        intact: info.source.frames_missing == 0,
        frames,
        frames_missing: info.source.frames_missing,
        seconds: frames as f64 / info.rate_hz,
        markers: info.markers.len(),
        rate_hz: info.rate_hz,
        samples: channels.iter().map(|channel| channel.samples).sum(),
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
            0 => "complete".to_owned(),
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
