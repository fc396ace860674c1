//! From the greeting to a driver that is ready, and every way in which this fails.

use mocapd_drivers::{
    device::Command,
    qtm::{PacketKind, put_packet, put_text},
};

use crate::pair::{Driver, LABELS, MS, Pair};

#[test]
fn a_qtm_identifies_itself() {
    let mut pair = Pair::new(None);
    pair.driver.command(Command::Stop);
    pair.driver.command(Command::Identify);
    pair.driver.command(Command::Ping { host_ns: 7 });
    pair.steps(30);
    let reported = &pair.driver.reported;
    let hello = reported.hello.as_ref().unwrap();
    assert_eq!((hello.model.as_str(), hello.serial.as_str()), ("QTM", ""));
    assert_eq!(hello.firmware, "2.3 (build 464), RT protocol 1.28");
    assert_eq!((hello.rate_millihertz, hello.tick_hz, hello.up_axis), (100_000, 1_000_000, 2));
    let labels: Vec<_> = reported.markers.iter().map(|marker| marker.label.as_str()).collect();
    assert_eq!(labels, LABELS);
    assert_eq!((reported.pongs, reported.started), (1, 0));
    assert_eq!(
        pair.driver.sent,
        [
            "Version 1.28",
            "QTMVersion",
            "ByteOrder",
            "GetState",
            "GetParameters General",
            "GetParameters 3D",
            "GetParameters 6D",
            "GetParameters Analog",
            "GetParameters Force"
        ]
    );
}

/// Replies to commands by a script: each line's first part is the start of a command.
fn answers(script: &[(&str, PacketKind, &str)]) -> Driver {
    let mut driver = Driver::new(None);
    driver.command(Command::Identify);
    let mut bytes = Vec::new();
    put_text(PacketKind::Command, "QTM RT Interface connected", &mut bytes);
    let mut n_answered = 0;
    for _ in 0..400 {
        driver.push(&std::mem::take(&mut bytes), false);
        driver.written();
        for command in &driver.sent[n_answered..] {
            let known = script.iter().find(|(name, _, _)| command.starts_with(name));
            if let Some((_, kind, text)) = known {
                put_text(*kind, text, &mut bytes);
            }
        }
        n_answered = driver.sent.len();
        driver.now_ns += 20 * MS;
    }
    driver
}

const GENERAL: &str = "<Q><General><Frequency>59.94</Frequency></General></Q>";
const MARKERS: &str = "<Q><The_3D><AxisUpwards>-Z</AxisUpwards><Labels>1</Labels>\
                       <Label><Name>m</Name></Label></The_3D></Q>";

#[test]
fn the_version_is_negotiated_downwards() {
    let error = |version: &'static str| (version, PacketKind::Error, "Version NOT supported");
    let driver = answers(&[
        error("Version 1.28"),
        error("Version 1.27"),
        // As a command response, which the documents do not rule out.
        ("Version 1.26", PacketKind::Command, "Version NOT supported"),
        ("Version 1.25", PacketKind::Command, "Version set to 1.25"),
        ("QTMVersion", PacketKind::Command, "QTM Version is 2023.1 (build 1)"),
        ("ByteOrder", PacketKind::Command, "Byte order is little endian"),
        ("GetState", PacketKind::Error, "no state yet"),
        ("GetParameters General", PacketKind::Xml, GENERAL),
        ("GetParameters 3D", PacketKind::Xml, MARKERS),
        ("GetParameters", PacketKind::Error, "Parameters not available"),
    ]);
    let hello = driver.reported.hello.unwrap();
    assert_eq!(hello.firmware, "2023.1 (build 1), RT protocol 1.25");
    assert_eq!((hello.rate_millihertz, hello.up_axis), (59_940, 0));
}

#[test]
fn old_and_silent_steps_are_survived() {
    // Version 1.8 has GetLastEvent, which is not answered before the first change; 6D is never answered.
    let driver = answers(&[
        ("Version 1.8", PacketKind::Command, "Version set to 1.8"),
        ("Version", PacketKind::Error, "Version NOT supported"),
        ("QTMVersion", PacketKind::Error, "Parse error"),
        ("ByteOrder", PacketKind::Command, "Byte order is little endian"),
        ("GetParameters General", PacketKind::Xml, GENERAL),
        ("GetParameters 3D", PacketKind::Xml, MARKERS),
        ("GetParameters", PacketKind::Error, "Parameters not available"),
    ]);
    assert!(driver.sent.contains(&"GetLastEvent".to_owned()));
    assert_eq!(driver.reported.hello.unwrap().firmware, "RT protocol 1.8");
}

#[test]
fn failures_say_what_to_do() {
    let good = [
        ("Version", PacketKind::Command, "Version set to 1.28"),
        ("QTMVersion", PacketKind::Command, "QTM Version is 1"),
        ("ByteOrder", PacketKind::Command, "Byte order is little endian"),
        ("GetState", PacketKind::Error, "none"),
        ("GetParameters General", PacketKind::Xml, GENERAL),
        ("GetParameters 3D", PacketKind::Xml, MARKERS),
    ];
    let unavailable = "Parameters not available";
    for (at, kind, text, facts) in [
        (0, PacketKind::Error, "Version NOT supported", ["1.8", "1.28"]),
        (2, PacketKind::Command, "Byte order is big endian", ["little-endian", "22223"]),
        (4, PacketKind::Error, unavailable, [unavailable, "measurement"]),
        (4, PacketKind::Xml, "<Q><General/></Q>", ["frame rate", "capture rate"]),
        (4, PacketKind::Xml, "<Q>", ["XML", "line 1"]),
        (5, PacketKind::Error, unavailable, [unavailable, "measurement"]),
        (5, PacketKind::Xml, "<Q/>", ["3D", "real-time"]),
        (5, PacketKind::Xml, "<Q><The_3D><Labels>2</Labels></The_3D></Q>", ["2 labels", "lists 0"]),
    ] {
        let mut script = good;
        script[at] = (script[at].0, kind, text);
        let driver = answers(&script);
        let failed = driver.failed.unwrap();
        assert!(failed.starts_with("qtm:lab: ") && !failed.contains('\n'), "{failed}");
        for fact in facts {
            assert!(failed.contains(fact), "{failed}: {fact}");
        }
        assert_eq!(driver.reported.hello, None);
    }
}

#[test]
fn a_port_that_is_not_qtms_is_named() {
    let mut refusal = Vec::new();
    put_text(PacketKind::Error, "Connection refused. Max number of clients reached.", &mut refusal);
    let mut http = b"HTTP/1.1 400 Bad Request\r\n\r\n".to_vec();
    http.resize(64, b' ');
    for (bytes, facts) in [
        (&[0, 0, 0, 35, 0, 0, 0, 1][..], ["other byte order", "22223"]),
        (b"QTM RT Interface connected\r\n", ["Telnet", "22223"]),
        (&http, ["plain text", "22223"]),
        (&[0xFF; 32], ["does not speak", "22223"]),
        (&refusal, ["Max number of clients reached", "close other clients"]),
    ] {
        let mut driver = Driver::new(None);
        driver.command(Command::Identify);
        driver.push(bytes, false);
        driver.written();
        let failed = driver.failed.unwrap();
        assert!(facts.iter().all(|fact| failed.contains(fact)), "{failed}");
    }
}

#[test]
fn silence_is_told_apart_by_where_it_begins() {
    let wait = |greets: bool| {
        let mut driver = Driver::new(None);
        driver.command(Command::Identify);
        let mut bytes = Vec::new();
        if greets {
            put_text(PacketKind::Command, "QTM RT Interface connected", &mut bytes);
        }
        driver.push(&bytes, false);
        // The recorder gives up after 5 s, with a message that knows less.
        while driver.failed.is_none() && driver.now_ns < 4_900 * MS {
            driver.now_ns += 20 * MS;
            driver.push(&[], false);
            driver.written();
        }
        driver.failed.unwrap()
    };
    let (no_greeting, no_reply) = (wait(false), wait(true));
    assert!(
        no_greeting.contains("nobody greets") && no_greeting.contains("22223"),
        "{no_greeting}"
    );
    assert!(no_reply.contains("does not answer"), "{no_reply}");
}

#[test]
fn a_reply_in_pieces_and_packets_that_nobody_asked_for_change_nothing() {
    let mut pair = Pair::new(None);
    pair.driver.command(Command::Identify);
    for _ in 0..30 {
        let to_server = pair.driver.written();
        pair.server.receive(pair.client, &to_server);
        let mut bytes = pair.server.pending(pair.client).to_vec();
        pair.server.sent(pair.client, bytes.len());
        put_packet(PacketKind::NoMoreData, &mut bytes, |_| {});
        put_packet(PacketKind::Data, &mut bytes, |out| out.extend_from_slice(&[0; 16]));
        put_packet(PacketKind::C3dFile, &mut bytes, |out| out.extend_from_slice(&[0; 99]));
        bytes.chunks(3).for_each(|bytes| pair.driver.push(bytes, false));
    }
    assert!(pair.driver.reported.hello.is_some());
    assert_eq!(pair.driver.failed, None);
}
