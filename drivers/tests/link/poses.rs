//! Rigid bodies and their poses.

use mocapd_drivers::{
    device::{BODIES_MAX, BodyInfo, DeviceEvent, Pose, PoseFrame, PoseStatus, Protocol},
    link::{DeviceLink, EncodeError, HostLink, WIRE_BYTES_MAX, pose_frame_bytes_max},
};
use proptest::{collection::vec, prelude::*};

use crate::{host_events, with_envelope};

fn any_pose() -> impl Strategy<Value = Pose> {
    let numbers = any::<[u32; 8]>().prop_map(|bits| bits.map(f32::from_bits));
    let code = prop_oneof![0..3_u8, 3..128_u8];
    (code, numbers).prop_map(|(code, [x, y, z, w, a, b, c, residual_mm])| {
        let status = PoseStatus::from_code(code).unwrap();
        let whole =
            Pose { body: 0, status, position_mm: [x, y, z], quaternion: [w, a, b, c], residual_mm };
        if status == PoseStatus::Tracked { whole } else { Pose::without(0, status) }
    })
}

/// All bits of a pose.
fn bits(pose: &Pose) -> (u16, PoseStatus, Vec<u32>) {
    let numbers = pose.position_mm.iter().chain(&pose.quaternion).chain([&pose.residual_mm]);
    (pose.body, pose.status, numbers.map(|number| number.to_bits()).collect())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn poses_round_trip_bit_for_bit(
        (seq, number, device_ticks) in any::<(u32, u32, u64)>(),
        mut poses in vec(any_pose(), 0..=BODIES_MAX),
        step in 1_u16..500,
    ) {
        (0..).step_by(step.into()).zip(&mut poses).for_each(|(id, pose)| pose.body = id);
        let frame = PoseFrame { seq, number, device_ticks, poses: &poses };
        let mut wire = Vec::new();
        DeviceLink::new().poses(&frame, &mut wire).unwrap();
        prop_assert!(wire.len() <= pose_frame_bytes_max(poses.len()));
        let mut n_events = 0;
        HostLink::new().push(&wire, &mut |event| {
            let DeviceEvent::Poses(got) = event else { panic!("{event:?}") };
            assert_eq!((got.seq, got.number, got.device_ticks), (seq, number, device_ticks));
            assert!(got.poses.iter().map(bits).eq(poses.iter().map(bits)));
            n_events += 1;
        });
        prop_assert_eq!(n_events, 1);
    }

    #[test]
    fn any_payload_is_a_message_or_damage(
        kind in prop_oneof![Just(0x04_u8), Just(0x14)],
        n in 0_u8..140,
        mut payload in vec(any::<u8>(), 0..400),
    ) {
        // A count that often fits, and ids and codes that are often valid.
        let at = if kind == 0x04 { 0 } else { 16 };
        if let Some(count) = payload.get_mut(at..at + 2) {
            count.copy_from_slice(&[n, 0]);
        }
        let mut host = HostLink::new();
        host.push(&with_envelope(1, kind, &payload), &mut |event| match event {
            DeviceEvent::Bodies(bodies) => assert!(bodies.is_sorted_by_key(|body| body.id)),
            DeviceEvent::Poses(frame) => assert!(frame.poses.is_sorted_by_key(|pose| pose.body)),
            DeviceEvent::EndOfPoses(_) => assert_eq!(payload.len(), 18),
            _ => panic!("{event:?}"),
        });
        let counters = host.counters();
        prop_assert_eq!(counters.messages + counters.messages_damaged, 1);
    }
}

#[test]
fn every_cut_and_every_wrong_code_is_damage() {
    let poses = [
        Pose {
            body: 1,
            status: PoseStatus::Tracked,
            position_mm: [1.0; 3],
            quaternion: [1.0, 0.0, 0.0, 0.0],
            residual_mm: 0.5,
        },
        Pose::without(2, PoseStatus::Lost),
    ];
    let mut payload = [7_u32.to_le_bytes(), 7_u32.to_le_bytes()].concat();
    payload.extend(70_000_u64.to_le_bytes());
    payload.extend([2, 0, 1, 0, 0]);
    for number in [1.0_f32, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.5] {
        payload.extend(number.to_le_bytes());
    }
    payload.extend([2, 0, 1]);
    let frame = PoseFrame { seq: 7, number: 7, device_ticks: 70_000, poses: &poses };
    let expected = format!("{:?}", DeviceEvent::Poses(frame));
    assert_eq!(host_events(&mut HostLink::new(), &with_envelope(1, 0x14, &payload)), [expected]);
    let mut bad: Vec<Vec<u8>> = (0..payload.len()).map(|n| payload[..n].to_vec()).collect();
    bad.push([&payload[..], &[0]].concat());
    // A status, a body twice, and more poses than there may be.
    for (at, byte) in [
        (20, 128),
        (payload.len() - 1, 128),
        (payload.len() - 1, 255),
        (payload.len() - 3, 1),
        (16, 129),
    ] {
        let mut wrong = payload.clone();
        wrong[at] = byte;
        bad.push(wrong);
    }
    for payload in bad {
        let mut host = HostLink::new();
        assert!(host_events(&mut host, &with_envelope(1, 0x14, &payload)).is_empty());
        assert_eq!(host.counters().messages_damaged, 1, "{payload:?}");
    }
}

/// A later version may have more reasons why a body has no pose; the poses of the others stay readable.
#[test]
fn a_status_of_a_later_version_is_a_body_without_a_pose_with_its_code() {
    for code in 3..128 {
        let mut payload = [[0; 16].as_slice(), &[3, 0, 1, 0, 0]].concat();
        for number in [1.0_f32, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0, 0.5] {
            payload.extend(number.to_le_bytes());
        }
        payload.extend([2, 0, code, 9, 0, 1]);
        let mut n_events = 0;
        HostLink::new().push(&with_envelope(1, 0x14, &payload), &mut |event| {
            let DeviceEvent::Poses(frame) = event else { panic!("{event:?}") };
            let found: Vec<_> = frame.poses.iter().map(|p| (p.body, p.status)).collect();
            let other = PoseStatus::Other(code);
            assert_eq!(found, [(1, PoseStatus::Tracked), (2, other), (9, PoseStatus::Lost)]);
            assert_eq!(frame.poses[0].position_mm, [1.0, 2.0, 3.0]);
            let without = frame.poses[1].checked();
            assert!(without.status == other && without.status.code() == code);
            assert!(without.position_mm.iter().all(|number| number.is_nan()));
            n_events += 1;
        });
        assert_eq!(n_events, 1);
    }
    // Not sent: codes that have a name, and those of takes.
    for code in [0, 1, 2, 128, 255] {
        let poses = [Pose::without(1, PoseStatus::Other(code))];
        let refused = DeviceLink::new().poses(&frame(&poses), &mut Vec::new());
        assert!(matches!(refused, Err(EncodeError::Poses(_))), "{code}");
    }
}

fn frame(poses: &[Pose]) -> PoseFrame<'_> {
    PoseFrame { seq: 1, number: 1, device_ticks: 1, poses }
}

#[test]
fn the_largest_tables_fit_and_more_is_refused() {
    let body = |id: u16| BodyInfo { id, name: "x".repeat(255) };
    let mut bodies: Vec<BodyInfo> = (0..BODIES_MAX as u16).map(|id| body(500 * id)).collect();
    let mut poses: Vec<Pose> =
        bodies.iter().map(|body| Pose::without(body.id, PoseStatus::Tracked)).collect();
    let (mut device, mut wire) = (DeviceLink::new(), Vec::new());
    device.bodies(&bodies, &mut wire).unwrap();
    device.poses(&frame(&poses), &mut wire).unwrap();
    assert!(wire.len() < WIRE_BYTES_MAX);
    assert_eq!(host_events(&mut HostLink::new(), &wire).len(), 2);
    wire.clear();
    bodies.push(body(u16::MAX));
    poses.push(Pose::without(u16::MAX, PoseStatus::Lost));
    // Too many; then two in descending order.
    for n in [BODIES_MAX + 1, 2] {
        assert!(matches!(device.bodies(&bodies[..n], &mut wire), Err(EncodeError::Bodies(_))));
        let refused = device.poses(&frame(&poses[..n]), &mut wire);
        assert!(matches!(refused, Err(EncodeError::Poses(_))));
        bodies.swap(0, 1);
        poses.swap(0, 1);
    }
    for name in ["x".repeat(256), "a\nb".to_owned()] {
        let refused = device.bodies(&[BodyInfo { id: 0, name }], &mut wire);
        assert!(matches!(refused, Err(EncodeError::Text { .. })));
    }
    assert!(wire.is_empty());
}
