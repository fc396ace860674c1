//! Passes the logged bytes on unchanged, except for Pongs: a Pong echoes the time of its Ping, and the pings of the
//! replay carry other times than the logged ones.

use std::collections::VecDeque;

use mocapd_drivers::device::{DeviceEvent, Pong, Protocol};
use mocapd_drivers::link::{DeviceLink, HostLink};

/// Length of a Pong on the wire. A longer message without its 0x00 is something else and need not be held back.
const PONG_BYTES_MAX: usize = 24;

/// Maximum number of pings that wait for a Pong. A host sends eight in a row.
const PINGS_MAX: usize = 16;

/// A ping older than this is not answered: such a round trip says nothing about the clocks.
const PING_NS_MAX: u64 = 200_000_000;

/// A ping and its time of arrival.
#[derive(Debug, Clone, Copy)]
struct Ping {
    host_ns: u64,
    came_ns: u64,
}

/// Finds Pongs in a byte stream, and makes them answer the host's pings.
#[derive(Debug)]
pub(super) struct PongRewriter {
    pings: VecDeque<Ping>,
    /// Bytes since the last 0x00 that are held back.
    open: Vec<u8>,
    /// Whether the message since the last 0x00 is longer than a Pong.
    is_long: bool,
    reader: HostLink,
    link: DeviceLink,
    message: Vec<u8>,
}

impl PongRewriter {
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

    /// Passes logged bytes on and returns how many. With `waits` it stops at a Pong that has no Ping to answer;
    /// otherwise it passes all.
    ///
    /// `ping_ns` gives the time of the Ping of a logged Pong, by the caller's clock. Without `waits`, only a Ping that
    /// came before it is answered: a Pong whose ticks are older than its Ping would spoil the clock fit.
    pub(super) fn pass(
        &mut self,
        bytes: &[u8],
        now_ns: u64,
        waits: bool,
        ping_ns: impl Fn(u64) -> Option<u64>,
        out: &mut Vec<u8>,
    ) -> usize {
        for (taken, &byte) in bytes.iter().enumerate() {
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
            let is_old = |ping: &mut Ping| now_ns.saturating_sub(ping.came_ns) > PING_NS_MAX;
            while !waits && self.pings.pop_front_if(is_old).is_some() {}
            let by_ns = if waits { Some(u64::MAX) } else { ping_ns(pong.host_ns) };
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
        bytes.len()
    }

    /// Passes the held-back bytes on unchanged.
    pub(super) fn flush(&mut self, out: &mut Vec<u8>) {
        out.append(&mut self.open);
    }

    pub(super) fn clear(&mut self) {
        self.open.clear();
        self.is_long = false;
        self.pings.clear();
    }

    /// Decodes the held-back message, if it is a Pong.
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
