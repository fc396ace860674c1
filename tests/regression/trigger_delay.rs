//! A trigger with a delay blocked every later trigger, and announcements to others, for up to a minute.

use std::{
    collections::HashMap,
    net::{IpAddr, SocketAddr, UdpSocket},
    sync::Arc,
    time::{Duration, Instant},
};

use mocapd_service::{
    config::TriggerConfig,
    control::{Control, Start},
    trigger::{
        DELAYED_OTHERS_MAX, Incoming, Listener, Network, PendingTriggers, ReceivedTrigger, Trigger,
        TriggerError, parse,
    },
    triggered::Triggers,
};

use crate::service::fake::Fake;

const DELAY_MAX: Duration = Duration::from_secs(5);

/// Long enough for a loaded machine, and shorter than the delay that it must not wait for.
const AT_ONCE: Duration = Duration::from_secs(3);

fn datagram(element: &str, name: &str, delay_ms: u64, packet: u64) -> Vec<u8> {
    format!(
        "<{element}><Name VALUE=\"{name}\"/><Delay VALUE=\"{delay_ms}\"/><PacketID VALUE=\"{packet}\"/></{element}>"
    )
    .into_bytes()
}

/// The service's side in virtual time.
struct Desk {
    listener: Listener,
    waiting: PendingTriggers,
    refused: HashMap<&'static str, usize>,
    most_waiting: usize,
}

impl Desk {
    fn new(allow_from: &[&str]) -> Self {
        let networks = allow_from.iter().map(|text| text.parse::<Network>().unwrap()).collect();
        Self {
            listener: Listener::new(networks, DELAY_MAX, 7),
            waiting: PendingTriggers::default(),
            refused: HashMap::new(),
            most_waiting: 0,
        }
    }

    fn receive(&mut self, from: IpAddr, bytes: &[u8], now: Duration) {
        let heard = self.listener.receive(from, bytes, now, &|_| false);
        let accepted = heard.and_then(|heard| {
            let Incoming::Trigger(trigger) = heard else { panic!("{heard:?}") };
            let is_known = self.listener.is_known(from);
            let from = SocketAddr::new(from, 8989);
            self.waiting.push(ReceivedTrigger { from, trigger, is_known, recording: None }, now)
        });
        let Err(refusal) = accepted else { return };
        let why = match refusal {
            TriggerError::NotAllowed(_) => "not allowed",
            TriggerError::DelayTooLong { .. } => "too long",
            TriggerError::TooManyOfSender { .. } => "too many of one",
            TriggerError::TooMany(_) => "too many",
            other => panic!("{other}"),
        };
        *self.refused.entry(why).or_default() += 1;
    }
}

/// Two minutes: the known sender starts and stops a take every two seconds, while each of `hostile` senders sends a
/// datagram a second. Returns how late each stop was executed.
fn two_minutes(desk: &mut Desk, hostile: u8) -> Vec<Duration> {
    let known = IpAddr::from([192, 0, 2, 1]);
    let (mut late, mut sent) = (Vec::new(), HashMap::new());
    for ms in 0..120_000_u64 {
        let now = Duration::from_millis(ms);
        if ms % 1000 == 0 {
            for n in 0..hostile {
                let (element, delay_ms) = match ms / 1000 % 3 {
                    0 => ("CaptureStart", 60_000),
                    1 => ("CaptureStart", 5000),
                    _ => ("CaptureStop", 4000),
                };
                let bytes = datagram(element, "disturb", delay_ms, ms);
                desk.receive(IpAddr::from([198, 51, 100, n]), &bytes, now);
            }
        }
        match ms % 2000 {
            300 => desk.receive(known, &datagram("CaptureStart", "walk", 33, ms), now),
            1700 => {
                sent.insert(ms, now);
                desk.receive(known, &datagram("CaptureStop", "walk", 0, ms), now);
            }
            _ => {}
        }
        while let Some(due) = desk.waiting.take_due(now) {
            if let Trigger::Stop(stop) = &due.trigger
                && due.from.ip() == known
            {
                let sent = sent.remove(&stop.about.packet_id.unwrap()).unwrap();
                late.push(now - sent);
            }
        }
        desk.most_waiting = desk.most_waiting.max(desk.waiting.len());
    }
    assert!(sent.is_empty(), "stops that never came: {sent:?}");
    late
}

#[test]
fn every_stop_acts_at_once_despite_hostile_senders_in_virtual_time() {
    let alone = two_minutes(&mut Desk::new(&[]), 0);
    assert_eq!(alone, [Duration::ZERO; 60]);

    let mut desk = Desk::new(&["192.0.2.1"]);
    assert_eq!(two_minutes(&mut desk, 1), alone);
    assert_eq!(desk.refused, HashMap::from([("not allowed", 120)]));

    // Without an allow list every sender is accepted, with one place each.
    let mut desk = Desk::new(&[]);
    assert_eq!(two_minutes(&mut desk, 1), alone);
    assert_eq!((desk.refused["too long"], desk.refused.get("too many")), (40, None));
    assert!(desk.refused["too many of one"] > 40, "{:?}", desk.refused);
    assert!(desk.most_waiting <= 2, "{}", desk.most_waiting);

    let mut desk = Desk::new(&[]);
    assert_eq!(two_minutes(&mut desk, 20), alone);
    assert_eq!(desk.refused["too long"], 20 * 40);
    assert!(desk.refused["too many"] > 0, "{:?}", desk.refused);
    assert_eq!(desk.most_waiting, DELAYED_OTHERS_MAX);
}

/// Announces takes to `peer`, and listens for triggers at `at`.
struct Served {
    fake: Arc<Fake>,
    triggers: Option<Triggers>,
    peer: UdpSocket,
    at: SocketAddr,
    folder: tempfile::TempDir,
}

impl Served {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let fake = Fake::new(folder.path(), vec![0; 8]);
        let peer = UdpSocket::bind("127.0.0.1:0").unwrap();
        peer.set_read_timeout(Some(AT_ONCE)).unwrap();
        let at = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let config = TriggerConfig {
            listen: Some(at),
            send_to: vec![peer.local_addr().unwrap()],
            allow_from: Vec::new(),
            delay_max: DELAY_MAX,
        };
        let control: Arc<dyn Control> = fake.clone();
        let triggers = Triggers::open(&config, "test", &control).unwrap();
        Self { fake, triggers, peer, at, folder }
    }

    fn send(&self, element: &str, name: &str, delay_ms: u64, packet: u64) {
        self.peer.send_to(&datagram(element, name, delay_ms, packet), self.at).unwrap();
    }

    fn recording(&self) -> Option<String> {
        self.fake.status().take.map(|take| take.name)
    }

    /// Time until this take is being recorded, or none.
    fn until_recording(&self, wanted: Option<&str>) -> Duration {
        let began = Instant::now();
        while self.recording().as_deref() != wanted {
            assert!(began.elapsed() < AT_ONCE, "{:?} instead of {wanted:?}", self.recording());
            std::thread::sleep(Duration::from_millis(2));
        }
        began.elapsed()
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        if let Some(triggers) = self.triggers.take() {
            triggers.close();
        }
    }
}

#[test]
fn a_delayed_trigger_holds_up_neither_stops_nor_announcements() {
    let served = Served::start();
    served.send("CaptureStart", "later", 5000, 1);
    // The delayed trigger was received before this one.
    served.send("CaptureStart", "soon", 0, 2);
    served.until_recording(Some("soon"));
    served.send("CaptureStop", "soon", 0, 3);
    served.until_recording(None);
    // Announcements to others are sent at once, too.
    served.fake.start(&Start { name: Some("ours".to_owned()), ..Start::default() }).unwrap();
    let mut bytes = [0; 4096];
    let n = served.peer.recv(&mut bytes).unwrap();
    let announced = parse(&bytes[..n]).unwrap();
    assert_eq!(announced.capture().name.as_ref().unwrap().text(), "ours");
}

#[test]
fn a_delay_is_respected_a_longer_one_refused_and_a_stop_cancels_it() {
    let served = Served::start();
    let sent = Instant::now();
    served.send("CaptureStart", "refused", 5001, 1);
    served.send("CaptureStart", "delayed", 150, 2);
    served.until_recording(Some("delayed"));
    assert!(sent.elapsed() >= Duration::from_millis(150), "{:?}", sent.elapsed());
    served.send("CaptureStop", "delayed", 0, 3);
    served.until_recording(None);
    served.send("CaptureStart", "cancelled", 300, 4);
    served.send("CaptureStop", "cancelled", 0, 5);
    std::thread::sleep(Duration::from_millis(600));
    assert_eq!(served.recording(), None);
}

#[test]
fn an_early_stop_without_a_name_ends_a_take_only_for_its_own_sender() {
    const STOP: &[u8] = b"<CaptureStop><Delay VALUE=\"200\"/><PacketID VALUE=\"1\"/></CaptureStop>";
    let named_stop_ms = 800;
    let served = Served::start();
    // Nothing is being recorded yet.
    let stranger = UdpSocket::bind("127.0.0.2:0").unwrap();
    stranger.send_to(STOP, served.at).unwrap();
    let sent = Instant::now();
    served.send("CaptureStop", "walk", named_stop_ms, 2);
    served.send("CaptureStart", "walk", 0, 3);
    served.until_recording(Some("walk"));
    // It lasts until its own stop; an earlier stop from another sender does not end it.
    served.until_recording(None);
    assert!(sent.elapsed() >= Duration::from_millis(named_stop_ms), "{:?}", sent.elapsed());
    // The sender of the start may send its stop before the start is executed.
    served.peer.send_to(STOP, served.at).unwrap();
    served.send("CaptureStart", "own", 0, 4);
    let began = Instant::now();
    while !served.folder.path().join("own.take").exists() {
        assert!(began.elapsed() < AT_ONCE, "its sender's stop ends it");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn a_flood_of_triggers_without_effect_is_a_few_lines_in_the_log() {
    let served = Served::start();
    served.send("CaptureStart", "walk", 0, 1);
    served.until_recording(Some("walk"));
    for packet in 0..200 {
        served.send("CaptureStart", "other", 0, 2 + 3 * packet);
        served.send("CaptureStop", "another", 0, 3 + 3 * packet);
        served.send("CaptureComplete", "another", 0, 4 + 3 * packet);
        // No more at once than a socket's buffer holds.
        std::thread::sleep(Duration::from_millis(1));
    }
    // On a loaded machine earlier datagrams may still be queued, and the last of many from one sender may be refused.
    let began = Instant::now();
    for packet in 1000.. {
        if served.recording().is_none() {
            break;
        }
        assert!(began.elapsed() < AT_ONCE, "it is stopped");
        served.send("CaptureStop", "walk", 0, packet);
        std::thread::sleep(Duration::from_millis(50));
    }
    let told = served.fake.told.lock().unwrap();
    let of_nothing = told.iter().filter(|(_, words)| words.contains("other")).count();
    // The messages of the socket and of the worker: five each, and one more for each ten seconds of the test.
    assert!((1..=14).contains(&of_nothing), "{of_nothing}: {told:?}");
}
