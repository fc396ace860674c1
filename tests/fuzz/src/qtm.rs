//! Arbitrary bytes as what a QTM sends, as what its clients send, and as its settings.

use std::net::{Ipv4Addr, SocketAddr};

use mocapd_drivers::{
    device::{Command, DeviceEvent, LinkCounters, Protocol},
    qtm::{LABELS_MAX, QtmHost, QtmServer, ServedSettings, Settings, SettingsRequest},
    transport::polled::{LineCommand, LineCommandReceiver, line_command_channel},
    uri::{Location, NetworkAddress},
};

use crate::Input;

/// Decodes the bytes at both ends, whole and in pieces, with equal results, and reads them as settings. The first byte
/// selects the state of the driver, and the pieces.
pub fn read_qtm(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let how = input.byte();
    let wire = input.take(usize::MAX);
    let piece = [wire.len().max(1), 1, 7, 64][usize::from(how >> 1 & 3)];
    let is_started = how & 1 == 1;
    let whole = host(wire, wire.len().max(1), is_started);
    assert_eq!(whole, host(wire, piece, is_started), "the pieces change what a host decodes");
    assert!(whole.1.bytes_skipped <= whole.1.bytes);
    datagrams(wire, how);
    assert_eq!(server(wire, wire.len().max(1)), server(wire, piece));
    settings(&String::from_utf8_lossy(wire));
}

fn served() -> ServedSettings {
    let labels = vec!["head".to_owned(), "hand".to_owned()];
    ServedSettings { frequency_hz: 100.0, up_axis: "+Z", labels, ..ServedSettings::default() }
}

/// The events of a host, and its counters. With `is_started` frames were requested of a server before.
fn host(wire: &[u8], piece: usize, is_started: bool) -> (Vec<String>, LinkCounters) {
    let (mut host, commands) = new_host(is_started, None);
    let mut events = Vec::new();
    // At last nothing, so that what waits for the line is sent.
    for bytes in wire.chunks(piece).chain([&[][..]]) {
        host.push(bytes, &mut |event| {
            events.push(match event {
                DeviceEvent::Frame(frame) => {
                    let seen = frame.markers.iter().filter(|marker| !marker.occluded);
                    let mut values = seen.flat_map(|marker| marker.position_mm);
                    assert!(values.all(f32::is_finite));
                    format!("frame {} {} {}", frame.seq, frame.device_ticks, frame.markers.len())
                }
                DeviceEvent::Markers(markers) => {
                    assert!(markers.len() <= LABELS_MAX);
                    format!("{} markers", markers.len())
                }
                DeviceEvent::Note(note) => {
                    assert!(!note.contains(char::is_control), "{note}");
                    note.to_owned()
                }
                other => format!("{other:?}"),
            });
        });
        while let Some(command) = commands.try_recv() {
            if let LineCommand::Fail(text) | LineCommand::Lost(text) = command {
                assert!(!text.contains(char::is_control), "{text}");
                events.push(text);
            }
        }
    }
    (events, host.counters())
}

/// A host that waits for its greeting, or that has requested frames.
fn new_host(is_started: bool, datagram_port: Option<u16>) -> (QtmHost, LineCommandReceiver) {
    let (sender, commands) = line_command_channel();
    let address = NetworkAddress::new("qtm", "lab", 22_223);
    let mut host = QtmHost::new(&Location::Network(address), sender, datagram_port);
    let mut out = Vec::new();
    host.command(Command::Identify, &mut out);
    if is_started {
        host.command(Command::Start { line_bytes_per_s: 0 }, &mut out);
        let mut server = QtmServer::new(served(), "1".to_owned());
        let client = server.connect(SocketAddr::from((Ipv4Addr::LOCALHOST, 1)));
        let client = client.expect("the first client");
        // Greeting, ten replies, and those to the request for frames.
        for _ in 0..16 {
            let bytes = server.take_pending(client);
            host.push(&bytes, &mut |_| {});
            while let Some(command) = commands.try_recv() {
                if let LineCommand::Write { request, .. } = command {
                    server.receive(client, request.as_bytes());
                }
            }
        }
    }
    (host, commands)
}

/// Datagrams, each of the length that its first byte states, in front of a flush of what waits.
fn datagrams(wire: &[u8], how: u8) {
    let (mut host, commands) = new_host(how & 1 == 1, Some(5000));
    let mut input = Input::new(wire);
    let mut now_ns = 0;
    while !input.is_empty() {
        let len = 8 * usize::from(input.byte());
        commands.set_datagram(len > 0);
        commands.set_now_ns(now_ns);
        let bytes = input.take(len);
        host.push(bytes, &mut |event| {
            if let DeviceEvent::Frame(frame) = event {
                let seen = frame.markers.iter().filter(|marker| !marker.occluded);
                assert!(seen.flat_map(|marker| marker.position_mm).all(f32::is_finite));
            }
        });
        while commands.try_recv().is_some() {}
        now_ns += 7_000_000;
    }
}

/// What a server replies.
fn server(wire: &[u8], piece: usize) -> Vec<u8> {
    let mut server = QtmServer::new(served(), "1".to_owned());
    let client = server.connect(SocketAddr::from((Ipv4Addr::LOCALHOST, 1)));
    let client = client.expect("the first client");
    let mut replies = Vec::new();
    for bytes in wire.chunks(piece) {
        server.receive(client, bytes);
        replies.extend_from_slice(&server.take_pending(client));
        server.take_datagrams();
    }
    replies
}

/// Labels that were read are written and read again unchanged.
fn settings(xml: &str) {
    let Ok(Settings { labels: Some(labels), .. }) = Settings::parse(xml) else { return };
    assert!(labels.len() <= LABELS_MAX);
    let request = SettingsRequest { markers: true, ..SettingsRequest::default() };
    let again = ServedSettings { labels: labels.clone(), ..served() }.to_xml(28, request);
    let again = again.unwrap_or_default();
    assert_eq!(Settings::parse(&again).map(|settings| settings.labels), Ok(Some(labels)));
}
