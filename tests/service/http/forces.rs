//! The forces of a recording for a player: those of its sampled channels at the times of its frames.

use std::fs;

use mocapd_drivers::device::{SampleBatch, SampleForm, SampledChannelInfo, SampledGroupInfo};

use super::{client::get, serve};
use crate::support::{TICK_HZ, config, dense, feed, jump, start};

/// Samples of a channel in a batch, and in a second.
const BATCH: u64 = 10;
const RATE_HZ: u64 = 1000;

/// A plate whose upward force is a quarter of the number of the sample, 250 N a second.
fn group() -> SampledGroupInfo {
    let channel = |(name, unit): (&str, &str)| SampledChannelInfo {
        name: name.to_owned(),
        unit: unit.to_owned(),
        scale: 0.25,
        offset: 0.0,
    };
    let names = [("Fx1", "N"), ("Fy1", "N"), ("Fz1", "N"), ("EMG1", "V")];
    SampledGroupInfo {
        id: 3,
        form: SampleForm::Int16,
        rate_millihertz: 1_000_000,
        channels: names.map(channel).into(),
    }
}

/// A take of three seconds, whose samples begin a twentieth of a second before the frames and lack a batch.
fn take() -> Vec<u8> {
    let motion = jump(4, 100.0, 3.0);
    let mut config = config(&motion, dense(0.5));
    config.sampled = vec![group()];
    let (mut intake, recording) = start(&config, Vec::new());
    let mut next = 0;
    for seq in 0..motion.n_frames() {
        while intake.is_full() {
            std::thread::yield_now();
        }
        // Sample 50 is taken with frame 0.
        let taken = 50 + seq as u64 * RATE_HZ / 100;
        while next + BATCH <= taken {
            let samples: Vec<f32> =
                (next..next + BATCH).flat_map(|n| [7.0, -7.0, n as f32, 1.0]).collect();
            let ticks = (next as i64 - 50) * (TICK_HZ / RATE_HZ) as i64;
            // The device ends its samples before its frames.
            if next != 2000 && next < 2800 {
                intake.samples(&SampleBatch {
                    group: 3,
                    number: (next / BATCH) as u32,
                    first: next,
                    device_ticks: ticks as u64,
                    form: SampleForm::Int16,
                    n_channels: 4,
                    samples: &samples,
                });
            }
            next += BATCH;
        }
        feed(&mut intake, &motion, seq);
    }
    drop(intake);
    recording.finish().unwrap().1
}

#[test]
fn frames_have_the_forces_of_their_times() {
    let served = serve();
    fs::write(served.folder.path().join("takes/jump.take"), take()).unwrap();
    fs::write(served.folder.path().join("takes/bare.take"), super::take()).unwrap();
    let plates = get(served.at, "/v1/takes/jump/plates").json();
    assert_eq!(plates["plates"], serde_json::json!([{ "name": "1", "corners_mm": null }]));
    assert_eq!(get(served.at, "/v1/takes/bare/plates").json()["plates"], serde_json::json!([]));
    let window = |query: &str| {
        let answer = get(served.at, &format!("/v1/takes/jump/forces{query}"));
        assert_eq!(answer.status, 200);
        let floats = answer.body[32..].chunks_exact(4);
        let floats: Vec<f32> =
            floats.map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect();
        (answer.body[24] & 2 != 0, floats.chunks_exact(9).map(<[f32]>::to_vec).collect::<Vec<_>>())
    };
    let (is_damaged, all) = window("?seconds=1.5");
    assert_eq!((is_damaged, all.len()), (false, 150));
    for (frame, load) in all.iter().enumerate().skip(1) {
        assert_eq!(load[..2], [1.75, -1.75], "{frame}");
        let number = 50.0 + 10.0 * frame as f32;
        assert_eq!(load[2], number / 4.0, "{frame}: {load:?}");
        assert!(load[3..7].iter().all(|value| value.is_nan()), "the place of the plate is unknown");
        // Up to the next frame.
        assert_eq!(load[7..], [number / 4.0, (number + 9.0) / 4.0], "{frame}: {load:?}");
    }
    // Later parts, from the key block before them; and what is missing.
    let (is_damaged, part) = window("?from=1.9&seconds=0.2");
    assert!(is_damaged);
    let missing: Vec<usize> = (0..20).filter(|i| part[*i][2].is_nan()).collect();
    assert_eq!(missing, [5], "samples 2000 to 2009");
    let (_, last) = window("?from=2.5&seconds=1");
    assert_eq!(last.len(), 50);
    let is_there = |load: &Vec<f32>| load[2].is_finite();
    // Sample 2799 is the last, frame 275 the first without one.
    assert!(last[..25].iter().all(is_there) && !last[25..].iter().any(is_there), "{last:?}");
    let (_, thinned) = window("?seconds=3&every=100");
    assert_eq!(thinned.len(), 3);
    assert_eq!(thinned[0][8], (50.0 + 999.0) / 4.0, "{thinned:?}");
}
