//! Accepts or refuses datagrams by their sender, recognises repeats, and lets accepted triggers wait for execution, in limited
//! numbers.
//!
//! A trigger without a delay is due immediately, and executed after the previous one. A delayed trigger is due later
//! and delays nothing else. [`PendingTriggers`] is sans-io: the time goes in, and due triggers come out.
//! [`TriggerQueue`] applies it in real time, between the thread that receives triggers and the one that executes them.

use std::{
    collections::{HashMap, VecDeque},
    fmt,
    hash::{DefaultHasher, Hash, Hasher},
    net::{IpAddr, SocketAddr},
    str::FromStr,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, Sender, bounded};
use ipnet::IpNet;
use mocapd_acquire::pipeline::lock;

use super::{Trigger, TriggerError, datagram::is_from_instance, parse};
use crate::config::problem::excerpt;

/// Maximum number of undelayed triggers that wait. Execution takes milliseconds, and a laboratory sends one every few
/// seconds: if this many wait, the service is stuck, and a start executed minutes later would be useless.
pub const DUE_MAX: usize = 16;

/// Maximum number of undelayed triggers of one sender that is not in `trigger.allow_from`: the stop of one take and the
/// start of the next, twice.
pub const DUE_EACH_MAX: usize = 4;

/// Maximum number of delayed triggers of all senders in `trigger.allow_from`: a start and a stop of eight machines.
pub const DELAYED_MAX: usize = 16;

/// Maximum number of delayed triggers of all other senders, one each: eight unlisted machines.
pub const DELAYED_OTHERS_MAX: usize = 8;

/// An accepted trigger.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReceivedTrigger {
    /// The sender.
    pub from: SocketAddr,
    /// The trigger.
    pub trigger: Trigger,
    /// Whether `trigger.allow_from` lists the sender.
    pub is_known: bool,
    /// The take that was being recorded when it arrived.
    pub recording: Option<String>,
}

impl ReceivedTrigger {
    /// The address that identifies the sender.
    #[must_use]
    pub fn sender(&self) -> IpAddr {
        self.from.ip().to_canonical()
    }
}

/// The pending triggers.
#[derive(Debug, Default)]
pub struct PendingTriggers {
    entries: Vec<Entry>,
    next_number: u64,
}

#[derive(Debug)]
struct Entry {
    due: Duration,
    /// In order of arrival.
    number: u64,
    is_delayed: bool,
    received: ReceivedTrigger,
}

impl PendingTriggers {
    /// Accepts a trigger received at `now`.
    ///
    /// # Errors
    /// Too many triggers are pending.
    pub fn push(&mut self, received: ReceivedTrigger, now: Duration) -> Result<(), TriggerError> {
        let delay = received.trigger.delay();
        let is_delayed = delay > Duration::ZERO;
        let (sender, is_known) = (received.sender(), received.is_known);
        let same_kind = || self.entries.iter().filter(|entry| entry.is_delayed == is_delayed);
        let all =
            same_kind().filter(|entry| !is_delayed || entry.received.is_known == is_known).count();
        let own = same_kind().filter(|entry| entry.received.sender() == sender).count();
        let (all_max, own_max) = match (is_delayed, is_known) {
            (false, true) => (DUE_MAX, None),
            (false, false) => (DUE_MAX, Some(DUE_EACH_MAX)),
            (true, true) => (DELAYED_MAX, None),
            (true, false) => (DELAYED_OTHERS_MAX, Some(1)),
        };
        if own_max.is_some_and(|max| own >= max) {
            return Err(TriggerError::TooManyOfSender { waiting: own, sender });
        }
        if all >= all_max {
            return Err(TriggerError::TooMany(all));
        }
        let number = self.next_number;
        self.next_number += 1;
        self.entries.push(Entry { due: now.saturating_add(delay), number, is_delayed, received });
        Ok(())
    }

    /// The number of pending triggers.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether no trigger is pending.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The time when the next trigger is due.
    #[must_use]
    pub fn next_due(&self) -> Option<Duration> {
        self.entries.iter().map(|entry| entry.due).min()
    }

    /// Takes the next trigger due at `now`, in order of due times.
    pub fn take_due(&mut self, now: Duration) -> Option<ReceivedTrigger> {
        let due = |at: &usize| self.entries[*at].due <= now;
        let order = |at: &usize| (self.entries[*at].due, self.entries[*at].number);
        let at = (0..self.entries.len()).filter(due).min_by_key(order)?;
        Some(self.entries.swap_remove(at).received)
    }

    /// Cancels pending starts of a sender: those of the named take, or all if `name` is `None`. Returns how many there
    /// were.
    pub fn cancel_starts(&mut self, from: SocketAddr, name: Option<&str>) -> usize {
        let before = self.entries.len();
        self.entries.retain(|entry| {
            let Trigger::Start(start) = &entry.received.trigger else { return true };
            let has_name = match (name, &start.name) {
                (Some(name), Some(start)) => start.text() == name,
                _ => true,
            };
            entry.received.sender() != from.ip().to_canonical() || !has_name
        });
        before - self.entries.len()
    }
}

/// The pending triggers, shared by two threads.
#[derive(Debug, Clone)]
pub struct TriggerQueue {
    waiting: Arc<Mutex<PendingTriggers>>,
    /// Holds at most one message: the next due time may have changed.
    wake: Sender<()>,
    woken: Receiver<()>,
    created: Instant,
}

impl Default for TriggerQueue {
    fn default() -> Self {
        let (wake, woken) = bounded(1);
        Self { waiting: Arc::default(), wake, woken, created: Instant::now() }
    }
}

impl TriggerQueue {
    /// The current time, by the clock of the due times.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.created.elapsed()
    }

    /// Accepts a trigger that has just arrived.
    ///
    /// # Errors
    /// Too many triggers are pending.
    pub fn push(&self, received: ReceivedTrigger) -> Result<(), TriggerError> {
        lock(&self.waiting).push(received, self.now())?;
        // If the channel is full, the receiver will wake up anyway.
        self.wake.try_send(()).ok();
        Ok(())
    }

    /// Takes the next trigger that is due now.
    #[must_use]
    pub fn take_due(&self) -> Option<ReceivedTrigger> {
        lock(&self.waiting).take_due(self.now())
    }

    /// The time until the next trigger is due; `None` if none is pending.
    #[must_use]
    pub fn due_in(&self) -> Option<Duration> {
        Some(lock(&self.waiting).next_due()?.saturating_sub(self.now()))
    }

    /// Receives a message when the next due time may have changed.
    #[must_use]
    pub fn woken(&self) -> &Receiver<()> {
        &self.woken
    }

    /// Cancels pending starts of a sender, and returns their number, as [`PendingTriggers::cancel_starts`] does.
    #[must_use]
    pub fn cancel_starts(&self, from: SocketAddr, name: Option<&str>) -> usize {
        lock(&self.waiting).cancel_starts(from, name)
    }
}

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
    use super::{super::Capture, *};

    fn start(sender: u8, is_known: bool, delay_ms: u64) -> ReceivedTrigger {
        let delay = Duration::from_millis(delay_ms);
        ReceivedTrigger {
            from: SocketAddr::from(([192, 0, 2, sender], 1)),
            trigger: Trigger::Start(Capture { delay, ..Capture::default() }),
            is_known,
            recording: None,
        }
    }

    #[test]
    fn triggers_come_in_order_of_due_times() {
        let mut waiting = PendingTriggers::default();
        let at = Duration::from_millis;
        for (sender, delay_ms) in [(1, 300), (2, 100), (3, 0), (4, 0)] {
            waiting.push(start(sender, true, delay_ms), at(1000)).unwrap();
        }
        let mut due = |ms: u64| waiting.take_due(at(ms)).map(|due| due.from.ip().to_string());
        assert_eq!(due(1000).as_deref(), Some("192.0.2.3"));
        assert_eq!(due(1000).as_deref(), Some("192.0.2.4"));
        assert_eq!(due(1099), None);
        assert_eq!(due(2000).as_deref(), Some("192.0.2.2"));
        assert_eq!(waiting.next_due(), Some(at(1300)));
    }

    #[test]
    fn one_delayed_trigger_per_unlisted_sender_and_eight_in_all() {
        let mut waiting = PendingTriggers::default();
        let mut push = |received| waiting.push(received, Duration::ZERO);
        for sender in 0..DELAYED_OTHERS_MAX as u8 {
            push(start(sender, false, 1)).unwrap();
            let again = push(start(sender, false, 1));
            assert!(matches!(again, Err(TriggerError::TooManyOfSender { waiting: 1, .. })));
        }
        assert_eq!(push(start(99, false, 1)), Err(TriggerError::TooMany(DELAYED_OTHERS_MAX)));
        // They take nothing away from undelayed triggers, or from listed senders.
        for _ in 0..DUE_EACH_MAX {
            push(start(0, false, 0)).unwrap();
        }
        assert!(push(start(0, false, 0)).is_err());
        push(start(1, false, 0)).unwrap();
        for _ in 0..DELAYED_MAX {
            push(start(100, true, 1)).unwrap();
        }
        assert_eq!(push(start(100, true, 1)), Err(TriggerError::TooMany(DELAYED_MAX)));
    }

    #[test]
    fn a_listed_sender_has_no_limit_of_its_own() {
        for (delay_ms, max) in [(0, DUE_MAX), (1, DELAYED_MAX)] {
            let mut waiting = PendingTriggers::default();
            for _ in 0..max {
                waiting.push(start(1, true, delay_ms), Duration::ZERO).unwrap();
            }
            for sender in [1, 2] {
                let refused = waiting.push(start(sender, true, delay_ms), Duration::ZERO);
                assert_eq!(refused, Err(TriggerError::TooMany(max)));
            }
        }
    }

    #[test]
    fn a_stop_cancels_the_starts_of_its_sender() {
        let mut waiting = PendingTriggers::default();
        waiting.push(start(1, true, 10), Duration::ZERO).unwrap();
        waiting.push(start(2, true, 10), Duration::ZERO).unwrap();
        let stop =
            ReceivedTrigger { trigger: Trigger::Stop(Capture::default()), ..start(1, true, 0) };
        assert_eq!(waiting.cancel_starts(stop.from, None), 1);
        assert_eq!(waiting.take_due(Duration::from_secs(1)), Some(start(2, true, 10)));
        assert_eq!(waiting.next_due(), None);
    }

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
