//! A ledger as JSON and as words, the same for every command that shows one.

use std::fmt::Write;

use mocapd_take::record::Ledger;
use serde::Serialize;

use super::{
    output::plain,
    values::{count, thousands},
};

#[derive(Debug, Serialize)]
pub(crate) struct LedgerReport {
    closes: bool,
    finished: bool,
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

/// What is not in a take, by cause: frames, and samples of markers beyond the channel pool.
#[derive(Debug, Default)]
pub(crate) struct Losses {
    pub(crate) lost_on_link: u64,
    pub(crate) dropped_by_device: u64,
    pub(crate) lost_ring_full: u64,
    pub(crate) lost_other: u64,
    pub(crate) unknown_after_disconnect: u64,
    pub(crate) markers_dropped: u64,
}

impl Losses {
    /// In one line; `None` when all is in it.
    pub(crate) fn words(&self) -> Option<String> {
        let parts = [
            (self.lost_on_link, "lost on the link"),
            (self.dropped_by_device, "dropped by the device"),
            (self.lost_ring_full, "lost in the host because a ring was full"),
            (self.lost_other, "lost in the host"),
            (self.unknown_after_disconnect, UNKNOWN),
        ];
        let frames = parts.iter().filter(|part| part.0 > 0);
        let mut said: Vec<String> =
            frames.map(|&(n, what)| format!("{} {what}", count(n, "frame"))).collect();
        if self.markers_dropped > 0 {
            let samples = count(self.markers_dropped, "sample");
            said.push(format!("{samples} of markers beyond the channel pool"));
        }
        (!said.is_empty()).then(|| said.join(", "))
    }
}

/// Nobody knows whether the device produced these frames.
const UNKNOWN: &str = "unknown: the device was away or silent";

impl LedgerReport {
    pub(crate) fn new(ledger: &Ledger) -> Self {
        let whole = |balance: i128| i64::try_from(balance).unwrap_or(i64::MAX);
        Self {
            closes: ledger.closes(),
            finished: ledger.finished,
            frames_sent: ledger.frames_sent,
            recorded: ledger.recorded,
            lost_on_link: ledger.lost_on_link,
            dropped_by_device: ledger.dropped_by_device,
            lost_in_host: LostInHost { ring_full: ledger.lost_ring_full, other: ledger.lost_other },
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

    pub(crate) fn recorded(&self) -> u64 {
        self.recorded
    }

    pub(crate) fn frames_sent(&self) -> u64 {
        self.frames_sent
    }

    /// As an account that adds up before the reader's eyes.
    pub(crate) fn words(&self) -> String {
        let mut out = String::from(if self.finished {
            "ledger\n"
        } else {
            "ledger, the last one written before the take was cut off\n"
        });
        let mut line = |n: u64, what: &str| {
            writeln!(out, "  {:>15} {what}", thousands(n)).ok();
        };
        line(self.frames_sent, "frames sent");
        line(self.recorded, "recorded");
        line(self.lost_on_link, "lost on the link");
        line(self.dropped_by_device, "dropped by the device");
        line(self.lost_in_host.ring_full, "lost in the host: a ring was full");
        for (n, what) in [
            (self.lost_in_host.other, "lost in the host: other"),
            (self.unknown_after_disconnect, UNKNOWN),
            (self.duplicates, "came again or too late, not recorded"),
        ] {
            if n > 0 {
                line(n, what);
            }
        }
        self.close(&mut out);
        self.samples(&mut out);
        self.link(&mut out);
        out
    }

    /// The clocks, as a ledger knows them: for takes that tell no more of them.
    pub(crate) fn clock_words(&self) -> Option<String> {
        let ClockReport { drift_ppm, residual_us } = self.clock.as_ref()?;
        let words = "ppm: how much faster the host's clock runs than the device's";
        Some(format!(
            "clock\n  drift {drift_ppm:+.1} {words}; arrivals {residual_us:.0} us off (rms)\n"
        ))
    }

    /// As an account of a file, which no device sent.
    pub(crate) fn words_of_import(&self) -> String {
        let mut out = String::from("ledger\n");
        writeln!(out, "  {:>15} frames in the file", thousands(self.frames_sent)).ok();
        writeln!(out, "  {:>15} in the take", thousands(self.recorded)).ok();
        self.close(&mut out);
        self.samples(&mut out);
        out
    }

    /// What is not in the take, in one line; `None` when all is.
    pub(crate) fn losses(&self) -> Option<String> {
        Losses {
            lost_on_link: self.lost_on_link,
            dropped_by_device: self.dropped_by_device,
            lost_ring_full: self.lost_in_host.ring_full,
            lost_other: self.lost_in_host.other,
            unknown_after_disconnect: self.unknown_after_disconnect,
            markers_dropped: self.markers_dropped,
        }
        .words()
    }

    /// Why it does not close, in one line; `None` when it does.
    pub(crate) fn not_closing(&self) -> Option<String> {
        let mut why: Vec<String> =
            self.contradictions.iter().map(|told| plain(told).into_owned()).collect();
        for (n, what) in [(self.frame_balance, "frames"), (self.sample_balance, "samples")] {
            if n != 0 {
                why.push(format!("{n} {what} are left over"));
            }
        }
        (!self.closes).then(|| format!("the ledger does not close: {}", why.join("; ")))
    }

    fn close(&self, out: &mut String) {
        let state = if self.closes { "the ledger closes" } else { "THE LEDGER DOES NOT CLOSE" };
        let but = match (self.closes, self.frame_balance, self.sample_balance) {
            (true, ..) => String::new(),
            // Every frame has its place, and what counted them cannot be believed.
            (_, 0, 0) => " of the frames, but what counts them contradicts itself".to_owned(),
            (_, _, 0) => " of the frames".to_owned(),
            (.., samples) => format!(" of the frames, {samples} of the samples"),
        };
        writeln!(out, "  {:>15} left over{but}: {state}", self.frame_balance).ok();
    }

    fn samples(&self, out: &mut String) {
        let not_finite = match self.samples_not_finite {
            0 => String::new(),
            n => format!(" ({} as NaN or infinity)", thousands(n)),
        };
        writeln!(
            out,
            "  {:>15} samples announced = {} present + {} occluded{not_finite}",
            thousands(self.samples_announced),
            thousands(self.samples_present),
            thousands(self.samples_occluded)
        )
        .ok();
    }

    fn link(&self, out: &mut String) {
        if self.markers_dropped > 0 {
            let n = thousands(self.markers_dropped);
            writeln!(out, "  {n:>15} samples of markers beyond the channel pool").ok();
        }
        if self.link_messages_damaged > 0 || self.link_bytes_skipped > 0 {
            let damaged = thousands(self.link_messages_damaged);
            let skipped = thousands(self.link_bytes_skipped);
            writeln!(out, "  {damaged:>15} messages arrived damaged, {skipped} bytes skipped").ok();
        }
        for contradiction in &self.contradictions {
            writeln!(out, "  contradiction: {}", plain(contradiction)).ok();
        }
    }
}
