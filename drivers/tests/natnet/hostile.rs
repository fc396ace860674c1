//! Mutated packets in both directions: no panic, and back in step.

use mocapd_drivers::natnet::{
    Bitstream, CLIENTS_MAX, DatagramContent, FrameOfData, HEADER_BYTES, Message, MessageKind,
    NatNetServer, ServedStream, ServerDatagram, ServerInfo, put_connect, put_echo, put_message,
    put_text,
};
use mocapd_testkit::random::Random;

use crate::{
    model::VERSIONS,
    pair::{GROUP, MS, Pair, client, frame_bytes, model, settings, time_ns},
};

const N_MUTATIONS: u64 = 10_000;

/// A seed per mutation, so that a failure can be repeated.
const SEED: u64 = 0x6E61_746E_6574;

const MULTICAST: ServedStream = ServedStream::Multicast(GROUP);

/// Changes some bytes, or the length.
fn mutate(bytes: &mut Vec<u8>, from: usize, random: &mut Random) {
    for _ in 0..1 + random.below(4) {
        let at = from + random.below(bytes.len().saturating_sub(from).max(1));
        match random.below(4) {
            0 => bytes.truncate(at.max(from)),
            1 => bytes.insert(at.min(bytes.len()), random.below(256) as u8),
            2 => {
                let value = [0, 1, 0x7FFF_FFFF, u32::MAX, 4 << 20][random.below(5)];
                for (k, byte) in value.to_le_bytes().into_iter().enumerate() {
                    if let Some(target) = bytes.get_mut(at + k) {
                        *target = byte;
                    }
                }
            }
            _ => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << random.below(8);
                }
            }
        }
    }
}

fn frame(number: u32, version: Bitstream) -> Vec<u8> {
    let mut server = NatNetServer::new(settings(version, MULTICAST));
    frame_bytes(number, &[50_007, 50_008], 0, &mut server);
    server.take_datagrams().remove(0).bytes
}

/// What a server sends.
fn packets(version: Bitstream) -> Vec<Vec<u8>> {
    let mut server = NatNetServer::new(settings(version, MULTICAST));
    let mut connect = Vec::new();
    put_text(MessageKind::Connect, "Ping", &mut connect);
    server.receive(client(), &connect, 0, 0);
    let mut packets = vec![server.take_datagrams().remove(0).bytes];
    let mut definitions = Vec::new();
    model().put(version, &mut definitions);
    let mut echo = Vec::new();
    put_echo(5, Some(6), &mut echo);
    let mut response = Vec::new();
    put_message(MessageKind::Response, &mut response, |out| out.extend(100_f32.to_le_bytes()));
    let mut text = Vec::new();
    put_text(MessageKind::Text, "hello", &mut text);
    packets.extend([frame(1, version), definitions, echo, response, text]);
    packets
}

/// A stream goes on behind a mutated datagram.
#[test]
fn the_driver_is_back_in_step_after_mutated_datagrams() {
    let (mut n_refused, mut n_lost) = (0, 0);
    for seed in 0..N_MUTATIONS {
        let mut random = Random::new(SEED + seed);
        let version = VERSIONS[random.below(VERSIONS.len())];
        let packets = packets(version);
        let mut bytes = packets[random.below(packets.len())].clone();
        mutate(&mut bytes, if seed % 2 == 0 { HEADER_BYTES } else { 0 }, &mut random);
        if seed % 2 == 0 {
            let size = (bytes.len() - HEADER_BYTES) as u16;
            bytes[2..4].copy_from_slice(&size.to_le_bytes());
        }
        let mut pair = Pair::new(version, MULTICAST);
        pair.driver.command(mocapd_drivers::device::Command::Identify);
        if seed % 3 == 0 {
            // During the bring-up, it costs a repetition.
            pair.step();
            pair.driver.push(&bytes);
        }
        pair.steps(60);
        if pair.driver.is_over() {
            n_refused += 1;
            continue;
        }
        pair.driver.command(mocapd_drivers::device::Command::Start { line_bytes_per_s: 0 });
        pair.steps(60);
        pair.driver.push(&bytes);
        pair.driver.now_ns += 300 * MS;
        pair.steps(2);
        if pair.driver.is_over() {
            // A forged version, or a change of the clock: that is reported.
            n_lost += 1;
            continue;
        }
        let before = pair.driver.reported.frames.len();
        pair.frame(900, &[50_007]);
        pair.driver.now_ns += 300 * MS;
        pair.steps(2);
        let found = pair.driver.reported.frames.get(before..).unwrap();
        let time = if version.has_ticks() { time_ns(900) } else { 9_000_000_000 };
        assert!(found.iter().any(|frame| frame.1 == time), "seed {seed}: {bytes:?}");
        let finite = |frame: &(u32, u64, Vec<mocapd_drivers::device::MarkerSample>)| {
            frame.2.iter().all(|s| s.occluded || s.position_mm.iter().all(|v| v.is_finite()))
        };
        assert!(pair.driver.reported.frames.iter().all(finite), "seed {seed}");
        assert!(pair.driver.reported.notes.len() < 70, "seed {seed}");
    }
    // Forged versions and rates: few of all mutations.
    assert!(n_refused < N_MUTATIONS / 20 && n_lost < N_MUTATIONS / 20, "{n_refused}, {n_lost}");
}

#[test]
fn the_server_survives_mutated_commands() {
    let text = |kind, text: &str| {
        let mut bytes = Vec::new();
        put_text(kind, text, &mut bytes);
        bytes
    };
    let empty = |kind| {
        let mut bytes = Vec::new();
        put_message(kind, &mut bytes, |_| {});
        bytes
    };
    let mut echo = Vec::new();
    put_echo(7, None, &mut echo);
    let commands = [
        text(MessageKind::Connect, "Ping"),
        empty(MessageKind::Connect),
        empty(MessageKind::RequestModel),
        empty(MessageKind::KeepAlive),
        empty(MessageKind::Disconnect),
        empty(MessageKind::Discovery),
        text(MessageKind::Request, "FrameRate"),
        text(MessageKind::Request, "Bitstream,3.1"),
        text(MessageKind::Request, "Bitstream"),
        text(MessageKind::Request, "AnalogSamplesPerMocapFrame"),
        echo,
    ];
    for seed in 0..N_MUTATIONS {
        let mut random = Random::new(SEED.rotate_left(8) ^ seed);
        let stream = if seed % 2 == 0 { MULTICAST } else { ServedStream::Unicast(1511) };
        let mut server = NatNetServer::new(settings(Bitstream::NEWEST, stream));
        for _ in 0..4 {
            let mut bytes = commands[random.below(commands.len())].clone();
            mutate(&mut bytes, if seed % 3 == 0 { 4 } else { 0 }, &mut random);
            if seed % 3 == 0 {
                let size = (bytes.len() - 4) as u16;
                bytes[2..4].copy_from_slice(&size.to_le_bytes());
            }
            server.receive(client(), &bytes, 0, 0);
        }
        // At most one reply a datagram.
        let replies = server.take_datagrams();
        assert!(replies.len() <= 4, "seed {seed}");
        server.receive(client(), &commands[0], 0, 0);
        server.receive(client(), &commands[6], 0, 0);
        let replies = server.take_datagrams();
        assert_eq!(replies.len(), 2);
        assert_eq!(replies[1].bytes[4..], 100_f32.to_le_bytes(), "seed {seed}");
    }
}

#[test]
fn clients_that_are_gone_or_too_many_cost_nothing() {
    let stream = ServedStream::Unicast(1511);
    let mut server = NatNetServer::new(settings(Bitstream::NEWEST, stream));
    let connect = connect(None);
    let at = |n: u16| std::net::SocketAddr::from(([10, 0, (n % 50) as u8, 1], 20_000 + n));
    let keep_alive = [10, 0, 0, 0];
    for n in 0..2000 {
        server.receive(at(n), &connect, 0, u64::from(n) * MS);
        server.receive(at(n), &keep_alive, 0, u64::from(n) * MS);
    }
    server.take_datagrams();
    frame_bytes(0, &[], 0, &mut server);
    let n = server.take_datagrams().len();
    assert_eq!(n, 2 * CLIENTS_MAX, "its own socket, and the port of its machine");
    assert_eq!(server.n_refused(), 2000 - CLIENTS_MAX as u64);
    server.receive(at(1), &keep_alive, 0, 9_000 * MS);
    // One that has been silent makes room.
    server.receive(at(1999), &connect, 0, 9_000 * MS);
    assert!(server.reports().iter().any(|report| report.address == at(1999)));
    let frame = mocapd_drivers::natnet::FrameToSend::default();
    assert_eq!(server.frame(&frame, 15_000 * MS), Some(4));
    // Those that kept their connections alive are gone, and the last one may be of those that never do.
    assert_eq!(server.frame(&frame, 30_000 * MS), Some(2));
    assert_eq!(server.frame(&frame, 610_000 * MS), Some(0));
    assert!(!server.has_listeners());
}

#[test]
fn a_flood_of_requests_is_not_answered() {
    let mut server = NatNetServer::new(settings(Bitstream::NEWEST, MULTICAST));
    let mut discovery = Vec::new();
    put_message(MessageKind::Discovery, &mut discovery, |_| {});
    let mut answered = |now_ns: u64| {
        (0..5000).for_each(|_| server.receive(client(), &discovery, 0, now_ns));
        server.take_datagrams().len()
    };
    assert_eq!([answered(0), answered(100 * MS), answered(2_000 * MS)], [200, 20, 200]);
}

/// A request to connect, as clients from the SDK of Motive 3 on send it where they want a version.
fn connect(version: Option<[u8; 4]>) -> Vec<u8> {
    let mut bytes = Vec::new();
    match version {
        None => put_text(MessageKind::Connect, "Ping", &mut bytes),
        Some([major, minor, ..]) => put_connect(Some(Bitstream::new(major, minor)), &mut bytes),
    }
    bytes
}

#[test]
fn each_client_has_its_version_and_its_machine_that_of_the_last() {
    let stream = ServedStream::Unicast(1511);
    let mut server = NatNetServer::new(settings(Bitstream::new(4, 1), stream)).limited_to(3);
    let at = |port| std::net::SocketAddr::from(([10, 0, 0, 1], port));
    server.receive(at(1), &connect(Some([0; 4])), 0, 0);
    server.receive(at(2), &connect(Some([3, 1, 0, 0])), 0, 0);
    // Readers take the layout from what the server states: that of their own frames.
    let stated = |datagram: &ServerDatagram| {
        ServerInfo::read(Message::of(&datagram.bytes).unwrap().body).unwrap().bitstream
    };
    let versions: Vec<_> = server.take_datagrams().iter().map(stated).collect();
    assert_eq!(versions, [Bitstream::new(4, 1), Bitstream::new(3, 1)]);
    server.receive(at(3), &connect(Some([5, 0, 0, 0])), 0, 0);
    server.receive(at(4), &connect(None), 0, 0);
    server.take_datagrams();
    assert_eq!(server.n_refused(), 1);
    let versions = |server: &NatNetServer| -> Vec<String> {
        server.reports().iter().map(|report| report.version.to_string()).collect()
    };
    assert_eq!(versions(&server), ["4.1", "3.1", "4.1"]);
    let mut request = Vec::new();
    put_text(MessageKind::Request, "Bitstream,3.0.0", &mut request);
    server.receive(at(3), &request, 0, 0);
    server.take_datagrams();
    assert_eq!(versions(&server), ["4.1", "3.1", "3.0"]);
    frame_bytes(7, &[50_007], 0, &mut server);
    let sent = server.take_datagrams();
    let found: Vec<_> =
        sent.iter().map(|datagram| (datagram.to.port(), datagram.content)).collect();
    let frames = [1, 2, 3].map(|port| (port, DatagramContent::Frame));
    assert_eq!(found, [&frames[..], &[(1511, DatagramContent::Copy)]].concat());
    let reads = |datagram: &ServerDatagram, version| {
        let body = Message::of(&datagram.bytes).unwrap().body;
        FrameOfData::read(body, version).is_some_and(|frame| frame.number == 7)
    };
    assert!(reads(&sent[0], Bitstream::new(4, 1)) && reads(&sent[1], Bitstream::new(3, 1)));
    assert!(reads(&sent[3], Bitstream::new(3, 0)), "the client that connected last");
    for (datagram, is_sent) in sent.iter().zip([true, false, true, true]) {
        server.datagram_sent(datagram, is_sent);
    }
    server.left_out(2);
    let counts: Vec<_> =
        server.reports().iter().map(|r| (r.frames_sent, r.frames_missed)).collect();
    assert_eq!(counts, [(1, 2), (0, 3), (1, 2)]);
    server.receive(at(2), &[9, 0, 0, 0], 0, 0);
    assert_eq!((server.frames_missed(), server.reports().len()), (7, 2));
    // Too large for a datagram: missed by all.
    let many = vec![mocapd_drivers::natnet::NatNetMarker::default(); 3000];
    let large = mocapd_drivers::natnet::FrameToSend { labelled: &many, ..Default::default() };
    assert_eq!(server.frame(&large, 0), None);
    assert_eq!(server.frames_missed(), 9);
}

/// Two servers must not answer each other for ever, and a forged request must not be answered with much more.
#[test]
fn words_of_servers_are_left_and_definitions_are_for_clients_and_few() {
    for stream in [MULTICAST, ServedStream::Unicast(1511)] {
        let mut server = NatNetServer::new(settings(Bitstream::NEWEST, stream));
        let other = client();
        for kind in MessageKind::ALL.iter().filter(|kind| kind.is_of_servers()) {
            let mut bytes = Vec::new();
            put_message(*kind, &mut bytes, |out| out.extend([0; 16]));
            server.receive(other, &bytes, 0, 0);
            assert_eq!(server.take_datagrams(), [], "{kind:?}");
        }
        let mut request = Vec::new();
        put_message(MessageKind::RequestModel, &mut request, |_| {});
        server.receive(other, &request, 0, 0);
        assert_eq!(server.take_datagrams(), [], "it has not connected");
        server.receive(other, &connect(None), 0, 0);
        server.take_datagrams();
        for _ in 0..100 {
            server.receive(other, &request, 0, 500 * MS);
        }
        assert_eq!(server.take_datagrams().len(), 10, "in a second");
        server.receive(other, &request, 0, 1500 * MS);
        assert_eq!(server.take_datagrams().len(), 1);
        // One that never kept its connection alive is waited for.
        server.forget_silent(590_000 * MS);
        server.receive(other, &request, 0, 590_000 * MS);
        assert_eq!(server.take_datagrams().len(), 1);
        let mut alive = Vec::new();
        put_message(MessageKind::KeepAlive, &mut alive, |_| {});
        server.receive(other, &alive, 0, 600_000 * MS);
        // What another server sends is no sign of life.
        server.receive(other, &[100, 0, 0, 0], 0, 608_000 * MS);
        server.forget_silent(611_000 * MS);
        server.receive(other, &request, 0, 611_000 * MS);
        assert_eq!(server.take_datagrams(), []);
        server.receive(other, &connect(None), 0, 620_000 * MS);
        server.take_datagrams();
        server.forget_silent(1_230_000 * MS);
        server.receive(other, &request, 0, 1_230_000 * MS);
        assert_eq!(server.take_datagrams(), [], "for ten minutes");
    }
}

#[test]
fn a_client_at_the_port_of_frames_gets_each_once() {
    let mut server = NatNetServer::new(settings(Bitstream::NEWEST, ServedStream::Unicast(1511)));
    for port in [1511, 2000] {
        let address = std::net::SocketAddr::from(([10, 0, 0, 1], port));
        server.receive(address, &connect(None), 0, 0);
    }
    server.take_datagrams();
    assert_eq!(server.frame(&mocapd_drivers::natnet::FrameToSend::default(), 0), Some(2));
}
