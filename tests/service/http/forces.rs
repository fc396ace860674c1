//! The forces of a recording for a player: those of its stated plates at the times of its frames.

use std::{fs, io::Cursor};

use mocapd_drivers::device::{SampleBatch, SampleForm, SampledChannelInfo, SampledGroupInfo};
use mocapd_take::{TakeFrames, interchange::Format, motion::UpAxis, record::StatedPlate};

use super::{client::get, serve};
use crate::support::{TICK_HZ, config, dense, feed, jump, start_with};

/// Samples of a channel in a batch, and in a second.
const BATCH: u64 = 10;
const RATE_HZ: u64 = 1000;

/// A plate whose z axis points down: the upward force is a quarter of the number of the sample, 250 N a second.
fn group() -> SampledGroupInfo {
    let channel = |(name, unit): (&str, &str)| SampledChannelInfo {
        name: name.to_owned(),
        unit: unit.to_owned(),
        scale: 0.25,
        offset: 0.0,
    };
    // Names do not make a plate.
    let units = ["V", "N", "N", "N", "N m", "N m", "N m"];
    SampledGroupInfo {
        id: 3,
        form: SampleForm::Int16,
        rate_millihertz: 1_000_000,
        channels: units.map(|unit| channel(("Fz1", unit))).into(),
    }
}

/// A vector of a take whose z axis points up, in the axes of one whose y axis may.
fn turned(up: UpAxis, [x, y, z]: [f64; 3]) -> [f64; 3] {
    if up == UpAxis::Y { [x, z, -y] } else { [x, y, z] }
}

fn corners(up: UpAxis) -> [[f64; 3]; 4] {
    let (x, y) = ([400.0, -200.0], [250.0, -150.0]);
    let corners = [[x[0], y[1]], [x[1], y[1]], [x[1], y[0]], [x[0], y[0]]];
    corners.map(|[x, y]| turned(up, [x, y, 5.0]))
}

/// A take of three seconds, whose samples begin a twentieth of a second before the frames and lack a batch.
fn take(up: UpAxis, states_plate: bool) -> Vec<u8> {
    let motion = jump(4, 100.0, 3.0);
    let mut config = config(&motion, dense(0.5));
    config.sampled = vec![group()];
    let plate = StatedPlate {
        number: 2,
        code: 2,
        group: 3,
        channels: (1..7).collect(),
        corners_mm: corners(up),
        origin_mm: [0.0; 3],
    };
    let (mut intake, recording) = start_with(&config, Vec::new(), |header| {
        header.up_axis = up;
        header.settings.extend(states_plate.then(|| plate.setting()));
    });
    let mut next = 0;
    for seq in 0..motion.n_frames() {
        while intake.is_full() {
            std::thread::yield_now();
        }
        // Sample 50 is taken with frame 0.
        let taken = 50 + seq as u64 * RATE_HZ / 100;
        while next + BATCH <= taken {
            // No negative zero, which an integer is not.
            let sample = |n: u64| [1.0, 7.0, -7.0, 0.0 - n as f32, -20.0, 40.0, 8.0];
            let samples: Vec<f32> = (next..next + BATCH).flat_map(sample).collect();
            let ticks = (next as i64 - 50) * (TICK_HZ / RATE_HZ) as i64;
            // The device ends its samples before its frames.
            if next != 2000 && next < 2800 {
                intake.samples(&SampleBatch {
                    group: 3,
                    number: (next / BATCH) as u32,
                    first: next,
                    device_ticks: ticks as u64,
                    form: SampleForm::Int16,
                    n_channels: 7,
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

/// The load of a sample, by hand: the plate's y and z axes are those of the laboratory, reversed.
fn load(up: UpAxis, number: f64) -> Vec<f64> {
    let upward = number / 4.0;
    // The centre of pressure from the centre of the plate, in the plate's axes: -My/Fz and Mx/Fz.
    let (x_m, y_m) = (10.0 / upward, 5.0 / upward);
    let cop = turned(up, [100.0 + 1000.0 * x_m, 50.0 - 1000.0 * y_m, 5.0]);
    let free_moment = 2.0 + x_m * 1.75 + y_m * 1.75;
    [&turned(up, [1.75, 1.75, upward])[..], &cop, &[free_moment, upward]].concat()
}

#[test]
fn frames_have_the_forces_on_the_subject_at_their_times() {
    for up in [UpAxis::Z, UpAxis::Y] {
        frames_have_forces(up);
    }
}

fn frames_have_forces(up: UpAxis) {
    let served = serve();
    fs::write(served.folder.path().join("takes/jump.take"), take(up, true)).unwrap();
    let plates = get(served.at, "/v1/takes/jump/plates").json();
    let expected = serde_json::json!([{ "name": "2", "corners_mm": corners(up) }]);
    assert_eq!(plates["plates"], expected);
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
    let close = |found: f32, expected: f64| (f64::from(found) - expected).abs() < 1e-3;
    for (frame, found) in all.iter().enumerate().skip(5) {
        let number = 50.0 + 10.0 * frame as f64;
        let expected = load(up, number);
        let is_same = found.iter().zip(&expected).all(|(found, expected)| close(*found, *expected));
        assert!(is_same, "{frame}: {found:?} {expected:?}");
        // Up to the next frame.
        assert!(close(found[8], (number + 9.0) / 4.0), "{frame}: {found:?}");
    }
    assert!(all[1][0] == 1.75 && all[1][3..7].iter().all(|v| v.is_nan()), "below 20 N");
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

#[test]
fn channels_without_a_stated_plate_are_none_in_the_player() {
    let served = serve();
    fs::write(served.folder.path().join("takes/jump.take"), take(UpAxis::Z, false)).unwrap();
    fs::write(served.folder.path().join("takes/bare.take"), super::take()).unwrap();
    for name in ["jump", "bare"] {
        let plates = get(served.at, &format!("/v1/takes/{name}/plates")).json();
        assert_eq!(
            (&plates["plates"], &plates["unusable"]),
            (&serde_json::json!([]), &serde_json::json!([]))
        );
    }
}

#[test]
fn a_c3d_file_of_a_recording_is_that_of_an_export() {
    let served = serve();
    let take = take(UpAxis::Z, true);
    fs::write(served.folder.path().join("takes/jump.take"), &take).unwrap();
    let answer = get(served.at, "/v1/takes/jump/download?format=c3d");
    let mut frames = TakeFrames::open(Cursor::new(take.clone())).unwrap();
    frames.open_recording(Cursor::new(take), false).unwrap();
    let mut exported = Vec::new();
    Format::C3d.write(&mut frames, &mut exported).unwrap();
    assert!(answer.body == exported, "{} {}", answer.body.len(), exported.len());
    let read = Format::C3d.read(&exported).unwrap();
    assert!(read.info.foreign.iter().any(|part| part.kind == "c3d/analog"));
}
