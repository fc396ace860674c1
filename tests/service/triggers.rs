//! Triggers over UDP: a capture that another program starts is recorded here, and ours are told to others.

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
    let say = |bytes: &[u8]| peer.send_to(bytes, free).map(drop).unwrap();
    // Repeats, and a name that is a path.
    for _ in 0..3 {
        say(&datagram("CaptureStart", "../Trial 01", 7));
    }
    wait_until("the take", || engine.status().state == State::Recording);
    let name = engine.status().take.unwrap().name;
    assert!(name.contains("Trial 01") && !name.contains('/'), "{name}");
    std::thread::sleep(Duration::from_millis(300));
    say(&datagram("CaptureStop", "another", 8));
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(engine.status().state, State::Recording, "another take is meant");
    say(&datagram("CaptureStop", "../Trial 01", 9));
    wait_until("the end", || engine.status().state == State::Armed);
    let summary = read(&directory.path().join(format!("{name}.take")));
    let told: Vec<_> = summary.take.events.iter().map(|event| event.text.as_str()).collect();
    assert!(
        told.iter().any(|text| text.contains("left leg") && text.contains("/etc/passwd")),
        "{told:?}"
    );
    // The same capture again: its name is taken.
    let events = engine.events();
    say(&datagram("CaptureStart", "../Trial 01", 10));
    wait_until("the refusal", || {
        events
            .next(Duration::from_millis(10))
            .is_some_and(|event| event.kind == ServiceEventKind::Trigger)
    });
    assert_eq!(engine.status().state, State::Armed);
    // Ours.
    engine.start(&named("ours")).unwrap();
    let heard = || {
        let mut bytes = [0; 4096];
        let n = peer.recv(&mut bytes).unwrap();
        parse(&bytes[..n]).unwrap()
    };
    assert!(
        matches!(heard(), Trigger::Start(start) if start.name.as_ref().unwrap().text() == "ours")
    );
    // It comes back to us, as a broadcast does, and nothing happens.
    engine.stop(&Request::default()).unwrap();
    assert!(matches!(heard(), Trigger::Stop(stop) if stop.name.as_ref().unwrap().text() == "ours"));
    assert!(matches!(heard(), Trigger::Complete(_)));
    triggers.close();
}

/// Others know a take by the name that it was started with.
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
    // One that the peer started: it need not be told, whatever the file is called by now.
    peer.send_to(&datagram("CaptureStart", "theirs", 7), free).unwrap();
    wait_until("the take", || engine.status().take.is_some_and(|take| take.rows > 0));
    rename("theirs", "moved");
    wait_until("the start", || {
        events
            .next(Duration::from_millis(10))
            .is_some_and(|event| event.kind == ServiceEventKind::Trigger)
    });
    assert_eq!(engine.stop(&Request::default()).unwrap().name, "moved");
    // One of ours.
    engine.start(&named("ours")).unwrap();
    rename("ours", "elsewhere");
    assert_eq!(engine.stop(&Request::default()).unwrap().name, "elsewhere");
    assert_eq!(engine.status().last_take.unwrap().name, "elsewhere");
    let heard = || {
        let mut bytes = [0; 4096];
        let n = peer.recv(&mut bytes).unwrap();
        parse(&bytes[..n]).unwrap()
    };
    let is_ours = |name: &str| assert_eq!(name, "ours");
    match heard() {
        Trigger::Start(start) => is_ours(start.name.as_ref().unwrap().text()),
        other => panic!("{other:?}"),
    }
    match heard() {
        Trigger::Stop(stop) => is_ours(stop.name.as_ref().unwrap().text()),
        other => panic!("{other:?}"),
    }
    assert!(matches!(heard(), Trigger::Complete(_)));
    triggers.close();
}
