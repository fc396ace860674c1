//! Whether an observation can belong to the line, or the device's clock jumped.

use super::fit::Line;

/// How far off an observation may be beside what is measured: a line of few points, a scheduler.
const SLACK_US: f64 = 2_000.0;

/// A segment younger than this has a line that a batch of frames may have turned.
const YOUNG_US: u64 = 3_000_000;
const YOUNG_SLACK_US: f64 = 100_000.0;

/// How fast a line may become wrong where nothing is observed, in microseconds a second: ten times what a
/// crystal is off.
const STALE_US_PER_S: f64 = 1_000.0;

/// So many times the mean lateness is still usual: batches are late by up to twice their mean.
const USUAL: f64 = 4.0;

/// Observations running that must say so before it is a jump: damage that its checksum does not show is single.
const IN_A_ROW: u32 = 3;

/// Frames that stay later than usual for so long are no longer held up: it is the clock that fell behind.
const LATE_FOR_US: u64 = 30_000_000;

/// What an observation says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Verdict {
    Fits,
    /// It cannot be, and is left out; it may be the first after a jump.
    Odd,
    /// The clock jumped ahead by so many microseconds; back when negative.
    Jumped(f64),
}

/// Remembers what was odd of a segment.
#[derive(Debug, Default)]
pub(super) struct Judge {
    mean_late_us: f64,
    n_late: u64,
    early: u32,
    missed: u32,
    late_since_us: Option<u64>,
    late: u32,
}

impl Judge {
    fn slack_us(&self, age_us: u64, silent_us: u64) -> f64 {
        let young = if age_us < YOUNG_US { YOUNG_SLACK_US } else { 0.0 };
        let stale = silent_us as f64 * 1e-6 * STALE_US_PER_S;
        SLACK_US + young + stale + USUAL * self.mean_late_us
    }

    /// A frame that came so long after the line, at host time `host_us`, in a segment of that age, so long
    /// after the observation before it.
    pub(super) fn frame(
        &mut self,
        late_us: f64,
        host_us: u64,
        age_us: u64,
        silent_us: u64,
    ) -> Verdict {
        let slack_us = self.slack_us(age_us, silent_us);
        if late_us < -slack_us {
            self.early += 1;
            return if self.early >= IN_A_ROW { Verdict::Jumped(-late_us) } else { Verdict::Odd };
        }
        self.early = 0;
        if late_us > slack_us + YOUNG_SLACK_US {
            self.late = self.late.saturating_add(1);
            let since_us = *self.late_since_us.get_or_insert(host_us);
            if host_us.saturating_sub(since_us) > LATE_FOR_US {
                return Verdict::Jumped(-late_us);
            }
            return Verdict::Fits;
        }
        self.late_since_us = None;
        self.late = 0;
        // The mean of the last thousand.
        self.n_late = (self.n_late + 1).min(1000);
        self.mean_late_us += (late_us.max(0.0) - self.mean_late_us) / self.n_late as f64;
        Verdict::Fits
    }

    /// A round trip that began and ended so long after the line.
    pub(super) fn probe(
        &mut self,
        line: &Line,
        sent_us: f64,
        answered_us: f64,
        age_us: u64,
        silent_us: u64,
    ) -> Verdict {
        let Some(bound) = line.bound else { return Verdict::Fits };
        let young = if age_us < YOUNG_US { YOUNG_SLACK_US } else { 0.0 };
        let slack_us =
            SLACK_US + young + bound.offset_us + silent_us as f64 * 1e-6 * STALE_US_PER_S;
        let off_us = if sent_us > slack_us {
            -sent_us
        } else if answered_us < -slack_us {
            -answered_us
        } else {
            self.missed = 0;
            // What comes late and is asked is late, and not another clock.
            self.late_since_us = None;
            return Verdict::Fits;
        };
        self.missed += 1;
        if self.missed >= IN_A_ROW { Verdict::Jumped(off_us) } else { Verdict::Odd }
    }

    /// Whether a round trip would tell late frames from a clock that fell behind.
    pub(super) fn is_in_doubt(&self) -> bool {
        self.late == IN_A_ROW
    }
}
