//! Arbitrary bytes as what a NatNet server sends, and as what its clients send.

use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};

use mocapd_drivers::{
    device::{Command, DeviceEvent, Protocol},
    natnet::{
        Bitstream, FrameOfData, FrameToSend, Message, Model, NatNetHost, NatNetServer,
        ServedStream, ServerInfo, ServerSettings,
    },
    transport::polled::{LineCommand, LineCommandReceiver, line_command_channel},
    uri::{Location, NetworkAddress},
};

use crate::Input;

const VERSIONS: [Bitstream; 6] = [
    Bitstream::new(2, 10),
    Bitstream::new(2, 11),
    Bitstream::new(3, 0),
    Bitstream::new(4, 0),
    Bitstream::new(4, 1),
    Bitstream::new(4, 2),
];

/// Most labels of a host, as its recorder allows.
const LABELS_MAX: usize = 4096;

/// Reads the bytes in every layout, and as datagrams to both ends. The first byte selects the version, and whether frames
/// were requested before; each datagram has the length that its first byte states.
pub fn read_natnet(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let how = input.byte();
    let wire = input.take(usize::MAX);
    for version in VERSIONS {
        read(wire, version);
    }
    let version = VERSIONS[usize::from(how >> 1) % VERSIONS.len()];
    host(wire, version, how & 1 == 1);
    server(wire, version);
}

/// What reads is in proportion to the bytes.
fn read(wire: &[u8], version: Bitstream) {
    if let Some(frame) = FrameOfData::read(wire, version) {
        let markers = frame.markers().count() + frame.other_positions_m().count();
        let bodies = frame.bodies().count() + frame.marker_sets().count();
        let samples: usize =
            frame.sampled().map(|data| data.channels().map(|c| c.count()).sum::<usize>()).sum();
        assert!(12 * markers + 5 * bodies + 4 * samples <= wire.len());
    }
    if let Ok(model) = Model::read(wire, version) {
        let names: usize = model.sets.iter().map(|set| 1 + set.markers.len()).sum();
        assert!(names + model.assets.len() + model.sampled.len() <= wire.len());
    }
    drop(ServerInfo::read(wire));
}

fn settings(bitstream: Bitstream) -> ServerSettings {
    ServerSettings {
        name: "Motive".to_owned(),
        app_version: [3, 1, 0, 0],
        bitstream,
        rate_hz: 100.0,
        samples_per_frame: 1,
        clock_hz: 10_000_000,
        stream: ServedStream::Multicast(SocketAddrV4::new(Ipv4Addr::new(239, 255, 42, 99), 1511)),
        model: Model::default(),
    }
}

/// A host that waits for its server's words, or that wants frames.
fn new_host(version: Bitstream, is_started: bool) -> (NatNetHost, LineCommandReceiver) {
    let (sender, commands) = line_command_channel();
    let address = NetworkAddress::new("natnet", "lab", 1510);
    let mut host = NatNetHost::new(&Location::Network(address), sender);
    let mut out = Vec::new();
    host.command(Command::Identify, &mut out);
    if is_started {
        host.command(Command::Start { line_bytes_per_s: 0 }, &mut out);
        let mut server = NatNetServer::new(settings(version));
        let client = SocketAddr::from((Ipv4Addr::LOCALHOST, 1));
        for step in 0..40 {
            while let Some(command) = commands.try_recv() {
                if let LineCommand::Write { request, .. } = command {
                    server.receive(client, request.as_bytes(), 0, 0);
                }
            }
            for datagram in server.take_datagrams() {
                host.push(&datagram.bytes, &mut |_| {});
            }
            commands.set_now_ns(step * 20_000_000);
            host.push(&[], &mut |_| {});
        }
    }
    (host, commands)
}

fn host(wire: &[u8], version: Bitstream, is_started: bool) {
    let (mut host, commands) = new_host(version, is_started);
    let mut input = Input::new(wire);
    let mut now_ns = 1_000_000_000;
    while !input.is_empty() {
        let len = 8 * usize::from(input.byte());
        commands.set_datagram(len > 0);
        commands.set_now_ns(now_ns);
        let bytes = input.take(len);
        host.push(bytes, &mut |event| match event {
            DeviceEvent::Frame(frame) => {
                let seen = frame.markers.iter().filter(|marker| !marker.occluded);
                assert!(seen.flat_map(|marker| marker.position_mm).all(f32::is_finite));
            }
            DeviceEvent::Markers(markers) => assert!(markers.len() <= LABELS_MAX),
            DeviceEvent::Note(note) => assert!(!note.contains(char::is_control), "{note}"),
            _ => {}
        });
        while let Some(command) = commands.try_recv() {
            if let LineCommand::Fail(text) | LineCommand::Lost(text) = command {
                assert!(!text.contains(char::is_control), "{text}");
            }
        }
        now_ns += 7_000_000;
    }
    assert!(host.counters().bytes_skipped <= host.counters().bytes);
}

/// At most one reply a datagram, each of them a message.
fn server(wire: &[u8], version: Bitstream) {
    let mut server = NatNetServer::new(settings(version));
    let client = SocketAddr::from((Ipv4Addr::LOCALHOST, 1));
    let mut input = Input::new(wire);
    while !input.is_empty() {
        let len = 8 * usize::from(input.byte());
        server.receive(client, input.take(len), 5, 0);
        let replies = server.take_datagrams();
        assert!(replies.len() <= 1);
        assert!(replies.iter().all(|reply| Message::of(&reply.bytes).is_some()));
    }
    server.frame(&FrameToSend::default(), 0);
    assert_eq!(server.take_datagrams().len(), 1);
    // By unicast, to a client that asked for it: its own socket, and the port of its machine.
    let stream = ServedStream::Unicast(1511);
    let mut server = NatNetServer::new(ServerSettings { stream, ..settings(version) });
    server.receive(client, wire, 5, 0);
    assert!(server.take_datagrams().len() <= 1);
    server.frame(&FrameToSend::default(), 0);
    assert!([0, 2].contains(&server.take_datagrams().len()));
}
