//! Frames lost to damage, as JSON and as text, for `info`, `verify` and `recover`.

use std::{fmt::Write, path::Path};

use mocapd_acquire::{
    health::TakeHealth,
    inspect::Summary,
    ledger::{LedgerDocument, SampleLedgerDocument},
};
use mocapd_take::damage::{DamageOrigin, LostRows};
use serde::Serialize;

use super::{
    ledger,
    output::plain,
    values::{count, thousands},
};

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
pub(crate) fn losses(take: &Path, summary: &Summary, with_hint: bool) -> Vec<String> {
    let document = summary.take.ledger.as_ref().map(LedgerDocument::from);
    let losses = document.as_ref().and_then(ledger::losses);
    let samples = summary.take.sample_ledger.as_ref().map(SampleLedgerDocument::from);
    let samples = samples.as_ref().map(ledger::sample_losses).unwrap_or_default();
    let has_losses = losses.is_some() || !samples.is_empty();
    let mut messages: Vec<String> =
        losses.map(|losses| format!("not in the take: {losses}")).into_iter().collect();
    messages.extend(samples);
    messages.extend(document.as_ref().and_then(ledger::not_closing));
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
pub(crate) fn lines(damage: &[DamageReport]) -> Vec<String> {
    let mut lines: Vec<String> = damage.iter().take(SHOWN_MAX).map(DamageReport::text).collect();
    if let Some(more) = damage.get(SHOWN_MAX..).filter(|more| !more.is_empty()) {
        let ranges = count(more.len() as u64, "range");
        let frames = count(more.iter().map(|damage| damage.frames).sum(), "frame");
        lines.push(format!("{ranges} more, {frames}"));
    }
    lines
}

/// Frames lost by each marker, markers with equal losses on one line; empty if no marker lost any.
pub(crate) fn by_marker(markers: &[(&str, u64)]) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markers_with_equal_losses_share_a_line() {
        let markers = [("a", 30), ("b", 30), ("c", 0), ("d", 7)];
        assert_eq!(
            by_marker(&markers),
            "        30 frames lost to damage: a, b\n         7 frames lost to damage: d\n"
        );
        assert_eq!(
            by_marker(&[("a", 30), ("b", 30)]),
            "        30 frames lost to damage: each of 2 markers\n"
        );
        assert_eq!(by_marker(&[("a", 0)]), "");
    }

    #[test]
    fn many_ranges_are_summed_up() {
        let range = |first_row| LostRows { first_row, rows: 2, origin: DamageOrigin::Damaged };
        let lost: Vec<_> = (0..25).map(|i| range(10 * i)).collect();
        let lines = lines(&DamageReport::all(&lost));
        assert_eq!(lines[1], "frames 10 to 11 (from 0), 2 frames: damaged in the file");
        assert_eq!(lines.last().unwrap(), "5 ranges more, 10 frames");
    }
}
