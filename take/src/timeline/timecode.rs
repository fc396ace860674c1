//! Timecodes: as the row before, one frame on, or spelled out.

use mocapd_codec::range::{BinaryCoder, Bit};

/// Rows of one timecode are counted up to this: 480 Hz at 30 frames a second.
const HELD_MAX: usize = 16;

/// Predicts each timecode from the one before.
#[derive(Debug)]
pub(super) struct Timecodes {
    last: Option<[u8; 4]>,
    /// Rows since it changed.
    n_held: usize,
    /// The frame number from which the seconds were last seen to change.
    top: u8,
    present: [Bit; 2],
    held: [Bit; HELD_MAX + 1],
    /// The next frame; one set for the frame at the top.
    next: [Bit; 2],
    carry: [Bit; 2],
}

impl Timecodes {
    pub(super) fn new() -> Self {
        Self {
            last: None,
            n_held: 0,
            top: u8::MAX,
            present: [Bit::expecting(0), Bit::expecting(255)],
            held: [Bit::expecting(128); HELD_MAX + 1],
            next: [Bit::expecting(240), Bit::expecting(16)],
            carry: [Bit::expecting(240); 2],
        }
    }

    /// Encodes `timecode` and gives it back, or ignores it and gives the decoded one.
    pub(super) fn code(
        &mut self,
        coder: &mut impl BinaryCoder,
        timecode: Option<[u8; 4]>,
    ) -> Option<[u8; 4]> {
        let present = &mut self.present[usize::from(self.last.is_some())];
        if !coder.bit(present, timecode.is_some()) {
            self.last = None;
            return None;
        }
        let given = timecode.unwrap_or_default();
        let last = self.last.unwrap_or_default();
        if coder.bit(&mut self.held[self.n_held], given == last) {
            self.n_held = (self.n_held + 1).min(HELD_MAX);
            self.last = Some(last);
            return self.last;
        }
        self.n_held = 0;
        let at_top = usize::from(last[3] == self.top);
        let (next, carried) = (next_frame(last), next_second(last));
        let coded = if coder.bit(&mut self.next[at_top], given == next) {
            next
        } else if coder.bit(&mut self.carry[at_top], given == carried) {
            self.top = last[3];
            carried
        } else {
            (coder.plain(u64::from(u32::from_be_bytes(given)), 32) as u32).to_be_bytes()
        };
        self.last = Some(coded);
        self.last
    }
}

fn next_frame([hours, minutes, seconds, frames]: [u8; 4]) -> [u8; 4] {
    [hours, minutes, seconds, frames.wrapping_add(1)]
}

fn next_second([hours, minutes, seconds, _]: [u8; 4]) -> [u8; 4] {
    match (hours, minutes, seconds) {
        (23, 59, 59) => [0; 4],
        (_, 59, 59) => [hours.wrapping_add(1), 0, 0, 0],
        (_, _, 59) => [hours, minutes.wrapping_add(1), 0, 0],
        _ => [hours, minutes, seconds.wrapping_add(1), 0],
    }
}
