//! The logged bytes as they are, but for one thing: a Pong says back the time of the Ping that it answers, and the
//! pings of today have other times than those of the log.

use std::collections::VecDeque;

use mocapd_drivers::device::{DeviceEvent, Pong, Protocol};
use mocapd_drivers::link::{DeviceLink, HostLink};

/// A Pong on the wire has 24 bytes: what is longer and not closed yet is none, and need not be held back.
const PONG_BYTES_MAX: usize = 24;

/// Pings that wait for a Pong. A host sends eight in a row.
const PINGS_MAX: usize = 16;

/// A ping that waited so long is not answered any more: it tells nothing of the clocks.
const PING_NS_MAX: u64 = 200_000_000;

/// A ping, and when it came.
#[derive(Debug, Clone, Copy)]
struct Ping {
    host_ns: u64,
    came_ns: u64,
}

#[derive(Debug)]
pub(super) struct Pongs {
    pings: VecDeque<Ping>,
    /// What was said since the last 0x00 and is held back.
    open: Vec<u8>,
    /// More than a Pong was said since the last 0x00.
    is_long: bool,
    reader: HostLink,
    link: DeviceLink,
    message: Vec<u8>,
}

impl Pongs {
    pub(super) fn new() -> Self {
        Self {
            pings: VecDeque::with_capacity(PINGS_MAX),
            open: Vec::new(),
            is_long: false,
            reader: HostLink::new(),
            link: DeviceLink::new(),
            message: Vec::new(),
        }
    }

    pub(super) fn ping(&mut self, host_ns: u64, came_ns: u64) {
        if self.pings.len() == PINGS_MAX {
            self.pings.pop_front();
        }
        self.pings.push_back(Ping { host_ns, came_ns });
    }

    /// Passes logged bytes on. Gives how many it took: all, but where a Pong has no Ping to answer and `waits`.
    ///
    /// `asked_ns` gives the time at which the Ping of a logged Pong was said, by the caller's clock. Without `waits`
    /// only a Ping that came before that is answered: the ticks of a Pong are never older than its Ping, or the line
    /// through the clocks would be wrong.
    pub(super) fn pass(
        &mut self,
        said: &[u8],
        now_ns: u64,
        waits: bool,
        asked_ns: impl Fn(u64) -> Option<u64>,
        out: &mut Vec<u8>,
    ) -> usize {
        for (taken, &byte) in said.iter().enumerate() {
            self.open.push(byte);
            if byte != 0 || self.is_long {
                self.is_long |= self.open.len() > PONG_BYTES_MAX;
                if self.is_long {
                    self.flush(out);
                    self.is_long = byte != 0;
                }
                continue;
            }
            let Some(pong) = self.pong() else {
                self.flush(out);
                continue;
            };
            let is_old = |ping: &Ping| now_ns.saturating_sub(ping.came_ns) > PING_NS_MAX;
            while !waits && self.pings.front().is_some_and(is_old) {
                self.pings.pop_front();
            }
            let by_ns = if waits { Some(u64::MAX) } else { asked_ns(pong.host_ns) };
            let ping = self.pings.front().copied();
            match ping.filter(|ping| by_ns.is_some_and(|by_ns| ping.came_ns <= by_ns)) {
                Some(Ping { host_ns, .. }) => {
                    self.pings.pop_front();
                    self.message.clear();
                    self.link.pong(Pong { host_ns, ..pong }, &mut self.message);
                    out.extend_from_slice(&self.message);
                    self.open.clear();
                }
                None if waits => {
                    self.open.pop();
                    return taken;
                }
                None => self.flush(out),
            }
        }
        said.len()
    }

    /// What is held back goes out as it is.
    pub(super) fn flush(&mut self, out: &mut Vec<u8>) {
        out.append(&mut self.open);
    }

    pub(super) fn clear(&mut self) {
        self.open.clear();
        self.is_long = false;
        self.pings.clear();
    }

    /// The Pong that the message held back is.
    fn pong(&mut self) -> Option<Pong> {
        let mut found = None;
        self.reader.push(&self.open, &mut |event| {
            if let DeviceEvent::Pong(pong) = event {
                found = Some(pong);
            }
        });
        found
    }
}
