//! Poses of rigid bodies beside the frames: all of a frame are in the take bit for bit or within the bounds, or counted as
//! lost.

use std::io::Cursor;

use mocapd_acquire::{
    inspect::{Summary, Verdict},
    pipeline::{Intake, PipelineConfig},
};
use mocapd_codec::{Settings, poses::PoseBounds};
use mocapd_drivers::device::{
    BodyInfo, EndOfPoses, Pose, PoseFrame, PoseStatus, SampleBatch, SampleForm, SampledChannelInfo,
    SampledGroupInfo,
};
use mocapd_take::{
    TakeMap,
    chunk::{self, ChunkParse, types},
    compare::{PoseDifference, compare_poses},
    edit::{EditContext, SourceTake, concat, cut, repack},
    motion::Motion,
    poses::{Pose as StoredPose, PoseState},
    record::{GroupLedger, MeasuredErrors, Record, SampleLedger, SummaryRecord},
    recovery::RecoveryScan,
};

use super::takes::feed_all;
use crate::support::{TICK_HZ, config, dense, jump, lossless, start};

/// More than the bodies of a group, with ids in no order.
const BODIES: u16 = 11;

pub(super) fn bodies() -> Vec<BodyInfo> {
    let body = |i: u16| BodyInfo { id: (i * 7) % 100, name: format!("body {i}") };
    (0..BODIES).map(body).collect()
}

/// The pose of a body in a frame: some are lost, rejected or unlisted, and the sign of quaternions changes.
pub(super) fn pose(info: &BodyInfo, frame: u32) -> Option<Pose> {
    let (id, t) = (f64::from(info.id), f64::from(frame) * 0.01);
    let without = |status| Some(Pose::without(info.id, status));
    match (u32::from(info.id) + frame) % 97 {
        3..=5 => return without(PoseStatus::Lost),
        6 => return without(PoseStatus::Other(77)),
        7 => return without(PoseStatus::Rejected),
        8 => return None,
        _ => {}
    }
    let half = 0.7 * t + id;
    let axis = [0.48 * (0.3 * t).sin(), 0.6, 0.64];
    let length = (1.0_f64 + axis.iter().map(|x| x * x).sum::<f64>()).sqrt();
    let sign = if frame.is_multiple_of(5) { -1.0 } else { 1.0 };
    let [x, y, z] = axis.map(|x| x * half.sin());
    let norm = (half.cos().powi(2) + x * x + y * y + z * z).sqrt().max(length * 1e-9);
    Some(Pose {
        body: info.id,
        status: PoseStatus::Tracked,
        position_mm: [
            (900.0 * (t + id).sin()) as f32,
            (id * 10.0 + 40.0 * t) as f32,
            1000.0 + (frame % 7) as f32 * 0.013,
        ],
        quaternion: [half.cos(), x, y, z].map(|number| (sign * number / norm) as f32),
        residual_mm: if info.id == 7 { f32::NAN } else { 0.1 + (frame % 13) as f32 * 0.017 },
    })
}

fn send(intake: &mut Intake, frame: u32, number: u32) {
    send_of(intake, &bodies(), frame, number);
}

/// Those of the first bodies.
fn send_some(intake: &mut Intake, frame: u32, n_bodies: usize) {
    send_of(intake, &bodies()[..n_bodies], frame, frame);
}

fn send_of(intake: &mut Intake, bodies: &[BodyInfo], frame: u32, number: u32) {
    let poses: Vec<Pose> = bodies.iter().filter_map(|body| pose(body, frame)).collect();
    intake.poses(&PoseFrame { seq: frame, number, device_ticks: ticks(frame), poses: &poses });
}

fn ticks(frame: u32) -> u64 {
    u64::from(frame) * TICK_HZ / 200
}

pub(super) fn with_bodies(motion: &Motion, codec: Settings) -> PipelineConfig {
    PipelineConfig { bodies: bodies(), ..config(motion, codec) }
}

/// The poses of a take: number of the frame, body, pose; lost ones are left out.
fn read(take: &[u8]) -> (Vec<(u64, usize, StoredPose)>, TakeMap) {
    let map = TakeMap::scan(&mut Cursor::new(take)).unwrap();
    let (mut found, mut before) = (Vec::new(), 0);
    for group in map.pose_groups() {
        let n_bodies = group.group.bodies().count();
        let undecodable = group
            .read_poses(&mut Cursor::new(take), |first, n, poses| {
                let Some(poses) = poses else { return Ok(()) };
                assert_eq!(poses.len() as u64, n * n_bodies as u64);
                for (frame, of_frame) in (first..).zip(poses.chunks_exact(n_bodies)) {
                    found.extend((before..).zip(of_frame).map(|(body, pose)| (frame, body, *pose)));
                }
                Ok(())
            })
            .unwrap();
        assert_eq!(undecodable, []);
        before += n_bodies;
    }
    (found, map)
}

#[track_caller]
pub(super) fn assert_clean(take: &[u8]) -> Vec<GroupLedger> {
    let summary = Summary::read(take).unwrap();
    let verdict = Verdict::of(&summary);
    assert!(verdict.problems.is_empty(), "{:?}", verdict.problems);
    assert_eq!(verdict.contradictions, [""; 0]);
    let ledger = summary.take.sample_ledger.clone().unwrap();
    assert!(ledger.finished && ledger.groups.iter().all(GroupLedger::closes), "{ledger:?}");
    ledger.groups
}

/// The angle between two rotations in degrees.
fn angle_degrees(a: [f32; 4], b: [f32; 4]) -> f64 {
    let unit = |q: [f32; 4]| {
        let length = q.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
        q.map(|x| f64::from(x) / length)
    };
    let (a, b) = (unit(a), unit(b));
    let distance = |sign: f64| a.iter().zip(&b).map(|(a, b)| (a - sign * b).powi(2)).sum::<f64>();
    let chord = distance(1.0).min(distance(-1.0)).sqrt();
    (4.0 * (chord / 2.0).asin()).to_degrees()
}

/// Asserts that the poses are those of the device from frame `from` on. Returns their number.
#[track_caller]
fn assert_true(take: &[u8], from: u64, bounds: Option<PoseBounds>) -> usize {
    let (found, map) = read(take);
    let clock = map.pose_groups().next().unwrap().clock(TICK_HZ);
    let infos = bodies();
    for (frame, body, got) in &found {
        let sent = (frame + from) as u32;
        let state = |status| match status {
            PoseStatus::Tracked => PoseState::Tracked,
            PoseStatus::Lost => PoseState::Lost,
            PoseStatus::Rejected => PoseState::Rejected,
            PoseStatus::Other(_) => PoseState::Other,
        };
        let expected = pose(&infos[*body], sent);
        assert_eq!(got.state, expected.map_or(PoseState::Unlisted, |pose| state(pose.status)));
        let time = clock.at(*frame).unwrap();
        assert_eq!(time.device_ticks, ticks(sent), "frame {sent}");
        let Some(expected) = expected.filter(|pose| pose.status == PoseStatus::Tracked) else {
            assert!(got.position_mm[0].is_nan() && got.quaternion[3].is_nan());
            continue;
        };
        let [x, y, z] =
            std::array::from_fn(|i| f64::from(got.position_mm[i] - expected.position_mm[i]));
        let distance_mm = (x * x + y * y + z * z).sqrt();
        let angle = angle_degrees(got.quaternion, expected.quaternion);
        let residual_mm = got.residual_mm - expected.residual_mm;
        match bounds {
            None => {
                assert_eq!(got.position_mm, expected.position_mm);
                assert_eq!(got.quaternion, expected.quaternion);
                assert_eq!(got.residual_mm.to_bits(), expected.residual_mm.to_bits());
            }
            Some(bounds) => {
                assert!(distance_mm <= bounds.position_mm(), "{distance_mm} mm");
                assert!(angle <= bounds.angle_degrees() * (1.0 + 1e-6), "{angle} degrees");
                let length: f64 = got.quaternion.iter().map(|x| f64::from(*x).powi(2)).sum();
                assert!((length - 1.0).abs() < 4e-7);
                assert!(residual_mm.abs() <= 1.0 / 256.0 || expected.residual_mm.is_nan());
            }
        }
    }
    found.len()
}

#[test]
fn every_pose_is_in_the_take_bit_for_bit_or_within_its_bounds() {
    let motion = jump(1, 200.0, 12.0);
    let mut sizes = Vec::new();
    for codec in [lossless(), dense(0.1), dense(5.0)] {
        let config = with_bodies(&motion, codec);
        let (mut intake, pipeline) = start(&config, Vec::new());
        for frame in 0..2400 {
            feed_all(&mut intake, &motion, [frame as usize]);
            send(&mut intake, frame, frame);
        }
        intake.finish();
        let (written, take) = pipeline.finish().unwrap();
        assert_eq!(written.ledger.recorded, 2400);
        for ledger in assert_clean(&take) {
            assert_eq!((ledger.taken, ledger.stored, ledger.lost()), (2400, 2400, 0));
        }
        assert_eq!(assert_true(&take, 0, config.pose_bounds), 2400 * usize::from(BODIES));
        let (_, map) = read(&take);
        let names: Vec<_> = map.pose_groups().flat_map(|group| group.group.bodies()).collect();
        assert!(names.iter().eq(&bodies().iter().map(|body| &body.name[..]).collect::<Vec<_>>()));
        let stated = map.pose_groups().next().unwrap().group.pose_bounds();
        let expected = config.pose_bounds.map(|b| [b.position_mm(), b.angle_degrees()]);
        assert_eq!(stated, expected);
        let stated: Vec<Option<MeasuredErrors>> =
            map.pose_groups().map(|g| g.pose_errors(map.sample_ledger.as_ref())).collect();
        match config.pose_bounds {
            None => assert_eq!(stated, [None; 2]),
            Some(bounds) => {
                for errors in stated.iter().flatten().map(MeasuredErrors::errors) {
                    let part = errors.position_mm / bounds.position_mm();
                    assert!(0.8 < part && part <= 1.0 + 1e-6, "{errors:?}");
                    let part = errors.angle_degrees / bounds.angle_degrees();
                    assert!(0.6 < part && part <= 1.0 + 1e-6, "{errors:?}");
                }
            }
        }
        sizes.push(map.pose_groups().map(|group| group.stored_bytes).sum::<u64>());
    }
    let raw = 2400 * u64::from(BODIES) * 32;
    println!("raw {raw}: {sizes:?}");
    assert!(sizes[0] < raw && 3 * sizes[1] < raw && sizes[2] < sizes[1], "{sizes:?}");
}

#[test]
fn lost_poses_are_stated_with_their_causes() {
    let motion = jump(2, 200.0, 6.0);
    let (mut intake, pipeline) = start(&with_bodies(&motion, lossless()), Vec::new());
    let mut number = 0;
    for frame in 0..1200 {
        feed_all(&mut intake, &motion, [frame as usize]);
        match frame {
            // The device dropped these.
            100..110 => continue,
            // These were lost on the link.
            200..203 => {}
            300 => {
                send(&mut intake, frame, number);
                send(&mut intake, frame, number);
                send(&mut intake, frame - 2, number - 2);
            }
            _ => send(&mut intake, frame, number),
        }
        number += 1;
    }
    // Two more at the end are lost, as their end says.
    let device_ticks = ticks(1202);
    intake.end_of_poses(&EndOfPoses { seq: 1202, number: number + 2, device_ticks });
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    for ledger in assert_clean(&take) {
        assert_eq!((ledger.taken, ledger.stored), (1202, 1187));
        assert_eq!((ledger.dropped_by_device, ledger.lost_on_link), (10, 5));
        assert_eq!((ledger.duplicates, ledger.jumps), (2, 0));
    }
    assert_eq!(assert_true(&take, 0, None), 1187 * usize::from(BODIES));
}

#[test]
fn what_is_no_pose_is_rejected_and_unknown_bodies_are_counted() {
    let motion = jump(3, 200.0, 1.0);
    let (mut intake, pipeline) = start(&with_bodies(&motion, lossless()), Vec::new());
    let info = &bodies()[2];
    let good = Pose {
        body: info.id,
        status: PoseStatus::Tracked,
        position_mm: [1.0; 3],
        quaternion: [1.0, 0.0, 0.0, 0.0],
        residual_mm: 0.5,
    };
    let frames = [
        vec![good],
        vec![Pose { quaternion: [0.5, 0.0, 0.0, 0.0], ..good }],
        vec![Pose { position_mm: [f32::NAN; 3], ..good }],
        vec![Pose { body: 9_999, ..good }, good],
        vec![Pose::without(info.id, PoseStatus::Lost)],
        // A frame that lists no body came all the same.
        Vec::new(),
    ];
    for (frame, poses) in (0..).zip(&frames) {
        feed_all(&mut intake, &motion, [frame as usize]);
        intake.poses(&PoseFrame { seq: frame, number: frame, device_ticks: ticks(frame), poses });
    }
    // Announced as before, with one more, and under another name: then it is not stored under the old one.
    let mut others = bodies();
    intake.announce_bodies(&others);
    others.push(BodyInfo { id: 300, name: "new".to_owned() });
    intake.announce_bodies(&others);
    let again = |seq, intake: &mut Intake| {
        feed_all(intake, &motion, [seq as usize]);
        let (device_ticks, poses) = (ticks(seq), &[good][..]);
        intake.poses(&PoseFrame { seq, number: seq, device_ticks, poses });
    };
    again(6, &mut intake);
    others[2].name = "other".to_owned();
    intake.announce_bodies(&others);
    again(7, &mut intake);
    intake.announce_bodies(&bodies());
    again(8, &mut intake);
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    let summary = Summary::read(&take[..]).unwrap();
    assert_eq!(summary.take.sample_ledger.as_ref().unwrap().batches_refused, 2);
    let (found, map) = read(&take);
    let states: Vec<PoseState> =
        found.iter().filter(|(_, body, _)| *body == 2).map(|(_, _, pose)| pose.state).collect();
    assert_eq!(
        states,
        [
            PoseState::Tracked,
            PoseState::Rejected,
            PoseState::Rejected,
            PoseState::Tracked,
            PoseState::Lost,
            PoseState::Unlisted,
            PoseState::Tracked,
            PoseState::Refused,
            PoseState::Tracked,
        ]
    );
    let ledger = &summary.take.sample_ledger.as_ref().unwrap().groups[0];
    assert_eq!((ledger.taken, ledger.stored), (9, 9));
    let texts: Vec<&str> = map.events.iter().map(|event| &event.text[..]).collect();
    assert_eq!(texts.len(), 3, "{texts:?}");
    assert!(texts[0].contains("poses of body 9999"), "{texts:?}");
    assert!(texts[1..].iter().all(|text| text.contains("other rigid bodies")), "{texts:?}");
}

/// The same frames with their poses before them, behind them, and one frame late.
#[test]
fn every_part_of_a_recording_has_the_poses_of_its_frames() {
    use super::splits::record_parts;
    let motion = jump(4, 200.0, 3.0);
    for order in [PoseOrder::Before, PoseOrder::Behind] {
        let config = with_bodies(&motion, lossless());
        let takes = record_parts((&motion, &config), 100, |intake| {
            for frame in 0..600_u32 {
                if order == PoseOrder::Before {
                    send(intake, frame, frame);
                }
                // One frame is lost on the link; its poses are not.
                if frame != 250 {
                    feed_all(intake, &motion, [frame as usize]);
                }
                if order == PoseOrder::Behind {
                    send(intake, frame, frame);
                }
            }
        });
        let mut from = 0;
        for take in &takes {
            let rows = Summary::read(&take[..]).unwrap().take.n_rows;
            assert_eq!(assert_true(take, from, None) as u64, rows * u64::from(BODIES));
            assert_clean(take);
            from += rows;
        }
        assert_eq!((takes.len(), from), (6, 600));
    }
}

#[derive(Clone, Copy, PartialEq)]
enum PoseOrder {
    Before,
    Behind,
}

#[test]
fn parts_have_the_poses_of_their_frames_and_joined_again_they_are_those_of_the_take() {
    let motion = jump(5, 200.0, 12.0);
    let config = with_bodies(&motion, dense(0.5));
    let (mut intake, pipeline) = start(&config, Vec::new());
    for frame in 0..2400 {
        feed_all(&mut intake, &motion, [frame as usize]);
        // The device dropped some poses.
        if !(1000..1020).contains(&frame) {
            send(&mut intake, frame, if frame < 1000 { frame } else { frame - 20 });
        }
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    let whole = assert_clean(&take);
    let new_scratch = || Err(std::io::ErrorKind::Unsupported.into());
    let context = EditContext { software: "test", new_scratch: &new_scratch, on_rows: &|_| () };
    let source = |take: &[u8]| SourceTake::read(&mut Cursor::new(take)).unwrap();
    let cut_to = |rows: std::ops::Range<u64>| {
        let mut part = Vec::new();
        cut(&source(&take), Cursor::new(&take), rows, &mut part, &context).unwrap();
        part
    };
    let parts = [cut_to(0..777), cut_to(777..778), cut_to(778..2400)];
    let (mut from, mut n) = (0, 0);
    for (part, n_rows) in parts.iter().zip([777, 1, 1622]) {
        let ledger = assert_clean(part)[0];
        assert_eq!(ledger.taken, n_rows);
        // A part states the errors of the whole.
        assert_eq!(ledger.errors, whole[0].errors);
        n += assert_true(part, from, config.pose_bounds);
        from += n_rows;
    }
    assert_eq!(n, 2380 * usize::from(BODIES));
    let sources: Vec<SourceTake> = parts.iter().map(|part| source(part)).collect();
    let (mut joined, mut repacked) = (Vec::new(), Vec::new());
    let open = |i: usize| Ok(Cursor::new(parts[i].clone()));
    concat(&sources, open, &mut joined, &context).unwrap();
    repack(&source(&take), Cursor::new(&take), None, &mut repacked, &context).unwrap();
    for other in [&joined, &repacked] {
        assert_eq!(assert_true(other, 0, config.pose_bounds), n);
        let ledgers = assert_clean(other);
        assert_eq!((ledgers[0].errors, ledgers[0].dropped_by_device), (whole[0].errors, 20));
    }
}

/// A take whose chunks of a type have other payloads of the same length.
fn with_payloads(take: &[u8], of_kind: u8, changed: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let (mut new, mut at, mut n) = (take.to_vec(), chunk::MAGIC.len(), 0);
    while let ChunkParse::Whole { kind, len, payload, .. } = chunk::parse(&take[at..]) {
        if kind == of_kind {
            let payload_at = payload.as_ptr() as usize - take.as_ptr() as usize;
            let payload = changed(payload);
            new[payload_at..payload_at + payload.len()].copy_from_slice(&payload);
            let crc_at = at + len - 4;
            let crc = crc32fast::hash(&new[at..crc_at]);
            new[crc_at..at + len].copy_from_slice(&crc.to_le_bytes());
            n += 1;
        }
        at += len;
    }
    assert!(n > 0);
    new
}

/// A version without poses reads the ledgers of a take with poses, and recovers it with what the last of them stated. That
/// is no contradiction in a recovered take, and one in others.
#[test]
fn ledgers_are_of_version_1_and_stale_ones_of_recovered_takes_are_no_contradiction() {
    let motion = jump(8, 200.0, 12.0);
    let (mut intake, pipeline) = start(&with_bodies(&motion, dense(0.5)), Vec::new());
    let of_tracked = 1000;
    for frame in 0..2400 {
        feed_all(&mut intake, &motion, [frame as usize]);
        // The bodies are out of sight at first, so that there is nothing to measure.
        if frame < of_tracked {
            let infos = bodies();
            let poses: Vec<Pose> =
                infos.iter().map(|info| Pose::without(info.id, PoseStatus::Lost)).collect();
            let ticks = ticks(frame);
            intake.poses(&PoseFrame {
                seq: frame,
                number: frame,
                device_ticks: ticks,
                poses: &poses,
            });
        } else {
            send(&mut intake, frame, frame);
        }
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    let stated = assert_clean(&take);
    assert!(stated.iter().all(|group| group.errors.unwrap().position_nm > 0));
    let mut taken = Vec::new();
    let mut at = chunk::MAGIC.len();
    while let ChunkParse::Whole { kind, len, payload, .. } = chunk::parse(&take[at..]) {
        if kind == types::SAMPLE_LEDGER {
            assert_eq!(payload[..2], [1, 0]);
            let ledger = SampleLedger::from_payload(payload, 0).unwrap();
            assert!(ledger.groups.iter().all(|group| group.errors.is_none()));
            taken.push(ledger.groups[0].taken);
        }
        at += len;
    }
    assert!(taken.len() > 1 && taken.is_sorted() && taken.last() == Some(&2400), "{taken:?}");

    let mut recovered = Vec::new();
    let scan = RecoveryScan::read(&take[..]).unwrap();
    scan.write(Cursor::new(&take), &mut recovered, "test").unwrap();
    assert_eq!(assert_clean(&recovered), stated);
    let older = |ledger: &mut SampleLedger| {
        for group in &mut ledger.groups {
            // The first ledger may have been written before the first sample.
            group.taken = group.taken.saturating_sub(1);
            group.stored = group.stored.saturating_sub(1);
        }
    };
    let stale = |take: &[u8]| {
        let take = with_payloads(take, types::SAMPLE_LEDGER, |payload| {
            let mut ledger = SampleLedger::from_payload(payload, 0).unwrap();
            older(&mut ledger);
            ledger.to_payload().unwrap()
        });
        with_payloads(&take, types::SUMMARY, |payload| {
            let mut summary = SummaryRecord::from_payload(payload, 0).unwrap();
            older(summary.sample_ledger.as_mut().unwrap());
            summary.to_payload().unwrap()
        })
    };
    let contradictions = |take: &[u8]| Verdict::of(&Summary::read(take).unwrap()).contradictions;
    assert_eq!(contradictions(&stale(&recovered)), [""; 0]);
    assert_eq!(contradictions(&stale(&take)).len(), stated.len());
}

/// Frames, a scalar channel and poses in one take.
#[test]
fn a_take_of_all_kinds_that_is_cut_off_anywhere_is_true_and_can_be_recovered() {
    let motion = jump(6, 200.0, 0.2);
    let channel = SampledChannelInfo { scale: 1.0, ..SampledChannelInfo::default() };
    let group = SampledGroupInfo {
        id: 0,
        form: SampleForm::Int16,
        rate_millihertz: 200_000,
        channels: vec![channel],
    };
    let codec = dense(0.5);
    let bodies = bodies()[..2].to_vec();
    let config = PipelineConfig { sampled: vec![group], bodies, ..config(&motion, codec) };
    let (mut intake, pipeline) = start(&config, Vec::new());
    for frame in 0..30 {
        feed_all(&mut intake, &motion, [frame as usize]);
        send_some(&mut intake, frame, 2);
        intake.samples(&SampleBatch {
            group: 0,
            number: frame,
            first: frame.into(),
            device_ticks: ticks(frame),
            form: SampleForm::Int16,
            n_channels: 1,
            samples: &[frame as f32],
        });
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    assert_clean(&take);
    let bounds = config.pose_bounds.unwrap();
    let at_most = MeasuredErrors::at_most([bounds.position_mm(), bounds.angle_degrees()]);
    let (mut longest, mut n_known, mut n_unmeasured) = (0, 0, 0);
    for cut in 0..take.len() {
        let part = &take[..cut];
        let Ok(map) = TakeMap::scan(&mut Cursor::new(part)) else { continue };
        if map.pose_groups().next().is_none() {
            continue;
        }
        n_known += 1;
        let n = assert_true(part, 0, config.pose_bounds);
        assert!(n >= longest, "{cut}: what was readable stays so");
        longest = n;
        let mut recovered = Vec::new();
        let scan = RecoveryScan::read(part).unwrap();
        scan.write(Cursor::new(part), &mut recovered, "test").unwrap();
        assert_eq!(assert_true(&recovered, 0, config.pose_bounds), n, "{cut}");
        let ledger = assert_clean(&recovered).pop().unwrap();
        assert_eq!(2 * ledger.stored, n as u64);
        // Without a ledger of all its poses, the bounds are all that is known of their errors.
        assert!(n == 0 || ledger.errors.unwrap().position_nm > 0, "{cut}: {ledger:?}");
        n_unmeasured += u32::from(n > 0 && ledger.errors == Some(at_most));
    }
    assert!(n_known > take.len() / 3 && longest == 60 && n_unmeasured > 10, "{n_known} {longest}");
}

/// The numbers of frames and messages wrap, and more poses come than the rings can hold: all groups lose the same frames.
#[test]
fn numbers_wrap_and_a_full_ring_costs_all_bodies_the_same_frames() {
    let motion = jump(7, 200.0, 1.0);
    let (mut intake, pipeline) = start(&with_bodies(&motion, lossless()), Vec::new());
    let first = u32::MAX - 99;
    let infos = bodies();
    for frame in 0..8_000_u32 {
        if frame < 200 {
            feed_all(&mut intake, &motion, [frame as usize]);
        }
        let poses: Vec<Pose> = infos.iter().filter_map(|body| pose(body, frame)).collect();
        let number = first.wrapping_add(frame);
        let device_ticks = ticks(frame);
        intake.poses(&PoseFrame { seq: number, number, device_ticks, poses: &poses });
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    let ledgers = assert_clean(&take);
    let counts = |ledger: &GroupLedger| GroupLedger { group: 0, ..*ledger };
    assert_eq!(counts(&ledgers[0]), counts(&ledgers[1]));
    let ledger = &ledgers[0];
    assert_eq!((ledger.taken, ledger.jumps, ledger.duplicates), (8_000, 0, 0));
    assert_eq!(ledger.lost(), ledger.lost_ring_full);
    assert_eq!(assert_true(&take, 0, None) as u64, ledger.stored * u64::from(BODIES));
}

/// A recording of three seconds, with what `change` makes of the poses of a frame: it returns whether they arrive.
fn recorded(codec: Settings, frames: u32, change: impl Fn(u32, &mut [Pose]) -> bool) -> Vec<u8> {
    let motion = jump(9, 200.0, 3.0);
    let (mut intake, pipeline) = start(&with_bodies(&motion, codec), Vec::new());
    for frame in 0..frames {
        feed_all(&mut intake, &motion, [frame as usize]);
        let mut poses: Vec<Pose> = bodies().iter().filter_map(|body| pose(body, frame)).collect();
        if change(frame, &mut poses) {
            let device_ticks = ticks(frame);
            intake.poses(&PoseFrame { seq: frame, number: frame, device_ticks, poses: &poses });
        }
    }
    intake.finish();
    pipeline.finish().unwrap().1
}

fn difference(take: &[u8], original: &[u8]) -> PoseDifference {
    let map = |take: &[u8]| TakeMap::scan(&mut Cursor::new(take)).unwrap();
    let (ours, theirs) = (map(take), map(original));
    compare_poses((&ours, &mut Cursor::new(take)), (&theirs, &mut Cursor::new(original)))
        .unwrap()
        .unwrap()
}

#[test]
fn poses_of_two_takes_are_compared_within_what_both_state() {
    let as_sent = |_: u32, _: &mut [Pose]| true;
    let [exact, bounded, coarse] =
        [lossless(), dense(0.5), dense(5.0)].map(|codec| recorded(codec, 600, as_sent));
    let same = difference(&exact, &exact);
    assert!(same.is_within() && same.poses_differing == 0 && same.poses > 5000, "{same:?}");
    assert_eq!(same.bodies.len(), usize::from(BODIES));
    assert!(same.bodies.iter().all(|body| body.stated_max_error_mm == 0.0));
    for (take, original, at_most_mm) in
        [(&bounded, &exact, 0.5), (&exact, &bounded, 0.5), (&coarse, &bounded, 5.5)]
    {
        let found = difference(take, original);
        assert!(found.is_within() && found.poses_differing > 5000, "{found:?}");
        assert_eq!(found.poses, same.poses);
        for body in &found.bodies {
            assert!(body.stated_max_error_mm <= at_most_mm + 1e-6, "{body:?}");
            assert!(body.max_error_mm > 0.5 * body.stated_max_error_mm, "{body:?}");
            assert!(body.max_error_degrees > 0.5 * body.stated_max_error_degrees, "{body:?}");
        }
    }
}

#[test]
fn every_difference_of_poses_is_found() {
    let as_sent = |_: u32, _: &mut [Pose]| true;
    let [exact, bounded] = [lossless(), dense(0.5)].map(|codec| recorded(codec, 600, as_sent));
    let at = |change: fn(&mut Pose)| {
        move |frame: u32, poses: &mut [Pose]| {
            if frame == 300 {
                change(&mut poses[4]);
            }
            true
        }
    };
    let moved = recorded(lossless(), 600, at(|pose| pose.position_mm[1] += 1.0));
    for take in [&bounded, &exact] {
        let found = difference(take, &moved);
        assert_eq!((found.beyond_stated, found.is_within()), (1, false), "{found:?}");
        assert!(found.bodies[4].max_error_mm > 0.5, "{found:?}");
    }
    let turned = recorded(lossless(), 600, at(|pose| pose.quaternion = [0.6, 0.0, 0.8, 0.0]));
    let found = difference(&bounded, &turned);
    assert!(found.beyond_stated == 1 && found.bodies[4].max_error_degrees > 1.0, "{found:?}");
    // The same rotation by other numbers is no difference within bounds.
    let opposite =
        recorded(lossless(), 600, at(|pose| pose.quaternion = pose.quaternion.map(|x| -x)));
    assert!(difference(&bounded, &opposite).is_within());
    let found = difference(&exact, &opposite);
    assert_eq!((found.poses_differing, found.beyond_stated), (1, 1), "{found:?}");
    assert!(found.bodies[4].max_error_degrees < 1e-6, "{found:?}");
    let far = recorded(lossless(), 600, at(|pose| pose.residual_mm += 0.1));
    assert_eq!(difference(&bounded, &far).beyond_stated, 1);
    let unseen =
        recorded(lossless(), 600, at(|pose| *pose = Pose::without(pose.body, PoseStatus::Lost)));
    assert_eq!(difference(&exact, &unseen).states_differing, 1);

    let lacks_one = recorded(lossless(), 600, |frame, _| frame != 300);
    let found = difference(&lacks_one, &exact);
    assert!(found.is_within() && found.poses_lost == u64::from(BODIES), "{found:?}");
    let short = recorded(lossless(), 500, as_sent);
    for (a, b) in [(&short, &exact), (&exact, &short)] {
        let found = difference(a, b);
        assert!(!found.is_within() && found.poses_missing == 100 * u64::from(BODIES), "{found:?}");
    }
    // What a take lacks that was cut off is lost.
    let found = difference(&exact[..exact.len() / 2], &exact);
    assert!(found.is_within() && found.poses_lost > 1000 && found.poses > 100, "{found:?}");
    let (without, pipeline) = start(&config(&jump(9, 200.0, 3.0), lossless()), Vec::new());
    without.finish();
    let without = pipeline.finish().unwrap().1;
    for (a, b) in [(&without, &exact), (&exact, &without)] {
        let found = difference(a, b);
        assert!(!found.is_within() && found.bodies_missing == 11, "{found:?}");
    }
}
