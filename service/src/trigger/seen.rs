//! Which datagrams were heard already: senders repeat a trigger, with the same number, so that one arrives.

use std::{
    collections::{HashMap, VecDeque},
    hash::{DefaultHasher, Hash, Hasher},
    net::IpAddr,
    time::Duration,
};

use super::Trigger;

/// How long a number is remembered: repeats come within seconds, and a sender that was started again counts anew.
pub const REMEMBERED: Duration = Duration::from_secs(60);

/// Numbers remembered of one sender: more than one a second is no laboratory.
pub const IDS_MAX: usize = 64;

/// Senders remembered: the one that was silent for longest is forgotten.
pub const SENDERS_MAX: usize = 64;

/// What makes a datagram the same as another one: its element and its number, or all of its bytes where it has none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Identity {
    Packet(&'static str, u64),
    Bytes(u64),
}

impl Identity {
    fn of(trigger: &Trigger, datagram: &[u8]) -> Self {
        match trigger.about().packet_id {
            Some(id) => Self::Packet(trigger.element(), id),
            None => {
                let mut hasher = DefaultHasher::new();
                datagram.hash(&mut hasher);
                Self::Bytes(hasher.finish())
            }
        }
    }
}

/// 64 senders of 64 numbers, 40 bytes each: 160 kB at most.
#[derive(Debug, Default)]
pub(super) struct Seen {
    senders: HashMap<IpAddr, VecDeque<(Identity, Duration)>>,
}

impl Seen {
    /// Whether it is a repeat; it is remembered in any case, until it is [forgotten](Self::forget).
    pub(super) fn is_repeat(
        &mut self,
        from: IpAddr,
        trigger: &Trigger,
        datagram: &[u8],
        now: Duration,
    ) -> bool {
        let identity = Identity::of(trigger, datagram);
        self.make_room(from, now);
        let heard = self.senders.entry(from).or_insert_with(|| VecDeque::with_capacity(IDS_MAX));
        if let Some(known) = heard.iter_mut().find(|(known, _)| *known == identity) {
            known.1 = now;
            return true;
        }
        if heard.len() == IDS_MAX {
            heard.pop_front();
        }
        heard.push_back((identity, now));
        false
    }

    /// Forgets a datagram that was not accepted: the next one like it is no repeat.
    pub(super) fn forget(&mut self, from: IpAddr, trigger: &Trigger, datagram: &[u8]) {
        let identity = Identity::of(trigger, datagram);
        if let Some(heard) = self.senders.get_mut(&from) {
            heard.retain(|(known, _)| *known != identity);
        }
    }

    fn make_room(&mut self, from: IpAddr, now: Duration) {
        let is_old = |at: &Duration| now.saturating_sub(*at) > REMEMBERED;
        for heard in self.senders.values_mut() {
            heard.retain(|(_, at)| !is_old(at));
        }
        self.senders.retain(|_, heard| !heard.is_empty());
        if self.senders.len() == SENDERS_MAX && !self.senders.contains_key(&from) {
            let last =
                |heard: &VecDeque<(Identity, Duration)>| heard.iter().map(|(_, at)| *at).max();
            let silent =
                self.senders.iter().min_by_key(|(_, heard)| last(heard)).map(|(ip, _)| *ip);
            silent.map(|ip| self.senders.remove(&ip));
        }
    }

    #[cfg(test)]
    pub(super) fn n_remembered(&self) -> (usize, usize) {
        (self.senders.len(), self.senders.values().map(VecDeque::len).sum())
    }
}
