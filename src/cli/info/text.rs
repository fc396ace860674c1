//! The report of `info` as text.

use std::fmt::Write;

use mocapd_service::units;

use super::{LABEL_COLUMNS_MAX, report::InfoReport};
use crate::cli::{
    clock::ClockReport,
    damage, ledger,
    output::plain,
    values::{bytes, count, frames_of, thousands},
};

/// The whole report: a list of facts, the ledger, the clock and a table of the markers.
pub(super) fn text(report: &InfoReport) -> String {
    let mut out = String::new();
    let mut line = |name: &str, value: &str| {
        writeln!(out, "{name:<10} {}", plain(value)).ok();
    };
    line("take", &report.take.display().to_string());
    let by = format!("by {}", report.software);
    let made = report.created_unix_ms.and_then(units::local_time);
    line("made", &made.map_or(by.clone(), |made| format!("{made} {by}")));
    if let Some(recovered) = &report.recovered {
        line("recovered", recovered);
    }
    line("health", &health(report));
    origin(report, &mut line);
    if let Some(subject) = &report.subject {
        subject.lines(&mut line);
    }
    motion(report, &mut line);
    size(report, &mut line);
    for lost in damage::lines(&report.damage) {
        line("lost", &lost);
    }
    // Frames are numbered as in the imported file, and as in exports.
    let first_frame = report.source.as_ref().map_or(0, |source| source.file.first_frame);
    for event in &report.events {
        let frame = thousands(first_frame.saturating_add(event.frame));
        let time_s = event.frame as f64 / report.rate_hz;
        let what = format!("at frame {frame}, {time_s:.3} s: {} {}", event.kind, event.text);
        line("event", &what);
    }
    if let Some(document) = &report.ledger {
        let text = match report.source {
            Some(_) => ledger::import_text(document),
            None => ledger::text(document),
        };
        out.push_str(&text);
    }
    if let Some(outages) = report.outages.text() {
        writeln!(out, "{:<10} {outages}", "outages").ok();
    }
    let by_ledger = || report.ledger.as_ref().and_then(ledger::clock_text);
    out.push_str(
        &report.clock.as_ref().map(ClockReport::text).or_else(by_ledger).unwrap_or_default(),
    );
    markers(report, &mut out);
    let damaged = report.channels.iter().map(|c| (c.label.as_str(), c.frames_damaged));
    out.push_str(&damage::by_marker(&damaged.collect::<Vec<_>>()));
    out
}

/// The health of the take and how it ended.
fn health(report: &InfoReport) -> String {
    let mut out = report.health.name().to_owned();
    if let Some(ending) = report.ending {
        out += &format!("; ended: {ending}");
    }
    if let Some(detail) = &report.ending_detail {
        out += &format!(" ({detail})");
    }
    out
}

fn origin(report: &InfoReport, line: &mut impl FnMut(&str, &str)) {
    if let Some(device) = &report.device {
        let firmware = if device.firmware.is_empty() {
            String::new()
        } else {
            format!(", firmware {}", device.firmware)
        };
        let device_line =
            format!("{} {}{firmware}, at {}", device.model, device.serial, device.uri);
        line("from", &device_line);
    }
    if let Some(source) = &report.source {
        let mut unit = match source.file.unit.as_str() {
            "" => "no unit stated".to_owned(),
            unit => format!("in {unit}"),
        };
        if let Some(given) = &source.unit_given {
            unit += &format!(", read as {given}");
        }
        if let Some(given) = &source.up_given {
            unit += &format!(", {given} up (--up)");
        }
        let file_line = format!(
            "{} ({}, {unit}, first frame {})",
            source.file.file, source.file.format, source.file.first_frame
        );
        line("from", &file_line);
        for warning in &source.file.warnings {
            line("note", warning);
        }
    }
    for part in &report.foreign_parts {
        line("kept", &format!("{}, {}", part.kind, bytes(part.bytes)));
    }
}

fn motion(report: &InfoReport, line: &mut impl FnMut(&str, &str)) {
    let up = report.up_axis.map_or(String::new(), |axis| format!(", {axis} is up"));
    let recorded = report.frames_recorded().unwrap_or(report.frames);
    let frames = frames_of(recorded, report.frames);
    let markers = count(report.markers as u64, "marker");
    line(
        "motion",
        &format!("{frames} of {markers} at {} Hz, {:.3} s{up}", report.rate_hz, report.seconds),
    );
    let all = report.frames.saturating_mul(report.markers as u64);
    let gaps: u64 = report.channels.iter().map(|channel| channel.gaps).sum();
    line(
        "samples",
        &format!(
            "{} of {} present, {}",
            thousands(report.samples),
            thousands(all),
            count(gaps, "gap")
        ),
    );
}

fn size(report: &InfoReport, line: &mut impl FnMut(&str, &str)) {
    let knots: u64 = report.channels.iter().map(|channel| channel.knots).sum();
    let bound = if report.tolerance_mm > 0.0 {
        format!(
            "within {} mm (largest error {:.4} mm), {} kept",
            report.tolerance_mm,
            report.max_error_mm,
            count(knots, "sample")
        )
    } else {
        "every bit kept".to_owned()
    };
    line("resampler", &format!("{}, {bound}", report.resampler));
    line(
        "size",
        &format!(
            "{} as float32, {} on disk, {:.1}:1",
            bytes(report.raw_bytes),
            bytes(report.file_bytes),
            report.ratio
        ),
    );
    if !report.foreign_parts.is_empty() {
        let blocks = report.bytes.blocks;
        let ratio = report.raw_bytes as f64 / blocks.max(1) as f64;
        let trajectories = format!("{} of it for trajectories, {ratio:.1}:1", bytes(blocks));
        line("", &format!("{trajectories}; the rest is mostly the header and foreign data"));
    }
    if let (Some(sr1), Some(sr2)) = (report.sr1, report.sr2) {
        line("SR1, SR2", &format!("{sr1:.2}, {sr2:.2} (Shi et al. 2012, eq. 7 and 8)"));
    }
}

fn markers(report: &InfoReport, out: &mut String) {
    let label = |channel: &super::report::ChannelReport| {
        let note = if channel.labelled { "" } else { " (unlabelled)" };
        format!("{}{note}", plain(&channel.label))
    };
    let labels: Vec<String> = report.channels.iter().map(label).collect();
    let width = labels
        .iter()
        .map(|label| label.chars().count())
        .max()
        .unwrap_or(0)
        .clamp(6, LABEL_COLUMNS_MAX);
    let (samples, knots, error) = ("samples", "knots", "max error mm");
    writeln!(out, "{:<width$} {samples:>10} {:>6} {knots:>10} {error:>13}", "marker", "gaps").ok();
    for (label, channel) in labels.iter().zip(&report.channels) {
        writeln!(
            out,
            "{label:<width$} {:>10} {:>6} {:>10} {:>13.4}",
            thousands(channel.samples),
            thousands(channel.gaps),
            thousands(channel.knots),
            channel.max_error_mm
        )
        .ok();
    }
}
