//! Frames for people's eyes: some thirty a second go past the rings into a small one of their own. What does not fit
//! is not shown.

use mocapd_take::motion::{GAP, Position};

use super::ring::{RingIn, RingOut, Sample, ring};

/// Time between two frames that are shown: 30 a second, and a little less than that, so that no beat with the
/// device's rate makes it 20.
const EVERY_NS: u64 = 32_000_000;

/// Frames that wait: a viewer's thread looks every few milliseconds, and a quarter of a second late is late enough.
const FRAMES_MAX: usize = 8;

/// What is known of a frame beside its positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TapHead {
    /// Its row, counted since the pipeline was started.
    pub row: u64,
    /// By the device's clock.
    pub device_ticks: u64,
    /// When its last byte arrived, by the host's monotonic clock.
    pub arrival_ns: u64,
    /// Channels.
    pub n_channels: usize,
}

/// The reader's end.
#[derive(Debug)]
pub(super) struct TapIn {
    heads: RingIn<TapHead>,
    positions: RingIn<Position>,
    last_ns: u64,
}

/// The end of whoever shows them.
#[derive(Debug)]
pub struct TapOut {
    heads: RingOut<TapHead>,
    positions: RingOut<Position>,
}

pub(super) fn tap(n_slots: usize) -> (TapIn, TapOut) {
    let (heads, heads_out) = ring(FRAMES_MAX);
    let (positions, positions_out) = ring(FRAMES_MAX * n_slots.max(1));
    let out = TapOut { heads: heads_out, positions: positions_out };
    (TapIn { heads, positions, last_ns: 0 }, out)
}

impl TapIn {
    /// A frame, which is shown when it is time for one.
    pub(super) fn offer(&mut self, head: TapHead, row: &[Sample]) {
        if head.arrival_ns.saturating_sub(self.last_ns) < EVERY_NS {
            return;
        }
        self.last_ns = head.arrival_ns;
        if self.heads.room() == 0 || self.positions.room() < row.len() {
            return;
        }
        for sample in row {
            self.positions.push(if sample.present { sample.position_mm } else { GAP });
        }
        self.heads.push(head);
    }
}

impl TapOut {
    /// The next frame; its positions by slot, NaN where a marker was not seen.
    pub fn next(&mut self, positions: &mut Vec<Position>) -> Option<TapHead> {
        let head = self.heads.pop()?;
        positions.clear();
        positions.resize(head.n_channels, GAP);
        self.positions.pop_slice(positions);
        Some(head)
    }
}
