//! Real sockets on this machine.

use std::{
    net::{SocketAddr, UdpSocket},
    time::Instant,
};

use super::{
    socket::{ListenerThread, TakeQueries, TriggerSender, bind, listen},
    *,
};

/// Longer than anything here takes: a test that waits this long has failed.
const GIVE_UP: Duration = Duration::from_secs(20);

struct Service {
    at: SocketAddr,
    triggers: TriggerQueue,
    reports: crossbeam_channel::Receiver<String>,
    listening: ListenerThread,
}

/// Waits at most `timeout` for the next trigger that is due.
fn next(triggers: &TriggerQueue, timeout: Duration) -> Option<ReceivedTrigger> {
    let until = Instant::now() + timeout;
    loop {
        let due = triggers.take_due();
        let left = until.saturating_duration_since(Instant::now());
        if due.is_some() || left.is_zero() {
            return due;
        }
        let wait = triggers.due_in().unwrap_or(left).min(left);
        triggers.woken().recv_timeout(wait).ok();
    }
}

impl Service {
    fn start(mark: u64) -> Self {
        let socket = bind("127.0.0.1:0".parse().unwrap()).unwrap();
        let at = socket.local_addr().unwrap();
        let triggers = TriggerQueue::default();
        let (sender, reports) = crossbeam_channel::bounded(1000);
        let listener = Listener::new(Vec::new(), DELAY_MAX, mark);
        let report = move |message: &str| sender.send(message.to_owned()).unwrap();
        let queries =
            TakeQueries { exists: Box::new(|name| name == "old"), recording: Box::new(|| None) };
        let listening = listen(socket, listener, queries, triggers.clone(), report).unwrap();
        Self { at, triggers, reports, listening }
    }

    fn next(&self) -> ReceivedTrigger {
        next(&self.triggers, GIVE_UP).unwrap()
    }

    fn end(self) {
        drop(self.listening);
    }
}

#[test]
fn one_service_receives_the_triggers_of_another_and_ignores_its_own() {
    let (own, other) = (Service::start(7), Service::start(8));
    let sender = TriggerSender::new(vec![own.at, other.at]).unwrap();
    let mut announcer = Announcer::new("left", 7, 1);
    let name = TakeName::of("walk").unwrap();
    let sent = announcer.start(&name, "");
    for _ in 0..3 {
        assert_eq!(sender.send(&sent), [""; 0]);
    }
    assert_eq!(sender.send(&announcer.stop(&name, &StopResult::Success)), [""; 0]);
    assert!(matches!(other.next().trigger, Trigger::Start(_)));
    // The repeats are ignored, and the stop comes next.
    assert!(matches!(other.next().trigger, Trigger::Stop(_)));
    // Its own triggers were read before this one, and had no effect.
    assert_eq!(sender.send(b"<CaptureComplete/>"), [""; 0]);
    assert!(matches!(own.next().trigger, Trigger::Complete(_)));
    assert!(own.reports.is_empty() && other.reports.is_empty());
    own.end();
    other.end();
}

#[test]
fn refusals_are_reported_a_few_at_a_time() {
    let service = Service::start(7);
    let client = UdpSocket::bind("127.0.0.1:0").unwrap();
    for id in 0..50 {
        let old = start(&format!("<Name VALUE='old'/><PacketID VALUE='{id}'/>"));
        client.send_to(old.as_bytes(), service.at).unwrap();
    }
    client.send_to(packet(1000).as_bytes(), service.at).unwrap();
    service.next();
    let reports: Vec<String> = service.reports.try_iter().collect();
    assert_eq!(reports.len(), 5, "{reports:?}");
    let from = client.local_addr().unwrap();
    let taken = TriggerError::NameTaken("old".to_owned()).to_string();
    let first = &reports[0];
    assert!(first.contains(&from.to_string()) && first.contains(&taken), "{first}");
    service.end();
}

#[test]
fn triggers_that_do_not_fit_are_dropped_and_reported() {
    let service = Service::start(7);
    let client = UdpSocket::bind("127.0.0.1:0").unwrap();
    for id in 0..=DUE_EACH_MAX as u64 {
        client.send_to(packet(id).as_bytes(), service.at).unwrap();
    }
    let reports = service.reports.recv_timeout(GIVE_UP).unwrap();
    let sender = client.local_addr().unwrap().ip();
    let refusal = TriggerError::TooManyOfSender { waiting: DUE_EACH_MAX, sender };
    assert!(reports.contains(&refusal.to_string()), "{reports}");
    for _ in 0..DUE_EACH_MAX {
        service.next();
    }
    assert_eq!(next(&service.triggers, Duration::ZERO), None);
    service.end();
}

#[test]
fn a_port_in_use_is_reported() {
    let service = Service::start(7);
    let error = bind(service.at).unwrap_err().to_string();
    assert!(error.contains(&service.at.to_string()) && error.contains("`ss -ulpn`"), "{error}");
    let error = bind("192.0.2.1:0".parse().unwrap()).unwrap_err().to_string();
    assert!(error.contains("192.0.2.1:0") && error.contains("`ip address`"), "{error}");
    service.end();
}

#[test]
fn a_repeat_of_a_dropped_trigger_is_executed() {
    let service = Service::start(7);
    let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
    let numbered =
        |packet: u64| format!("<CaptureStart><PacketID VALUE='{packet}'/></CaptureStart>");
    // Without a number it is identified by its bytes.
    let unnumbered = "<CaptureStop RESULT='SUCCESS'/>".to_owned();
    for late in [numbered(100), unnumbered] {
        // The queue is not emptied, so it fills up and the next one is refused.
        for packet in 0..DUE_EACH_MAX as u64 {
            let packet = packet + 10 * late.len() as u64;
            sender.send_to(numbered(packet).as_bytes(), service.at).unwrap();
        }
        sender.send_to(late.as_bytes(), service.at).unwrap();
        service.reports.recv_timeout(GIVE_UP).unwrap();
        for _ in 0..DUE_EACH_MAX {
            service.next();
        }
        // The sender repeats it twice: one repeat is executed.
        for _ in 0..2 {
            sender.send_to(late.as_bytes(), service.at).unwrap();
        }
        let acted = next(&service.triggers, Duration::from_secs(5)).expect("the repeat acts");
        assert_eq!(acted.trigger, parse(late.as_bytes()).unwrap());
        assert_eq!(next(&service.triggers, Duration::from_millis(50)), None);
    }
    service.end();
}
