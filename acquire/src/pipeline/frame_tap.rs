//! Every frame for one other program part, such as a server that publishes them: copied into two rings beside those of the
//! channels, without waiting. Frames that do not fit are left out and counted.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use mocapd_take::motion::{GAP, Position};

use super::ring::{RingConsumer, RingProducer, Sample, ring};

/// Time of frames that the rings hold, in seconds: many times what a thread waits for a processor.
const HELD_S: f64 = 0.5;

/// Frames that they hold at least.
const HELD_FRAMES_MIN: usize = 64;

/// Memory of the rings: beyond it they hold frames for a shorter time. 200 markers at 1000 Hz need 2 MB.
const HELD_BYTES_MAX: usize = 16 << 20;

/// The data of a frame besides its markers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TappedFrame {
    /// Its row, counted from the start of the pipeline. A row that is skipped is a frame that did not arrive.
    pub row: u64,
    /// Time by the device's clock.
    pub device_ticks: u64,
    /// Arrival of its last byte, by the host's monotonic clock.
    pub arrival_ns: u64,
    /// Number of channels.
    pub n_channels: usize,
    /// Frames before it that arrived and were left out here, because the rings were full.
    pub left_out: u64,
}

/// A marker of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TappedMarker {
    /// Its position; NaN if it was not seen.
    pub position_mm: Position,
    /// The device's residual in units of 10 micrometres; 0 if it reports none.
    pub residual_10um: u8,
}

/// The reader's end.
#[derive(Debug)]
pub(super) struct FrameTapSender {
    heads: RingProducer<TappedFrame>,
    samples: RingProducer<Sample>,
    is_wanted: Arc<AtomicBool>,
    left_out: u64,
}

/// The other end.
#[derive(Debug)]
pub struct FrameTap {
    heads: RingConsumer<TappedFrame>,
    samples: RingConsumer<Sample>,
    is_wanted: Arc<AtomicBool>,
    row: Vec<Sample>,
}

/// The ends of a tap for frames of up to `n_slots` channels.
pub(super) fn frame_tap(rate_hz: f64, n_slots: usize) -> (FrameTapSender, FrameTap) {
    let n_frames_max = HELD_BYTES_MAX / (n_slots.max(1) * size_of::<Sample>());
    let n_frames = ((rate_hz * HELD_S) as usize).min(n_frames_max).max(HELD_FRAMES_MIN);
    let (heads, heads_out) = ring(n_frames);
    let (samples, samples_out) = ring(n_frames * n_slots.max(1));
    let is_wanted = Arc::new(AtomicBool::new(false));
    let sender = FrameTapSender { heads, samples, is_wanted: Arc::clone(&is_wanted), left_out: 0 };
    (sender, FrameTap { heads: heads_out, samples: samples_out, is_wanted, row: Vec::new() })
}

impl FrameTapSender {
    /// Copies a frame, if somebody wants it.
    pub(super) fn offer(&mut self, head: TappedFrame, row: &[Sample]) {
        if !self.is_wanted.load(Ordering::Relaxed) {
            self.left_out = 0;
            return;
        }
        if self.heads.vacant() == 0 || self.samples.vacant() < row.len() {
            self.left_out += 1;
            return;
        }
        self.samples.push_slice(row);
        self.heads.push(TappedFrame { left_out: std::mem::take(&mut self.left_out), ..head });
    }
}

impl FrameTap {
    /// Whether frames are wanted from now on. At first they are not.
    pub fn set_wanted(&self, is_wanted: bool) {
        self.is_wanted.store(is_wanted, Ordering::Relaxed);
    }

    /// The next frame. Fills `markers` by slot.
    pub fn next(&mut self, markers: &mut Vec<TappedMarker>) -> Option<TappedFrame> {
        let head = self.heads.pop()?;
        self.row.clear();
        self.row.resize(head.n_channels, Sample::default());
        self.samples.pop_slice(&mut self.row);
        markers.clear();
        markers.extend(self.row.iter().map(|sample| TappedMarker {
            position_mm: if sample.present { sample.position_mm } else { GAP },
            residual_10um: sample.residual_10um,
        }));
        Some(head)
    }

    /// Whether no more frames will come.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.heads.is_over()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_comes_through_or_is_counted() {
        let (mut sender, mut tap) = frame_tap(100.0, 2);
        let row = [
            Sample { position_mm: [1.0, 2.0, 3.0], present: true, residual_10um: 7 },
            Sample::default(),
        ];
        let head = |row| TappedFrame { row, n_channels: 2, ..TappedFrame::default() };
        sender.offer(head(0), &row);
        let mut markers = Vec::new();
        assert_eq!(tap.next(&mut markers), None, "nobody wanted it");
        tap.set_wanted(true);
        for n in 1..=70 {
            sender.offer(head(n), &row);
        }
        for n in 1..=64 {
            assert_eq!(tap.next(&mut markers), Some(head(n)));
        }
        assert_eq!((markers[0].position_mm, markers[0].residual_10um), ([1.0, 2.0, 3.0], 7));
        assert!(markers[1].position_mm[0].is_nan());
        sender.offer(head(71), &row);
        assert_eq!(tap.next(&mut markers), Some(TappedFrame { left_out: 6, ..head(71) }));
        drop(sender);
        assert!(tap.is_over());
    }
}
