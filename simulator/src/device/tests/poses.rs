//! Rigid bodies: announced after the sampled channels, their poses behind each frame, and an empty message at the end.

use std::sync::Arc;

use super::*;
use crate::generator::RigidBodies;

fn bodies() -> Arc<RigidBodies> {
    let occlusion = Some(Occlusion { fraction: 0.1, mean_gap_s: 0.1 });
    let spec = JumpSpec { occlusion, ..JumpSpec::new(8, 100.0) };
    Arc::new(RigidBodies::new(&spec, 11).unwrap())
}

fn bench(settings: DeviceSettings) -> Bench {
    Bench::new(jump(1.0), DeviceSettings { bodies: Some(bodies()), ..settings })
}

fn poses(bench: &Bench) -> Vec<SentPoses> {
    let of_event = |event: &Event| match event {
        Event::Poses(poses) => Some(poses.clone()),
        _ => None,
    };
    bench.events.iter().filter_map(of_event).collect()
}

#[test]
fn the_poses_of_every_frame_are_sent_once_with_its_number_and_time() {
    let mut bench = bench(DeviceSettings::default());
    bench.send(Command::Identify);
    bench.send(start());
    bench.pass(2 * SECOND_NS, true);
    let tables = bench.events.iter().filter(|event| matches!(event, Event::Bodies(_)));
    assert_eq!(tables.collect::<Vec<_>>(), [&Event::Bodies(bodies().infos())]);
    let (frames, found, mut expected) = (bench.frames(), poses(&bench), Vec::new());
    assert_eq!((frames.len(), found.len()), (100, 100));
    for (number, (frame, got)) in (0..).zip(frames.iter().zip(&found)) {
        assert_eq!((got.seq, got.ticks, got.number), (frame.0, frame.1, number));
        bodies().poses(number.into(), 100.0, &mut expected);
        assert_eq!(format!("{:?}", got.poses), format!("{expected:?}"));
    }
    let is_end = |event: &&Event| matches!(event, Event::EndOfPoses(..));
    let ends: Vec<&Event> = bench.events.iter().filter(is_end).collect();
    assert_eq!(ends, [&Event::EndOfPoses(100, 100)]);
}

#[test]
fn numbers_begin_again_after_a_loss_of_power_and_a_full_queue_uses_none() {
    let settings = DeviceSettings { queue_bytes: Some(10_000), ..DeviceSettings::default() };
    let mut bench = bench(settings);
    bench.device.keep_frame_log();
    bench.send(start());
    bench.pass(SECOND_NS * 2 / 5, false);
    bench.pass(SECOND_NS * 2 / 5, true);
    let first = poses(&bench);
    assert!((0..).zip(&first).all(|(number, poses)| poses.number == number));
    let logged = bench.device.take_batches();
    assert!(bench.device.log().batches_dropped > 10 && logged.iter().any(|poses| poses.dropped));
    let kept = logged.iter().filter(|poses| !poses.dropped);
    assert!(kept.map(|poses| poses.first).eq(first.iter().map(|poses| u64::from(poses.seq))));
    bench.device.lose_power();
    bench.device.power_up(bench.now_ns, true);
    bench.send(start());
    bench.pass(SECOND_NS / 10, true);
    let again = &poses(&bench)[first.len()];
    assert_eq!((again.seq, again.number), (0, 0));
}

#[test]
fn a_device_without_bodies_sends_neither_message() {
    let mut bench = Bench::new(jump(0.2), DeviceSettings::default());
    bench.send(Command::Identify);
    bench.send(start());
    bench.pass(SECOND_NS, true);
    let is_of_bodies = |event: &Event| matches!(event, Event::Bodies(_) | Event::Poses(_));
    assert!(!bench.events.iter().any(is_of_bodies) && !bench.ends().is_empty());
}
