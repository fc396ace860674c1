use labstream_core::proto::{
    discovery::{build_query, parse_answer as parse_found},
    feed::{FeedClient, FeedParams, State},
    timesync::{build_probe, parse_answer as parse_reply},
};

use super::*;
use crate::lsl::{Publisher, StreamDescription};

const PORT: u16 = 16_573;

fn peer() -> SocketAddr {
    ([127, 0, 0, 1], 9).into()
}

fn local() -> SocketAddr {
    ([127, 0, 0, 1], PORT).into()
}

fn publisher() -> Publisher<'static> {
    Publisher { name: "rig", source_id: "mocapd rig", program: "mocapd" }
}

fn server(inlets_max: usize) -> OutletServer {
    let mut server = OutletServer::new(16_572, inlets_max);
    let info = publisher().positions(&["a <&>\u{1}", "b"], 100.0);
    server.set_stream(PORT, Some(info), 5_000_000_000);
    server
}

/// Everything that is pending.
fn taken(server: &mut OutletServer, id: InletId) -> Vec<u8> {
    let mut all = Vec::new();
    while !server.pending(id).is_empty() {
        let part = server.pending(id).to_vec();
        server.sent(id, part.len());
        all.extend(part);
    }
    all
}

fn asked(server: &mut OutletServer, request: &str) -> String {
    let id = server.connect_at(peer(), local()).unwrap();
    // In pieces, as it may come.
    for byte in request.as_bytes() {
        assert!(server.may_receive(id) && !server.is_over(id));
        server.receive(id, &[*byte]);
    }
    let answer = String::from_utf8(taken(server, id)).unwrap();
    assert!(server.is_over(id));
    server.disconnect(id);
    answer
}

/// A reader that has shaken hands; and what came behind the handshake.
fn reader(server: &mut OutletServer, held: i32) -> InletId {
    let description = StreamDescription::parse(&asked(server, "LSL:fullinfo\r\n")).unwrap();
    let mut params = FeedParams::new(&description.uid, Format::Float32);
    params.max_buffer_length = held;
    let (mut client, request) = FeedClient::start(params, Format::Float32, description.n_channels);
    let id = server.connect_at(peer(), local()).unwrap();
    server.receive(id, &request);
    let bytes = taken(server, id);
    let used = client.on_headers(&bytes).unwrap();
    let rest = client.on_test_pattern(&bytes[used..]).unwrap();
    assert_eq!((client.state(), used + rest), (State::Streaming, bytes.len()));
    id
}

#[test]
fn a_stream_is_found_described_and_read() {
    let mut server = server(4);
    let query = build_query("type='MoCap' and starts-with(name,'ri')", 7, "42");
    let answers = server.answers(peer(), &query, || 1.0);
    let [(to, bytes)] = &answers[..] else { panic!("{answers:?}") };
    assert_eq!((to.port(), parse_found(bytes).unwrap().query_id.as_str()), (7, "42"));
    let deep = ["-".repeat(1000) + "1>2", "1+".repeat(500) + "1<0", "not(".repeat(16) + "1"];
    for other in deep {
        assert!(server.answers(peer(), &build_query(&other, 7, "1"), || 1.0).is_empty(), "{other}");
    }
    for other in [
        "name='other'",
        "name='rig'[1]",
        "//name",
        "count(*)",
        &"(".repeat(1000),
        &"(".repeat(4096),
    ] {
        assert!(server.answers(peer(), &build_query(other, 7, "1"), || 1.0).is_empty(), "{other}");
    }
    let replies = server.answers(peer(), &build_probe(3, 0.5), || 2.0);
    let reply = parse_reply(&replies[0].1).unwrap();
    assert_eq!((reply.wave_id, reply.t0, reply.t1, reply.t2), (3, 0.5, 2.0, 2.0));

    let description = StreamDescription::parse(&asked(&mut server, "LSL:fullinfo\r\n")).unwrap();
    assert_eq!(description.source_id, "mocapd rig");
    assert_eq!(description.data_ports[0], PORT);
    let channel = &description.channels[1];
    assert_eq!((&*channel.label, &*channel.marker), ("a <&>.y", "a <&>"));
    assert!(asked(&mut server, "LSL:shortinfo\r\nname='rig'\r\n").contains("<uid>"));
    assert_eq!(asked(&mut server, "LSL:shortinfo\r\nname='x'\r\n"), "");
    assert_eq!(asked(&mut server, "GET / HTTP/1.1\r\n"), "");
    assert!(asked(&mut server, "LSL:streamfeed/110 other\r\n\r\n").contains("404"));

    let id = reader(&mut server, 100);
    assert!(server.is_read(PORT));
    server.push(PORT, 6.0, &[1.0, 2.0, 3.0, f32::NAN, f32::NAN, 1e-42]);
    let bytes = taken(&mut server, id);
    assert_eq!(bytes.len(), 1 + 8 + 24);
    assert_eq!(bytes[..9], [&[2_u8][..], &6.0_f64.to_le_bytes()].concat());
    assert_eq!(bytes[29..], 1e-42_f32.to_le_bytes());
    assert_eq!(server.reports()[0].frames_sent, 1);
}

#[test]
fn one_that_does_not_read_misses_the_oldest_and_costs_bounded_memory() {
    let mut server = server(4);
    let (slow, quick) = (reader(&mut server, 3), reader(&mut server, 100_000_000));
    server.push(PORT, 1.0, &[1.0; 6]);
    server.sent(slow, 1);
    for number in 2..=10 {
        server.push(PORT, f64::from(number), &[number as f32; 6]);
    }
    let bytes = taken(&mut server, slow);
    let rest = &bytes[32..];
    assert_eq!(bytes.len(), 32 + 2 * 33, "the one that was begun, and the newest");
    assert_eq!(rest[1..9], 9.0_f64.to_le_bytes());
    assert_eq!(server.report(slow).unwrap().frames_missed, 7);
    // Whatever it asks for, 4 MiB wait at most.
    for _ in 0..200_000 {
        server.push(PORT, 1.0, &[1.0; 6]);
    }
    let report = server.report(quick).unwrap();
    assert!(report.frames_missed > 70_000, "{report:?}");
    let waiting = taken(&mut server, quick).len();
    assert!(waiting <= 4 << 20, "{waiting}");
    let missed = server.frames_missed();
    server.left_out(PORT, 2);
    server.disconnect(quick);
    assert_eq!(server.frames_missed(), missed + 4, "both, also the one that left");
}

#[test]
fn samples_are_counted_and_not_the_batches_in_which_they_come() {
    let mut server = server(4);
    let id = reader(&mut server, 10);
    // Batches of 4, 1 and 8 samples of 2 x 3 values: the first makes room for the last.
    for n in [4, 1, 8] {
        server.push(PORT, f64::from(n as u8), &vec![1.0; 6 * n]);
    }
    assert_eq!(server.report(id).unwrap().frames_missed, 1);
    let size = |n: usize| 25 * n + 8;
    assert_eq!(taken(&mut server, id).len(), size(1) + size(8));
    // One of more than may wait does so alone.
    server.push(PORT, 1.0, &[1.0; 6 * 20]);
    assert_eq!(taken(&mut server, id).len(), size(20));
    // What waits for one that leaves is missed: the rest of a begun batch, too.
    for _ in 0..3 {
        server.push(PORT, 1.0, &[1.0; 6 * 2]);
    }
    server.sent(id, 1);
    server.disconnect(id);
    assert_eq!(server.frames_missed(), 1 + 3);
}

#[test]
fn a_flood_of_questions_is_not_answered() {
    let mut server = server(4);
    let query = build_query("name='rig'", 7, "1");
    let mut answered = 0;
    for _ in 0..1000 {
        answered += server.answers(peer(), &query, || 1.0).len();
    }
    assert_eq!(answered, 50);
    let other = ([10, 0, 0, 1], 9).into();
    assert_eq!(server.answers(other, &query, || 1.0).len(), 1);
    server.set_now(6_500_000_000);
    assert_eq!(server.answers(peer(), &query, || 1.0).len(), 1);
}

#[test]
fn another_stream_in_its_place_ends_the_readers_of_the_one_before() {
    let mut server = server(1);
    let id = reader(&mut server, 100);
    server.push(PORT, 1.0, &[1.0; 6]);
    server.set_stream(PORT, Some(publisher().events()), 6_000_000_000);
    server.push_text(PORT, 2.0, "for nobody");
    assert!(server.is_over(id) && !server.is_read(PORT));
    assert_eq!(taken(&mut server, id).len(), 33, "what waited for it");
    server.disconnect(id);
    // One that does not take it is given up.
    server.set_stream(PORT, Some(publisher().positions(&["a", "b"], 100.0)), 6_000_000_000);
    let stuck = reader(&mut server, 100);
    server.push(PORT, 1.0, &[1.0; 6]);
    server.set_stream(PORT, Some(publisher().events()), 6_000_000_000);
    server.set_now(17_000_000_000);
    assert!(server.is_over(stuck) && server.pending(stuck).is_empty());
    server.disconnect(stuck);
    assert_eq!(server.frames_missed(), 1);
    server.set_stream(PORT, None, 7_000_000_000);
    assert_eq!(server.names().count(), 0);
    let id = server.connect_at(peer(), local()).unwrap();
    server.receive(id, b"LSL");
    assert!(server.is_over(id));
}

#[test]
fn too_many_silent_and_hostile_connections_are_given_up() {
    let mut server = server(1);
    reader(&mut server, 10);
    let uid = StreamDescription::parse(&asked(&mut server, "LSL:fullinfo\r\n")).unwrap().uid;
    let refused = asked(&mut server, &format!("LSL:streamfeed/110 {uid}\r\n\r\n"));
    assert!(refused.contains("503"), "{refused}");
    assert_eq!(server.n_refused(), 1);
    let endless = server.connect_at(peer(), local()).unwrap();
    for _ in 0..10 {
        server.receive(endless, &[b'x'; 4096]);
    }
    assert!(server.is_over(endless));
    server.disconnect(endless);
    let silent: Vec<_> = (0..64).filter_map(|_| server.connect_at(peer(), local()).ok()).collect();
    assert_eq!(silent.len(), ASKING_MAX);
    server.receive(silent[0], b"LSL:fullinfo\r\n");
    server.set_now(16_000_000_000);
    assert!(silent.iter().all(|id| server.is_over(*id)));
    // The one that does not take its description has ten more seconds.
    assert!(server.pending(silent[0]).is_empty());
}

#[test]
fn mutated_requests_and_datagrams_are_answered_or_left() {
    let request = b"LSL:streamfeed/110 \r\nNative-Byte-Order: 4321\r\nEndian-Performance: 1\r\nMax-Buffer-Length: 5\r\nValue-Size: 4\r\n\
                    Protocol-Version: 110\r\n\r\n";
    let query = build_query("session_id='default' and name='rig'", 7, "42");
    let mut random = mocapd_testkit::random::Random::new(0x6C73_6C6F_7574);
    for seed in 0..5000 {
        let mut server = server(2);
        for original in [&request[..], &query] {
            let mut bytes = original.to_vec();
            for _ in 0..1 + random.below(4) {
                let at = random.below(bytes.len());
                bytes[at] = random.below(256) as u8;
            }
            let id = server.connect_at(peer(), local()).unwrap();
            server.receive(id, &bytes);
            server.push(PORT, 1.0, &[1.0; 6]);
            assert!(taken(&mut server, id).len() < 4096, "seed {seed}");
            assert!(server.answers(peer(), &bytes, || 1.0).len() <= 1, "seed {seed}");
        }
    }
}
