//! From a socket to a server that is ready.

use mocapd_drivers::{
    device::{Command, Protocol, SampleForm},
    natnet::{Bitstream, MessageKind, ServedStream, put_message, put_text},
    transport::DatagramSource,
};

use crate::{
    model::VERSIONS,
    pair::{Driver, GROUP, LABELS, MS, Pair, client, settings},
};

const MULTICAST: ServedStream = ServedStream::Multicast(GROUP);
const UNICAST: ServedStream = ServedStream::Unicast(1511);

#[test]
fn every_version_is_set_up_by_multicast_and_unicast() {
    for stream in [MULTICAST, UNICAST] {
        for version in VERSIONS {
            let mut pair = Pair::new(version, stream);
            pair.identify();
            let reported = &pair.driver.reported;
            let hello = reported.hello.as_ref().unwrap();
            assert_eq!((&*hello.model, hello.rate_millihertz), ("Motive", 100_000));
            assert_eq!(hello.firmware, format!("3.1, NatNet {version}"));

            assert_eq!((hello.tick_hz, hello.up_axis), (1_000_000_000, 0));
            let labels: Vec<_> = reported.markers.iter().map(|m| &*m.label).collect();
            assert_eq!(labels, LABELS);
            assert_eq!(reported.groups.len(), if version.has_ticks() { 2 } else { 0 }, "{version}");
            if let [plate, device] = &reported.groups[..] {
                assert_eq!(
                    (plate.id, plate.form, plate.rate_millihertz),
                    (0, SampleForm::Float32, 200_000)
                );
                let names: Vec<_> = plate.channels.iter().map(|c| &*c.name).collect();
                assert_eq!(names, ["AMTI:Fx", "AMTI:Fy", "AMTI:Fz"]);
                assert_eq!((&*device.channels[0].name, &*device.channels[0].unit), ("NI:ai0", "V"));
            }
        }
    }
}

#[test]
fn requests_and_replies_that_are_lost_are_repeated() {
    for losses in 1..4 {
        let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
        pair.loses = losses;
        pair.driver.command(Command::Identify);
        pair.steps(250);
        assert!(pair.driver.reported.hello.is_some(), "{losses}");
    }
}

#[test]
fn a_server_that_does_not_answer_is_explained() {
    let mut driver = Driver::new("natnet:lab");
    driver.command(Command::Identify);
    let mut sent = 0;
    while driver.failed.is_none() {
        driver.push(&[]);
        sent += driver.written().len();
        driver.now_ns += 20 * MS;
        assert!(driver.now_ns < 5_000 * MS);
    }
    let message = driver.failed.unwrap();
    assert!(sent >= 10, "{sent}");
    for part in
        ["natnet:lab: no NatNet server answers", "UDP port 1510", "Local Interface", "local="]
    {
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn versions_that_are_not_known_are_refused_with_their_name_or_asked_to_change() {
    for version in [Bitstream::new(2, 9), Bitstream::new(1, 0), Bitstream::new(5, 0)] {
        let mut pair = Pair::new(version, MULTICAST);
        pair.driver.command(Command::Identify);
        pair.steps(10);
        let message = pair.driver.failed.unwrap();
        assert!(message.contains(&format!("bitstream {version}")), "{message}");
        assert!(message.contains("2.10 to 4.2"), "{message}");
    }
    // A newer one that sends frames to this machine alone is asked for the newest known one.
    let newer = Bitstream::new(4, 4);
    let mut pair = Pair::new(newer, UNICAST);
    pair.start();
    for number in 0..3 {
        pair.frame(number, &[]);
    }
    assert_eq!(pair.driver.reported.frames.len(), 3);
    assert!(pair.driver.reported.hello.unwrap().firmware.ends_with("NatNet 4.2"));
    // By multicast it is read as far as it is known.
    let mut pair = Pair::new(newer, MULTICAST);
    pair.start();
    pair.frame(0, &[]);
    pair.step();
    assert_eq!(pair.driver.reported.frames.len(), 1);
    assert!(pair.driver.reported.has_note("bitstream 4.4"));
}

#[test]
fn frames_are_received_where_the_server_sends_them_or_the_user_says() {
    let source = |uri: &str, stream: ServedStream| {
        let mut pair = Pair::new(Bitstream::NEWEST, stream);
        pair.driver = Driver::new(uri);
        pair.start();
        (pair.driver.listens, pair.driver.reported.has_note("Transmission Type"))
    };
    let group = Some(DatagramSource { group: Some(*GROUP.ip()), port: 1511 });
    assert_eq!(source("natnet:lab", MULTICAST), (group, false));
    assert_eq!(source("natnet:lab?mode=multicast", MULTICAST), (group, false));
    assert_eq!(source("natnet:lab", UNICAST), (None, false));
    assert_eq!(source("natnet:lab?mode=unicast", MULTICAST), (None, true));
    assert_eq!(source("natnet:lab?mode=multicast", UNICAST), (group, true));
}

#[test]
fn frames_that_race_with_the_servers_words_are_no_frames_of_the_stream() {
    let mut pair = Pair::new(Bitstream::new(3, 1), UNICAST);
    pair.driver.command(Command::Identify);
    for number in 0..50 {
        pair.frame(number, &[]);
    }
    let labels: Vec<_> = pair.driver.reported.markers.iter().map(|m| &*m.label).collect();
    assert_eq!(labels, LABELS);
    pair.driver.command(Command::Start { line_bytes_per_s: 0 });
    for number in 50..60 {
        pair.frame(number, &[]);
    }
    let numbers: Vec<_> = pair.driver.reported.frames.iter().map(|frame| frame.0).collect();
    assert_eq!(numbers, ((60 - numbers.len() as u32)..60).collect::<Vec<_>>());
    assert!(numbers.len() >= 8 && pair.driver.counters().messages_damaged == 0);
}

#[test]
fn a_server_that_reads_one_form_of_the_request_to_connect_is_found() {
    for len in [4 + 5, 4 + 271] {
        let mut driver = Driver::new("natnet:lab");
        driver.command(Command::Identify);
        let reads =
            |request: &Vec<u8>| request[0] == MessageKind::Connect as u8 && request.len() == len;
        while !driver.written().iter().any(reads) {
            driver.push(&[]);
            driver.now_ns += 20 * MS;
            assert!(driver.now_ns < 600 * MS, "{len}");
        }
    }
}

#[test]
fn a_server_without_a_rate_is_explained() {
    let mut driver = Driver::new("natnet:lab");
    driver.command(Command::Identify);
    let mut server =
        mocapd_drivers::natnet::NatNetServer::new(settings(Bitstream::NEWEST, MULTICAST));
    while driver.failed.is_none() {
        for request in driver.written() {
            if request[0] == MessageKind::Connect as u8 {
                server.receive(client(), &request, 0, 0);
            }
        }
        for datagram in server.take_datagrams() {
            driver.push(&datagram.bytes);
        }
        let mut unrecognized = Vec::new();
        put_message(MessageKind::Unrecognized, &mut unrecognized, |_| {});
        driver.push(&unrecognized);
        let mut other = Vec::new();
        put_text(MessageKind::Response, "no number", &mut other);
        driver.push(&other);
        driver.now_ns += 20 * MS;
        assert!(driver.now_ns < 10_000 * MS);
    }
    assert!(driver.failed.unwrap().contains("does not state its frame rate"));
}

#[test]
fn the_rate_is_the_servers() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.identify();
    for (rate, is_set) in [(100_000, true), (120_000, false)] {
        let mut events = Vec::new();
        let mut out = Vec::new();
        pair.driver.host.command(Command::SetRate(rate), &mut out);
        pair.driver.host.push(&[], &mut |event| events.push(format!("{event:?}")));
        assert!(out.is_empty() && events[0].starts_with("RateSet") == is_set, "{events:?}");
    }
}
