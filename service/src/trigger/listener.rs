//! Who is listened to, and what of it is new.

use std::{
    collections::{HashMap, VecDeque},
    fmt,
    hash::{DefaultHasher, Hash, Hasher},
    net::IpAddr,
    str::FromStr,
    time::Duration,
};

use ipnet::IpNet;

use super::{Refusal, Trigger, encode, parse};
use crate::config::problem::excerpt;

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
    instance_id: u64,
    seen: RecentTriggers,
}

impl Listener {
    /// Listens to these networks, or to everybody where there are none, for delays of at most `delay_max`; `mark` is the
    /// [`Announcer`](super::Announcer)'s, so that our own datagrams are known.
    #[must_use]
    pub fn new(allow_from: Vec<Network>, delay_max: Duration, instance_id: u64) -> Self {
        Self { allow_from, delay_max, instance_id, seen: RecentTriggers::default() }
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
        if encode::is_from_instance(&trigger, self.instance_id) {
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

/// A network, such as `192.168.10.0/24`; a single address is one of all its bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Network(IpNet);

impl Network {
    /// Whether an address is in it. An IPv4 address that came over IPv6 is the IPv4 address.
    #[must_use]
    pub fn contains(&self, address: IpAddr) -> bool {
        self.0.contains(&address.to_canonical())
    }
}

impl FromStr for Network {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (address, prefix) =
            text.split_once('/').map_or((text, None), |(address, prefix)| (address, Some(prefix)));
        let no_address = |_| "it is no address and no network".to_owned();
        let address: IpAddr = address.parse().map_err(no_address)?;
        if address != address.to_canonical() {
            return Err(format!("write it as the IPv4 address {}", address.to_canonical()));
        }
        let alone = IpNet::from(address);
        let Some(prefix) = prefix else { return Ok(Self(alone)) };
        let is_number = prefix.bytes().all(|byte| byte.is_ascii_digit());
        let bits = prefix.parse().ok().filter(|_| is_number);
        let network = bits.and_then(|bits| IpNet::new(address, bits).ok()).ok_or_else(|| {
            let bits = alone.max_prefix_len();
            format!("its prefix '{}' is no number from 0 to {bits}", excerpt(prefix))
        })?;
        if network != network.trunc() {
            return Err(format!(
                "it has bits behind its prefix: write {}, or {address} for this one alone",
                network.trunc()
            ));
        }
        Ok(Self(network))
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.prefix_len() == self.0.max_prefix_len() {
            true => self.0.addr().fmt(f),
            false => self.0.fmt(f),
        }
    }
}

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
        match trigger.capture().about.packet_id {
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
pub(super) struct RecentTriggers {
    senders: HashMap<IpAddr, VecDeque<(Identity, Duration)>>,
}

impl RecentTriggers {
    /// Whether it is a repeat; it is remembered in any case, until it is [forgotten](Self::forget).
    pub(super) fn is_repeat(
        &mut self,
        from: IpAddr,
        trigger: &Trigger,
        datagram: &[u8],
        now: Duration,
    ) -> bool {
        let identity = Identity::of(trigger, datagram);
        self.evict(from, now);
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

    fn evict(&mut self, from: IpAddr, now: Duration) {
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
    pub(super) fn sizes(&self) -> (usize, usize) {
        (self.senders.len(), self.senders.values().map(VecDeque::len).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knows_its_own_and_no_others() {
        for (network, inside, outside) in [
            ("192.168.10.0/24", "192.168.10.255", "192.168.11.0"),
            ("192.168.10.7", "192.168.10.7", "192.168.10.6"),
            ("10.0.0.0/8", "::ffff:10.1.2.3", "11.0.0.0"),
            ("0.0.0.0/0", "8.8.8.8", "::1"),
            ("fe80::/10", "febf::1", "fec0::1"),
            ("::1", "::1", "::2"),
            ("::/0", "fe80::1", "127.0.0.1"),
        ] {
            let parsed: Network = network.parse().unwrap();
            assert!(parsed.contains(inside.parse().unwrap()), "{network}");
            assert!(!parsed.contains(outside.parse().unwrap()), "{network}");
            assert_eq!(parsed.to_string(), network);
        }
    }

    #[test]
    fn what_is_none_says_why() {
        let refused = |text: &str| text.parse::<Network>().unwrap_err();
        let no_address = refused("").replace("''", "");
        assert_eq!(refused("lab").replace("'lab'", ""), no_address);
        for (text, facts) in [
            ("192.168.1.7/24", &["192.168.1.0/24", "192.168.1.7"][..]),
            ("10.0.0.0/33", &["0 to 32"]),
            ("10.0.0.0/", &["0 to 32"]),
            ("10.0.0.0/+8", &["0 to 32"]),
            ("::/129", &["0 to 128"]),
            ("::ffff:10.0.0.1", &["10.0.0.1"]),
        ] {
            let reason = refused(text);
            assert!(facts.iter().all(|fact| reason.contains(fact)), "{text}: {reason}");
            assert_ne!(reason.replace(&format!("'{text}'"), ""), no_address);
        }
    }
}
