use mocapd_take::motion::is_gap;

use super::arithmetic::{V3, add, scale};
use super::*;

fn site(name: &str) -> usize {
    SITES.iter().position(|s| *s == name).unwrap()
}

fn at(jump: &Jump, frame: usize, name: &str) -> V3 {
    jump.motion.frame(frame)[site(name)].map(f64::from)
}

fn distance(a: V3, b: V3) -> f64 {
    arithmetic::norm(arithmetic::sub(a, b))
}

fn span(jump: &Jump, phase: Phase) -> std::ops::Range<usize> {
    let index = jump.phases.iter().position(|(p, _)| *p == phase).unwrap();
    let end = jump.phases.get(index + 1).map_or(jump.motion.n_frames(), |(_, first)| *first);
    jump.phases[index].1..end
}

/// Largest speed of a site over some frames, m/s.
fn top_speed(jump: &Jump, name: &str, frames: std::ops::Range<usize>) -> f64 {
    let rate = jump.motion.info.rate_hz;
    frames
        .skip(1)
        .map(|f| distance(at(jump, f, name), at(jump, f - 1, name)) * rate / 1000.0)
        .fold(0.0, f64::max)
}

#[test]
fn bones_keep_their_lengths() {
    for seed in 0..12 {
        let spec = JumpSpec { seconds: Some(30.0), ..JumpSpec::new(seed, 120.0) };
        let jump = spec.clean().generate().unwrap();
        for (a, b) in BONES {
            let length = |f: usize| distance(at(&jump, f, SITES[a]), at(&jump, f, SITES[b]));
            let first = length(0);
            for frame in 0..jump.motion.n_frames() {
                let off = (length(frame) - first).abs();
                assert!(off < 1e-3, "seed {seed} frame {frame} {}-{}: {off}", SITES[a], SITES[b]);
            }
        }
    }
}

#[test]
fn a_seed_gives_the_same_bits_in_every_version() {
    let spec = JumpSpec {
        n_markers: 40,
        seconds: Some(20.0),
        occlusion: Some(Occlusion { fraction: 0.1, mean_gap_s: 0.2 }),
        ..JumpSpec::new(1, 60.0)
    };
    let jump = spec.generate().unwrap();
    assert_eq!(jump.motion.n_frames(), 1200);
    // FNV-1a over the bits. If this fails, every take that was described by its seed has changed.
    let hash = jump.motion.positions_mm.iter().flatten().fold(0xcbf2_9ce4_8422_2325u64, |h, v| {
        (h ^ u64::from(v.to_bits())).wrapping_mul(0x0100_0000_01b3)
    });
    assert_eq!(hash, 0x2f9e_119c_e34f_2a8f, "{hash:#x}");
    let other = JumpSpec { seed: 2, ..spec }.generate().unwrap();
    assert_ne!(other.motion.frame(0), jump.motion.frame(0));
}

#[test]
fn phases_come_in_order_and_again_in_the_next_trial() {
    let jump = JumpSpec { seconds: Some(40.0), ..JumpSpec::new(3, 60.0) }.generate().unwrap();
    let order = [
        Phase::Standing,
        Phase::Swings,
        Phase::LastSwing,
        Phase::TakeOff,
        Phase::Flight,
        Phase::Settling,
        Phase::Walking,
    ];
    for (i, (phase, _)) in jump.phases.iter().enumerate() {
        assert_eq!(*phase, order[i % order.len()]);
    }
    assert!(jump.phases.len() > 14, "{}", jump.phases.len());
    assert!(jump.phases.windows(2).all(|w| w[0].1 < w[1].1));
    assert_eq!(jump.phases[0].1, 0);
}

#[test]
fn flight_is_a_parabola_under_gravity() {
    for seed in 0..12 {
        let jump = JumpSpec::new(seed, 240.0).clean().generate().unwrap();
        let flight = span(&jump, Phase::Flight);
        // The second derivative of a parabola, from the far ends and the middle.
        let n = (flight.len() - 1) / 2;
        let z = |f: usize| at(&jump, flight.start + f, "pelvis")[2] / 1000.0;
        let h = n as f64 / 240.0;
        let g = -(z(2 * n) - 2.0 * z(n) + z(0)) / (h * h);
        assert!((g / 9.81 - 1.0).abs() < 0.02, "seed {seed}: {g}");
        for f in 1..2 * n {
            let x = f as f64 / (2 * n) as f64;
            let line = z(0) * (1.0 - x) + z(2 * n) * x;
            let parabola = line + 0.5 * 9.81 * (x * (1.0 - x)) * (2.0 * h) * (2.0 * h);
            assert!((z(f) - parabola).abs() < 2e-3, "seed {seed} frame {f}");
        }
    }
}

#[test]
fn jumps_are_humanly_possible() {
    for seed in 0..40 {
        let jump = JumpSpec::new(seed, 240.0).clean().generate().unwrap();
        let all = 0..jump.motion.n_frames();
        let wrist = top_speed(&jump, "l_wrist", all.clone());
        assert!((5.0..15.0).contains(&wrist), "seed {seed}: wrist {wrist} m/s");
        for name in SITES {
            let speed = top_speed(&jump, name, all.clone());
            assert!(speed < 15.0, "seed {seed}: {name} {speed} m/s");
        }
        let walking = top_speed(&jump, "pelvis", span(&jump, Phase::Walking));
        assert!(walking < 1.5, "seed {seed}: walks at {walking} m/s");
        let take_off = span(&jump, Phase::TakeOff);
        assert!((0.25..0.35).contains(&(take_off.len() as f64 / 240.0)));
        // The body accelerates until the feet leave the ground.
        let speed = |f: usize| distance(at(&jump, f, "pelvis"), at(&jump, f - 1, "pelvis"));
        let n = take_off.len();
        let thirds = [1, 2, 3].map(|k| speed(take_off.start + k * (n - 1) / 3));
        assert!(thirds[0] < thirds[1] && thirds[1] < thirds[2], "seed {seed}: {thirds:?}");
        let landed = span(&jump, Phase::Walking).start;
        let jumped = at(&jump, landed, "l_ankle")[0] - at(&jump, 0, "l_ankle")[0];
        assert!((1950.0..2650.0).contains(&jumped), "seed {seed}: {jumped} mm");
        for f in all {
            for name in SITES {
                assert!(at(&jump, f, name)[2] > 40.0, "seed {seed} frame {f}: {name} in the floor");
            }
        }
    }
}

#[test]
fn feet_stay_planted() {
    for seed in 0..12 {
        let jump = JumpSpec::new(seed, 60.0).clean().generate().unwrap();
        for frame in 0..span(&jump, Phase::TakeOff).start {
            for foot in ["l_ankle", "r_ankle"] {
                let moved = distance(at(&jump, frame, foot), at(&jump, 0, foot));
                assert!(moved < 1.0, "seed {seed} frame {frame} {foot}: {moved} mm");
            }
        }
    }
}

#[test]
fn motion_is_smooth_everywhere() {
    // Halving the step must make the largest second difference about four times smaller; at a jump or a kink
    // it would stay or only halve.
    for seed in 0..6 {
        let worst = |rate: f64| {
            let spec = JumpSpec { seconds: Some(28.0), ..JumpSpec::new(seed, rate) };
            let jump = spec.clean().generate().unwrap();
            let mut worst = (0.0f64, 0, "");
            for f in 1..jump.motion.n_frames() - 1 {
                for name in SITES {
                    let [a, b, c] = [f - 1, f, f + 1].map(|f| at(&jump, f, name));
                    let second = distance(add(a, c), scale(b, 2.0)) * rate * rate / 1e6;
                    if second > worst.0 {
                        worst = (second, f, name);
                    }
                }
            }
            worst
        };
        let (coarse, fine) = (worst(240.0), worst(960.0));
        assert!(fine.0 < 1.5 * coarse.0 && fine.0 < 1.0, "seed {seed}: {coarse:?} {fine:?} km/s^2");
    }
}

#[test]
fn long_takes_stay_in_the_volume() {
    let jump = JumpSpec { seconds: Some(300.0), ..JumpSpec::new(5, 60.0) }.generate().unwrap();
    for position in &jump.motion.positions_mm {
        assert!(position[0].abs() < 6000.0 && position[1].abs() < 3500.0, "{position:?}");
        assert!((0.0..2600.0).contains(&position[2]));
    }
}

#[test]
fn noise_has_the_requested_deviation() {
    for noise_mm in [0.05, 0.4] {
        let spec = JumpSpec { noise_mm, soft_tissue_mm: 0.0, ..JumpSpec::new(11, 1000.0) };
        let jump = spec.generate().unwrap();
        for name in ["head", "pelvis", "r_ankle"] {
            for axis in 0..3 {
                let v: Vec<f64> =
                    (0..jump.motion.n_frames()).map(|f| at(&jump, f, name)[axis]).collect();
                // Fourth difference: variance 70 sigma^2; the median of |x| is 0.6745 of a normal's sigma.
                let mut fourth: Vec<f64> = v
                    .windows(5)
                    .map(|w| (w[0] - 4.0 * w[1] + 6.0 * w[2] - 4.0 * w[3] + w[4]).abs())
                    .collect();
                fourth.sort_by(f64::total_cmp);
                let sigma = fourth[fourth.len() / 2] / 0.6745 / 70f64.sqrt();
                assert!((sigma / noise_mm - 1.0).abs() < 0.05, "{name} {axis}: {sigma}");
            }
        }
    }
}

#[test]
fn soft_tissue_vibrates_only_after_landing() {
    let spec = JumpSpec { noise_mm: 0.0, n_markers: 60, ..JumpSpec::new(4, 240.0) };
    let (soft, hard) = (spec.generate().unwrap(), spec.clean().generate().unwrap());
    let off = |f: usize, m: usize| {
        distance(soft.motion.frame(f)[m].map(f64::from), hard.motion.frame(f)[m].map(f64::from))
    };
    let touch_down = span(&soft, Phase::Settling).start;
    let thigh = soft.motion.info.markers.iter().position(|m| m.label == "l_thigh_1").unwrap();
    assert!((0..touch_down).all(|f| off(f, thigh) == 0.0));
    let most = (touch_down..touch_down + 120).map(|f| off(f, thigh)).fold(0.0, f64::max);
    assert!((1.0..6.0).contains(&most), "{most} mm");
}

#[test]
fn occlusion_removes_the_requested_fraction() {
    for fraction in [0.02, 0.3, 0.9] {
        let occlusion = Some(Occlusion { fraction, mean_gap_s: 0.15 });
        let jump = JumpSpec { occlusion, ..JumpSpec::new(9, 120.0) }.generate().unwrap();
        let n = jump.motion.n_frames();
        for marker in 0..15 {
            let gaps = (0..n).filter(|f| is_gap(jump.motion.frame(*f)[marker])).count();
            assert_eq!(gaps, (fraction * n as f64).round() as usize, "marker {marker}");
        }
    }
}

#[test]
fn clusters_are_rigid_and_extra_markers_change_nothing_else() {
    let spec = JumpSpec { n_markers: 200, ..JumpSpec::new(6, 60.0) };
    let jump = spec.generate().unwrap();
    let few = JumpSpec { n_markers: 15, ..spec }.generate().unwrap();
    let labels: std::collections::HashSet<_> = jump
        .motion
        .info
        .markers
        .iter()
        .collect::<Vec<_>>()
        .into_iter()
        .map(|m| m.label.as_str())
        .collect();
    assert_eq!(labels.len(), 200);
    for f in (0..few.motion.n_frames()).step_by(17) {
        assert_eq!(few.motion.frame(f), &jump.motion.frame(f)[..15]);
    }
    let clean = spec.clean().generate().unwrap();
    let index =
        |label: &str| clean.motion.info.markers.iter().position(|m| m.label == label).unwrap();
    for (a, b) in
        [("l_shank_1", "l_shank_4"), ("trunk_2", "trunk_3"), ("r_forearm_1", "r_forearm_2")]
    {
        let length = |f: usize| {
            let frame = clean.motion.frame(f);
            distance(frame[index(a)].map(f64::from), frame[index(b)].map(f64::from))
        };
        for f in 0..clean.motion.n_frames() {
            assert!((length(f) - length(0)).abs() < 2e-3, "{a} {b} frame {f}");
        }
    }
}

#[test]
fn values_out_of_range_are_refused_by_name() {
    let spec = JumpSpec::new(1, 60.0);
    let bad = [
        (JumpSpec { rate_hz: 0.0, ..spec }, "rate_hz"),
        (JumpSpec { rate_hz: f64::NAN, ..spec }, "rate_hz"),
        (JumpSpec { n_markers: 0, ..spec }, "markers"),
        (JumpSpec { n_markers: 10_001, ..spec }, "markers"),
        (JumpSpec { seconds: Some(-1.0), ..spec }, "seconds"),
        (JumpSpec { noise_mm: -0.1, ..spec }, "noise_mm"),
    ];
    for (spec, name) in bad {
        let error = spec.generate().unwrap_err();
        let named = |what: &str| what.contains(name);
        assert!(
            matches!(error, GenerateError::OutOfRange { what, .. } if named(what)),
            "{name}: {error:?}"
        );
    }
    let error = JumpSpec { seconds: Some(1e6), rate_hz: 10_000.0, ..spec }.generate().unwrap_err();
    assert!(matches!(error, GenerateError::TooLong { .. }), "{error:?}");
    assert_eq!(JumpSpec { seconds: Some(1e-4), ..spec }.generate().unwrap().motion.n_frames(), 1);
}
