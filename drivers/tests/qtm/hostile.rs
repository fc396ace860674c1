//! Mutated packets in both directions: no panic, bounded memory, and back in step or a clear end.

use std::net::SocketAddr;

use mocapd_drivers::device::{Pose, PoseStatus};
use mocapd_drivers::qtm::{
    BodySettings, FrameHeader, PacketKind, QtmServer, ServedBody, ServedFrame, ServedSettings,
    SettingsRequest, WireMarker, put_text,
};
use mocapd_testkit::random::Random;

use crate::pair::{LABELS, MS, Pair, marker};

const N_MUTATIONS: u64 = 10_000;

/// A seed per mutation, so that a failure can be repeated.
const SEED: u64 = 0x7174_6D00;

/// Changes some bytes, or the length. `from` keeps what is in front of it.
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

/// A system with rigid bodies.
fn settings() -> ServedSettings {
    let body = |name: &str| BodySettings { name: name.to_owned(), ..BodySettings::default() };
    ServedSettings {
        frequency_hz: 100.0,
        up_axis: "+Y",
        labels: LABELS.map(str::to_owned).to_vec(),
        bodies: ["cup", "table"].map(body).to_vec(),
        ..ServedSettings::default()
    }
}

fn pair(datagram_port: Option<u16>) -> Pair {
    Pair::with(datagram_port, settings())
}

/// The packet of a frame, as a server sends it that has just been asked.
fn frame(number: u32) -> Vec<u8> {
    let mut server = server();
    let client = server.connect(SocketAddr::from(([127, 0, 0, 1], 1))).unwrap();
    let mut bytes = Vec::new();
    for command in ["Version 1.28", "GetCurrentFrame 3DRes 3DNoLabelsRes 6DRes"] {
        put_text(PacketKind::Command, command, &mut bytes);
    }
    server.receive(client, &bytes);
    server.take_pending(client);
    let labelled = [marker(number, 0); LABELS.len()];
    let unlabelled: Vec<WireMarker> = (0..5).map(|id| marker(number, id)).collect();
    let turned = [0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let body = ServedBody { position_mm: [1.0, 2.0, 3.0], matrix: turned, residual_mm: 0.5 };
    server.frame(&ServedFrame {
        header: FrameHeader { time_us: u64::from(number) * 10_000, number },
        rates: [0; 2],
        labelled: &labelled,
        unlabelled: &unlabelled,
        bodies: &[body, ServedBody::LOST],
        lacks_bodies: false,
    });
    server.take_pending(client)
}

fn packets() -> Vec<Vec<u8>> {
    let all = SettingsRequest { general: true, markers: true, bodies: true, ..Default::default() };
    let text = |kind, text: &str| {
        let mut bytes = Vec::new();
        put_text(kind, text, &mut bytes);
        bytes
    };
    vec![
        frame(1),
        text(PacketKind::Xml, &settings().to_xml(28, all).unwrap()),
        text(PacketKind::Xml, &settings().to_xml(20, all).unwrap()),
        text(PacketKind::Error, "Parse error"),
        text(PacketKind::Command, "Byte order is little endian"),
        vec![9, 0, 0, 0, 6, 0, 0, 0, 3],
        vec![8, 0, 0, 0, 4, 0, 0, 0],
    ]
}

/// The size is kept or corrected: a packet whose content is wrong does not cost the next one.
#[test]
fn the_driver_is_back_in_step_after_mutated_contents() {
    let packets = packets();
    for seed in 0..N_MUTATIONS {
        let mut random = Random::new(SEED + seed);
        let mut bytes = packets[random.below(packets.len())].clone();
        mutate(&mut bytes, 8, &mut random);
        let size = (bytes.len() as u32).to_le_bytes();
        bytes[..4].copy_from_slice(&size);
        let mut pair = pair((seed % 100 != 0).then_some(5000));
        pair.start();
        pair.driver.push(&bytes, seed % 2 == 0 && seed % 100 != 0);
        pair.driver.written();
        let is_over = pair.driver.lost.is_some() || pair.driver.failed.is_some();
        let before = pair.driver.reported.frames.len();
        pair.driver.push(&frame(7), false);
        // A mutated event may say that the settings changed, which nobody states: frames wait for a second.
        pair.driver.now_ns += 1_100 * MS;
        pair.driver.push(&[], false);
        let found = pair.driver.reported.frames.get(before..).unwrap();
        // A mutated event or error may end the stream; that is reported.
        let ended = is_over || pair.driver.reported.notes.iter().any(|n| n.contains("Stopped"));
        assert!(ended || found.iter().any(|f| f.1 == 70_000), "seed {seed}: {bytes:?}");
        let finite = |f: &(u32, u64, Vec<_>)| {
            f.2.iter().all(|s: &mocapd_drivers::device::MarkerSample| {
                s.occluded || s.position_mm.iter().all(|v| v.is_finite())
            })
        };
        assert!(pair.driver.reported.frames.iter().all(finite), "seed {seed}");
        let poses = pair.driver.reported.poses.iter().flat_map(|(.., poses)| poses);
        let tracked = poses.filter(|pose| pose.status == PoseStatus::Tracked);
        let is_same = |pose: &Pose| pose.checked().quaternion == pose.quaternion;
        assert!(tracked.clone().all(is_same), "seed {seed}");
    }
}

/// Any byte may be wrong: then the connection ends with its cause, or the packet is skipped.
#[test]
fn the_driver_survives_mutated_packets_in_any_pieces() {
    let packets = packets();
    for seed in 0..N_MUTATIONS {
        let mut random = Random::new(SEED ^ seed);
        let mut bytes = Vec::new();
        (0..3).for_each(|_| bytes.extend_from_slice(&packets[random.below(packets.len())]));
        mutate(&mut bytes, 0, &mut random);
        let mut pair = pair(None);
        if seed % 4 != 0 {
            pair.start();
        } else {
            pair.driver.command(mocapd_drivers::device::Command::Identify);
        }
        for piece in bytes.chunks(1 + random.below(64)) {
            pair.driver.push(piece, false);
        }
        pair.driver.written();
        // Either the connection ends with a cause, or a later frame is decoded: after as many bytes as a false size can
        // state, or the silence that it causes.
        let good = frame(9);
        let mut n_good = 0;
        let is_end = |pair: &Pair| {
            pair.driver.lost.is_some()
                || pair.driver.failed.is_some()
                || pair.driver.reported.ended.is_some()
        };
        while seed % 4 != 0 && seed % 16 == 1 && !is_end(&pair) && n_good < 50_000 {
            let before = pair.driver.reported.frames.len();
            pair.driver.push(&good, false);
            pair.driver.written();
            n_good += 1;
            if pair.driver.reported.frames.len() > before {
                break;
            }
            pair.driver.now_ns += MS;
        }
        assert!(n_good < 50_000, "seed {seed}");
    }
}

fn server() -> QtmServer {
    QtmServer::new(settings(), "1".to_owned())
}

#[test]
fn the_server_survives_mutated_commands() {
    let commands = [
        "Version 1.25",
        "QTMVersion",
        "ByteOrder",
        "GetState",
        "GetParameters All",
        "GetCurrentFrame 3D",
        "StreamFrames Frequency:30 UDP:2234 3D Analog",
        "StreamFrames AllFrames 3DRes 3DNoLabelsRes 6DRes",
        "GetCurrentFrame 6DEulerRes 6d",
        "StreamFrames Stop",
        "TakeControl x364k6Gt",
        "New",
        "Start RTFromFile",
        "Stop",
        "Close",
        "Trig",
    ];
    let address = |port| SocketAddr::from(([127, 0, 0, 1], port));
    for seed in 0..N_MUTATIONS {
        let mut random = Random::new(SEED.rotate_left(8) ^ seed);
        let mut server = server();
        let (hostile, other) =
            (server.connect(address(1)).unwrap(), server.connect(address(2)).unwrap());
        let mut bytes = Vec::new();
        for _ in 0..3 {
            put_text(PacketKind::Command, commands[random.below(commands.len())], &mut bytes);
        }
        mutate(&mut bytes, if seed % 2 == 0 { 8 } else { 0 }, &mut random);
        for piece in bytes.chunks(1 + random.below(16)) {
            server.receive(hostile, piece);
        }
        // Another client is served as before.
        server.take_pending(other);
        let mut good = Vec::new();
        put_text(PacketKind::Command, "Version 1.28", &mut good);
        put_text(PacketKind::Command, "QTMVersion", &mut good);
        server.receive(other, &good);
        let answer = server.take_pending(other);
        let text = String::from_utf8_lossy(&answer);
        assert!(
            text.contains("Version set to 1.28") && text.contains("QTM Version is 1"),
            "seed {seed}: {text}"
        );
        // One answer a command, some of them with settings.
        assert!(server.bytes_waiting(hostile) < 64 << 10, "seed {seed}");
    }
}

#[test]
fn a_client_that_does_not_read_costs_a_bounded_memory_and_only_its_own_frames() {
    let mut server = server();
    let clients =
        [1, 2].map(|port| server.connect(SocketAddr::from(([127, 0, 0, 1], port))).unwrap());
    let mut commands = Vec::new();
    put_text(PacketKind::Command, "Version 1.28", &mut commands);
    put_text(PacketKind::Command, "StreamFrames AllFrames 3DRes", &mut commands);
    for client in clients {
        server.receive(client, &commands);
    }
    let markers = [marker(1, 0); 1000];
    let mut read = 0;
    for number in 0..1000 {
        server.frame(&ServedFrame {
            header: FrameHeader { time_us: 0, number },
            rates: [0; 2],
            labelled: &markers,
            ..Default::default()
        });
        read += server.take_pending(clients[1]).len();
    }
    assert!(read > 16_000_000, "{read}");
    assert!(server.bytes_waiting(clients[0]) <= 4 << 20);
    // Another client's changes of state do not fill its memory: it is disconnected.
    let mut toggles = Vec::new();
    put_text(PacketKind::Command, "TakeControl", &mut toggles);
    for _ in 0..50 {
        put_text(PacketKind::Command, "New", &mut toggles);
        put_text(PacketKind::Command, "Close", &mut toggles);
    }
    let idle = server.connect(SocketAddr::from(([127, 0, 0, 1], 3))).unwrap();
    for _ in 0..5_000 {
        server.receive(clients[1], &toggles);
        server.take_pending(clients[1]);
        assert!(server.bytes_waiting(idle) <= (4 << 20) + 64);
    }
    assert!(server.is_out_of_step(idle));
    assert!(server.bytes_waiting(clients[0]) <= (4 << 20) + 64);
    // Its commands wait until it reads.
    let settings: Vec<u8> = {
        let mut bytes = Vec::new();
        put_text(PacketKind::Command, "GetParameters All", &mut bytes);
        bytes
    };
    while server.may_receive(clients[0]) {
        server.receive(clients[0], &settings);
        assert!(server.bytes_waiting(clients[0]) < (4 << 20) + (64 << 10));
    }
}
