//! Streams: frames, samples, poses, definitions that change, and a server that is gone.

use mocapd_drivers::{
    device::{Command, MarkerSample, Pong, PoseStatus},
    natnet::{
        Asset, AssetKind, Bitstream, FrameEnd, FrameToSend, MODELS_CHANGED, MessageKind, Model,
        ServedStream, WireBody, put_message, put_text,
    },
    transport::DatagramSource,
};

use crate::{
    model::VERSIONS,
    pair::{
        CLOCK_HZ, GROUP, MS, Pair, Reported, client, frame_bytes, model, position_m, ticks, time_ns,
    },
};

const MULTICAST: ServedStream = ServedStream::Multicast(GROUP);
const UNICAST: ServedStream = ServedStream::Unicast(1511);

fn in_mm(position_m: [f32; 3]) -> [f32; 3] {
    position_m.map(|metres| (f64::from(metres) * 1000.0) as f32)
}

fn sample<'a>(reported: &'a Reported, frame: usize, label: &str) -> &'a MarkerSample {
    let id = reported.markers.iter().find(|marker| marker.label == label).unwrap().id;
    reported.frames[frame].2.iter().find(|sample| sample.id == id).unwrap()
}

#[test]
fn frames_of_every_version_have_their_markers_times_and_samples() {
    for stream in [MULTICAST, UNICAST] {
        for version in VERSIONS {
            let mut pair = Pair::new(version, stream);
            pair.start();
            for number in 0..10 {
                pair.frame(number, &[50_007]);
            }
            let reported = &pair.driver.reported;
            assert_eq!(reported.frames.len(), 10, "{version} {stream:?}");
            for (index, (seq, time, samples)) in reported.frames.iter().enumerate() {
                let number = index as u32;
                let expected =
                    if version.has_ticks() { time_ns(number) } else { index as u64 * 10_000_000 };
                assert_eq!((*seq, *time, samples.len()), (number, expected, 5));
                let head = sample(reported, index, "Anna:head");
                let residual = if version.has_ticks() { 250 } else { 0 };
                assert_eq!(head.position_mm, in_mm(position_m(number, 0)));
                assert_eq!((head.residual_10um, head.occluded), (residual, false));
                assert_eq!(sample(reported, index, "Anna:hand").occluded, number % 5 == 3);
                assert_eq!(
                    sample(reported, index, "right").position_mm,
                    in_mm(position_m(number, 3))
                );
                let place = in_mm(position_m(number, 50_007));
                assert!(
                    samples
                        .iter()
                        .any(|s| reported.label(s.id).is_none() && s.position_mm == place)
                );
            }
            let n_groups = if version.has_ticks() { 2 } else { 0 };
            assert_eq!(reported.batches.len(), 10 * n_groups);
            if n_groups > 0 {
                let (group, number, first, values) = &reported.batches[2 * 4];
                assert_eq!((*group, number % 256, first % 512), (0, 4, 8));
                assert_eq!(values, &[4.0, -4.0, 9.0, 4.5, -4.5, 9.5], "samples one after another");
            }
            pair.driver.command(Command::Stop);
            pair.step();
            let status = pair.driver.reported.ended.unwrap();
            assert_eq!((status.frames_produced, status.frames_dropped), (10, 0));
            assert_eq!(pair.driver.listens, None);
        }
    }
}

/// Motive was paused at the start: no frame, and 0 samples stated.
#[test]
fn samples_that_no_frame_announced_are_noted_and_announced_anew() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.server.set_rates(100.0, 0);
    pair.start();
    let reported = &pair.driver.reported;
    assert!(reported.has_note("how many samples 2 force plates or devices have in a frame"));
    let rates = |reported: &Reported| -> Vec<u32> {
        reported.groups.iter().map(|group| group.rate_millihertz).collect()
    };
    assert_eq!(rates(reported), [100_000; 2]);
    for number in 0..10 {
        pair.frame(number, &[]);
    }
    let reported = &pair.driver.reported;
    // The recorder counts what comes after it as lost.
    assert_eq!(rates(reported), [100_000, 100_000, 200_000, 200_000]);
    assert_eq!(reported.groups[2].channels, reported.groups[0].channels);
    let firsts: Vec<_> = reported.batches.iter().map(|batch| (batch.0, batch.2 % 512)).collect();
    let expected: Vec<_> = (1..10).flat_map(|number| [(0, 2 * number), (1, 2 * number)]).collect();
    assert_eq!(firsts, expected);
    for note in ["'AMTI' has 2 samples of 3 channels in a frame, not 1 of 3", "'NI' has 2 samples"]
    {
        let found = reported.notes.iter().filter(|text| text.contains(note));
        assert_eq!(found.count(), 1, "{note}: {:?}", reported.notes);
    }
}

#[test]
fn devices_with_more_samples_than_there_is_memory_for_are_left_out() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.server.set_rates(2_000.0, 1_000);
    pair.start();
    // Three channels, and one.
    let reported = &pair.driver.reported;
    let groups: Vec<_> = reported.groups.iter().map(|group| &*group.channels[0].name).collect();
    assert_eq!(groups, ["NI:ai0"]);
    assert!(reported.has_note("1 force plates or devices are left out"), "{:?}", reported.notes);
}

/// Before 3.0 plates are not described; frames tell their channels.
#[test]
fn a_plate_without_a_description_has_numbers_for_names() {
    let mut pair = Pair::new(Bitstream::OLDEST, UNICAST);
    pair.driver.command(Command::Identify);
    for number in 0..20 {
        pair.frame(number, &[]);
    }
    let group = &pair.driver.reported.groups[0];
    assert_eq!((group.channels.len(), group.rate_millihertz), (3, 200_000));
    assert_eq!(group.channels[2].name, "plate 1:channel 3");
}

#[test]
fn lost_frames_leave_gaps_and_late_ones_and_duplicates_move_nothing() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.start();
    for number in [0, 1, 4, 5, 5, 3, 6] {
        pair.frame(number, &[]);
        pair.step();
    }
    let numbers: Vec<_> = pair.driver.reported.frames.iter().map(|frame| frame.0).collect();
    assert_eq!(numbers, [0, 1, 4, 5, 5, 3, 6]);
    let firsts: Vec<_> =
        pair.driver.reported.batches.iter().step_by(2).map(|b| b.2 % 512).collect();
    assert_eq!(firsts, [0, 2, 8, 10, 10, 6, 12]);
    pair.driver.command(Command::Stop);
    pair.step();
    assert_eq!(pair.driver.reported.ended.unwrap().frames_produced, 7);
}

#[test]
fn a_number_that_jumps_is_no_loss() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.start();
    // Forth, back, and a frame that is missing.
    for (number, stated) in [(0, 7_u32), (1, 50_000_008), (2, 9), (4, 11)] {
        frame_bytes(number, &[], 0, &mut pair.server);
        let mut datagram = pair.server.take_datagrams().remove(0);
        datagram.bytes[4..8].copy_from_slice(&stated.to_le_bytes());
        pair.driver.push(&datagram.bytes);
        pair.steps(2);
    }
    pair.driver.command(Command::Stop);
    pair.step();
    assert_eq!(pair.driver.reported.frames.len(), 4);
    assert_eq!(pair.driver.reported.ended.unwrap().frames_produced, 5);
}

#[test]
fn a_number_that_stands_still_is_counted_by_the_servers_clock() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.start();
    for number in [0, 1, 2, 5] {
        frame_bytes(number, &[], 0, &mut pair.server);
        let mut datagram = pair.server.take_datagrams().remove(0);
        // The number behind the header.
        datagram.bytes[4..8].copy_from_slice(&77_u32.to_le_bytes());
        pair.driver.push(&datagram.bytes);
        pair.steps(2);
    }
    let numbers: Vec<_> = pair.driver.reported.frames.iter().map(|frame| frame.0).collect();
    assert_eq!(numbers, [77, 78, 79, 82]);
}

#[test]
fn rigid_bodies_have_poses() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    let mut with_body = model();
    let (kind, name) = (AssetKind::RigidBody, "wand".to_owned());
    with_body.assets.push(Asset { kind, id: 300, name, markers: Vec::new() });
    pair.server.set_model(with_body);
    pair.start();
    let bodies: Vec<_> = pair.driver.reported.bodies.iter().map(|b| (b.id, &*b.name)).collect();
    assert_eq!(bodies, [(0, "wand")]);
    let body = WireBody {
        id: 300,
        position_m: [0.1, 1.7, -0.3],
        quaternion_xyzw: [0.0, 0.6, 0.0, 0.8],
        error_m: 0.000_5,
        is_tracked: true,
    };
    let stranger = WireBody { id: 301, ..body };
    for (number, is_tracked) in [(0, true), (1, false), (2, true)] {
        let bodies = [WireBody { is_tracked, ..body }, stranger];
        let end = FrameEnd { ticks: [ticks(number); 3], ..FrameEnd::default() };
        let frame = FrameToSend { number, bodies: &bodies, end, ..FrameToSend::default() };
        pair.server.frame(&frame, 0).unwrap();
        pair.steps(2);
    }
    pair.driver.command(Command::Stop);
    pair.step();
    let poses = &pair.driver.reported.poses;
    assert_eq!(
        poses.iter().map(|(seq, found)| (*seq, found.len())).collect::<Vec<_>>(),
        [(0, 1), (1, 1), (2, 1)]
    );
    assert_eq!(pair.driver.reported.end_of_poses, Some(3));
    let pose = poses[2].1[0];
    assert_eq!((pose.body, pose.status), (0, PoseStatus::Tracked));
    assert_eq!((pose.position_mm, pose.quaternion), (in_mm(body.position_m), [0.8, 0.0, 0.6, 0.0]));
    assert_eq!(pose.residual_mm, in_mm([0.000_5; 3])[0]);
    assert_eq!(poses[1].1[0].status, PoseStatus::Lost);
}

#[test]
fn a_ping_reads_the_servers_clock() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.start();
    pair.driver.command(Command::Ping { host_ns: 123_456 });
    pair.step();
    assert_eq!(
        pair.driver.reported.pongs.last(),
        Some(&Pong { host_ns: 123_456, device_ticks: 1_000 * 1_000_000_000 / CLOCK_HZ })
    );
    // Before 3.0 there is none, and the recorder does not ask again.
    let mut pair = Pair::new(Bitstream::OLDEST, MULTICAST);
    pair.start();
    pair.driver.command(Command::Ping { host_ns: 5 });
    assert!(pair.driver.written().is_empty());
}

/// The definitions with the last marker renamed.
fn renamed() -> Model {
    let mut renamed = model();
    "wrist".clone_into(&mut renamed.sets[1].markers[1]);
    renamed
}

#[test]
fn frames_wait_for_definitions_that_changed() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.start();
    pair.frame(0, &[]);
    pair.step();
    pair.driver.now_ns += 2_000 * MS;
    pair.frame(1, &[]);
    pair.server.set_model(renamed());
    pair.server.withhold_model(true);
    pair.frame_with(2, &[], MODELS_CHANGED);
    pair.frame(3, &[]);
    assert_eq!(pair.driver.reported.frames.len(), 2, "they wait");
    pair.server.withhold_model(false);
    let mut answer = Vec::new();
    renamed().put(Bitstream::NEWEST, &mut answer);
    pair.driver.push(&answer);
    let reported = &pair.driver.reported;
    assert_eq!(reported.frames.len(), 4);
    assert!(reported.has_note("definitions changed: 4 labels"));
    assert_eq!(sample(reported, 2, "wrist").position_mm, in_mm(position_m(2, 3)));
    let old = reported.frames[1].2.last().unwrap().id;
    assert_ne!(old, sample(reported, 2, "wrist").id, "another label, another channel");
}

#[test]
fn a_change_whose_frame_is_lost_is_found_by_the_gap() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.start();
    pair.frame(0, &[]);
    pair.step();
    pair.driver.now_ns += 2_000 * MS;
    pair.server.set_model(renamed());
    // Frame 1, which states it, does not arrive.
    for number in 2..5 {
        pair.frame(number, &[]);
        pair.step();
    }
    let reported = &pair.driver.reported;
    assert_eq!(reported.frames.len(), 4, "frames do not wait for a mere doubt");
    assert_eq!(sample(reported, 3, "wrist").position_mm, in_mm(position_m(4, 3)));
}

#[test]
fn definitions_that_come_late_name_the_markers_from_then_on() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.server.withhold_model(true);
    pair.driver.command(Command::Identify);
    pair.steps(300);
    assert!(pair.driver.reported.hello.is_some() && pair.driver.reported.markers.is_empty());
    pair.driver.command(Command::Start { line_bytes_per_s: 0 });
    pair.steps(3);
    assert!(pair.driver.reported.has_note("has not sent its definitions yet"));
    for number in 0..60 {
        pair.frame(number, &[]);
    }
    assert!(pair.driver.reported.frames.len() >= 30);
    pair.server.withhold_model(false);
    for number in 60..300 {
        pair.frame(number, &[]);
    }
    let reported = &pair.driver.reported;
    assert_eq!(reported.frames.len(), 300, "every frame is there");
    let last = reported.frames.len() - 1;
    assert_eq!(sample(reported, last, "Anna:head").position_mm, in_mm(position_m(299, 0)));
}

#[test]
fn assets_without_an_id_are_known_by_their_positions() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    let mut nameless = model();
    nameless.assets.clear();
    pair.server.set_model(nameless);
    pair.start();
    for number in 3..6 {
        pair.frame(number, &[]);
        pair.step();
    }
    let reported = &pair.driver.reported;
    for frame in 0..3 {
        let number = frame as u32 + 3;
        assert_eq!(sample(reported, frame, "Anna:head").position_mm, in_mm(position_m(number, 0)));
        assert_eq!(sample(reported, frame, "Anna:hand").occluded, number == 3);
        assert_eq!(reported.frames[frame].2.len(), 4);
    }
}

#[test]
fn another_bitstream_is_found_by_its_layout() {
    let mut pair = Pair::new(Bitstream::new(3, 0), MULTICAST);
    pair.start();
    pair.frame(0, &[]);
    pair.server.set_bitstream(Bitstream::NEWEST);
    for number in 1..4 {
        pair.frame(number, &[]);
        pair.step();
    }
    assert_eq!(pair.driver.reported.frames.len(), 4);
    assert!(pair.driver.reported.has_note("layout of bitstream 4.2, and not of 3.0"));
    // Without the server's clock times would be of another kind: the recorder joins the stream again.
    pair.server.set_bitstream(Bitstream::OLDEST);
    pair.frame(4, &[]);
    pair.step();
    assert!(pair.driver.lost.unwrap().contains("bitstream to 2.10"));
}

#[test]
fn frames_of_no_known_layout_are_explained() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.start();
    let mut bytes = Vec::new();
    put_message(MessageKind::Frame, &mut bytes, |out| out.extend([1; 200]));
    for _ in 0..20 {
        pair.driver.push(&bytes);
    }
    pair.driver.written();
    let message = pair.driver.failed.unwrap();
    assert!(message.contains("bitstream 4.2") && message.contains("2.10 to 4.2"), "{message}");
}

#[test]
fn a_silent_server_is_asked_and_given_up() {
    let mut pair = Pair::new(Bitstream::NEWEST, MULTICAST);
    pair.start();
    // It answers, but sends no frames: once explained.
    pair.steps(500);
    assert!(!pair.driver.is_over());
    let notes =
        pair.driver.reported.notes.iter().filter(|note| note.contains("no frame comes from"));
    assert_eq!(notes.count(), 1);
    pair.frame(0, &[]);
    let began_ns = pair.driver.now_ns;
    while pair.driver.lost.is_none() {
        pair.driver.push(&[]);
        pair.driver.written();
        pair.driver.now_ns += 20 * MS;
        assert!(pair.driver.now_ns - began_ns < 8_000 * MS);
    }
    assert!(pair.driver.lost.unwrap().contains("has not answered"));
}

#[test]
fn a_server_of_this_machine_alone_is_kept_and_its_other_port_tried() {
    let mut pair = Pair::new(Bitstream::NEWEST, UNICAST);
    pair.start();
    let mut kept = 0;
    for _ in 0..500 {
        for request in pair.driver.written() {
            kept += u32::from(request[0] == MessageKind::KeepAlive as u8);
            pair.server.receive(client(), &request, 0, pair.driver.now_ns);
        }
        for datagram in pair.server.take_datagrams() {
            pair.driver.push(&datagram.bytes);
        }
        pair.driver.push(&[]);
        pair.driver.now_ns += 10 * MS;
    }
    assert!((4..=6).contains(&kept), "{kept}");
    assert_eq!(pair.driver.listens, Some(DatagramSource { group: None, port: 1511 }));
    assert!(pair.driver.reported.has_note("Transmission Type is not Unicast"));
    let mut gone = Vec::new();
    put_message(MessageKind::DisconnectByTimeout, &mut gone, |_| {});
    pair.driver.push(&gone);
    let written = pair.driver.written();
    let again = written.iter().find(|request| request[0] == MessageKind::Connect as u8).unwrap();
    assert_eq!(again.len(), 4 + 271, "the request that the server answered");
    let mut text = Vec::new();
    put_text(MessageKind::Text, "a \u{1b}[2Jword", &mut text);
    pair.driver.push(&text);
    assert!(pair.driver.reported.has_note("the server says: a  [2Jword"));
}
