//! `info`: what is in a take.

use std::{fmt::Write, io::BufReader, path::PathBuf};

use anyhow::Context;
use mocapd::{
    files,
    inspect::{Summary, size_ratio},
    outcome::Outcome,
};
use mocapd_take::record::{Event, Header, Ledger};
use serde::Serialize;

use super::output::{bytes, print, print_json, say, thousands};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    take: PathBuf,
    finished: bool,
    problems: Vec<String>,
    software: String,
    created: String,
    resampler: String,
    tolerance_mm: f64,
    device: Option<DeviceReport>,
    source: Option<SourceReport>,
    frames: u64,
    seconds: f64,
    markers: usize,
    rate_hz: f64,
    samples: u64,
    raw_bytes: u64,
    file_bytes: u64,
    foreign_parts: Vec<ForeignReport>,
    ratio: f64,
    max_error_mm: f64,
    stretches: u64,
    sr1: Option<f64>,
    sr2: Option<f64>,
    ledger: Option<LedgerReport>,
    events: Vec<EventReport>,
    channels: Vec<ChannelReport>,
}

#[derive(Debug, Serialize)]
struct DeviceReport {
    driver: String,
    uri: String,
    model: String,
    serial: String,
    firmware: String,
    tick_hz: u64,
}

#[derive(Debug, Serialize)]
struct SourceReport {
    format: String,
    file: String,
    unit: String,
    factor_to_mm: f64,
    first_frame: u64,
    warnings: Vec<String>,
}

#[derive(Debug, Serialize)]
struct ForeignReport {
    kind: String,
    bytes: u64,
}

#[derive(Debug, Serialize)]
struct EventReport {
    kind: String,
    frame: u64,
    text: String,
}

#[derive(Debug, Serialize)]
struct ChannelReport {
    label: String,
    labelled: bool,
    samples: u64,
    gaps: u64,
    knots: u64,
    max_error_mm: f64,
    payload_bytes: u64,
}

/// A ledger as JSON and as words, the same for every command that shows one.
#[derive(Debug, Serialize)]
pub(crate) struct LedgerReport {
    closes: bool,
    frames_sent: u64,
    recorded: u64,
    lost_on_link: u64,
    dropped_by_device: u64,
    lost_in_host: LostInHost,
    duplicates: u64,
    unknown_after_disconnect: u64,
    frame_balance: i64,
    samples_announced: u64,
    samples_present: u64,
    samples_occluded: u64,
    samples_not_finite: u64,
    sample_balance: i64,
    markers_dropped: u64,
    link_bytes: u64,
    link_bytes_skipped: u64,
    link_messages: u64,
    link_messages_damaged: u64,
    link_messages_unknown: u64,
    contradictions: Vec<String>,
    clock: Option<ClockReport>,
}

#[derive(Debug, Serialize)]
struct LostInHost {
    ring_full: u64,
    other: u64,
}

#[derive(Debug, Serialize)]
struct ClockReport {
    drift_ppm: f64,
    residual_us: f64,
}

impl LedgerReport {
    pub(crate) fn new(ledger: &Ledger) -> Self {
        let whole = |balance: i128| i64::try_from(balance).unwrap_or(i64::MAX);
        Self {
            closes: ledger.closes(),
            frames_sent: ledger.frames_sent,
            recorded: ledger.recorded,
            lost_on_link: ledger.lost_on_link,
            dropped_by_device: ledger.dropped_by_device,
            lost_in_host: LostInHost {
                ring_full: ledger.lost_ring_full,
                other: ledger.lost_other,
            },
            duplicates: ledger.duplicates,
            unknown_after_disconnect: ledger.unknown_after_disconnect,
            frame_balance: whole(ledger.frame_balance()),
            samples_announced: ledger.samples_announced,
            samples_present: ledger.samples_present,
            samples_occluded: ledger.samples_occluded,
            samples_not_finite: ledger.samples_not_finite,
            sample_balance: whole(ledger.sample_balance()),
            markers_dropped: ledger.markers_dropped,
            link_bytes: ledger.link_bytes,
            link_bytes_skipped: ledger.link_bytes_skipped,
            link_messages: ledger.link_messages,
            link_messages_damaged: ledger.link_messages_damaged,
            link_messages_unknown: ledger.link_messages_unknown,
            contradictions: ledger.contradictions.clone(),
            clock: ledger.clock.map(|clock| ClockReport {
                drift_ppm: clock.drift_ppm,
                residual_us: clock.residual_us,
            }),
        }
    }

    /// As an account that adds up before the reader's eyes.
    pub(crate) fn words(&self) -> String {
        let mut out = String::from("ledger\n");
        let mut line = |n: u64, what: &str, always: bool| {
            if always || n > 0 {
                writeln!(out, "  {:>15} {what}", thousands(n)).ok();
            }
        };
        line(self.frames_sent, "frames sent", true);
        line(self.recorded, "recorded", true);
        line(self.lost_on_link, "lost on the link", true);
        line(self.dropped_by_device, "dropped by the device", true);
        line(self.lost_in_host.ring_full, "lost in the host: a ring was full", true);
        line(self.lost_in_host.other, "lost in the host: other", false);
        line(self.unknown_after_disconnect, "unknown after the disconnect", false);
        line(self.duplicates, "duplicates, not recorded again", false);
        let state = if self.closes { "the ledger closes" } else { "THE LEDGER DOES NOT CLOSE" };
        writeln!(out, "  {:>15} left over: {state}", self.frame_balance).ok();
        writeln!(
            out,
            "  {:>15} samples announced = {} present + {} occluded",
            thousands(self.samples_announced),
            thousands(self.samples_present),
            thousands(self.samples_occluded)
        )
        .ok();
        if self.markers_dropped > 0 {
            let n = thousands(self.markers_dropped);
            writeln!(out, "  {n:>15} samples of markers beyond the channel pool").ok();
        }
        if self.link_messages_damaged > 0 || self.link_bytes_skipped > 0 {
            writeln!(
                out,
                "  {:>15} messages arrived damaged, {} bytes skipped",
                thousands(self.link_messages_damaged),
                thousands(self.link_bytes_skipped)
            )
            .ok();
        }
        for contradiction in &self.contradictions {
            writeln!(out, "  contradiction: {contradiction}").ok();
        }
        if let Some(clock) = &self.clock {
            writeln!(
                out,
                "  device clock {:+.1} ppm against the host's, arrivals scatter by {:.0} us",
                clock.drift_ppm, clock.residual_us
            )
            .ok();
        }
        out
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let reading = || format!("cannot read {}", args.take.display());
    let file = files::open(&args.take)?;
    let file_bytes = file.metadata().with_context(reading)?.len();
    let summary = Summary::read(BufReader::new(file)).with_context(reading)?;
    let header = summary.header.clone().with_context(reading)?;
    let report = report(args, &summary, &header, file_bytes);
    if args.json {
        print_json(&report)?;
    } else {
        print(&words(&report))?;
        for problem in &report.problems {
            say(&format!("{}: {problem}", args.take.display()));
        }
    }
    let lost = summary.ledger.as_ref().is_some_and(Ledger::lost_anything);
    Ok(Outcome::of(lost || !report.problems.is_empty()))
}

fn report(args: &Args, summary: &Summary, header: &Header, file_bytes: u64) -> Report {
    let channels = summary.channels.iter().zip(&summary.per_channel);
    let created = jiff::Timestamp::from_millisecond(header.created_unix_ms);
    Report {
        take: args.take.clone(),
        finished: summary.finished,
        problems: summary.problems.clone(),
        software: header.software.clone(),
        created: created.map(|time| time.to_string()).unwrap_or_default(),
        resampler: header.resampler.clone(),
        tolerance_mm: header.tolerance_mm,
        device: header.device.clone().map(|d| DeviceReport {
            driver: d.driver,
            uri: d.uri,
            model: d.model,
            serial: d.serial,
            firmware: d.firmware,
            tick_hz: d.tick_hz,
        }),
        source: header.source.clone().map(|s| SourceReport {
            format: s.format,
            file: s.file,
            unit: s.unit,
            factor_to_mm: s.factor,
            first_frame: s.first_frame,
            warnings: s.warnings,
        }),
        frames: summary.rows,
        seconds: summary.rows as f64 / header.rate_hz,
        markers: summary.channels.len(),
        rate_hz: header.rate_hz,
        samples: summary.samples(),
        raw_bytes: summary.raw_bytes(),
        file_bytes,
        foreign_parts: summary
            .foreign
            .iter()
            .map(|(kind, bytes)| ForeignReport { kind: kind.clone(), bytes: *bytes })
            .collect(),
        ratio: size_ratio(summary.samples(), file_bytes),
        max_error_mm: summary.max_error_mm(),
        stretches: summary.stretches,
        sr1: summary.sr1(),
        sr2: summary.sr2(),
        ledger: summary.ledger.as_ref().map(LedgerReport::new),
        events: summary.events.iter().map(event_report).collect(),
        channels: channels
            .map(|(channel, c)| ChannelReport {
                label: channel.label.clone(),
                labelled: channel.labelled,
                samples: c.samples,
                gaps: c.gaps,
                knots: c.knots,
                max_error_mm: c.max_error_mm,
                payload_bytes: c.payload_bytes,
            })
            .collect(),
    }
}

fn event_report(event: &Event) -> EventReport {
    EventReport {
        kind: format!("{:?}", event.kind).to_lowercase(),
        frame: event.row,
        text: event.text.clone(),
    }
}

fn words(report: &Report) -> String {
    let mut out = String::new();
    let bound = if report.resampler == "lossless" {
        "bit-exact".to_owned()
    } else {
        format!("max error {:.4} mm (tolerance {} mm)", report.max_error_mm, report.tolerance_mm)
    };
    let from = match (&report.device, &report.source) {
        (Some(device), _) => format!("{} {} at {}", device.model, device.serial, device.uri),
        (None, Some(source)) => format!("{} ({})", source.file, source.format),
        (None, None) => "unknown".to_owned(),
    };
    let sr = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
    let mut line = |name: &str, value: String| {
        writeln!(out, "{name:<10} {value}").ok();
    };
    line("take", report.take.display().to_string());
    line("from", from);
    line("made", format!("{} by {}", report.created, report.software));
    line(
        "frames",
        format!(
            "{} of {} markers at {} Hz, {:.3} s",
            thousands(report.frames),
            report.markers,
            report.rate_hz,
            report.seconds
        ),
    );
    line("resampler", format!("{}, {bound}", report.resampler));
    line(
        "bytes",
        format!(
            "{} raw -> {} on disk, {:.1}:1",
            bytes(report.raw_bytes),
            bytes(report.file_bytes),
            report.ratio
        ),
    );
    line("SR1, SR2", format!("{}, {} (Shi et al. 2012)", sr(report.sr1), sr(report.sr2)));
    for part in &report.foreign_parts {
        line("kept", format!("{}, {}", part.kind, bytes(part.bytes)));
    }
    for event in &report.events {
        line("event", format!("frame {}: {} {}", event.frame, event.kind, event.text));
    }
    if let Some(ledger) = &report.ledger {
        out.push_str(&ledger.words());
    }
    let width = report.channels.iter().map(|c| c.label.chars().count()).max().unwrap_or(0).max(6);
    writeln!(
        out,
        "{:<width$} {:>10} {:>6} {:>10} {:>12} {:>10}",
        "marker", "samples", "gaps", "knots", "max err mm", "bytes"
    )
    .ok();
    for c in &report.channels {
        writeln!(
            out,
            "{:<width$} {:>10} {:>6} {:>10} {:>12.4} {:>10}",
            c.label, c.samples, c.gaps, c.knots, c.max_error_mm, c.payload_bytes
        )
        .ok();
    }
    out
}
