//! The report of `info` as text.

use std::fmt::Write;

use mocapd_service::units;
use mocapd_take::record::CODEC_VERSION;

use super::{ForeignReport, InfoReport, contents};
use crate::cli::{
    ledger::{self, ClockReport},
    output::{plain, plain_path},
    values::{LABEL_COLUMNS_MAX, bytes, count, frames_of, length_of_time, rate, thousands},
};

/// The report in one line.
pub(super) fn line(report: &InfoReport) -> String {
    format!(
        "{}: {}, {}, {} of {} at {}, {} ({:.1}:1)\n",
        plain_path(&report.take),
        report.health.name(),
        length_of_time(report.seconds),
        frames_of(report.frames_recorded().unwrap_or(report.frames), report.frames),
        count(report.markers as u64, "marker"),
        rate(report.rate_hz),
        bytes(report.file_bytes),
        report.ratio,
    )
}

/// The report: a list of facts, the ledger, the clock, and with `all_markers` a table of the markers.
pub(super) fn text(report: &InfoReport, all_markers: bool) -> String {
    let mut out = String::new();
    let mut line = |name: &str, value: &str| {
        writeln!(out, "{name:<10} {}", plain(value)).ok();
    };
    line("take", &report.take.display().to_string());
    let by = format!("by {}", report.software);
    let created = report.created_unix_ms.and_then(units::local_time);
    line("made", &created.map_or(by.clone(), |at| format!("{at} {by}")));
    if let Some(recovered) = &report.recovered {
        line("recovered", recovered);
    }
    line("health", &health(report));
    origin(report, &mut line);
    if let Some(subject) = &report.subject {
        subject.lines(&mut line);
    }
    motion(report, &mut line);
    markers(report, &mut line);
    resampler(report, &mut line);
    size(report, &mut line);
    if let Some(store) = &report.store {
        let requests = count(store.requests, "request");
        let received = bytes(store.received_bytes);
        let window = count(store.window_requests, "request");
        line("store", &format!("{received} in {requests}; a second of it needs {window}"));
    }
    for lost in ledger::damage_lines(&report.damage) {
        line("lost", &lost);
    }
    // Frames are numbered as in the imported file, and as in exports.
    let first_frame = report.source.as_ref().map_or(1, |source| source.file.first_frame);
    for event in &report.events {
        let frame = thousands(first_frame.saturating_add(event.frame));
        let time_s = event.frame as f64 / report.rate_hz;
        let what = format!("at frame {frame}, {time_s:.3} s: {} {}", event.kind, event.text);
        line("event", &what);
    }
    if let Some(document) = &report.ledger {
        let is_import = report.source.is_some();
        out += &if is_import { ledger::import_text(document) } else { ledger::text(document) };
    }
    if let Some(document) = &report.sample_ledger {
        out += &ledger::samples_text(document);
    }
    if let Some(outages) = report.outages.text() {
        writeln!(out, "{:<10} {outages}", "outages").ok();
    }
    let by_ledger = || report.ledger.as_ref().and_then(ledger::clock_text);
    let clock = report.clock.as_ref().map(ClockReport::text).or_else(by_ledger);
    out.push_str(&clock.unwrap_or_default());
    if all_markers {
        marker_table(report, &mut out);
        contents::channel_table(&report.sampled_groups, &mut out);
        if let Some(poses) = &report.poses {
            poses.body_table(&mut out);
        }
    }
    let damaged = report.channels.iter().map(|c| (c.label.as_str(), c.frames_damaged));
    out.push_str(&ledger::damage_by_marker(&damaged.collect::<Vec<_>>()));
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
        let firmware = match device.firmware.as_str() {
            "" => String::new(),
            firmware => format!(", firmware {firmware}"),
        };
        // QTM has no serial number.
        let name = format!("{} {}", device.model, device.serial);
        let from = format!("{}{firmware}, at {}", name.trim_end(), device.uri);
        line("from", &from);
    }
    if let Some(source) = &report.source {
        let file = &source.file;
        let mut unit = match file.unit.as_str() {
            "" => "no unit stated".to_owned(),
            unit => format!("in {unit}"),
        };
        if let Some(option) = &source.unit_given {
            unit += &format!(", read as {option}");
        }
        if let Some(axis) = &source.up_given {
            unit += &format!(", {axis} up (--up)");
        }
        let (name, format, first_frame) = (&file.file, &file.format, file.first_frame);
        let from = format!("{name} ({format}, {unit}, first frame {first_frame})");
        line("from", &from);
        for warning in &file.warnings {
            line("note", warning);
        }
    }
    let recorded = || report.sampled_groups.iter().filter(|group| group.kind.is_empty());
    for group in recorded().filter(|group| !group.has_residuals) {
        let shape = contents::channels_text(&[group]);
        line("sampled", shape.trim_start_matches(": "));
    }
    let residuals: Vec<_> = recorded().filter(|group| group.has_residuals).collect();
    if !residuals.is_empty() {
        let shape = contents::channels_text(&residuals);
        line("residuals", shape.trim_start_matches(": "));
    }
    if let Some(poses) = &report.poses {
        line("poses", &poses.text());
        line("", &poses.tracked_text());
    }
    for part in &report.foreign_parts {
        let groups = report.sampled_groups.iter().filter(|group| group.kind == part.kind);
        let shape = contents::channels_text(&groups.collect::<Vec<_>>());
        line("kept", &format!("{}, {}{shape}", part.kind, bytes(part.bytes)));
    }
}

fn motion(report: &InfoReport, line: &mut impl FnMut(&str, &str)) {
    let up = report.up_axis.map_or(String::new(), |axis| format!(", {axis} is up"));
    let recorded = report.frames_recorded().unwrap_or(report.frames);
    let frames = frames_of(recorded, report.frames);
    let markers = count(report.markers as u64, "marker");
    let (rate, seconds) = (rate(report.rate_hz), report.seconds);
    line("motion", &format!("{frames} of {markers} at {rate}, {seconds:.3} s{up}"));
    let all = thousands(report.frames.saturating_mul(report.markers as u64));
    let gaps = count(report.channels.iter().map(|channel| channel.gaps).sum(), "gap");
    line("samples", &format!("{} of {all} present, {gaps}", thousands(report.samples)));
}

/// How many markers were seen, and which one was seen least.
fn markers(report: &InfoReport, line: &mut impl FnMut(&str, &str)) {
    let seen = || report.channels.iter().filter(|channel| channel.samples > 0);
    let all = count(report.markers as u64, "marker");
    let mut out = format!("{} of {all} seen", thousands(seen().count() as u64));
    // The first of equals, unless all are equal.
    let most = seen().map(|channel| channel.samples).max().unwrap_or(0);
    let fewer = seen().filter(|channel| channel.samples < most);
    if let Some(least) = fewer.min_by_key(|channel| channel.samples) {
        let share = 100.0 * least.samples as f64 / report.frames.max(1) as f64;
        let (label, gaps) = (&least.label, count(least.gaps, "gap"));
        out += &format!("; least {label}, in {share:.1} % of the frames, {gaps}");
    }
    line("markers", &out);
}

fn resampler(report: &InfoReport, line: &mut impl FnMut(&str, &str)) {
    let knots = count(report.channels.iter().map(|channel| channel.knots).sum(), "sample");
    let (tolerance_mm, error_mm) = (report.tolerance_mm, report.max_error_mm);
    let bound = if tolerance_mm > 0.0 {
        format!("within {tolerance_mm} mm (no error above {error_mm:.4} mm), {knots} kept")
    } else {
        "every bit of the positions kept".to_owned()
    };
    line("resampler", &format!("{}, {bound}", report.resampler));
    if report.keys.is_some() || report.format_version != CODEC_VERSION {
        let keys = match report.keys.as_deref() {
            None => "more than 10 s apart".to_owned(),
            Some("none") => "the first stretch only".to_owned(),
            Some(distance) => format!("at most {distance} apart"),
        };
        line("keys", &format!("{keys}; format version {}", report.format_version));
    }
}

/// The kinds of foreign parts that hold samples, in place of descriptions. Takes of earlier versions have them deflated.
const SAMPLED: [&str; 2] = ["c3d/analog", "c3d/model-outputs"];

fn size(report: &InfoReport, line: &mut impl FnMut(&str, &str)) {
    let (raw, file) = (bytes(report.raw_bytes), bytes(report.file_bytes));
    line("size", &format!("{raw} as float32, {file} on disk, {:.1}:1", report.ratio));
    if let Some(source_bytes) = report.source.as_ref().and_then(|source| source.bytes) {
        let ratio = source_bytes as f64 / report.file_bytes.max(1) as f64;
        line("", &format!("{} in the imported file, {ratio:.1}:1", bytes(source_bytes)));
    }
    let trajectories = report.bytes.blocks;
    let is_sampled = |part: &&ForeignReport| SAMPLED.contains(&&*part.kind);
    let imported = report.foreign_parts.iter().filter(is_sampled).map(|part| part.stored_bytes);
    let recorded = report.sampled_groups.iter().filter(|group| group.kind.is_empty());
    let sampled = imported.sum::<u64>() + recorded.map(|group| group.stored_bytes).sum::<u64>();
    let rest = report.file_bytes.saturating_sub(trajectories + sampled);
    let ratio = report.raw_bytes as f64 / trajectories.max(1) as f64;
    let mut parts = format!("{} for trajectories, {ratio:.1}:1", bytes(trajectories));
    if sampled > 0 {
        parts += &format!("; {} for sampled data", bytes(sampled));
    }
    line("", &format!("{parts}; {} for the rest", bytes(rest)));
}

fn marker_table(report: &InfoReport, out: &mut String) {
    let label = |channel: &super::ChannelReport| {
        let note = if channel.labelled { "" } else { " (unlabelled)" };
        format!("{}{note}", plain(&channel.label))
    };
    let labels: Vec<String> = report.channels.iter().map(label).collect();
    let widths = labels.iter().map(|label| label.chars().count());
    let width = widths.max().unwrap_or(0).clamp(6, LABEL_COLUMNS_MAX);
    let (samples, knots, error) = ("samples", "knots", "error <= mm");
    writeln!(out, "{:<width$} {samples:>10} {:>6} {knots:>10} {error:>13}", "marker", "gaps").ok();
    for (label, channel) in labels.iter().zip(&report.channels) {
        let [samples, gaps, knots] = [channel.samples, channel.gaps, channel.knots].map(thousands);
        let error_mm = channel.max_error_mm;
        writeln!(out, "{label:<width$} {samples:>10} {gaps:>6} {knots:>10} {error_mm:>13.4}").ok();
    }
}
