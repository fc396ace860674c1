//! Finds streams on the network: a question by UDP, to groups and to machines that LSL's configuration names, and answers
//! with short descriptions.
//!
//! Streams that are over while others are read are found, compared and opened again on a thread of their own, so that no
//! sample of the others waits for somebody who does not answer.

use std::{
    collections::BTreeMap,
    io::{self, ErrorKind},
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket},
    ops::Range,
    sync::{
        Arc, LazyLock, Mutex, MutexGuard, PoisonError,
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    thread::Builder,
    time::{Duration, Instant},
};

use labstream_core::{
    net::{config, local_ipv4_addresses, make_query_id},
    proto::discovery::{build_query, parse_answer},
};

use super::sockets::{Feed, whole_description};
use crate::{
    lsl::StreamDescription,
    transport::TransportError,
    uri::{STREAMS_MAX, StreamQuery},
};

/// How long to wait for a stream: several waves, of which each can be lost.
const FIND_TIMEOUT: Duration = Duration::from_millis(2500);

/// How long to wait for others when all were found by their source ids, which programs make unique: LSL's own limit for answers
/// by multicast.
const OTHERS_TIMEOUT: Duration = Duration::from_millis(500);

/// Time between two questions.
const WAVE_INTERVAL: Duration = Duration::from_millis(400);

/// Streams that are kept, several times those of the busiest laboratory, and those of other names, for an error.
const FOUND_MAX: usize = 512;
const OTHERS_MAX: usize = 64;

/// Streams that an error names.
const NAMED_MAX: usize = 8;

/// How long a search waits for the addresses of machines that LSL's configuration names: those that are found later are asked
/// with the next wave.
const RESOLVE_TIMEOUT: Duration = Duration::from_millis(200);

/// Bytes of an answer, at most those of a datagram.
const ANSWER_BYTES_MAX: usize = 1 << 16;

/// A stream on the network.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundStream {
    /// What it states about itself, without channels.
    pub description: StreamDescription,
    /// Its machine; the port says nothing.
    pub(super) machine: SocketAddr,
}

impl FoundStream {
    /// Where its data can be read.
    pub(super) fn data_address(&self) -> Option<SocketAddr> {
        self.at(self.description.data_ports)
    }

    /// Where time probes are answered.
    pub(super) fn service_address(&self) -> Option<SocketAddr> {
        self.at(self.description.service_ports)
    }

    fn at(&self, [v4, v6]: [u16; 2]) -> Option<SocketAddr> {
        let port = if self.machine.is_ipv4() { v4 } else { v6 };
        let mut address = self.machine;
        address.set_port(port);
        (port != 0).then_some(address)
    }

    /// The URI that opens it and none of the others; `None` if no URI does.
    #[must_use]
    pub fn uri_among(&self, all: &[FoundStream]) -> Option<String> {
        let of = &self.description;
        let names = vec![of.name.clone()];
        let by_name = StreamQuery { names, ..StreamQuery::default() };
        let kind = Some(of.kind.clone()).filter(|kind| !kind.is_empty());
        let source_id = Some(of.source_id.clone()).filter(|id| !id.is_empty());
        let hostname = Some(of.hostname.clone()).filter(|name| !name.is_empty());
        let queries = [
            by_name.clone(),
            StreamQuery { source_id: source_id.clone(), ..by_name.clone() },
            StreamQuery { kind: kind.clone(), ..by_name.clone() },
            StreamQuery { kind, source_id, hostname, ..by_name },
        ];
        let is_only = |query: &&StreamQuery| {
            choose(query, all).is_ok_and(|chosen| matches!(&chosen[..], [only] if only == self))
        };
        let found = queries.iter().find(is_only).filter(|_| !of.name.is_empty());
        found.map(ToString::to_string)
    }
}

/// All streams that answer in this time.
///
/// # Errors
/// `Io` when the system gives no socket.
pub fn streams(wait: Duration) -> Result<Vec<FoundStream>, TransportError> {
    let mut search = Search::open(&[])?;
    search.run(wait, |_| false);
    Ok(search.found)
}

/// The streams of these names that answer in this time; none if the system gives no socket.
pub(super) fn named(names: &[String], wait: Duration) -> Vec<FoundStream> {
    let Ok(mut search) = Search::open(names) else { return Vec::new() };
    search.run(wait, |_| false);
    search.found
}

/// Finds the streams of a query, in its order. Without a source id it listens to the end of its time: another stream of the same
/// name, whose first answers were lost, may answer late.
///
/// # Errors
/// `Unreachable`, which says what was found and what to do.
pub(super) fn find(query: &StreamQuery) -> Result<Vec<FoundStream>, TransportError> {
    let mut search = Search::open(&query.names)?;
    let is_unique = query.source_id.is_some();
    search.run(FIND_TIMEOUT, |found| is_unique && choose(query, found).is_ok());
    search.run(OTHERS_TIMEOUT.saturating_sub(search.began.elapsed()), |_| false);
    choose(query, &search.found)
        .map_err(|remedy| TransportError::Unreachable { device: query.to_string(), remedy })
}

/// The streams of a query, in its order.
fn choose(query: &StreamQuery, found: &[FoundStream]) -> Result<Vec<FoundStream>, String> {
    if query.names.is_empty() {
        return Ok(vec![the_one(query, None, found)?]);
    }
    query.names.iter().map(|name| the_one(query, Some(name), found)).collect()
}

fn the_one(
    query: &StreamQuery,
    name: Option<&str>,
    found: &[FoundStream],
) -> Result<FoundStream, String> {
    let is_wanted = |wanted: Option<&str>, is: &str| wanted.is_none_or(|wanted| wanted == is);
    let matches = |stream: &&FoundStream| {
        let of = &stream.description;
        is_wanted(name, &of.name)
            && is_wanted(query.kind.as_deref(), &of.kind)
            && is_wanted(query.source_id.as_deref(), &of.source_id)
            && is_wanted(query.hostname.as_deref(), &of.hostname)
    };
    let same: Vec<&FoundStream> = found.iter().filter(matches).collect();
    match same.as_slice() {
        [only] => Ok((*only).clone()),
        [] => Err(not_found(name, found)),
        several => Err(format!(
            "{} streams match: {}; choose one with ?source_id=, type= or hostname=",
            several.len(),
            summaries(several)
        )),
    }
}

fn not_found(name: Option<&str>, found: &[FoundStream]) -> String {
    let what =
        name.map_or_else(|| "no such stream".to_owned(), |name| format!("no stream '{name}'"));
    if found.is_empty() {
        return format!(
            "{what} answers, and no other: start its program, check that no firewall blocks UDP ports 16571 to 16604, and \
             that both machines have the same SessionID in their LSL configuration; across networks name the other machine \
             in its KnownPeers"
        );
    }
    let all: Vec<&FoundStream> = found.iter().collect();
    format!("{what} with these properties answers; found: {}", summaries(&all))
}

fn summaries(streams: &[&FoundStream]) -> String {
    let named = streams.iter().take(NAMED_MAX).map(|stream| stream.description.summary());
    let mut text = named.collect::<Vec<_>>().join(", ");
    if let Some(more @ 1..) = streams.len().checked_sub(NAMED_MAX) {
        text.push_str(&format!(" and {more} more"));
    }
    text
}

/// A search that asks again until it is over.
struct Search {
    began: Instant,
    next_wave: Instant,
    legs: Vec<Leg>,
    /// The question's number, by which its answers are known.
    id: String,
    buffer: Vec<u8>,
    /// Names to look for; empty for all.
    names: Vec<String>,
    found: Vec<FoundStream>,
    n_others: usize,
}

/// The sockets of one version of the Internet Protocol.
struct Leg {
    /// Where answers arrive.
    receiver: UdpSocket,
    /// One for each address of this machine: multicast leaves by one interface at a time.
    senders: Vec<UdpSocket>,
    groups: Vec<SocketAddr>,
    /// The ports of each machine that is asked alone.
    ports: Range<u16>,
}

impl Search {
    fn open(names: &[String]) -> Result<Self, TransportError> {
        let settings = config::get();
        PEERS.look_up(&settings.known_peers, resolve);
        let families = [(settings.allow_ipv4, false), (settings.allow_ipv6, true)];
        let opened = families.into_iter().filter(|(allowed, _)| *allowed);
        let opened: Vec<io::Result<Leg>> = opened.map(|(_, v6)| Leg::open(v6)).collect();
        let (legs, errors): (Vec<_>, Vec<_>) = opened.into_iter().partition(Result::is_ok);
        let legs: Vec<Leg> = legs.into_iter().flatten().collect();
        if let (true, Some(Err(source))) = (legs.is_empty(), errors.into_iter().next()) {
            let device = "LSL".to_owned();
            return Err(TransportError::Io { device, action: "opening a UDP socket", source });
        }
        let now = Instant::now();
        Ok(Self {
            began: now,
            next_wave: now,
            legs,
            id: make_query_id(),
            buffer: vec![0; ANSWER_BYTES_MAX],
            names: names.to_vec(),
            found: Vec::new(),
            n_others: 0,
        })
    }

    fn ask(&self) {
        let settings = config::get();
        let peers = PEERS.known(&settings.known_peers);
        let question = format!("session_id='{}'", settings.session_id);
        self.legs.iter().for_each(|leg| leg.ask(&question, &self.id, &peers));
    }

    /// Asks and listens for this long, or until the answers suffice.
    fn run(&mut self, wait: Duration, suffices: impl Fn(&[FoundStream]) -> bool) {
        let until = Instant::now() + wait;
        while Instant::now() < until {
            if Instant::now() >= self.next_wave {
                self.next_wave = Instant::now() + WAVE_INTERVAL;
                self.ask();
            }
            let before = self.found.len();
            if !self.listen() {
                std::thread::sleep(Duration::from_millis(5));
            }
            if self.found.len() > before && suffices(&self.found) {
                return;
            }
        }
    }

    /// Takes an answer from each socket; whether one came.
    fn listen(&mut self) -> bool {
        let mut has_come = false;
        for leg in &self.legs {
            let Ok((n, sender)) = leg.receiver.recv_from(&mut self.buffer) else { continue };
            has_come = true;
            let answer = parse_answer(self.buffer.get(..n).unwrap_or_default());
            let Some(answer) = answer.filter(|answer| answer.query_id == self.id) else { continue };
            let Ok(description) = StreamDescription::parse(&answer.xml) else { continue };
            let is_known = self.found.iter().any(|known| known.description.uid == description.uid);
            let found = FoundStream { description, machine: sender };
            if is_known || found.data_address().is_none() {
                continue;
            }
            let is_other = !self.names.is_empty() && !self.names.contains(&found.description.name);
            let n_wanted = self.found.len() - self.n_others;
            if is_other && self.n_others < OTHERS_MAX {
                self.n_others += 1;
                self.found.push(found);
            } else if !is_other && n_wanted < FOUND_MAX {
                self.found.push(found);
            }
        }
        has_come
    }
}

impl Leg {
    fn open(v6: bool) -> io::Result<Self> {
        let settings = config::get();
        let any: IpAddr =
            if v6 { Ipv6Addr::UNSPECIFIED.into() } else { Ipv4Addr::UNSPECIFIED.into() };
        let receiver = UdpSocket::bind((any, 0))?;
        receiver.set_nonblocking(true)?;
        let mut addresses = vec![any];
        if !v6 {
            addresses.extend(local_ipv4_addresses().into_iter().map(IpAddr::from));
        }
        let bound = addresses.into_iter().filter_map(|address| UdpSocket::bind((address, 0)).ok());
        let senders: Vec<UdpSocket> = bound.collect();
        for sender in &senders {
            // What the system refuses is a way that finds fewer streams.
            sender.set_nonblocking(true).ok();
            if !v6 {
                sender.set_broadcast(true).ok();
                sender.set_multicast_ttl_v4(settings.multicast_ttl.max(1)).ok();
            }
        }
        let parsed = settings.multicast_addresses.iter().filter_map(|text| text.parse().ok());
        let mut hosts: Vec<IpAddr> = parsed.filter(|ip: &IpAddr| ip.is_ipv6() == v6).collect();
        let mut groups: Vec<SocketAddr> =
            hosts.iter().map(|ip| SocketAddr::new(*ip, settings.multicast_port)).collect();
        if v6 {
            // The loopback interface has no group.
            hosts.push(Ipv6Addr::LOCALHOST.into());
        }
        let last = settings.base_port.saturating_add(settings.port_range.min(PORTS_MAX));
        let ports = settings.base_port..last;
        for port in ports.clone() {
            groups.extend(hosts.iter().map(|ip| SocketAddr::new(*ip, port)));
        }
        Ok(Self { receiver, senders, groups, ports })
    }

    fn ask(&self, question: &str, id: &str, peers: &[IpAddr]) {
        let Ok(own) = self.receiver.local_addr() else { return };
        let peers = peers.iter().filter(|ip| ip.is_ipv6() == own.is_ipv6());
        let at_ports = |ip: &IpAddr| {
            let ip = *ip;
            self.ports.clone().map(move |port| SocketAddr::new(ip, port))
        };
        let asked: Vec<SocketAddr> =
            self.groups.iter().copied().chain(peers.flat_map(at_ports)).collect();
        let datagram = build_query(question, own.port(), id);
        for sender in &self.senders {
            for to in &asked {
                // A group that no interface reaches, a peer that is off: others may answer.
                sender.send_to(&datagram, to).ok();
            }
        }
    }
}

/// Ports of a machine that are asked, at most, whatever a configuration says.
const PORTS_MAX: u16 = 256;

/// Machines that are looked up by their names, at most, whatever a configuration says: each may take a thread for a while.
const PEERS_MAX: usize = 64;

/// The machines that LSL's configuration names: all searches of this process share what is known.
static PEERS: LazyLock<PeerNames> = LazyLock::new(PeerNames::default);

/// Addresses of machines, by their names.
#[derive(Clone, Default)]
struct PeerNames(Arc<Mutex<BTreeMap<String, PeerName>>>);

#[derive(Default)]
struct PeerName {
    addresses: Vec<IpAddr>,
    /// Whether a thread looks it up.
    is_looked_up: bool,
}

impl PeerNames {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, PeerName>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks these machines up, and waits for a moment for the answers. The system's lookup cannot be cancelled: one that takes
    /// long goes on, and holds up none of the others.
    fn look_up(&self, names: &[String], resolve: fn(&str) -> Vec<IpAddr>) {
        let is_name = |name: &&String| name.parse::<IpAddr>().is_err();
        let mut started = Vec::new();
        for name in names.iter().filter(is_name).take(PEERS_MAX) {
            let peer = &mut self.lock();
            let peer = peer.entry(name.clone()).or_default();
            if std::mem::replace(&mut peer.is_looked_up, true) {
                continue;
            }
            let (peers, of) = (self.clone(), name.clone());
            let look_up = move || {
                let found = resolve(&of);
                let mut peers = peers.lock();
                let peer = peers.entry(of).or_default();
                peer.is_looked_up = false;
                if !found.is_empty() {
                    // A name server that is gone for a while does not hide the machine.
                    peer.addresses = found;
                }
            };
            match Builder::new().name("mocapd-resolve".to_owned()).spawn(look_up) {
                Ok(_) => started.push(name),
                Err(_) => peer.is_looked_up = false,
            }
        }
        let until = Instant::now() + RESOLVE_TIMEOUT;
        let is_open = |name: &&String| self.lock().get(*name).is_some_and(|peer| peer.is_looked_up);
        while started.iter().any(is_open) && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// The addresses that are known by now.
    fn known(&self, names: &[String]) -> Vec<IpAddr> {
        let peers = self.lock();
        let addresses = |name: &String| match name.parse() {
            Ok(ip) => vec![ip],
            Err(_) => peers.get(name).map(|peer| peer.addresses.clone()).unwrap_or_default(),
        };
        names.iter().flat_map(addresses).collect()
    }
}

fn resolve(name: &str) -> Vec<IpAddr> {
    let addresses = (name, 0).to_socket_addrs();
    addresses.map(|all| all.map(|address| address.ip()).collect()).unwrap_or_default()
}

/// Whether a call is to be repeated.
pub(super) fn is_retry(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// Time between two searches.
const INTERVAL: Duration = Duration::from_secs(1);

/// How long streams have to answer in each.
const ANSWERS: Duration = Duration::from_millis(500);

/// Time in which one has to be described and its feed to be open.
const OPEN_TIMEOUT: Duration = Duration::from_secs(3);

/// What became of a stream that was over.
#[derive(Debug)]
pub(super) enum Return {
    /// It is read again.
    Back {
        /// Its number.
        number: usize,
        /// What it states now; boxed, as is the feed, to keep the report small.
        found: Box<FoundStream>,
        /// Its open feed.
        feed: Box<Feed>,
    },
    /// It is back with another description, under which its samples must not be stored.
    Changed {
        /// Its number.
        number: usize,
    },
}

/// The thread, until it is dropped.
#[derive(Debug)]
pub(super) struct ReturnWatch {
    lost: SyncSender<(usize, StreamDescription)>,
    returns: Receiver<Return>,
}

impl ReturnWatch {
    /// Starts the thread; `None` if the system has none left.
    pub(super) fn start() -> Option<Self> {
        // Each stream is lost once before it returns.
        let (lost, to_find) = sync_channel(STREAMS_MAX);
        let (found, returns) = sync_channel(STREAMS_MAX);
        let watch = move || watch(&to_find, &found);
        Builder::new().name("mocapd-lsl".to_owned()).spawn(watch).ok()?;
        Some(Self { lost, returns })
    }

    /// Looks for a stream with this description.
    pub(super) fn look_for(&self, number: usize, description: StreamDescription) {
        // There is room for all of them.
        self.lost.try_send((number, description)).ok();
    }

    /// The next one that is back.
    pub(super) fn next_return(&self) -> Option<Return> {
        self.returns.try_recv().ok()
    }
}

fn watch(to_find: &Receiver<(usize, StreamDescription)>, found: &SyncSender<Return>) {
    let mut lost: Vec<(usize, StreamDescription)> = Vec::new();
    loop {
        let next = if lost.is_empty() {
            to_find.recv().map_err(|_| RecvTimeoutError::Disconnected)
        } else {
            to_find.recv_timeout(INTERVAL)
        };
        match next {
            Ok(stream) => lost.push(stream),
            Err(RecvTimeoutError::Timeout) => {}
            // The line is closed.
            Err(RecvTimeoutError::Disconnected) => return,
        }
        let names: Vec<String> = lost.iter().map(|(_, of)| of.name.clone()).collect();
        let all = named(&names, ANSWERS);
        lost.retain(|(number, of)| match attempt(*number, of, &all) {
            Some(report) => found.try_send(report).is_err(),
            None => true,
        });
    }
}

/// Opens a stream, if it is there and is the only one.
fn attempt(number: usize, lost: &StreamDescription, all: &[FoundStream]) -> Option<Return> {
    let is_same = |found: &&FoundStream| {
        let of = &found.description;
        (&of.name, &of.source_id, &of.kind, &of.hostname)
            == (&lost.name, &lost.source_id, &lost.kind, &lost.hostname)
    };
    let mut same = all.iter().filter(is_same);
    let (Some(found), None) = (same.next(), same.next()) else { return None };
    let (address, until) = (found.data_address()?, Instant::now() + OPEN_TIMEOUT);
    let now = StreamDescription::parse(&whole_description(address, until).ok()?).ok()?;
    if !now.is_recorded_as(lost) {
        return Some(Return::Changed { number });
    }
    let feed = Box::new(Feed::open(&now, address, until).ok()?);
    let found = Box::new(FoundStream { description: now, ..found.clone() });
    Some(Return::Back { number, found, feed })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    fn found(name: &str, kind: &str, source_id: &str) -> FoundStream {
        FoundStream {
            description: StreamDescription {
                name: name.to_owned(),
                kind: kind.to_owned(),
                source_id: source_id.to_owned(),
                uid: format!("{name}{kind}{source_id}"),
                hostname: "lab".to_owned(),
                n_channels: 1,
                data_ports: [16_572, 0],
                ..StreamDescription::default()
            },
            machine: "192.0.2.1:9".parse().unwrap(),
        }
    }

    fn query(uri: &str) -> StreamQuery {
        let (names, rest) = uri.split_once('?').unwrap_or((uri, ""));
        let parts: Vec<&str> = rest.split('&').filter(|part| !part.is_empty()).collect();
        StreamQuery::parse(names, &parts).unwrap()
    }

    #[test]
    fn streams_are_chosen_by_name_and_properties_in_the_order_of_the_query() {
        let all = [found("A", "EEG", "1"), found("B", "MoCap", "2"), found("A", "EEG", "3")];
        let names = |uri| {
            let chosen = choose(&query(uri), &all).unwrap();
            chosen.iter().map(|stream| stream.description.source_id.clone()).collect::<String>()
        };
        assert_eq!(names("B"), "2");
        assert_eq!(names("A?source_id=3"), "3");
        assert_eq!(names("?type=MoCap&hostname=lab"), "2");
        assert_eq!(all[0].data_address(), "192.0.2.1:16572".parse().ok());
        assert_eq!(all[0].service_address(), None);
        assert_eq!(all[1].uri_among(&all).as_deref(), Some("lsl:B"));
        assert_eq!(all[2].uri_among(&all).as_deref(), Some("lsl:A?source_id=3"));
        let twins = [
            found("A", "EEG", "1"),
            FoundStream { machine: "192.0.2.2:9".parse().unwrap(), ..found("A", "EEG", "1") },
        ];
        assert_eq!(twins[0].uri_among(&twins), None);
    }

    #[test]
    fn a_machine_that_is_not_found_hides_no_other_and_takes_one_thread() {
        static LOOKUPS: AtomicUsize = AtomicUsize::new(0);
        fn resolve(name: &str) -> Vec<IpAddr> {
            if name == "gone" {
                LOOKUPS.fetch_add(1, Ordering::Relaxed);
                std::thread::sleep(Duration::from_secs(3));
                return Vec::new();
            }
            vec![Ipv4Addr::new(192, 0, 2, 1).into()]
        }
        let peers = PeerNames::default();
        let names = ["gone", "192.0.2.9", "there"].map(str::to_owned);
        let began = Instant::now();
        for _ in 0..4 {
            peers.look_up(&names, resolve);
            let known: Vec<String> = peers.known(&names).iter().map(IpAddr::to_string).collect();
            assert_eq!(known, ["192.0.2.9", "192.0.2.1"]);
        }
        // The first search waits for it for a moment, and no other does.
        assert!(began.elapsed() < Duration::from_secs(2));
        assert_eq!(LOOKUPS.load(Ordering::Relaxed), 1);
    }

    #[test]
    fn errors_say_what_was_found_and_what_to_do() {
        let all = [found("A", "EEG", "1"), found("A", "EEG", "3")];
        let several = choose(&query("A"), &all).unwrap_err();
        assert!(
            several.contains("2 streams match") && several.contains("source_id '3'"),
            "{several}"
        );
        let other = choose(&query("B"), &all).unwrap_err();
        assert!(other.contains("no stream 'B'") && other.contains("'A' (EEG"), "{other}");
        let none = choose(&query("B"), &[]).unwrap_err();
        assert!(none.contains("KnownPeers") && none.contains("16571"), "{none}");
        let many: Vec<FoundStream> = (0..20).map(|n| found("A", "EEG", &n.to_string())).collect();
        assert!(choose(&query("A"), &many).unwrap_err().contains("and 12 more"));
    }
}
