//! Triggers over UDP: captures of another program start takes, and takes are announced to other programs.

use std::{net::UdpSocket, sync::Arc, time::Duration};

use mocapd_service::{
    config::TriggerConfig,
    control::{Control, Request},
    status::{ServiceEventKind, State},
    trigger::{Trigger, parse},
    triggered::Triggers,
};

use super::engine::{Room, named, read, room, wait_until};

fn datagram(element: &str, name: &str, packet: u32) -> Vec<u8> {
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"no\" ?><{element}><Name VALUE=\"{name}\"/>\
         <Notes VALUE=\"left leg\"/><Description VALUE=\"\"/><DatabasePath VALUE=\"/etc/passwd\"/>\
         <Delay VALUE=\"0\"/><PacketID VALUE=\"{packet}\"/></{element}>"
    )
    .into_bytes()
}

#[test]
fn another_program_starts_and_stops_takes_and_gets_triggers_for_ours() {
    let Room { directory, device: _device, engine } = room(|options| options.arm.at_start = true);
    wait_until("the device", || engine.status().state == State::Armed);
    let peer = UdpSocket::bind("127.0.0.1:0").unwrap();
    peer.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let free = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let config = TriggerConfig {
        listen: Some(free),
        send_to: vec![peer.local_addr().unwrap()],
        allow_from: Vec::new(),
        delay_max: Duration::from_secs(5),
    };
    let engine: Arc<dyn Control> = Arc::new(engine);
    let triggers = Triggers::open(&config, "test", &engine).unwrap().unwrap();
    let send = |bytes: &[u8]| peer.send_to(bytes, free).map(drop).unwrap();
    // Repeated datagrams, and a name that is a path.
    for _ in 0..3 {
        send(&datagram("CaptureStart", "../Trial 01", 7));
    }
    wait_until("the take", || engine.status().state == State::Recording);
    let name = engine.status().take.unwrap().name;
    assert!(name.contains("Trial 01") && !name.contains('/'), "{name}");
    std::thread::sleep(Duration::from_millis(300));
    send(&datagram("CaptureStop", "another", 8));
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(engine.status().state, State::Recording, "a stop of another take is ignored");
    send(&datagram("CaptureStop", "../Trial 01", 9));
    wait_until("the end", || engine.status().state == State::Armed);
    let summary = read(&directory.path().join(format!("{name}.take")));
    let texts: Vec<_> = summary.take.events.iter().map(|event| event.text.as_str()).collect();
    assert!(
        texts.iter().any(|text| text.contains("left leg") && text.contains("/etc/passwd")),
        "{texts:?}"
    );
    // The same capture again: the name exists.
    let events = engine.events();
    send(&datagram("CaptureStart", "../Trial 01", 10));
    wait_until("the refusal", || {
        events
            .next(Duration::from_millis(10))
            .is_some_and(|event| event.kind == ServiceEventKind::Trigger)
    });
    assert_eq!(engine.status().state, State::Armed);
    // A take of our own is announced.
    engine.start(&named("ours")).unwrap();
    let receive = || {
        let mut bytes = [0; 4096];
        let n = peer.recv(&mut bytes).unwrap();
        parse(&bytes[..n]).unwrap()
    };
    assert!(
        matches!(receive(), Trigger::Start(start) if start.name.as_ref().unwrap().text() == "ours")
    );
    // The announcement comes back, as with a broadcast, and is ignored.
    engine.stop(&Request::default()).unwrap();
    assert!(
        matches!(receive(), Trigger::Stop(stop) if stop.name.as_ref().unwrap().text() == "ours")
    );
    assert!(matches!(receive(), Trigger::Complete(_)));
    triggers.close();
}

/// Other programs know a take by the name with which it was started.
#[test]
fn a_take_that_was_renamed_is_announced_under_its_first_name() {
    let Room { directory, device: _device, engine } = room(|options| options.arm.at_start = true);
    wait_until("the device", || engine.status().state == State::Armed);
    let peer = UdpSocket::bind("127.0.0.1:0").unwrap();
    peer.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let free = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let config = TriggerConfig {
        listen: Some(free),
        send_to: vec![peer.local_addr().unwrap()],
        allow_from: Vec::new(),
        delay_max: Duration::from_secs(5),
    };
    let engine: Arc<dyn Control> = Arc::new(engine);
    let events = engine.events();
    let triggers = Triggers::open(&config, "test", &engine).unwrap().unwrap();
    let rename = |from: &str, to: &str| {
        let path = |name: &str| directory.path().join(format!("{name}.take"));
        std::fs::rename(path(from), path(to)).unwrap();
    };
    // A take started by the peer is not announced, even if it was renamed.
    peer.send_to(&datagram("CaptureStart", "theirs", 7), free).unwrap();
    wait_until("the take", || engine.status().take.is_some_and(|take| take.rows > 0));
    rename("theirs", "moved");
    wait_until("the start", || {
        events
            .next(Duration::from_millis(10))
            .is_some_and(|event| event.kind == ServiceEventKind::Trigger)
    });
    assert_eq!(engine.stop(&Request::default()).unwrap().name, "moved");
    // A take of our own.
    engine.start(&named("ours")).unwrap();
    rename("ours", "elsewhere");
    assert_eq!(engine.stop(&Request::default()).unwrap().name, "elsewhere");
    assert_eq!(engine.status().last_take.unwrap().name, "elsewhere");
    let receive = || {
        let mut bytes = [0; 4096];
        let n = peer.recv(&mut bytes).unwrap();
        parse(&bytes[..n]).unwrap()
    };
    let is_ours = |name: &str| assert_eq!(name, "ours");
    match receive() {
        Trigger::Start(start) => is_ours(start.name.as_ref().unwrap().text()),
        other => panic!("{other:?}"),
    }
    match receive() {
        Trigger::Stop(stop) => is_ours(stop.name.as_ref().unwrap().text()),
        other => panic!("{other:?}"),
    }
    assert!(matches!(receive(), Trigger::Complete(_)));
    triggers.close();
}
