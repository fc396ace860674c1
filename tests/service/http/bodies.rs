//! The rigid bodies of a recording for a player: each frame has its poses.

use std::fs;

use mocapd_acquire::pipeline::PipelineConfig;
use mocapd_drivers::device::{BodyInfo, Pose, PoseFrame, PoseStatus};

use super::{client::get, serve};
use crate::support::{TICK_HZ, config, feed, jump, lossless, start};

/// The pose of the first body in a frame; it is lost in every tenth.
fn pose(frame: usize) -> Pose {
    if frame % 10 == 3 {
        return Pose::without(4, PoseStatus::Lost);
    }
    Pose {
        body: 4,
        status: PoseStatus::Tracked,
        position_mm: [frame as f32, -2.5, 1000.0],
        quaternion: [0.6, 0.0, -0.8, 0.0],
        residual_mm: 0.25,
    }
}

/// A take of three seconds at 100 Hz with two bodies, of which the second is never listed. Frame 120 has no poses.
fn take() -> Vec<u8> {
    let motion = jump(4, 100.0, 3.0);
    let body = |id, name: &str| BodyInfo { id, name: name.to_owned() };
    let config = PipelineConfig {
        bodies: vec![body(4, "wand"), body(9, "")],
        ..config(&motion, lossless())
    };
    let (mut intake, recording) = start(&config, Vec::new());
    for frame in 0..motion.n_frames() {
        while intake.is_full() {
            std::thread::yield_now();
        }
        feed(&mut intake, &motion, frame);
        let (seq, device_ticks) = (frame as u32, frame as u64 * TICK_HZ / 100);
        if frame != 120 {
            intake.poses(&PoseFrame { seq, number: seq, device_ticks, poses: &[pose(frame)] });
        }
    }
    drop(intake);
    recording.finish().unwrap().1
}

#[test]
fn frames_have_the_poses_of_all_bodies() {
    let served = serve();
    fs::write(served.folder.path().join("takes/wand.take"), take()).unwrap();
    let bodies = get(served.at, "/v1/takes/wand/bodies").json();
    assert_eq!(bodies["names"], serde_json::json!(["wand", ""]));
    let window = |query: &str| {
        let answer = get(served.at, &format!("/v1/takes/wand/poses{query}"));
        assert_eq!((answer.status, &answer.body[..4]), (200, &b"MPB1"[..]));
        let floats = answer.body[32..].chunks_exact(4);
        let floats: Vec<f32> =
            floats.map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect();
        let poses: Vec<_> = floats.chunks_exact(9).map(<[f32]>::to_vec).collect();
        assert_eq!(poses.len() % 2, 0);
        (answer.body[24], poses)
    };
    let (flags, all) = window("?seconds=3");
    assert_eq!((flags, all.len()), (2, 600), "poses of a frame are missing");
    for (frame, found) in all.chunks_exact(2).enumerate() {
        let states = (found[0][0], found[1][0]);
        match frame {
            120 => assert_eq!(states, (253.0, 253.0)),
            _ if frame % 10 == 3 => {
                assert_eq!(states, (1.0, 255.0));
                assert!(found[0][1..].iter().all(|value| value.is_nan()));
            }
            _ => {
                assert_eq!(states, (0.0, 255.0));
                let expected = [0.25, frame as f32, -2.5, 1000.0, 0.6, 0.0, -0.8, 0.0];
                assert_eq!(found[0][1..], expected, "{frame}");
            }
        }
    }
    let (flags, part) = window("?from=1.5&seconds=0.8&every=20");
    assert_eq!((flags, part.len()), (0, 8));
    let xs: Vec<f32> = part.chunks_exact(2).map(|frame| frame[0][2]).collect();
    assert_eq!(xs, [150.0, 170.0, 190.0, 210.0]);
    assert_eq!(get(served.at, "/v1/takes/wand/poses?from=9").status, 416);
}

#[test]
fn a_take_without_bodies_has_no_poses() {
    let served = serve();
    fs::write(served.folder.path().join("takes/bare.take"), super::take()).unwrap();
    assert_eq!(get(served.at, "/v1/takes/bare/bodies").json()["names"], serde_json::json!([]));
    let answer = get(served.at, "/v1/takes/bare/poses");
    assert_eq!((answer.status, answer.body.len()), (200, 32));
}
