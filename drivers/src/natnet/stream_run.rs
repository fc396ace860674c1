//! What is known of a stream from its start to its end.

use super::message::Bitstream;
use crate::device::Status;

/// The state of a stream.
#[derive(Debug, Default)]
pub(super) struct NatNetRun {
    /// When the last frame came, or frames were wanted; and when their group was joined again.
    pub(super) last_frame_ns: u64,
    pub(super) joined_ns: u64,
    /// Number and stamps of the last frame.
    pub(super) last_key: Option<(u32, [u64; 3])>,
    /// Whether definitions were requested because they changed.
    pub(super) had_change: bool,
    pub(super) is_stranger_noted: bool,
    /// Counter of the first frame, and of the last that was not late; the latter also as the number of the frame.
    pub(super) first: Option<u32>,
    pub(super) last: u32,
    pub(super) index: u64,
    /// The server's clock at the last frame.
    pub(super) last_ticks: u64,
    pub(super) frames: u64,
    pub(super) notes: u32,
    pub(super) is_idle_noted: bool,
    pub(super) is_port_open: bool,
    /// Frames whose sets were searched for names.
    pub(super) searches: u32,
    /// Number of the last frame that was not late.
    pub(super) number: u32,
    /// Whether the definitions may have changed.
    pub(super) doubts_model: bool,
    /// Frames that wait for definitions, each with its layout.
    pub(super) held: Vec<(Bitstream, Vec<u8>)>,
    /// Frames of an unknown layout.
    pub(super) misfits: u64,
    /// Frames without the time of their exposure.
    pub(super) without_exposure: u64,
    /// Markers whose positions are computed, and those without a channel.
    pub(super) filled: u64,
    pub(super) excess: u64,
    /// Markers whose label was in their frame already.
    pub(super) repeated: u64,
}

impl NatNetRun {
    /// The final counters. The server does not state how many frames it made: these are frames by their numbers.
    pub(super) fn status(&self) -> Status {
        let produced = self.first.map_or(0, |first| u64::from(self.last.wrapping_sub(first)) + 1);
        // A count that began again tells nothing.
        let frames_produced =
            if produced > u64::from(u32::MAX / 2) { self.frames } else { produced };
        Status { frames_produced, frames_dropped: 0, temperature_c_100: i16::MIN }
    }
}
