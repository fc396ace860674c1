//! What is known of a stream from its start to its end.

use std::collections::VecDeque;

use super::{
    axis::{ProducedFrames, RateCheck},
    frame::{FrameComponent, FrameHeader, read_components},
};
use crate::device::Status;

/// The frame that is put together: over UDP its components may arrive in several datagrams.
#[derive(Debug, Clone, Copy)]
pub(super) struct OpenFrame {
    pub(super) header: FrameHeader,
    /// When its first part arrived.
    pub(super) opened_ns: u64,
    pub(super) has_labelled: bool,
    pub(super) has_unlabelled: bool,
    pub(super) has_bodies: bool,
    /// Whether bodies were requested.
    pub(super) wants_bodies: bool,
}

impl OpenFrame {
    /// Whether all parts are there that were requested.
    pub(super) fn is_whole(&self) -> bool {
        self.has_labelled && self.has_unlabelled && (self.has_bodies || !self.wants_bodies)
    }
}

/// The content of a data packet, which is read before any of it is recorded.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct FrameParts {
    /// Number of labelled markers, if there is such a component.
    pub(super) n_labelled: Option<usize>,
    /// Number of bodies, if there is such a component.
    pub(super) n_bodies: Option<usize>,
}

impl FrameParts {
    /// Reads a data packet; `None` when it is damaged, or has two components of markers of one sort.
    pub(super) fn of(body: &[u8]) -> Option<Self> {
        let mut parts = Self::default();
        let (mut n_labelled, mut n_unlabelled) = (0, 0);
        read_components(body, &mut |_, component| match component {
            FrameComponent::Markers(markers) if markers.kind.is_labelled() => {
                n_labelled += 1;
                parts.n_labelled = Some(markers.n_markers());
            }
            FrameComponent::Markers(_) => n_unlabelled += 1,
            FrameComponent::Bodies(bodies) => parts.n_bodies = Some(bodies.n_bodies()),
            _ => {}
        })?;
        (n_labelled <= 1 && n_unlabelled <= 1).then_some(parts)
    }
}

/// Datagrams of a frame that wait, at most: those of markers, bodies and samples, each twice.
const PARTS_MAX: usize = 8;

/// The datagrams of a frame whose first part arrived before the last one of the frame before it.
#[derive(Debug, Default)]
pub(super) struct NextFrame {
    header: FrameHeader,
    since_ns: u64,
    bytes: Vec<u8>,
    /// Where each datagram's content ends.
    ends: Vec<usize>,
}

impl NextFrame {
    /// Holds a datagram. Returns `false` if it is of a third frame, or one too many.
    pub(super) fn hold(&mut self, header: FrameHeader, body: &[u8], now_ns: u64) -> bool {
        if self.ends.is_empty() {
            (self.header, self.since_ns) = (header, now_ns);
        }
        let has_room = header == self.header && self.ends.len() < PARTS_MAX;
        if has_room {
            self.bytes.extend_from_slice(body);
            self.ends.push(self.bytes.len());
        }
        has_room
    }

    /// When its first part arrived; `None` if none has.
    pub(super) fn since_ns(&self) -> Option<u64> {
        (!self.ends.is_empty()).then_some(self.since_ns)
    }

    pub(super) fn parts(&self) -> impl Iterator<Item = &[u8]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).filter_map(|(start, end)| self.bytes.get(start..*end))
    }

    pub(super) fn clear(&mut self) {
        self.bytes.clear();
        self.ends.clear();
    }
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
    /// Whether bodies were requested, and whether any came.
    pub(super) has_bodies: bool,
    /// Whether any came.
    pub(super) had_bodies: bool,
    /// The frame that is put together, and what has come of the one after it.
    pub(super) open: Option<OpenFrame>,
    pub(super) next: NextFrame,
    /// Frames by their counters.
    pub(super) produced: ProducedFrames,
    /// Counter and time stamp of the last frame that was not late.
    pub(super) last: u32,
    pub(super) last_us: u64,
    pub(super) frames: u64,
    pub(super) notes: u32,
    pub(super) vendor: VendorLoss,
    pub(super) rate: RateCheck,
    pub(super) is_idle_noted: bool,
    pub(super) is_refusal_noted: bool,
    /// Frames with and without all of their parts.
    pub(super) whole: u64,
    pub(super) partial: u64,
    /// Unlabelled markers without a channel.
    pub(super) excess: u64,
    /// Samples of devices that are not recorded.
    pub(super) samples_left_out: u64,
    /// Components of samples that cannot be read.
    pub(super) samples_unreadable: u64,
    /// Poses of frames that have another number of bodies than the settings.
    pub(super) bodies_left_out: u64,
    /// Components of bodies that cannot be read.
    pub(super) bodies_unreadable: u64,
}

/// How long a frame waits for its other datagram, which was sent at the same time.
const PART_WAIT_NS: u64 = 20_000_000;

impl StreamRun {
    /// Whether the rest of the open frame is lost.
    pub(super) fn is_part_overdue(&self, now_ns: u64) -> bool {
        self.open.is_some_and(|open| now_ns.saturating_sub(open.opened_ns) >= PART_WAIT_NS)
    }

    /// The final counters. QTM does not state how many frames it made: these are frames by their numbers.
    pub(super) fn status(&self) -> Status {
        let frames_produced = self.produced.produced();
        Status { frames_produced, frames_dropped: 0, temperature_c_100: i16::MIN }
    }
}

/// Settings that name what frames have in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Named {
    Markers,
    Bodies,
}

/// The requests of a connection.
#[derive(Debug, Default)]
pub(super) struct Renewal {
    /// Those without a reply. QTM answers in order, however late.
    pub(super) awaited: VecDeque<Named>,
    /// When each was requested last.
    pub(super) requested_ns: [Option<u64>; 2],
    /// Frames that wait for the replies, their bytes, and since when.
    pub(super) held: Vec<Vec<u8>>,
    pub(super) held_bytes: usize,
    pub(super) held_since_ns: u64,
    /// Whether the replies are late, so that no frame waits for them any more.
    pub(super) is_late: bool,
}

impl Renewal {
    /// Whether a reply is awaited.
    pub(super) fn is_awaited(&self) -> bool {
        !self.awaited.is_empty()
    }

    /// The oldest request was replied to, which is of no use any more.
    pub(super) fn forget_one(&mut self) -> bool {
        self.awaited.pop_front().is_some()
    }
}
