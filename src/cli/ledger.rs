//! A ledger in words, the same for every command that shows one.

use std::fmt::Write;

use mocapd_acquire::{
    ledger::{ClockDocument, LedgerDocument},
    verdict::Finding,
};
use serde::Serialize;

use super::{
    output::plain,
    values::{count, thousands},
};

/// Times that the device was away and frames are missing for it.
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

    /// In one line; `None` when there was none.
    pub(crate) fn words(&self) -> Option<String> {
        let away = count(u64::from(self.count), "time");
        let frames = count(self.frames, "frame");
        let words = format!(
            "the device was away or silent {away}, {:.3} s of the take: {frames}",
            self.seconds
        );
        (self.frames > 0).then_some(words)
    }
}

/// Nobody knows whether the device produced these frames.
const UNKNOWN: &str = "unknown: the device was away or silent";

/// As an account that adds up before the reader's eyes.
pub(crate) fn words(ledger: &LedgerDocument) -> String {
    let mut out = String::from(if ledger.finished {
        "ledger\n"
    } else {
        "ledger, the last one written before the take was cut off\n"
    });
    let mut line = |n: u64, what: &str| {
        writeln!(out, "  {:>15} {what}", thousands(n)).ok();
    };
    line(ledger.frames_sent, "frames sent");
    line(ledger.recorded, "recorded");
    line(ledger.lost_on_link, "lost on the link");
    line(ledger.dropped_by_device, "dropped by the device");
    line(ledger.lost_ring_full, "lost in the host: a ring was full");
    for (n, what) in [
        (ledger.lost_other, "lost in the host: other"),
        (ledger.unknown_after_disconnect, UNKNOWN),
        (ledger.duplicates, "came again or too late, not recorded"),
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

/// The clocks, as a ledger knows them: for takes that tell no more of them.
pub(crate) fn clock_words(ledger: &LedgerDocument) -> Option<String> {
    let ClockDocument { drift_ppm, residual_us } = ledger.clock.as_ref()?;
    let words = "ppm: how much faster the host's clock runs than the device's";
    Some(format!(
        "clock\n  drift {drift_ppm:+.1} {words}; arrivals {residual_us:.0} us off (rms)\n"
    ))
}

/// As an account of a file, which no device sent.
pub(crate) fn words_of_import(ledger: &LedgerDocument) -> String {
    let mut out = String::from("ledger\n");
    writeln!(out, "  {:>15} frames in the file", thousands(ledger.frames_sent)).ok();
    writeln!(out, "  {:>15} in the take", thousands(ledger.recorded)).ok();
    close(ledger, &mut out);
    samples(ledger, &mut out);
    out
}

/// What is not in the take, by cause and in one line: frames, and samples of markers beyond the channel pool. `None`
/// when all is.
pub(crate) fn losses(ledger: &LedgerDocument) -> Option<String> {
    let causes = [
        "lost on the link",
        "dropped by the device",
        "lost in the host because a ring was full",
        "lost in the host",
        UNKNOWN,
    ];
    let frames = ledger.frames_lost_by_cause().into_iter().zip(causes).filter(|part| part.0 > 0);
    let mut said: Vec<String> =
        frames.map(|(n, what)| format!("{} {what}", count(n, "frame"))).collect();
    if ledger.markers_dropped > 0 {
        let samples = count(ledger.markers_dropped, "sample");
        said.push(format!("{samples} of markers beyond the channel pool"));
    }
    (!said.is_empty()).then(|| said.join(", "))
}

/// Why it does not close, in one line; `None` when it does.
pub(crate) fn not_closing(ledger: &LedgerDocument) -> Option<String> {
    let mut why: Vec<String> =
        ledger.contradictions.iter().map(|told| plain(told).into_owned()).collect();
    for (n, what) in [(ledger.frame_balance, "frames"), (ledger.sample_balance, "samples")] {
        if n != 0 {
            why.push(format!("{n} {what} are left over"));
        }
    }
    (!ledger.closes).then(|| format!("{}: {}", Finding::LedgerOpen, why.join("; ")))
}

fn close(ledger: &LedgerDocument, out: &mut String) {
    let state = if ledger.closes { "the ledger closes" } else { "THE LEDGER DOES NOT CLOSE" };
    let but = match (ledger.closes, ledger.frame_balance, ledger.sample_balance) {
        (true, ..) => String::new(),
        // Every frame has its place, and what counted them cannot be believed.
        (_, 0, 0) => " of the frames, but what counts them contradicts itself".to_owned(),
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
        writeln!(out, "  {n:>15} samples of markers beyond the channel pool").ok();
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
