//! What is known of a stream from its start to its end.

use super::frame::FrameHeader;
use crate::device::Status;

/// The frame that is put together: over UDP its components may arrive in several datagrams.
#[derive(Debug, Clone, Copy)]
pub(super) struct OpenFrame {
    pub(super) header: FrameHeader,
    pub(super) has_labelled: bool,
    pub(super) has_unlabelled: bool,
}

/// QTM's account of what it lost between cameras and computer: 2D frames, per thousand, over the last second.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct VendorLoss {
    /// Highest rates of lost 2D frames, and of those out of step.
    pub(super) worst: [u16; 2],
    /// Frames that stated a rate above 0.
    pub(super) frames: [u64; 2],
}

/// The state of a stream.
#[derive(Debug, Default)]
pub(super) struct StreamRun {
    /// Whether the start was reported.
    pub(super) is_reported: bool,
    /// The frame that is put together.
    pub(super) open: Option<OpenFrame>,
    /// Counter of the first frame.
    pub(super) first: Option<u32>,
    /// Counter and time stamp of the last frame that was not late.
    pub(super) last: u32,
    pub(super) last_us: u64,
    pub(super) frames: u64,
    pub(super) notes: u32,
    pub(super) vendor: VendorLoss,
    pub(super) is_idle_noted: bool,
    /// Unlabelled markers without a channel.
    pub(super) excess: u64,
}

impl StreamRun {
    /// The final counters. QTM does not state how many frames it made: these are frames by their numbers.
    pub(super) fn status(&self) -> Status {
        let produced = self.first.map_or(0, |first| u64::from(self.last.wrapping_sub(first)) + 1);
        // A count that began again tells nothing.
        let frames_produced =
            if produced > u64::from(u32::MAX / 2) { self.frames } else { produced };
        Status { frames_produced, frames_dropped: 0, temperature_c_100: i16::MIN }
    }
}
