//! The poses of a recording with faults: those of the messages that arrived, bit for bit, and a ledger that says so.

use std::io::Cursor;

use mocapd_drivers::device::{Pose, PoseStatus};
use mocapd_simulator::{
    device::{POSES_GROUP, TICK_HZ},
    faults::{BatchFate, Fate, Script},
};
use mocapd_take::{
    TakeMap,
    poses::{Pose as StoredPose, PoseState},
    sampled::RESIDUAL_GROUPS,
};

use super::{
    super::Folder,
    played::{Played, bodies, sent_poses},
    sampled::{Expected, expected},
};

/// The poses of every frame of the take, lost ones left out: the number of the frame, and the poses of all bodies.
fn stored(take: &[u8], map: &TakeMap) -> Vec<(u64, Vec<StoredPose>)> {
    let mut all: Vec<(u64, Vec<StoredPose>)> = Vec::new();
    for (index, group) in map.pose_groups().enumerate() {
        let n_bodies = group.group.bodies().count();
        let mut at = 0;
        let read = |first, _, poses: Option<&[StoredPose]>| {
            for (number, poses) in (first..).zip(poses.unwrap_or_default().chunks_exact(n_bodies)) {
                match index {
                    0 => all.push((number, poses.to_vec())),
                    _ => {
                        assert_eq!(all[at].0, number, "all groups have the same frames");
                        all[at].1.extend_from_slice(poses);
                        at += 1;
                    }
                }
            }
            Ok(())
        };
        assert_eq!(group.read_poses(&mut Cursor::new(take), read).unwrap(), []);
    }
    all
}

/// The state, and all numbers as bits if it has a pose.
fn bits(pose: Option<&Pose>) -> (PoseState, Vec<u32>) {
    let Some(pose) = pose else { return (PoseState::Unlisted, Vec::new()) };
    let numbers = pose.position_mm.iter().chain(&pose.quaternion).chain([&pose.residual_mm]);
    match pose.status {
        PoseStatus::Tracked => (PoseState::Tracked, numbers.map(|x| x.to_bits()).collect()),
        PoseStatus::Lost => (PoseState::Lost, Vec::new()),
        PoseStatus::Rejected => (PoseState::Rejected, Vec::new()),
        PoseStatus::Other(_) => (PoseState::Other, Vec::new()),
    }
}

pub(super) fn take_holds_what_was_sent(folder: &Folder, script: &Script, played: &Played) {
    let take = folder.read("a.take");
    let map = TakeMap::scan(&mut Cursor::new(&take)).unwrap();
    let of_poses = |fate: &&BatchFate| fate.frame.group == POSES_GROUP;
    let messages: Vec<&BatchFate> = played.batches.iter().filter(of_poses).collect();
    let infos = bodies().infos();
    let names = map.pose_groups().flat_map(|group| group.group.bodies());
    assert!(names.eq(infos.iter().map(|body| &body.name[..])));
    let whole = messages.iter().filter(|of| of.fate == Fate::Whole && of.frame.n > 0);
    let (sent, found) = (sent_poses(script), stored(&take, &map));
    assert_eq!(found.len(), whole.clone().count());
    let clock = map.pose_groups().next().unwrap().clock(TICK_HZ);
    let mut n_tracked = 0;
    for ((number, poses), message) in found.iter().zip(whole) {
        let of_frame = &sent[message.frame.first_in_run as usize];
        for (info, got) in infos.iter().zip(poses) {
            let wanted = bits(of_frame.iter().find(|pose| pose.body == info.id));
            let numbers = got.position_mm.iter().chain(&got.quaternion).chain([&got.residual_mm]);
            let is_tracked = got.state == PoseState::Tracked;
            let numbers = numbers.filter(|_| is_tracked).map(|x| x.to_bits()).collect();
            assert_eq!((got.state, numbers), wanted, "{message:?} {info:?}");
            n_tracked += u32::from(is_tracked);
        }
        let time = clock.at(*number).unwrap();
        let off = time.device_ticks.abs_diff(message.frame.device_ticks);
        assert!(off <= TICK_HZ / 200, "frame {number}: {time:?}, {:?}", message.frame);
    }
    assert!(n_tracked > 0);
    let ledgers = played.report["sample_ledger"]["groups"].as_array().unwrap();
    let numbers = u64::from(POSES_GROUP)..RESIDUAL_GROUPS.start.into();
    let of_poses = ledgers.iter().filter(|of| numbers.contains(&of["group"].as_u64().unwrap()));
    for ledger in of_poses.clone() {
        assert_eq!(Expected::stated(ledger), expected(&messages), "{ledger:#}");
    }
    assert_eq!(of_poses.count(), map.pose_groups().count());
}
