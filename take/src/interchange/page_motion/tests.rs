//! Blocks of pages: bounds, gaps, poses, and arbitrary bytes.

use mocapd_testkit::random::Random;

use super::*;

/// A walk of `n` markers with gaps, and positions far away.
fn walk(seed: u64, n: usize, frames: usize) -> Vec<Position> {
    let mut random = Random::new(seed);
    let mut unit = || random.below(2001) as f32 / 1000.0 - 1.0;
    let mut at = vec![[0.0_f32; 3]; n];
    let mut positions = Vec::new();
    for frame in 0..frames {
        for (marker, place) in at.iter_mut().enumerate() {
            *place = place.map(|v| v + 9.0 * unit());
            let is_missing = marker == 1 || (marker == 2 && frame % 17 < 5);
            positions.push(if is_missing { GAP } else { *place });
        }
    }
    positions[0] = [1e30, -3.5, 0.0];
    positions
}

fn error_mm(a: Position, b: Position) -> f64 {
    a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(b)).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn a_block_is_decoded_within_its_bound_and_keeps_every_gap() {
    for (seed, n, frames) in [(1, 5, 300), (2, 1, 40), (3, 3, 1)] {
        let given = walk(seed, n, frames);
        for added_mm in [0.001, 0.5, 40.0] {
            let lattice = Lattice::within(added_mm);
            let mut bytes = Vec::new();
            let [stated, of_turns] = encode_block(&given, [n, 0], frames, lattice, &mut bytes);
            assert_eq!(of_turns, 0.0);
            let found = decode_block(&bytes, n, frames, lattice);
            assert_eq!(found.len(), given.len());
            assert_eq!(found[0], given[0], "too far away for the lattice");
            let mut worst = 0.0_f64;
            for (a, b) in given.iter().zip(&found) {
                assert_eq!(is_gap(*a), is_gap(*b));
                if !is_gap(*a) {
                    worst = worst.max(error_mm(*a, *b));
                }
            }
            assert!(worst <= added_mm && worst == stated, "{worst} {stated} {added_mm}");
        }
    }
}

/// The angle between two rotations, in degrees.
fn angle_degrees(a: [f32; 4], b: [f32; 4]) -> f64 {
    let [a, b] = [a, b].map(|q| q.map(f64::from));
    let length = |q: [f64; 4]| q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let (a, b) = (a.map(|v| v / length(a)), b.map(|v| v / length(b)));
    // Of the two that are the same rotation the nearer one; an arc cosine would lose half of the digits.
    let apart = |sign: f64| -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - sign * b).powi(2)).sum::<f64>().sqrt()
    };
    4.0 * (apart(1.0).min(apart(-1.0)) / 2.0).asin().to_degrees()
}

/// A body that turns about changing axes, at times fast, over every angle; and is lost for a while.
fn turning(frames: usize, speed: f64) -> Vec<Pose> {
    let mut q = [1.0_f64, 0.0, 0.0, 0.0];
    let poses = (0..frames).map(|frame| {
        let t = frame as f64 / 60.0;
        let axis = [t.sin(), (1.3 * t).cos(), (0.7 * t).sin()];
        let [w, x, y, z] = q;
        let [a, b, c] = axis.map(|v| v * speed / 120.0);
        // A small rotation is a product with 1 plus half of it.
        q = [
            w - a * x - b * y - c * z,
            x + a * w + b * z - c * y,
            y + b * w + c * x - a * z,
            z + c * w + a * y - b * x,
        ];
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        q = q.map(|v| v / length);
        if frame % 50 < 7 {
            let states = [PoseState::Lost, PoseState::Missing, PoseState::Unlisted];
            return Pose::without(states[frame / 50 % 3]);
        }
        let sign = if frame % 3 == 0 { -1.0 } else { 1.0 };
        Pose {
            state: PoseState::Tracked,
            position_mm: axis.map(|v| (800.0 * v) as f32),
            quaternion: q.map(|v| (sign * v) as f32),
            residual_mm: 0.2,
        }
    });
    poses.collect()
}

#[test]
fn poses_are_within_their_bounds_and_keep_their_states() {
    for speed in [0.0, 1.0, 25.0] {
        let poses = turning(600, speed);
        for added_mm in [0.001, 0.5, 20.0] {
            let lattice = Lattice::within(added_mm);
            let mut before = [0.0; 3];
            let given: Vec<Position> =
                poses.iter().flat_map(|pose| trajectories_of(pose, &mut before, lattice)).collect();
            let mut bytes = Vec::new();
            let [of_places, of_turns] =
                encode_block(&given, [0, 1], poses.len(), lattice, &mut bytes);
            assert!(of_places.max(of_turns) <= added_mm);
            let found = decode_block(&bytes, OF_BODY, poses.len(), lattice);
            let mut largest = 0.0_f64;
            for (pose, found) in poses.iter().zip(found.chunks_exact(OF_BODY)) {
                let found = pose_of([found[0], found[1]], lattice);
                assert_eq!(found.state, pose.state, "{speed} {added_mm}");
                if pose.is_tracked() {
                    assert!(error_mm(found.position_mm, pose.position_mm) <= of_places);
                    largest = largest.max(angle_degrees(found.quaternion, pose.quaternion));
                }
            }
            assert!(largest <= degrees(of_turns), "{largest} {of_turns}");
            assert!(degrees(of_turns) <= lattice.added_degrees());
            // The bound is not a wild guess, either.
            assert!(speed == 0.0 || largest > 0.2 * degrees(of_turns), "{largest} {of_turns}");
        }
    }
}

#[test]
fn every_rotation_and_every_state_has_a_turn() {
    let lattice = Lattice::within(0.1);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    for quaternion in [
        [1.0, 0.0, 0.0, 0.0],
        [-1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, -1.0, 0.0],
        [half, 0.0, 0.0, -half],
        [-1e-7, 1.0, 0.0, 0.0],
        // A device's, whose length is not quite 1.
        [0.6, 0.0, 0.79, 0.0],
    ] {
        let pose = Pose {
            state: PoseState::Tracked,
            position_mm: [1.0, 2.0, 3.0],
            quaternion,
            residual_mm: 0.0,
        };
        for mut before in [[0.0; 3], [1.9, 0.0, 0.0], [0.0, 0.0, -3.0]] {
            let found = pose_of(trajectories_of(&pose, &mut before, lattice), lattice);
            let apart = angle_degrees(found.quaternion, quaternion);
            assert!(apart < 1e-4, "{quaternion:?}: {apart}");
        }
    }
    for state in [
        PoseState::Lost,
        PoseState::Rejected,
        PoseState::Other,
        PoseState::Missing,
        PoseState::Refused,
        PoseState::Unlisted,
    ] {
        let found = trajectories_of(&Pose::without(state), &mut [0.0; 3], lattice);
        assert_eq!(pose_of(found, lattice).state, state);
    }
}

#[test]
fn arbitrary_bytes_decode_to_as_many_positions() {
    let mut random = Random::new(7);
    for n in 0..200 {
        let bytes: Vec<u8> = (0..n).map(|_| random.below(256) as u8).collect();
        let lattice = Lattice::within(1.0);
        let found = decode_block(&bytes, 3, 20, lattice);
        assert_eq!(found.len(), 60);
        for two in found.windows(2) {
            let _pose = pose_of([two[0], two[1]], lattice);
        }
    }
}

#[test]
fn base64_as_in_the_rfc() {
    for (bytes, text) in [
        ("", ""),
        ("f", "Zg=="),
        ("fo", "Zm8="),
        ("foo", "Zm9v"),
        ("foob", "Zm9vYg=="),
        ("foobar", "Zm9vYmFy"),
    ] {
        assert_eq!(base64(bytes.as_bytes()), text);
    }
}
