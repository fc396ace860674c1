//! A device that sends no frames any more: asked who it is, and believed or started again.

use std::time::Duration;

use mocapd_drivers::{
    device::{Command, Hello, Status},
    transport::TransportError,
};

use super::{
    ReadOptions, Rig,
    reader::{Reader, host_event},
};

/// A device that sent frames and is silent for so long is asked who it is, and again after as long: one that starts up
/// needs a while, and being asked stops one that only pauses.
const ASK_EVERY: Duration = Duration::from_secs(10);

/// Starts that get an event and words: a device that is started in vain must fill neither the take nor the screen.
const STARTS_TOLD_MAX: u32 = 32;

/// After so many answers that arrived with damage beside them the last one is believed: a line that is never clean must
/// not keep a device from being started again.
const ASKED_MAX: u32 = 5;

/// When and in what state of the line it was asked.
#[derive(Debug, Clone, Copy)]
pub(super) struct Asked {
    at_ns: u64,
    /// Messages that had arrived damaged by then.
    damaged: u64,
    /// How often, without a frame in between.
    times: u32,
    /// It has not answered.
    waits: bool,
}

impl Rig {
    /// A device that sent frames and sends none any more may have lost its power while the line to it stayed: it says who
    /// it is when it is asked, and is started again then.
    pub(super) fn ask_who(&mut self, reader: &mut Reader<'_>, last_frame_ns: u64, now_ns: u64) {
        let since_ns = reader.asked.map_or(last_frame_ns, |asked| asked.at_ns);
        let is_due = now_ns.saturating_sub(since_ns) > ASK_EVERY.as_nanos() as u64;
        if is_due && reader.intake.counts_seen() > 0 {
            reader.asked = Some(Asked {
                at_ns: now_ns,
                damaged: self.protocol.counters().messages_damaged,
                times: reader.asked.map_or(1, |asked| asked.times.saturating_add(1)),
                waits: true,
            });
            // A device that is gone shows in the next read.
            self.say(Command::Identify).ok();
        }
    }

    /// A device introduced itself while it was to send frames: its stream ended, or it is started again. `false` when it
    /// is another one.
    pub(super) fn follow_hello(
        &mut self,
        reader: &mut Reader<'_>,
        now: &Hello,
        options: &ReadOptions<'_>,
    ) -> Result<bool, TransportError> {
        if let Some(status) = reader.end_that_was_lost(now) {
            let words =
                "the end of the stream was lost on the line: the device was asked, and had ended";
            reader.intake.event(host_event(words));
            (options.say)(words);
            reader.intake.status(status, true);
            reader.end = Some(());
            return Ok(true);
        }
        let damaged = self.protocol.counters().messages_damaged;
        if let Some(asked) = &mut reader.asked
            && now.n_frames > 0
            && damaged > asked.damaged
            && asked.times < ASKED_MAX
        {
            // That its motion is over may have been lost again: it is asked again when that is due, and it waits.
            asked.waits = true;
            return Ok(true);
        }
        self.start_again(reader, now, options)
    }

    /// A device that introduced itself while it was to send frames is started again, as it was. `false` when it is
    /// another one.
    fn start_again(
        &mut self,
        reader: &mut Reader<'_>,
        now: &Hello,
        options: &ReadOptions<'_>,
    ) -> Result<bool, TransportError> {
        if (&now.model, &now.serial) != (&self.hello.model, &self.hello.serial) {
            (options.say)(&format!("another device answers, {} {}", now.model, now.serial));
            return Ok(false);
        }
        reader.started_again += 1;
        reader.count_anew();
        if reader.started_again <= STARTS_TOLD_MAX {
            reader.intake.event(host_event("the device introduced itself and was started again"));
            (options.say)(
                "the device introduced itself, as after a reset, a loss of power or a long silence: it was started again",
            );
        }
        if now.rate_mhz != self.hello.rate_mhz {
            self.say(Command::SetRate(self.hello.rate_mhz))?;
        }
        let line_bytes_per_s = self.transport.line_bytes_per_s().unwrap_or(0);
        self.say(Command::Start { line_bytes_per_s })?;
        Ok(true)
    }
}

impl Reader<'_> {
    /// Whether an answer is waited for.
    pub(super) fn is_asking(&self) -> bool {
        self.asked.is_some_and(|asked| asked.waits)
    }

    /// It answered, or is asked no more.
    pub(super) fn no_longer_asking(&mut self) {
        if let Some(asked) = &mut self.asked {
            asked.waits = false;
        }
    }

    /// What a device said of its run that was asked because no frame came, when that was all of a motion: then the end of
    /// its stream was lost on the way.
    fn end_that_was_lost(&self, now: &Hello) -> Option<Status> {
        let of_all = |status: &Status| now.n_frames > 0 && status.frames_produced >= now.n_frames;
        self.last_status.filter(of_all).filter(|_| self.asked.is_some())
    }
}
