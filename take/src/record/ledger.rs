//! LEDGER: every frame and sample accounted for.

use bincode::{Decode, Encode};

use super::Record;
use crate::chunk::types;

/// How the device's clock runs against the host's: `host_ns = offset_ns + 1e9 * ticks / tick_hz * (1 + drift_ppm * 1e-6)`.
#[derive(Debug, Clone, Copy, PartialEq, Encode, Decode)]
pub struct ClockFit {
    /// Host monotonic time at device tick 0, in nanoseconds.
    pub offset_ns: i64,
    /// How much faster the host's clock runs, in parts per million.
    pub drift_ppm: f64,
    /// Root mean square distance of arrivals from the line, in microseconds.
    pub residual_us: f64,
    /// Arrivals fitted.
    pub n_fitted: u64,
}

/// The counters; docs/take-format.md gives each one's meaning.
#[derive(Debug, Clone, PartialEq, Default, Encode, Decode)]
#[expect(missing_docs, reason = "docs/take-format.md, The ledger")]
pub struct Ledger {
    pub finished: bool,
    pub frames_sent: u64,
    pub recorded: u64,
    pub lost_on_link: u64,
    pub dropped_by_device: u64,
    pub lost_ring_full: u64,
    pub lost_other: u64,
    pub duplicates: u64,
    pub unknown_after_disconnect: u64,
    pub samples_announced: u64,
    pub samples_present: u64,
    pub samples_occluded: u64,
    pub samples_not_finite: u64,
    pub markers_dropped: u64,
    pub link_bytes: u64,
    pub link_bytes_skipped: u64,
    pub link_messages: u64,
    pub link_messages_damaged: u64,
    pub link_messages_unknown: u64,
    pub contradictions: Vec<String>,
    pub clock: Option<ClockFit>,
}

impl Ledger {
    /// Frames in, less frames accounted for: 0 when the ledger closes.
    #[must_use]
    pub fn frame_balance(&self) -> i128 {
        let accounted = [
            self.recorded,
            self.lost_on_link,
            self.dropped_by_device,
            self.lost_ring_full,
            self.lost_other,
            self.unknown_after_disconnect,
        ];
        i128::from(self.frames_sent) - accounted.iter().map(|&n| i128::from(n)).sum::<i128>()
    }

    /// Samples announced, less samples accounted for: 0 when the ledger closes.
    #[must_use]
    pub fn sample_balance(&self) -> i128 {
        i128::from(self.samples_announced)
            - i128::from(self.samples_present)
            - i128::from(self.samples_occluded)
    }

    /// Whether both balances are zero and no counter contradicted itself.
    #[must_use]
    pub fn closes(&self) -> bool {
        self.frame_balance() == 0 && self.sample_balance() == 0 && self.contradictions.is_empty()
    }

    /// Frames that the device produced and the take does not have, as far as is known.
    #[must_use]
    pub fn frames_lost(&self) -> u64 {
        [
            self.lost_on_link,
            self.dropped_by_device,
            self.lost_ring_full,
            self.lost_other,
            self.unknown_after_disconnect,
        ]
        .iter()
        .fold(0, |sum, &n| sum.saturating_add(n))
    }

    /// Whether anything at all was lost: frames, or samples of markers beyond the pool.
    #[must_use]
    pub fn lost_anything(&self) -> bool {
        self.frames_lost() > 0 || self.markers_dropped > 0
    }
}

impl Record for Ledger {
    const NAME: &'static str = "ledger";
    const KIND: u8 = types::LEDGER;
    const VERSION: u16 = 1;
}
