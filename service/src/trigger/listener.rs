//! Who is listened to, and what of it is new.

use std::{net::IpAddr, time::Duration};

use super::{Refusal, Trigger, encode, parse, seen::Seen};
use crate::config::Network;

/// What became of a datagram that was understood.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Heard {
    /// Somebody else's, for the first time.
    Trigger(Trigger),
    /// Heard before: senders repeat theirs.
    Repeat,
    /// Our own, which came back as broadcasts do.
    Own,
}

/// Hears datagrams, one after another.
#[derive(Debug)]
pub struct Listener {
    allow_from: Vec<Network>,
    delay_max: Duration,
    mark: u64,
    seen: Seen,
}

impl Listener {
    /// Listens to these networks, or to everybody where there are none, for delays of at most `delay_max`; `mark` is the
    /// [`Announcer`](super::Announcer)'s, so that our own datagrams are known.
    #[must_use]
    pub fn new(allow_from: Vec<Network>, delay_max: Duration, mark: u64) -> Self {
        Self { allow_from, delay_max, mark, seen: Seen::default() }
    }

    /// Whether a sender is one of those that are named.
    #[must_use]
    pub fn is_known(&self, from: IpAddr) -> bool {
        self.allow_from.iter().any(|allowed| allowed.contains(from.to_canonical()))
    }

    /// A datagram that came `now`, a time that only grows. `exists` says whether there is a take of a name: a start
    /// of one is refused. That is also what ends every echo: whoever tells us of our own take names one that exists.
    ///
    /// # Errors
    /// Why it starts and stops nothing.
    pub fn hear(
        &mut self,
        from: IpAddr,
        datagram: &[u8],
        now: Duration,
        exists: &dyn Fn(&str) -> bool,
    ) -> Result<Heard, Refusal> {
        let from = from.to_canonical();
        if !self.allow_from.is_empty() && !self.is_known(from) {
            return Err(Refusal::NotAllowed(from));
        }
        let trigger = parse(datagram)?;
        if encode::has_mark(&trigger, self.mark) {
            return Ok(Heard::Own);
        }
        if self.seen.is_repeat(from, &trigger, datagram, now) {
            return Ok(Heard::Repeat);
        }
        if trigger.delay() > self.delay_max {
            return Err(Refusal::DelayTooLong { found: trigger.delay(), max: self.delay_max });
        }
        if let Trigger::Start(start) = &trigger
            && let Some(name) = &start.name
            && exists(name.text())
        {
            return Err(Refusal::NameTaken(name.to_string()));
        }
        Ok(Heard::Trigger(trigger))
    }

    /// A trigger out of this datagram found no place in the queue. Its repeats are then the sender's next attempts, and
    /// must not pass for repeats of one that was carried out.
    pub fn forget(&mut self, from: IpAddr, trigger: &Trigger, datagram: &[u8]) {
        self.seen.forget(from.to_canonical(), trigger, datagram);
    }
}
