//! Detection of phases in generated jumps with known phases.

use mocapd_report::phases::{NoJump, Phase, find, parts};
use mocapd_simulator::generator::{JumpSpec, Phase as Truth};
use mocapd_take::motion::{GAP, UpAxis};

use crate::support::assert_mentions;

/// Tolerance of the start of a phase, seconds. The start of the first swing is too slow to be detected; a
/// walk is detected by its first step, after its true start.
fn slack_s(phase: Phase) -> (f64, f64) {
    match phase {
        Phase::Swings => (0.0, 0.12),
        Phase::TakeOff => (0.0, 0.09),
        Phase::Walking => (0.0, 0.40),
        _ => (-0.04, 0.04),
    }
}

fn truth(phase: Truth) -> Phase {
    Phase::from_name(phase.name()).unwrap()
}

#[test]
fn phases_of_generated_jumps_are_found() {
    for seed in 0..12 {
        for rate_hz in [60.0, 120.0, 500.0] {
            let jump = JumpSpec::new(seed, rate_hz).generate().unwrap();
            let found = find(&jump.motion).unwrap();
            let expected: Vec<_> = jump.phases.iter().map(|(phase, _)| truth(*phase)).collect();
            assert_eq!(found.iter().map(|(phase, _)| *phase).collect::<Vec<_>>(), expected);
            for ((phase, frame), (_, true_frame)) in found.iter().zip(&jump.phases) {
                let late_s = (*frame as f64 - *true_frame as f64) / rate_hz;
                let (early, late) = slack_s(*phase);
                // A frame at 60 Hz is 17 ms.
                assert!(
                    (early - 0.02..late + 0.02).contains(&late_s),
                    "seed {seed}, {rate_hz} Hz: {} is {late_s:.3} s late",
                    phase.name()
                );
            }
        }
    }
}

#[test]
fn every_jump_of_a_long_take_is_found() {
    let spec = JumpSpec { seconds: Some(45.0), ..JumpSpec::new(3, 60.0) };
    let jump = spec.generate().unwrap();
    let found = find(&jump.motion).unwrap();
    let flights = |phases: Vec<(Phase, usize)>| -> Vec<usize> {
        let flights = phases.into_iter().filter(|(phase, _)| *phase == Phase::Flight);
        flights.map(|(_, frame)| frame).collect()
    };
    let expected = flights(jump.phases.iter().map(|(p, frame)| (truth(*p), *frame)).collect());
    let found = flights(found);
    assert!(expected.len() >= 3 && found.len() == expected.len(), "{found:?} {expected:?}");
    for (found, expected) in found.iter().zip(&expected) {
        assert!(found.abs_diff(*expected) <= 3, "{found} {expected}");
    }
}

#[test]
fn gaps_and_axes_do_not_hide_a_jump() {
    let mut jump = JumpSpec::new(5, 120.0).generate().unwrap();
    let expected = find(&jump.motion).unwrap();
    // Y up, which the file does not state.
    jump.motion.info.up = UpAxis::Unknown;
    jump.motion.positions_mm.iter_mut().for_each(|at| *at = [at[1], at[2], at[0]]);
    assert_eq!(find(&jump.motion).unwrap(), expected);
    // A tenth of a second without the pelvis, while standing.
    let n = jump.motion.info.markers.len();
    (20..32).for_each(|row| jump.motion.positions_mm[row * n + 2] = GAP);
    assert_eq!(find(&jump.motion).unwrap(), expected);
}

#[test]
fn motions_without_a_jump_have_no_phases() {
    let mut walk = JumpSpec::new(2, 60.0).generate().unwrap();
    let from = walk.phases.last().unwrap().1;
    let n = walk.motion.info.markers.len();
    walk.motion.positions_mm.drain(..from * n);
    assert_eq!(find(&walk.motion), Err(NoJump::NeverInFlight));
    walk.motion.positions_mm.fill(GAP);
    assert!(matches!(find(&walk.motion), Err(NoJump::NeverSeen(_))));
    walk.motion.info.markers.iter_mut().for_each(|marker| marker.label.push('x'));
    let nameless = find(&walk.motion).unwrap_err();
    assert!(matches!(nameless, NoJump::NoMarker(_)));
    assert_mentions(&nameless.to_string(), &["pelvis"]);
    walk.motion.positions_mm.clear();
    assert!(find(&walk.motion).is_err());
}

#[test]
fn parts_end_where_the_next_begins() {
    let found = parts(&[(Phase::Swings, 3), (Phase::TakeOff, 7), (Phase::Walking, 30)], 20);
    let frames: Vec<_> = found.iter().map(|part| (part.phase, part.frames.clone())).collect();
    assert_eq!(frames, [(Phase::Swings, 3..7), (Phase::TakeOff, 7..20)]);
}
