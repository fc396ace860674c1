//! Taps for publishers: each gets every frame with its poses, and every batch of samples, or nothing.

use mocapd_acquire::{
    header,
    pipeline::{LeftOut, Pipeline, PipelineConfig, PublishTap, TappedBatch, TappedFrame},
};
use mocapd_drivers::device::{
    Pose, PoseFrame, SampleBatch, SampleForm, SampledChannelInfo, SampledGroupInfo,
};
use mocapd_take::poses::PoseState;

use super::poses::{bodies, pose, with_bodies};
use crate::support::{TICK_HZ, feed, jump, lossless};

/// Fewer than what the rings hold.
const FRAMES: usize = 60;

fn group() -> SampledGroupInfo {
    let channels = vec![SampledChannelInfo::default(); 3];
    let rate_millihertz = 1_000_000;
    SampledGroupInfo { id: 5, form: SampleForm::Float32, rate_millihertz, channels }
}

/// All that waits in a tap.
fn take(tap: &mut PublishTap) -> (Vec<TappedFrame>, Vec<TappedBatch>) {
    let (mut frames, mut batches) = (Vec::new(), Vec::new());
    let (mut frame, mut batch) = (TappedFrame::default(), TappedBatch::default());
    while tap.next_frame(&mut frame) {
        frames.push(frame.clone());
    }
    while tap.next_batch(&mut batch) {
        batches.push(batch.clone());
    }
    (frames, batches)
}

#[test]
fn every_publisher_gets_all_that_it_wants() {
    let motion = jump(1, 200.0, 1.0);
    let config = PipelineConfig {
        sampled: vec![group()],
        publish_taps: 3,
        ..with_bodies(&motion, lossless())
    };
    let header = header::new(&config.codec, config.rate_hz).unwrap();
    let (mut intake, pipeline, armed) = Pipeline::arm(&config, &header).unwrap();
    let mut taps = armed.publish_taps;
    taps[0].set_wanted(true, true, true);
    taps[1].set_wanted(false, false, true);
    let infos = bodies();
    for frame in 0..FRAMES as u32 {
        let poses: Vec<Pose> = infos.iter().filter_map(|body| pose(body, frame)).collect();
        let device_ticks = u64::from(frame) * TICK_HZ / 200;
        let sent = PoseFrame { seq: frame, number: frame, device_ticks, poses: &poses };
        // Before their frame or behind it; some come twice.
        if frame % 3 == 0 {
            intake.poses(&sent);
        }
        feed(&mut intake, &motion, frame as usize);
        if frame % 3 != 0 {
            intake.poses(&sent);
        }
        if frame % 3 == 1 {
            intake.poses(&sent);
        }
        let samples: Vec<f32> = (0..15).map(|i| (frame * 15 + i) as f32).collect();
        intake.samples(&SampleBatch {
            group: 5,
            number: frame,
            first: u64::from(frame) * 5 + 1000,
            device_ticks,
            form: SampleForm::Float32,
            n_channels: 3,
            samples: &samples,
        });
    }
    let [first, second, third] = &mut taps[..] else { panic!("three taps") };
    let (frames, batches) = take(first);
    assert_eq!((frames.len(), batches.len()), (FRAMES, FRAMES));
    for (row, found) in frames.iter().enumerate() {
        assert_eq!(found.row, row as u64);
        let markers: Vec<_> = found.markers.iter().map(|marker| marker.position_mm).collect();
        let bits = |positions: &[[f32; 3]]| positions.as_flattened().to_vec();
        let is_same = |(a, b): (&f32, &f32)| a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan();
        assert!(bits(&markers).iter().zip(&bits(motion.frame(row))).all(is_same), "{row}");
        assert_eq!(found.poses.len(), infos.len());
        for (body, found) in infos.iter().zip(&found.poses) {
            let sent = pose(body, row as u32);
            let is_tracked = sent.is_some_and(|sent| sent.status.code() == 0);
            assert_eq!(found.state == PoseState::Tracked, is_tracked, "{row} {body:?}");
            if let Some(sent) = sent.filter(|_| is_tracked) {
                assert_eq!(found.position_mm, sent.position_mm, "{row} {body:?}");
                assert_eq!(found.quaternion, sent.quaternion, "{row} {body:?}");
            }
        }
    }
    for (index, found) in batches.iter().enumerate() {
        assert_eq!((found.group, found.first, found.n_channels), (5, index as u64 * 5, 3));
        assert_eq!(found.samples[0], index as f32 * 15.0);
    }
    let (frames, batches) = take(second);
    assert_eq!((frames.len(), batches.len()), (0, FRAMES), "only samples were wanted");
    assert_eq!(take(third), (Vec::new(), Vec::new()), "nothing was");
    for tap in &taps {
        assert_eq!(tap.left_out(), LeftOut::default());
    }
    drop(intake);
    pipeline.join().unwrap();
    assert!(taps.iter().all(PublishTap::is_over));
}
