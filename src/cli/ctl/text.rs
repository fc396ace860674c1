//! The service's answers as text.

use std::fmt::Write;

use mocapd_service::{
    control::{Started, Stopped},
    finished::{TakeNotes, TakeRating, TrashedTake},
    status::{Presence, State, Status, TakeSummary},
    units,
};

use mocapd_take::record::EndingKind;

use crate::cli::{
    ledger::losses,
    output::plain,
    values::{bytes, count, frames_of, rate, thousands},
};

pub(super) fn state(state: State) -> &'static str {
    match state {
        State::Idle => "idle",
        State::Armed => "armed",
        State::Recording => "recording",
        State::Failed => "failed",
    }
}

/// The status, one line each for state, device, input, pre-roll, take and disk.
pub(super) fn status(status: &Status) -> String {
    let mut out = format!("{}: {}\n", plain(&status.rig), line(status));
    // Writing to a string does not fail, here and below.
    if let Some(failure) = &status.failure {
        writeln!(out, "  {}", plain(failure)).ok();
    }
    let device = &status.device;
    let named = format!("{} {}", device.model, device.serial);
    let named = if named.trim().is_empty() { &device.uri } else { named.trim() };
    let rate = format!("{} at {}", count(device.markers as u64, "marker"), rate(device.rate_hz));
    let known = if device.rate_hz > 0.0 { format!(", {rate}") } else { String::new() };
    writeln!(out, "  device    {}: {}{known}", plain(named), device.presence).ok();
    if let Some(obstacle) = &device.obstacle {
        writeln!(out, "            {}", plain(obstacle)).ok();
    }
    let (input, pre_roll) = (&status.input, &status.pre_roll);
    let (frames, lost) = (count(input.frames, "frame"), thousands(input.lost));
    let rate_hz = input.measured_hz;
    writeln!(out, "  input     {frames}, {lost} lost since arming, {rate_hz:.1} Hz").ok();
    let cut = if pre_roll.is_cut { ", limited by arm.memory_max" } else { "" };
    let (held, wanted) = (pre_roll.held_s, pre_roll.wanted_s);
    writeln!(out, "  pre-roll  {held:.1} s of {wanted} s{cut}").ok();
    if let Some(take) = &status.take {
        let size = format!("{}, {:.1}:1", bytes(take.bytes), take.ratio);
        let (name, seconds, error) = (plain(&take.name), take.seconds, take.max_error_mm);
        let wanted = take.wanted_s.map_or_else(String::new, |s| format!(", ends after {s} s"));
        writeln!(
            out,
            "  take      {name}: {seconds:.1} s{wanted}, {size}, max error {error:.4} mm"
        )
        .ok();
        if let Some(notice) = &take.file_notice {
            writeln!(out, "            {}", plain(notice)).ok();
        }
        if let Some(losses) = losses(&take.ledger) {
            writeln!(out, "            not in the take: {losses}").ok();
        }
    }
    if let Some(pending) = &status.pending_start {
        let name =
            pending.name.as_deref().map_or_else(String::new, |name| format!(" {}", plain(name)));
        writeln!(out, "  start     a take{name} will be started at {}", plain(&pending.at)).ok();
    }
    if let Some(missed) = &status.missed_start {
        writeln!(out, "  start     {}", plain(missed)).ok();
    }
    if let Some(take) = &status.last_take {
        let (name, size, health) = (plain(&take.name), bytes(take.bytes), take.health.name());
        let ending = take.ending.map_or("", EndingKind::name);
        writeln!(out, "  last take {name}: {size}, {health}, ended: {ending}").ok();
    }
    writeln!(out, "  disk      {}, in {}", disk(status), plain(&status.disk.directory)).ok();
    out
}

/// The state in one line.
pub(super) fn line(status: &Status) -> String {
    let now = match &status.take {
        Some(take) => {
            let (of, lost) = (plain(&take.name), thousands(take.ledger.frames_lost()));
            // The frames of an outage are counted when it ends.
            let before = if status.device.outage.is_some() { " before" } else { "" };
            let (length_s, size) = (take.seconds, bytes(take.bytes));
            format!("recording {of}, {length_s:.1} s, {size}, {lost} lost{before}")
        }
        None => state(status.state).to_owned(),
    };
    match without_device(status) {
        Some(missing) => format!("{missing}: {now}"),
        None => now,
    }
}

/// One line of `status --watch`: while a device runs, also its losses, rate and pre-roll, and the disk.
pub(super) fn watch_line(status: &Status) -> String {
    let mut out = line(status);
    if !matches!(status.state, State::Armed | State::Recording) {
        return out;
    }
    let (input, pre_roll) = (&status.input, &status.pre_roll);
    if status.take.is_none() {
        out += &format!(", {} lost since arming", thousands(input.lost));
    }
    out += &format!(", {:.1} Hz", input.measured_hz);
    if pre_roll.wanted_s > 0.0 {
        out += &format!(", pre-roll {:.1} of {} s", pre_roll.held_s, pre_roll.wanted_s);
    }
    out + &format!(", disk {}", disk(status))
}

/// Free disk space, and how long it lasts.
fn disk(status: &Status) -> String {
    // On a full disk a take still has its reserve, so the remaining time would be wrong.
    let Some(free_bytes) = status.disk.free_bytes else { return "free space unknown".to_owned() };
    let free = bytes(free_bytes);
    let left = status.disk.left_s.filter(|_| free_bytes > 0);
    let left = left.map(|left| format!(", enough for {}", duration(left)));
    format!("{free} free{}", left.unwrap_or_default())
}

/// The warning that no frames arrive: since when, how many are missing, and what happens next. It begins the line.
fn without_device(status: &Status) -> Option<String> {
    let device = &status.device;
    let Some(outage) = device.outage else {
        return match status.state {
            State::Idle if device.is_awaited => {
                Some("NO DEVICE, arms when it is connected".to_owned())
            }
            State::Failed if device.presence == Presence::Absent => Some("NO DEVICE".to_owned()),
            _ => None,
        };
    };
    let what = if device.presence == Presence::Silent { "NO FRAMES" } else { "NO DEVICE" };
    let mut out = format!("{what} for {:.1} s", outage.seconds);
    if status.take.is_some() {
        let ends = outage.ends_in_s.map(|left_s| format!(" within {}", duration(left_s as u64)));
        let (missing, ends) = (count(outage.frames, "frame"), ends.unwrap_or_default());
        out += &format!(", {missing} missing, recording resumes when the device is back{ends}");
    } else {
        out += ", nothing can be recorded until the device is back";
    }
    Some(out)
}

fn duration(seconds: u64) -> String {
    match seconds {
        0..120 => format!("{seconds} s"),
        120..7200 => format!("{} min", seconds / 60),
        7200..172_800 => format!("{} h", seconds / 3600),
        _ => format!("{} days", thousands(seconds / 86_400)),
    }
}

pub(super) fn started(started: &Started) -> String {
    let before = started.first_frame.before_request_s;
    let pre_roll = if before > 0.0 {
        format!(", from {before:.2} s before the request")
    } else {
        String::new()
    };
    format!("recording {}{pre_roll}\n", plain(&started.path.display().to_string()))
}

pub(super) fn stopped(stopped: &Stopped) -> String {
    let path = stopped.path.display().to_string();
    let frames = frames_of(stopped.ledger.recorded, stopped.rows);
    let (size, ending) = (bytes(stopped.bytes), stopped.ending.map_or("", EndingKind::name));
    format!("{}: {frames}, {:.1} s, {size}; ended: {ending}\n", plain(&path), stopped.seconds)
}

pub(super) fn takes(takes: &[TakeSummary]) -> String {
    if takes.is_empty() {
        return "no takes\n".to_owned();
    }
    let mut out = String::new();
    for take in takes {
        let when = time(take.modified_unix_ms);
        let health = if take.is_open { "being written" } else { take.health.name() };
        let (size, name) = (bytes(take.bytes), plain(&take.name));
        let (ended, noted) = (ended(take), noted(take));
        writeln!(out, "{when}  {size:>10}  {health:<13} {name}{ended}{noted}").ok();
    }
    out
}

/// The rating and the first line of the notes of a take; empty if it has none.
fn noted(take: &TakeSummary) -> String {
    let Some(notes) = &take.notes else { return String::new() };
    if let Some(problem) = &notes.problem {
        return format!("  [{}]", plain(problem));
    }
    let rating = Some(notes.rating.name()).filter(|_| notes.rating != TakeRating::None);
    let line = notes.text.lines().next().filter(|line| !line.is_empty());
    let both: Vec<String> =
        rating.into_iter().chain(line).map(|text| plain(text).to_string()).collect();
    if both.is_empty() { String::new() } else { format!("  [{}]", both.join(": ")) }
}

/// Why a take ended; empty if that is unknown.
fn ended(take: &TakeSummary) -> String {
    let detail = match take.ending_detail.as_str() {
        "" => String::new(),
        detail => format!(": {}", plain(detail)),
    };
    take.ending.map_or_else(String::new, |ending| format!("  ({ending}{detail})"))
}

pub(super) fn notes(name: &str, notes: &TakeNotes) -> String {
    let name = plain(name);
    let mut out = format!("{name}: rating {}\n", notes.rating.name());
    for line in notes.text.lines() {
        writeln!(out, "  {}", plain(line)).ok();
    }
    out
}

pub(super) fn trashed(takes: &[TrashedTake]) -> String {
    if takes.is_empty() {
        return "the trash is empty\n".to_owned();
    }
    let mut out = String::new();
    for take in takes {
        let (removed, size, id) = (time(take.removed_unix_ms), bytes(take.bytes), plain(&take.id));
        writeln!(out, "until {removed}  {size:>10}  {id}").ok();
    }
    out
}

/// A time in the local time zone, to the second.
pub(super) fn time(unix_ms: i64) -> String {
    units::local_time(unix_ms).unwrap_or_else(|| "?".to_owned())
}

#[cfg(test)]
mod tests {
    use mocapd_acquire::ledger::LedgerDocument;

    use super::*;

    #[test]
    fn losses_are_listed_by_cause() {
        assert_eq!(losses(&LedgerDocument { duplicates: 4, ..LedgerDocument::default() }), None);
        let ledger =
            LedgerDocument { lost_on_link: 1, markers_dropped: 1200, ..LedgerDocument::default() };
        assert_eq!(
            losses(&ledger).unwrap(),
            "1 frame lost on the link, 1 200 samples of markers without a free channel"
        );
    }

    #[test]
    fn hostile_names_stay_on_their_lines() {
        let take = TakeSummary { name: "a\nb\x1b[2J".to_owned(), ..TakeSummary::default() };
        let text = takes(&[take]);
        assert_eq!(text.lines().count(), 1);
        assert!(!text.contains('\x1b') && text.starts_with(&time(0)), "{text}");
    }
}
