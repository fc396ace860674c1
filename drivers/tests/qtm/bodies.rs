//! Rigid bodies: names from the settings, poses from the frames, and lists that change.

use mocapd_drivers::{
    device::{Command, Pose, PoseStatus},
    qtm::{
        BodySettings, Event, FrameHeader, PacketKind, QtmServer, ServedBody, ServedFrame,
        ServedSettings, put_event, put_text,
    },
};

use crate::pair::{LABELS, Pair};

fn settings(names: &[&str]) -> ServedSettings {
    let body = |name: &&str| BodySettings { name: (*name).to_owned(), ..BodySettings::default() };
    ServedSettings {
        frequency_hz: 100.0,
        up_axis: "+Z",
        labels: LABELS.map(str::to_owned).to_vec(),
        bodies: names.iter().map(body).collect(),
        ..ServedSettings::default()
    }
}

/// The pose of a body in a frame.
fn pose(number: u32, body: u16) -> Pose {
    let (sin, cos) = (number as f32 * 0.03 + f32::from(body)).sin_cos();
    Pose {
        body,
        status: PoseStatus::Tracked,
        position_mm: [number as f32 + 0.1, -f32::from(body), 1000.3],
        quaternion: [cos, sin * 0.6, 0.0, sin * -0.8],
        residual_mm: 0.5,
    }
}

fn header(number: u32) -> FrameHeader {
    FrameHeader { time_us: 5_000 + u64::from(number) * 10_000, number }
}

fn frame(pair: &mut Pair, number: u32, n_bodies: u16) {
    let bodies: Vec<_> = (0..n_bodies).map(|b| ServedBody::of_pose(&pose(number, b))).collect();
    pair.frame_with(header(number), &[], &bodies);
}

#[track_caller]
fn assert_same(found: &Pose, expected: &Pose) {
    assert_eq!((found.body, found.status), (expected.body, expected.status));
    assert_eq!(found.position_mm, expected.position_mm);
    assert_eq!(found.residual_mm, expected.residual_mm);
    let product: f32 = found.quaternion.iter().zip(expected.quaternion).map(|(a, b)| a * b).sum();
    let apart = found.quaternion.iter().zip(expected.quaternion);
    let apart = apart.map(|(a, b)| (a - product.signum() * b).abs()).fold(0.0, f32::max);
    assert!(apart < 5e-7, "{found:?} {expected:?}");
}

fn stop(pair: &mut Pair) {
    pair.driver.command(Command::Stop);
    pair.steps(20);
    assert!(pair.driver.reported.ended.is_some());
}

#[test]
fn poses_arrive_with_their_frames_and_names() {
    for port in [None, Some(5000)] {
        let mut pair = Pair::with(port, settings(&["cup", "table"]));
        pair.start();
        let request =
            pair.driver.sent.iter().find(|sent| sent.starts_with("StreamFrames")).unwrap();
        assert!(request.ends_with("3DRes 3DNoLabelsRes 6DRes"), "{request}");
        let names: Vec<_> =
            pair.driver.reported.bodies[0].iter().map(|b| (b.id, b.name.as_str())).collect();
        assert_eq!(names, [(0, "cup"), (1, "table")]);
        for number in 0..20 {
            frame(&mut pair, number, 2);
            pair.step();
        }
        stop(&mut pair);
        let reported = &pair.driver.reported;
        assert_eq!((reported.frames.len(), reported.poses.len()), (20, 20));
        for (number, (seq, ticks, poses)) in reported.poses.iter().enumerate() {
            let number = number as u32;
            assert_eq!((*seq, *ticks, poses.len()), (number, header(number).time_us, 2));
            (0..2).for_each(|body| assert_same(&poses[usize::from(body)], &pose(number, body)));
        }
        assert_eq!(reported.end_of_poses.unwrap().seq, 20);
        assert_eq!(reported.notes, ["QTM: RT From File Started"]);
        assert_eq!(pair.driver.host_counters().messages_damaged, 0);
    }
}

#[test]
fn lost_bodies_are_lost_and_a_mirrored_one_is_rejected() {
    let mut pair = Pair::with(None, settings(&["cup", "table", "phone"]));
    pair.start();
    let mut mirrored = ServedBody::of_pose(&pose(0, 1));
    mirrored.matrix[..3].iter_mut().for_each(|number| *number = -*number);
    let bodies = [ServedBody::LOST, mirrored, ServedBody::of_pose(&pose(0, 2))];
    pair.frame_with(header(0), &[], &bodies);
    pair.step();
    let (.., poses) = &pair.driver.reported.poses[0];
    let statuses: Vec<_> = poses.iter().map(|pose| pose.status).collect();
    assert_eq!(statuses, [PoseStatus::Lost, PoseStatus::Rejected, PoseStatus::Tracked]);
    assert!(poses[..2].iter().all(|pose| pose.position_mm.iter().all(|value| value.is_nan())));
}

#[test]
fn a_list_that_changes_is_requested_again_and_loses_no_pose() {
    let mut pair = Pair::with(None, settings(&["cup", "table"]));
    pair.start();
    for number in 0..3 {
        frame(&mut pair, number, 2);
        pair.step();
    }
    // The first body is gone, and another one is there behind the second: the number alone tells.
    pair.server.change_settings(settings(&["table", "phone", "cup"]));
    for number in 3..9 {
        frame(&mut pair, number, 3);
        pair.step();
    }
    let reported = &pair.driver.reported;
    let names: Vec<_> =
        reported.bodies[1].iter().map(|body| (body.id, body.name.as_str())).collect();
    assert_eq!(names, [(1, "table"), (2, "phone"), (0, "cup")]);
    assert!(reported.notes.iter().any(|note| note.contains("bodies changed: 3 bodies")));
    assert_eq!((reported.frames.len(), reported.poses.len()), (9, 9));
    for (number, (seq, _, poses)) in reported.poses.iter().enumerate() {
        assert_eq!(*seq, number as u32);
        let bodies: Vec<_> = poses.iter().map(|pose| pose.body).collect();
        assert_eq!(bodies, if number < 3 { vec![0, 1] } else { vec![1, 2, 0] });
    }
}

#[test]
fn a_renamed_list_of_the_same_length_is_followed_when_qtm_tells() {
    let mut pair = Pair::with(None, settings(&["cup", "table"]));
    pair.start();
    frame(&mut pair, 0, 2);
    pair.step();
    let swapped = ServedSettings {
        labels: vec!["tail".to_owned(), LABELS[1].to_owned(), LABELS[0].to_owned()],
        ..settings(&["table", "cup"])
    };
    // Clients learn of it by an event, in front of the first frame with the new lists.
    pair.server.change_settings(swapped);
    for number in 1..4 {
        frame(&mut pair, number, 2);
        pair.step();
    }
    let reported = &pair.driver.reported;
    assert_eq!((reported.frames.len(), reported.poses.len()), (4, 4));
    let of = |index: usize| {
        let labels: Vec<_> = reported.frames[index].2.iter().map(|sample| sample.id).collect();
        let bodies: Vec<_> = reported.poses[index].2.iter().map(|pose| pose.body).collect();
        (labels, bodies)
    };
    assert_eq!(of(0), (vec![0, 1, 2], vec![0, 1]));
    (1..4).for_each(|index| assert_eq!(of(index), (vec![3, 1, 0], vec![1, 0]), "{index}"));
}

/// At 1000 Hz a hundred frames are a tenth of a second, which settings of many cameras take.
#[test]
fn settings_that_come_late_are_used_all_the_same() {
    let mut pair = Pair::with(None, settings(&["cup", "table"]));
    pair.start();
    frame(&mut pair, 0, 2);
    pair.step();
    let renamed = ServedSettings {
        labels: vec!["tail".to_owned(), LABELS[1].to_owned(), LABELS[2].to_owned()],
        ..settings(&["table", "cup"])
    };
    pair.server.change_settings(renamed);
    // The requests wait on their way.
    for number in 1..=100 {
        frame(&mut pair, number, 2);
        let bytes = pair.server.take_pending(pair.client);
        pair.driver.push(&bytes, false);
    }
    assert_eq!(pair.driver.reported.frames.len(), 101, "none waits for long");
    pair.steps(2);
    frame(&mut pair, 101, 2);
    pair.steps(2);
    let reported = &pair.driver.reported;
    assert_eq!((reported.frames.len(), reported.poses.len()), (102, 102));
    let bodies: Vec<_> = reported.poses[101].2.iter().map(|pose| pose.body).collect();
    let labels: Vec<_> = reported.frames[101].2.iter().map(|sample| sample.id).collect();
    assert_eq!((labels, bodies), (vec![3, 1, 2], vec![1, 0]));
    let names: Vec<_> = reported.bodies[1].iter().map(|body| body.name.as_str()).collect();
    assert_eq!(names, ["table", "cup"], "and no list without bodies");
}

/// Independent of the driver's own arithmetic: a point of the body, turned by the matrix as QTM's documents and clients read
/// it, and by the quaternion that is recorded.
#[test]
fn a_matrix_turns_points_as_the_quaternion_does() {
    // A third of a turn about (1, 1, 1) takes x to y; then the nose of the body points along y. Column after column.
    let matrix = [0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0];
    let mut pair = Pair::with(None, settings(&["cup"]));
    pair.start();
    let body = ServedBody { position_mm: [0.0; 3], matrix, residual_mm: 0.0 };
    pair.frame_with(header(0), &[], &[body]);
    pair.step();
    let [w, x, y, z] = pair.driver.reported.poses[0].2[0].quaternion;
    // The image of the x axis under a quaternion.
    let nose = [w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)];
    assert!(
        nose.iter().zip([0.0, 1.0, 0.0]).all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-6),
        "{nose:?}"
    );
    let back = ServedBody::of_pose(&pair.driver.reported.poses[0].2[0]);
    assert!(back.matrix.iter().zip(matrix).all(|(a, b)| (a - b).abs() < 1e-6), "{back:?}");
}

/// By UDP, a QTM that has bodies and tracks none sends frames without them.
#[test]
fn frames_without_bodies_do_not_wait_for_them_for_ever() {
    let mut pair = Pair::with(Some(5000), settings(&["cup"]));
    let mut other = Pair::new(Some(5000));
    pair.start();
    other.start();
    for number in 0..40 {
        other.frame(number, header(number).time_us, &[]);
        for datagram in other.server.take_datagrams() {
            pair.driver.push(&datagram.bytes, true);
        }
        if number < 16 {
            // Its part is waited for in vain.
            pair.driver.now_ns += 30 * crate::pair::MS;
            pair.driver.push(&[], false);
        }
        assert_eq!(pair.driver.reported.frames.len(), number as usize + 1, "at once");
    }
    stop(&mut pair);
    assert_eq!(pair.driver.reported.poses.len(), 24, "nothing is known of the bodies");
}

#[test]
fn bodies_without_settings_cost_no_marker_and_are_counted() {
    let mut pair = Pair::with(None, settings(&["cup", "table"]));
    pair.start();
    // Frames with another number of bodies than the settings, which stay as they are.
    for number in 0..100 {
        frame(&mut pair, number, 3);
        pair.step();
    }
    stop(&mut pair);
    let reported = &pair.driver.reported;
    assert_eq!((reported.frames.len(), reported.poses.len()), (100, 100));
    assert!(reported.poses.iter().all(|(.., poses)| poses.is_empty()));
    let notes = reported.notes.join("\n");
    assert!(notes.contains("300 poses were left out"), "{notes}");
    // Requested again every second, not for every frame.
    let requests = pair.driver.sent.iter().filter(|sent| *sent == "GetParameters 6D").count();
    assert!((2..6).contains(&requests), "{requests}");
}

#[test]
fn an_event_that_changes_nothing_holds_frames_back_for_a_moment() {
    let mut pair = Pair::with(None, settings(&["cup"]));
    pair.start();
    frame(&mut pair, 0, 1);
    pair.step();
    let mut event = Vec::new();
    put_event(Event::CameraSettingsChanged, &mut event);
    pair.driver.push(&event, false);
    for number in 1..5 {
        frame(&mut pair, number, 1);
        pair.step();
    }
    assert_eq!(pair.driver.reported.frames.len(), 5);
    assert_eq!(pair.driver.reported.bodies.len(), 1);
}

#[test]
fn a_component_of_bodies_that_cannot_be_read_costs_no_marker() {
    let mut pair = Pair::with(None, settings(&["cup"]));
    pair.start();
    frame(&mut pair, 0, 1);
    let mut packet = pair.server.take_pending(pair.client);
    // The last component, of 68 bytes, states two bodies.
    let at = packet.len() - 68 + 8;
    packet[at] = 2;
    pair.driver.push(&packet, false);
    stop(&mut pair);
    let reported = &pair.driver.reported;
    assert_eq!((reported.frames.len(), reported.poses.len()), (1, 1));
    assert!(reported.poses[0].2.is_empty());
    let notes = reported.notes.join("\n");
    assert!(notes.contains("1 components of rigid bodies cannot be read"), "{notes}");
}

/// In datagrams the bodies of a frame may be lost alone: their poses are missing, and the markers are not.
#[test]
fn the_datagram_of_the_bodies_may_be_lost_alone() {
    let names: Vec<String> = (0..128).map(|index| format!("body {index}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut pair = Pair::with(Some(5000), settings(&names));
    pair.start();
    // So many markers that the bodies are in a datagram of their own.
    let unlabelled: Vec<u32> = (0..3_200).collect();
    for number in 0..6 {
        let bodies: Vec<_> = (0..128).map(|b| ServedBody::of_pose(&pose(number, b))).collect();
        pair.frame_with(header(number), &unlabelled, &bodies);
        let datagrams = pair.server.take_datagrams();
        assert_eq!(datagrams.len(), 2);
        let n = if number == 3 { 1 } else { 2 };
        datagrams[..n].iter().for_each(|datagram| pair.driver.push(&datagram.bytes, true));
        pair.step();
    }
    stop(&mut pair);
    let reported = &pair.driver.reported;
    assert_eq!(reported.frames.len(), 6);
    let numbers: Vec<_> = reported.poses.iter().map(|(seq, ..)| *seq).collect();
    assert_eq!(numbers, [0, 1, 2, 4, 5]);
    let notes = reported.notes.join("\n");
    assert!(notes.contains("1 frames are incomplete"), "{notes}");
}

#[test]
fn one_frame_with_bodies_is_the_next_that_has_them() {
    let mut server = QtmServer::new(settings(&["cup"]), String::new());
    let clients = [1, 2].map(|port| server.connect(([127, 0, 0, 1], port).into()).unwrap());
    for (client, components) in clients.into_iter().zip(["3D 6D", "3D"]) {
        let mut bytes = Vec::new();
        for command in ["Version 1.28", &format!("GetCurrentFrame {components}")] {
            put_text(PacketKind::Command, command, &mut bytes);
        }
        server.receive(client, &bytes);
        server.take_pending(client);
    }
    let bodies = [ServedBody::LOST];
    let mut answers = Vec::new();
    for (number, lacks_bodies) in [(0, true), (1, false), (2, false)] {
        let header = header(number);
        server.frame(&ServedFrame { header, bodies: &bodies, lacks_bodies, ..Default::default() });
        answers.push(clients.map(|client| !server.take_pending(client).is_empty()));
    }
    assert_eq!(answers, [[false, true], [true, false], [false, false]]);
}
