//! The accounts of a take, as text and as JSON, for every command that shows them: its ledger, the frames lost to damage, and
//! the device's clock against the host's.

use std::{fmt::Write, path::Path};

use mocapd_acquire::{
    clock::ClockStatus,
    inspect::{Finding, Summary},
    ledger::{
        ClockDocument, GroupLedgerDocument, LedgerDocument, SampleLedgerDocument, TakeHealth,
    },
};
use mocapd_take::{
    damage::{DamageOrigin, LostRows},
    record::{ClockJitter, ClockLine},
    sampled::RESIDUAL_GROUPS,
};
use serde::Serialize;

use super::{
    output::plain,
    values::{count, thousands},
};

/// Outages: times when the device was away or silent, and the frames that are missing for it.
#[derive(Debug, Serialize)]
pub(crate) struct OutagesReport {
    count: u32,
    frames: u64,
    seconds: f64,
}

impl OutagesReport {
    pub(crate) fn new(count: u32, frames: u64, rate_hz: f64) -> Self {
        Self { count, frames, seconds: frames as f64 / rate_hz }
    }

    /// One line; `None` if no frame is missing.
    pub(crate) fn text(&self) -> Option<String> {
        let (away, frames) = (count(u64::from(self.count), "time"), count(self.frames, "frame"));
        let seconds = self.seconds;
        let text = format!(
            "the device was absent or silent {away}, for {seconds:.3} s of the take: {frames} missing"
        );
        (self.frames > 0).then_some(text)
    }
}

/// Frames that the device may or may not have produced.
const UNKNOWN: &str = "unknown: the device was absent or silent";

/// The ledger of a recording, one line per entry, with its balance.
pub(crate) fn text(ledger: &LedgerDocument) -> String {
    let cut = if ledger.finished { "" } else { " (the last one before the take was cut off)" };
    let mut out = format!("ledger{cut}\n");
    let mut line = |n: u64, what: &str| {
        writeln!(out, "  {:>15} {what}", thousands(n)).ok();
    };
    // Of a device that was away only the frames that were due are known.
    let is_known = ledger.unknown_after_disconnect == 0;
    line(ledger.frames_sent, if is_known { "frames sent" } else { "frames sent or due" });
    line(ledger.recorded, "recorded");
    line(ledger.lost_on_link, "lost on the link");
    line(ledger.dropped_by_device, "dropped by the device");
    line(ledger.lost_ring_full, "lost in the host: a ring was full");
    for (n, what) in [
        (ledger.lost_other, "lost in the host: other"),
        (ledger.unknown_after_disconnect, UNKNOWN),
        (ledger.duplicates, "duplicates or late arrivals, not recorded"),
    ] {
        if n > 0 {
            line(n, what);
        }
    }
    close(ledger, &mut out);
    samples(ledger, &mut out);
    link(ledger, &mut out);
    out
}

/// The groups of a ledger with what they are: those of residuals, which have the same rows, as one. Of numbers that differ it
/// states the worst.
fn named_groups(ledger: &SampleLedgerDocument) -> Vec<(String, GroupLedgerDocument)> {
    let is_residual = |group: &&GroupLedgerDocument| RESIDUAL_GROUPS.contains(&group.group);
    let others = ledger.groups.iter().filter(|group| !is_residual(group));
    let others = others.map(|group| (format!("group {}", group.group), *group));
    let of_residuals = ledger.groups.iter().filter(is_residual).copied();
    let residuals = of_residuals.reduce(|sum, group| GroupLedgerDocument {
        group: sum.group,
        taken: sum.taken.max(group.taken),
        stored: sum.stored.min(group.stored),
        lost_on_link: sum.lost_on_link.max(group.lost_on_link),
        dropped_by_device: sum.dropped_by_device.max(group.dropped_by_device),
        lost_ring_full: sum.lost_ring_full.max(group.lost_ring_full),
        lost_other: sum.lost_other.max(group.lost_other),
        unknown_after_disconnect: sum.unknown_after_disconnect.max(group.unknown_after_disconnect),
        duplicates: sum.duplicates.max(group.duplicates),
        jumps: sum.jumps.max(group.jumps),
    });
    let residuals = residuals.map(|sum| ("the residuals".to_owned(), sum));
    others.chain(residuals).collect()
}

/// The ledger of sampled channels, one line per group, and one for all residuals.
pub(crate) fn samples_text(ledger: &SampleLedgerDocument) -> String {
    let mut out = String::new();
    for (name, group) in &named_groups(ledger) {
        let state = if ledger.closes { "the ledger closes" } else { "THE LEDGER DOES NOT CLOSE" };
        let lost = samples_lost(group).map(|lost| format!(", {lost}")).unwrap_or_default();
        let again = match group.duplicates {
            0 => String::new(),
            n => format!(", {} again", thousands(n)),
        };
        writeln!(
            out,
            "  {:>15} samples of each channel of {name}, {} in the take{lost}{again}: {state}",
            thousands(group.taken),
            thousands(group.stored),
        )
        .ok();
    }
    out
}

/// The samples that a group lacks, by cause; `None` if it lacks none.
fn samples_lost(group: &GroupLedgerDocument) -> Option<String> {
    let lost: Vec<String> = [
        (group.lost_on_link, "lost on the link"),
        (group.dropped_by_device, "dropped by the device"),
        (group.lost_ring_full, "lost in the host because a ring was full"),
        (group.lost_other, "lost in the host"),
        (group.unknown_after_disconnect, UNKNOWN),
    ]
    .into_iter()
    .filter(|(n, _)| *n > 0)
    .map(|(n, what)| format!("{} {what}", count(n, "sample")))
    .chain((group.jumps > 0).then(|| {
        format!("an unknown number where the numbers began again ({})", count(group.jumps, "time"))
    }))
    .collect();
    (!lost.is_empty()).then(|| lost.join(", "))
}

/// The samples of sampled channels that are missing, one message per group and one for all
/// residuals, and the batches that were refused.
pub(crate) fn sample_losses(ledger: &SampleLedgerDocument) -> Vec<String> {
    let of_group = |(name, group): (String, GroupLedgerDocument)| {
        let lost = samples_lost(&group)?;
        Some(format!("not in the take, of each channel of {name}: {lost}"))
    };
    let refused = (ledger.batches_refused > 0).then(|| {
        let batches = ledger.batches_refused;
        let what = if batches == 1 { "batch" } else { "batches" };
        format!(
            "not in the take: {} {what} of samples that were not announced, or did not fit",
            thousands(batches)
        )
    });
    named_groups(ledger).into_iter().filter_map(of_group).chain(refused).collect()
}

/// The clock figures of a ledger, for takes that store no others.
pub(crate) fn clock_text(ledger: &LedgerDocument) -> Option<String> {
    let ClockDocument { drift_ppm, residual_us } = ledger.clock.as_ref()?;
    let meaning = "ppm: how much faster the host's clock runs than the device's";
    Some(format!(
        "clock\n  drift {drift_ppm:+.1} {meaning}; arrivals {residual_us:.0} us off (rms)\n"
    ))
}

/// The ledger of an import.
pub(crate) fn import_text(ledger: &LedgerDocument) -> String {
    let mut out = String::from("ledger\n");
    writeln!(out, "  {:>15} frames in the file", thousands(ledger.frames_sent)).ok();
    writeln!(out, "  {:>15} in the take", thousands(ledger.recorded)).ok();
    close(ledger, &mut out);
    samples(ledger, &mut out);
    out
}

/// Frames and samples that are missing from the take, by cause and in one line; `None` if nothing is.
pub(crate) fn losses(ledger: &LedgerDocument) -> Option<String> {
    let causes = [
        "lost on the link",
        "dropped by the device",
        "lost in the host because a ring was full",
        "lost in the host",
        UNKNOWN,
    ];
    let frames = ledger.frames_lost_by_cause().into_iter().zip(causes).filter(|part| part.0 > 0);
    let mut losses: Vec<String> =
        frames.map(|(n, what)| format!("{} {what}", count(n, "frame"))).collect();
    if ledger.markers_dropped > 0 {
        let samples = count(ledger.markers_dropped, "sample");
        losses.push(format!("{samples} of markers without a free channel"));
    }
    (!losses.is_empty()).then(|| losses.join(", "))
}

/// Why the ledger does not close, in one line; `None` if it does.
pub(crate) fn not_closing(ledger: &LedgerDocument) -> Option<String> {
    let mut why: Vec<String> =
        ledger.contradictions.iter().map(|text| plain(text).into_owned()).collect();
    for (n, what) in [(ledger.frame_balance, "frames"), (ledger.sample_balance, "samples")] {
        if n != 0 {
            why.push(format!("{n} {what} unaccounted for"));
        }
    }
    (!ledger.closes).then(|| format!("{}: {}", Finding::LedgerOpen, why.join("; ")))
}

fn close(ledger: &LedgerDocument, out: &mut String) {
    let state = if ledger.closes { "the ledger closes" } else { "THE LEDGER DOES NOT CLOSE" };
    let but = match (ledger.closes, ledger.frame_balance, ledger.sample_balance) {
        (true, ..) => String::new(),
        // Every frame is accounted for, but the counters are not credible.
        (_, 0, 0) => " of the frames, but the counters contradict each other".to_owned(),
        (_, _, 0) => " of the frames".to_owned(),
        (.., samples) => format!(" of the frames, {samples} of the samples"),
    };
    writeln!(out, "  {:>15} left over{but}: {state}", ledger.frame_balance).ok();
}

fn samples(ledger: &LedgerDocument, out: &mut String) {
    let not_finite = match ledger.samples_not_finite {
        0 => String::new(),
        n => format!(" ({} as NaN or infinity)", thousands(n)),
    };
    writeln!(
        out,
        "  {:>15} samples announced = {} present + {} occluded{not_finite}",
        thousands(ledger.samples_announced),
        thousands(ledger.samples_present),
        thousands(ledger.samples_occluded)
    )
    .ok();
}

fn link(ledger: &LedgerDocument, out: &mut String) {
    if ledger.markers_dropped > 0 {
        let n = thousands(ledger.markers_dropped);
        writeln!(out, "  {n:>15} samples of markers without a free channel").ok();
    }
    if ledger.link_messages_damaged > 0 || ledger.link_bytes_skipped > 0 {
        let damaged = thousands(ledger.link_messages_damaged);
        let skipped = thousands(ledger.link_bytes_skipped);
        writeln!(out, "  {damaged:>15} messages arrived damaged, {skipped} bytes skipped").ok();
    }
    for contradiction in &ledger.contradictions {
        writeln!(out, "  contradiction: {}", plain(contradiction)).ok();
    }
}

/// Maximum number of ranges that are listed; the rest are summed up in one line.
const SHOWN_MAX: usize = 20;

#[derive(Debug, Clone, Serialize)]
pub(crate) struct DamageReport {
    first_frame: u64,
    frames: u64,
    cause: &'static str,
}

impl DamageReport {
    pub(crate) fn all(lost: &[LostRows]) -> Vec<Self> {
        let report = |lost: &LostRows| Self {
            first_frame: lost.first_row,
            frames: lost.rows,
            cause: match lost.origin {
                DamageOrigin::Damaged => "damaged in the file",
                DamageOrigin::BeforeRecovery => "damaged before the take was recovered",
            },
        };
        lost.iter().map(report).collect()
    }

    /// Counted from 0 as in the problems, `--json` and `cut --frames`; the events in `info` have the file's numbers.
    fn text(&self) -> String {
        let Self { first_frame, frames, cause } = self;
        let last = first_frame.saturating_add(frames.saturating_sub(1));
        let (first, last) = (thousands(*first_frame), thousands(last));
        match frames {
            1 => format!("frame {first} (from 0): {cause}"),
            _ => format!("frames {first} to {last} (from 0), {}: {cause}", count(*frames, "frame")),
        }
    }
}

/// What a take lacks, one message each: its losses, a ledger that does not close, and, if no losses are known, that the
/// recording ended before the motion did. With `with_hint` also how to recover a damaged take.
pub(crate) fn missing_messages(take: &Path, summary: &Summary, with_hint: bool) -> Vec<String> {
    let document = summary.take.ledger.as_ref().map(LedgerDocument::from);
    let losses = document.as_ref().and_then(losses);
    let samples = summary.take.sample_ledger.as_ref().map(SampleLedgerDocument::from);
    let samples = samples.as_ref().map(sample_losses).unwrap_or_default();
    let has_losses = losses.is_some() || !samples.is_empty();
    let mut messages: Vec<String> =
        losses.map(|losses| format!("not in the take: {losses}")).into_iter().collect();
    messages.extend(samples);
    messages.extend(document.as_ref().and_then(not_closing));
    if summary.health() == TakeHealth::Lossy
        && !has_losses
        && let Some(ending) = &summary.take.ending
    {
        let ending = ending.kind.name();
        messages.push(format!("the recording ended early ({ending}): later frames are missing"));
    }
    if with_hint && !summary.take.problems.is_empty() {
        let name = take.display();
        messages.push(format!(
            "`mocapd recover {name} -o NEW.take` writes a new take from what can be read"
        ));
    }
    messages
}

/// The lost ranges, one line each.
pub(crate) fn damage_lines(damage: &[DamageReport]) -> Vec<String> {
    let mut lines: Vec<String> = damage.iter().take(SHOWN_MAX).map(DamageReport::text).collect();
    if let Some(more) = damage.get(SHOWN_MAX..).filter(|more| !more.is_empty()) {
        let ranges = count(more.len() as u64, "range");
        let frames = count(more.iter().map(|damage| damage.frames).sum(), "frame");
        lines.push(format!("{ranges} more, {frames}"));
    }
    lines
}

/// Frames lost by each marker, markers with equal losses on one line; empty if no marker lost any.
pub(crate) fn damage_by_marker(markers: &[(&str, u64)]) -> String {
    let mut groups: Vec<(u64, Vec<&str>)> = Vec::new();
    for &(label, frames) in markers {
        match groups.iter_mut().find(|(n, _)| *n == frames) {
            Some((_, labels)) => labels.push(label),
            None => groups.push((frames, vec![label])),
        }
    }
    let whole = groups.len() == 1;
    let mut out = String::new();
    for (frames, labels) in groups.iter().filter(|(frames, _)| *frames > 0) {
        let markers = match labels.as_slice() {
            [label] => plain(label).into_owned(),
            labels if whole => format!("each of {}", count(labels.len() as u64, "marker")),
            labels => plain(&labels.join(", ")).into_owned(),
        };
        writeln!(out, "  {:>15} lost to damage: {markers}", count(*frames, "frame")).ok();
    }
    out
}

#[derive(Debug, Serialize)]
pub(crate) struct ClockReport {
    method: &'static str,
    offset_ns: i64,
    drift_ppm: f64,
    bound_us: Option<u64>,
    drift_bound_ppm: Option<f64>,
    at: ClockPoint,
    residual_us: u64,
    jitter_us: Jitter,
    frames: u64,
    probes: u64,
    points: u64,
    segments: u64,
    lines: Vec<LineReport>,
}

/// Maximum number of earlier segments that the text lists.
const LINES_SHOWN: usize = 8;

/// The fitted line of one clock segment.
#[derive(Debug, Serialize)]
struct LineReport {
    segment: u32,
    drift_ppm: f64,
    bound_us: Option<u64>,
    drift_bound_ppm: Option<f64>,
    at: ClockPoint,
}

impl LineReport {
    fn new(segment: u32, line: &ClockLine) -> Self {
        let &ClockLine { device_ticks, host_ns, drift_ppb, bound } = line;
        Self {
            segment,
            drift_ppm: drift_ppb as f64 / 1e3,
            bound_us: bound.map(|bound| bound.offset_us),
            drift_bound_ppm: bound.map(|bound| bound.drift_ppb as f64 / 1e3),
            at: ClockPoint { device_ticks, host_ns },
        }
    }
}

/// The reference point of a line: a device time, and the host time that the line gives for it.
#[derive(Debug, Serialize)]
struct ClockPoint {
    device_ticks: u64,
    host_ns: u64,
}

#[derive(Debug, Serialize)]
struct Jitter {
    p50: u64,
    p99: u64,
    max: u64,
}

impl ClockReport {
    /// `lines` holds the line of each segment that has one. `None` if the last segment has none.
    pub(crate) fn new(status: &ClockStatus, lines: &[(u32, ClockLine)]) -> Option<Self> {
        let ClockLine { device_ticks, host_ns, bound, .. } = status.line?;
        let fit = status.ledger()?;
        let ClockJitter { frames, residual_us, p50_us, p99_us, max_us } = status.jitter;
        Some(Self {
            method: if bound.is_some() { "round trips" } else { "arrivals" },
            offset_ns: fit.offset_ns,
            drift_ppm: fit.drift_ppm,
            bound_us: bound.map(|bound| bound.offset_us),
            drift_bound_ppm: bound.map(|bound| bound.drift_ppb as f64 / 1e3),
            at: ClockPoint { device_ticks, host_ns },
            residual_us,
            jitter_us: Jitter { p50: p50_us, p99: p99_us, max: max_us },
            frames,
            probes: status.probes,
            points: status.points,
            segments: u64::from(status.segment) + 1,
            lines: lines.iter().map(|(segment, line)| LineReport::new(*segment, line)).collect(),
        })
    }

    /// Indented text, one line per fact.
    pub(crate) fn text(&self) -> String {
        let mut out = String::from("clock\n");
        let mut line = |name: &str, text: &str| {
            writeln!(out, "  {name:>15} {text}").ok();
        };
        let within = match self.drift_bound_ppm {
            Some(ppm) => format!(" +- {ppm:.1} ppm: {}", self.faster_clock(ppm)),
            None => " ppm, accuracy unknown without round trips".to_owned(),
        };
        line("drift", &format!("{:+.1}{within}", self.drift_ppm));
        let ClockPoint { device_ticks, host_ns } = self.at;
        let host_s = host_ns as f64 * 1e-9;
        let known = match self.bound_us {
            Some(us) => format!("within {us} us, by {}", count(self.probes, "round trip")),
            None => {
                "late by the shortest frame delay, which is unknown without round trips".to_owned()
            }
        };
        let offset = format!("device tick {device_ticks} is {host_s:.6} s of host time, {known}");
        line("offset", &offset);
        let Jitter { p50, p99, max } = self.jitter_us;
        let jitter =
            format!("frames arrived {p50} us after that (p50), {p99} us (p99), {max} us (max)");
        line("jitter", &format!("{jitter}; {} us rms", self.residual_us));
        if self.segments > 1 {
            let segments = count(self.segments, "segment");
            let why = "the device disconnected, its clock jumped, or takes were joined";
            line("segments", &format!("{segments}: {why}; this is the last"));
            let earlier =
                self.lines.iter().filter(|line| u64::from(line.segment) + 1 < self.segments);
            let shown = earlier.clone().take(LINES_SHOWN);
            for LineReport { segment, drift_ppm, bound_us, .. } in shown {
                let known = bound_us.map_or(String::new(), |us| format!(", within {us} us"));
                line("", &format!("segment {segment}: drift {drift_ppm:+.1} ppm{known}"));
            }
            let more = earlier.count().saturating_sub(LINES_SHOWN);
            if more > 0 {
                line("", &format!("and {more} more: see --json"));
            }
        }
        out
    }

    /// Which clock runs faster, by more than the bound of the drift.
    fn faster_clock(&self, bound_ppm: f64) -> &'static str {
        if self.drift_ppm.abs() <= bound_ppm {
            "no significant difference"
        } else if self.drift_ppm >= 0.0 {
            "the host's clock runs faster than the device's"
        } else {
            "the device's clock runs faster than the host's"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markers_with_equal_losses_share_a_line() {
        let markers = [("a", 30), ("b", 30), ("c", 0), ("d", 7)];
        assert_eq!(
            damage_by_marker(&markers),
            "        30 frames lost to damage: a, b\n         7 frames lost to damage: d\n"
        );
        assert_eq!(
            damage_by_marker(&[("a", 30), ("b", 30)]),
            "        30 frames lost to damage: each of 2 markers\n"
        );
        assert_eq!(damage_by_marker(&[("a", 0)]), "");
    }

    #[test]
    fn residuals_are_one_line_and_one_message() {
        let group = |group, lost_ring_full| GroupLedgerDocument {
            group,
            taken: 900,
            stored: 900 - lost_ring_full,
            lost_ring_full,
            ..GroupLedgerDocument::default()
        };
        let groups = vec![group(3, 0), group(32, 20), group(33, 20), group(34, 20)];
        let ledger = SampleLedgerDocument { closes: true, groups, ..Default::default() };
        let text = samples_text(&ledger);
        let lines: Vec<&str> = text.lines().map(str::trim).collect();
        let lost = "20 samples lost in the host because a ring was full";
        let all = "900 samples of each channel of";
        let closes = "the ledger closes";
        assert_eq!(
            lines,
            [
                format!("{all} group 3, 900 in the take: {closes}"),
                format!("{all} the residuals, 880 in the take, {lost}: {closes}"),
            ]
        );
        let told = format!("not in the take, of each channel of the residuals: {lost}");
        assert_eq!(sample_losses(&ledger), [told]);
    }

    #[test]
    fn many_ranges_are_summed_up() {
        let range = |first_row| LostRows { first_row, rows: 2, origin: DamageOrigin::Damaged };
        let lost: Vec<_> = (0..25).map(|i| range(10 * i)).collect();
        let lines = damage_lines(&DamageReport::all(&lost));
        assert_eq!(lines[1], "frames 10 to 11 (from 0), 2 frames: damaged in the file");
        assert_eq!(lines.last().unwrap(), "5 ranges more, 10 frames");
    }
}
