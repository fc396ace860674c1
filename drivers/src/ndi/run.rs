//! What a system's frame numbers say of the frames that nobody saw.

use crate::device::Status;

/// A number this far ahead is loss, and one this far behind came late; anything else is a counter that
/// began anew. The same holds where frames are put on record.
const AHEAD_MAX: i32 = 1 << 20;
const LATE_MIN: i32 = -64;

/// What a frame's number says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Counted {
    /// By how many it is ahead of the last one; 0 when it came late.
    pub(super) ahead: u32,
    /// Of those in between, the ones that were never fetched.
    pub(super) dropped: u32,
}

/// From a Start to its end. A system that is lost and found again is started again, and with that a new run begins: a
/// host counts its reports from there.
///
/// A system keeps one frame. Those that its number skips were replaced before a poll came: they never
/// left it. But an answer that was damaged or did not come may have held one: of the frames that are
/// skipped then, one for each such answer counts as lost on the link.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Run {
    /// The last frame's number, in tracked frames.
    last: Option<u32>,
    /// Frames as far as their numbers tell, those that did not come too.
    produced: u64,
    /// Of these, never fetched.
    dropped: u64,
    /// Polls since the last frame whose answers could not be read.
    unread: u32,
    ticks: u64,
    started: bool,
    /// What was said already.
    said_slow: bool,
    said_clock: bool,
}

impl Run {
    /// Before a Start.
    pub(super) fn begin(&mut self) {
        if !self.started {
            *self = Self { ticks: self.ticks, started: true, ..Self::default() };
        }
    }

    /// The system is lost: what was counted of it was told. What was said of the line holds.
    pub(super) fn lost(&mut self) {
        let Self { ticks, started, said_slow, said_clock, .. } = *self;
        *self = Self { ticks, started, said_slow, said_clock, ..Self::default() };
    }

    /// At its end; whether there was one to end.
    pub(super) fn end(&mut self) -> bool {
        std::mem::take(&mut self.started)
    }

    pub(super) fn is_last(&self, number: u32) -> bool {
        self.last == Some(number)
    }

    /// A poll had no answer that could be read.
    pub(super) fn unread(&mut self) {
        self.unread = self.unread.saturating_add(1);
    }

    /// A frame came.
    pub(super) fn frame(&mut self, number: u32, ticks: u64) -> Counted {
        let ahead = self.last.map_or(1, |last| number.wrapping_sub(last).cast_signed());
        let ahead = match ahead {
            1..=AHEAD_MAX => ahead as u32,
            LATE_MIN..=0 if ticks <= self.ticks => return Counted { ahead: 0, dropped: 0 },
            _ => 1,
        };
        let skipped = ahead - 1;
        let dropped = skipped - skipped.min(std::mem::take(&mut self.unread));
        self.produced += u64::from(ahead);
        self.dropped += u64::from(dropped);
        (self.last, self.ticks) = (Some(number), ticks);
        Counted { ahead, dropped }
    }

    pub(super) fn status(&self) -> Status {
        Status {
            frames_produced: self.produced,
            frames_dropped: self.dropped,
            temperature_c_100: i16::MIN,
        }
    }

    /// The device's clock at the last frame; 0 before the first.
    pub(super) fn last_ticks(&self) -> u64 {
        self.ticks
    }

    /// Whether to say that the line is slow: once.
    pub(super) fn says_slow(&mut self) -> bool {
        !std::mem::replace(&mut self.said_slow, true)
    }

    /// Whether to say what the clock is: once.
    pub(super) fn says_clock(&mut self) -> bool {
        !std::mem::replace(&mut self.said_clock, true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skipped_frames_were_never_fetched_unless_an_answer_was_damaged() {
        let mut run = Run::default();
        run.begin();
        let counted = |ahead, dropped| Counted { ahead, dropped };
        assert_eq!(run.frame(1000, 10), counted(1, 0), "where a run begins nobody knows");
        assert_eq!(run.frame(1001, 20), counted(1, 0));
        assert_eq!(run.frame(1005, 60), counted(4, 3));
        run.unread();
        assert_eq!(run.frame(1007, 80), counted(2, 0), "the damaged answer had it");
        run.unread();
        run.unread();
        assert_eq!(run.frame(1012, 130), counted(5, 2));
        assert_eq!(run.frame(1014, 150), counted(2, 1), "those are accounted for");
        let Status { frames_produced, frames_dropped, .. } = run.status();
        assert_eq!((frames_produced, frames_dropped), (15, 6));
        // Late, and a counter that began anew.
        assert_eq!(run.frame(1013, 140), counted(0, 0));
        assert_eq!(run.frame(1015, 160), counted(1, 0), "what came late moves nothing");
        assert_eq!(run.frame(3, 5), counted(1, 0));
        assert_eq!(run.status().frames_produced, 17);
        assert!(run.end() && !run.end());
    }
}
