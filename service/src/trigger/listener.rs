//! Accepts or refuses datagrams by their sender, and recognises repeats.

use std::{
    collections::{HashMap, VecDeque},
    fmt,
    hash::{DefaultHasher, Hash, Hasher},
    net::IpAddr,
    str::FromStr,
    time::Duration,
};

use ipnet::IpNet;

use super::{Trigger, TriggerError, datagram::is_from_instance, parse};
use crate::config::problem::excerpt;

/// A datagram that was parsed and accepted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Incoming {
    /// A trigger of another program, received for the first time.
    Trigger(Trigger),
    /// A repeat: senders repeat their datagrams.
    Repeat,
    /// Our own trigger, which came back, as broadcasts do.
    Own,
}

/// Filters received datagrams.
#[derive(Debug)]
pub struct Listener {
    allow_from: Vec<Network>,
    delay_max: Duration,
    instance_id: u64,
    recent: RecentTriggers,
}

impl Listener {
    /// Accepts datagrams from these networks, or from everywhere if there are none, with delays of at most `delay_max`.
    /// `instance_id` is that of the [`Announcer`](super::Announcer), to recognise our own datagrams.
    #[must_use]
    pub fn new(allow_from: Vec<Network>, delay_max: Duration, instance_id: u64) -> Self {
        Self { allow_from, delay_max, instance_id, recent: RecentTriggers::default() }
    }

    /// Whether `trigger.allow_from` lists the sender.
    #[must_use]
    pub fn is_known(&self, from: IpAddr) -> bool {
        self.allow_from.iter().any(|allowed| allowed.contains(from.to_canonical()))
    }

    /// Checks a datagram received at `now`, a time that never decreases. `exists` tells whether a take of a name
    /// exists: its start is refused. That also ends every echo, because a program that announces our own take to us
    /// names one that exists.
    ///
    /// # Errors
    /// Why the datagram has no effect.
    pub fn receive(
        &mut self,
        from: IpAddr,
        datagram: &[u8],
        now: Duration,
        exists: &dyn Fn(&str) -> bool,
    ) -> Result<Incoming, TriggerError> {
        let from = from.to_canonical();
        if !self.allow_from.is_empty() && !self.is_known(from) {
            return Err(TriggerError::NotAllowed(from));
        }
        let trigger = parse(datagram)?;
        if is_from_instance(&trigger, self.instance_id) {
            return Ok(Incoming::Own);
        }
        if self.recent.is_repeat(from, &trigger, datagram, now) {
            return Ok(Incoming::Repeat);
        }
        if trigger.delay() > self.delay_max {
            return Err(TriggerError::DelayTooLong { found: trigger.delay(), max: self.delay_max });
        }
        if let Trigger::Start(start) = &trigger
            && let Some(name) = &start.name
            && exists(name.text())
        {
            return Err(TriggerError::NameTaken(name.to_string()));
        }
        Ok(Incoming::Trigger(trigger))
    }

    /// Forgets a trigger that did not fit into the queue: its repeats are new attempts of the sender, not repeats of an
    /// executed trigger.
    pub fn forget(&mut self, from: IpAddr, trigger: &Trigger, datagram: &[u8]) {
        self.recent.forget(from.to_canonical(), trigger, datagram);
    }
}

/// A network, such as `192.168.10.0/24`, or a single address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Network(IpNet);

impl Network {
    /// Whether it contains an address. An IPv4 address received over IPv6 counts as the IPv4 address.
    #[must_use]
    pub fn contains(&self, address: IpAddr) -> bool {
        self.0.contains(&address.to_canonical())
    }
}

impl FromStr for Network {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (address, prefix) = text.split_once('/').unzip();
        let no_address = |_| "it is neither an address nor a network".to_owned();
        let address: IpAddr = address.unwrap_or(text).parse().map_err(no_address)?;
        if address != address.to_canonical() {
            return Err(format!("write it as the IPv4 address {}", address.to_canonical()));
        }
        let alone = IpNet::from(address);
        let Some(prefix) = prefix else { return Ok(Self(alone)) };
        let is_number = prefix.bytes().all(|byte| byte.is_ascii_digit());
        let bits = prefix.parse().ok().filter(|_| is_number);
        let network = bits.and_then(|bits| IpNet::new(address, bits).ok()).ok_or_else(|| {
            let bits = alone.max_prefix_len();
            format!("its prefix '{}' is not a number from 0 to {bits}", excerpt(prefix))
        })?;
        if network != network.trunc() {
            return Err(format!(
                "it has bits set after its prefix: write {}, or {address} for this address alone",
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

/// How long packet numbers are remembered: repeats come within seconds, and a restarted sender may restart its count.
pub const REMEMBERED: Duration = Duration::from_secs(60);

/// Numbers remembered per sender: no laboratory needs more than one a second.
pub const IDS_MAX: usize = 64;

/// Senders remembered; beyond that, the one that was silent for longest is forgotten.
pub const SENDERS_MAX: usize = 64;

/// Identifies repeated datagrams: by element and packet number, or by all bytes if there is no number.
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

/// Recently received triggers: 64 senders with 64 numbers of 40 bytes each, 160 kB at most.
#[derive(Debug, Default)]
pub(super) struct RecentTriggers {
    senders: HashMap<IpAddr, VecDeque<(Identity, Duration)>>,
}

impl RecentTriggers {
    /// Whether the datagram is a repeat. It is remembered in any case, until it is [forgotten](Self::forget).
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

    /// Forgets a datagram that was not accepted: the next one like it is not a repeat.
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
            let last = |heard: &VecDeque<(_, Duration)>| heard.iter().map(|(_, at)| *at).max();
            let silent = self.senders.iter().min_by_key(|(_, heard)| last(heard));
            silent.map(|(ip, _)| *ip).map(|ip| self.senders.remove(&ip));
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
    fn a_network_contains_only_its_own_addresses() {
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
    fn invalid_networks_are_explained() {
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
