//! Any motion, any gaps, any tolerance, any cut into blocks: the bound holds and all counts agree.

use mocapd_codec::{CodecError, DecodedRows, Position, Rows};
use proptest::prelude::*;

use super::{
    KINDS, Stretch, check, distance_mm, encode,
    motions::{MOTIONS, PRESENCES, positions, presence},
    settings,
};

/// A channel cut into blocks of the given lengths; a key block wherever `keys` has its bit.
fn stretches(motion: &str, gaps: &str, seed: u64, lengths: &[usize], keys: u32) -> Vec<Stretch> {
    let n = lengths.iter().sum();
    let (positions, present) = (positions(motion, seed, n), presence(gaps, seed, n));
    let mut at = 0;
    lengths
        .iter()
        .enumerate()
        .map(|(i, &len)| {
            let part = at..at + len;
            at += len;
            Stretch {
                positions: positions[part.clone()].to_vec(),
                present: present[part].to_vec(),
                key: i == 0 || keys >> i & 1 == 1,
            }
        })
        .collect()
}

fn round_trip(kind: &str, tolerance_mm: f64, stretches: &[Stretch]) {
    let settings = settings(kind, tolerance_mm);
    let blocks = encode(settings, stretches);
    assert_eq!(blocks, encode(settings, stretches), "the same samples gave other bytes");
    let mut decoder = settings.decoder();
    let mut decoded = DecodedRows::default();
    for (stretch, block) in stretches.iter().zip(&blocks) {
        let n = stretch.present.len();
        decoder.decode(&block.bytes, &block.shared, n, stretch.key, &mut decoded).unwrap();
        check(settings, stretch, block, &decoded);
    }
}

#[test]
fn every_motion_presence_and_kind() {
    for kind in KINDS {
        let (lengths, tolerances): (&[usize], &[f64]) = if kind.ends_with("exhaustive") {
            (&[40, 1, 9], &[0.5])
        } else {
            (&[60, 1, 30, 7, 130, 2], &[1e-4, 0.03, 1.0, 1e3])
        };
        for motion in MOTIONS {
            for gaps in PRESENCES {
                for &tolerance in tolerances {
                    round_trip(kind, tolerance, &stretches(motion, gaps, 7, lengths, 0b01_0000));
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn any_channel(
        kind in proptest::sample::select(vec!["dense", "fast", "lossless", "spline", "sync"]),
        motion in proptest::sample::select(MOTIONS.to_vec()),
        gaps in proptest::sample::select(PRESENCES.to_vec()),
        seed in any::<u64>(),
        lengths in proptest::collection::vec(0_usize..140, 1..6),
        keys in any::<u32>(),
        exponent in -4.0..3.0_f64,
    ) {
        round_trip(kind, 10_f64.powf(exponent), &stretches(motion, gaps, seed, &lengths, keys));
    }

    /// Bit patterns as they come: whatever is finite is kept within the bound, whatever is not is refused.
    #[test]
    fn any_bits(
        kind in proptest::sample::select(vec!["dense", "fast", "lossless", "spline", "sync"]),
        bits in proptest::collection::vec(any::<[u32; 3]>(), 1..50),
    ) {
        let positions: Vec<Position> = bits.iter().map(|p| p.map(f32::from_bits)).collect();
        let present = positions.iter().map(|p| p.iter().all(|v| v.is_finite())).collect();
        round_trip(kind, 0.5, &[Stretch { positions, present, key: true }]);
    }
}

#[test]
fn a_sample_that_is_not_finite_is_refused_and_nothing_is_changed() {
    for kind in KINDS {
        let settings = settings(kind, 0.5);
        let good = stretches("smooth", "all", 3, &[30, 30], 0);
        let mut bad = good[1].clone();
        bad.positions[17][1] = f32::NAN;
        let mut encoder = settings.encoder();
        let mut out = vec![1, 2, 3];
        let shared: Vec<Vec<u8>> =
            good.iter().map(|s| settings.plan(&[s.rows()]).unwrap()).collect();
        encoder.encode(good[0].rows(), &shared[0], true, &mut out).unwrap();
        let before = out.clone();
        let error = encoder.encode(bad.rows(), &shared[1], true, &mut out).unwrap_err();
        assert!(
            matches!(&error, CodecError::InvalidArgument(m) if m.contains("row 17")),
            "{error}"
        );
        assert_eq!(out, before);
        encoder.encode(good[1].rows(), &shared[1], false, &mut out).unwrap();
        let expected: Vec<u8> =
            encode(settings, &good).into_iter().flat_map(|block| block.bytes).collect();
        assert_eq!(out[3..], expected, "{kind}: the refused block left a trace");
        // Where it is absent its bits do not matter.
        bad.present[17] = false;
        round_trip(kind, 0.5, &[Stretch { key: true, ..bad }]);
    }
}

#[test]
fn one_plan_serves_channels_that_move_apart() {
    let settings = settings("sync", 0.2);
    let channels: Vec<Stretch> = ["smooth", "walk", "steps", "constant", "line"]
        .iter()
        .zip(["all", "gaps", "late", "singles", "none"])
        .map(|(motion, gaps)| stretches(motion, gaps, 11, &[300], 0).remove(0))
        .collect();
    let rows: Vec<Rows<'_>> = channels.iter().map(Stretch::rows).collect();
    let shared = settings.plan(&rows).unwrap();
    let mut decoded = DecodedRows::default();
    for channel in &channels {
        let mut out = Vec::new();
        let report = settings.encoder().encode(channel.rows(), &shared, true, &mut out).unwrap();
        assert_eq!(report.recoded, 0, "the plan holds for every channel");
        settings.decoder().decode(&out, &shared, 300, true, &mut decoded).unwrap();
        for (row, (a, b)) in channel.positions.iter().zip(&decoded.positions).enumerate() {
            assert!(!channel.present[row] || distance_mm(*a, *b) <= 0.2);
        }
    }
    let short = &rows[0].positions()[..9];
    let odd = Rows::new(short, &[true; 9]).unwrap();
    assert!(matches!(settings.plan(&[rows[0], odd]), Err(CodecError::InvalidArgument(_))));
}

#[test]
fn a_plan_of_other_samples_costs_bytes_but_not_the_bound() {
    let settings = settings("sync", 0.2);
    let walk = stretches("walk", "all", 5, &[80], 0).remove(0);
    let mut out = Vec::new();
    let report = settings.encoder().encode(walk.rows(), &[], true, &mut out).unwrap();
    assert_eq!((report.recoded, report.kept, report.max_error_mm), (1, 80, 0.0));
    let mut decoded = DecodedRows::default();
    settings.decoder().decode(&out, &[], 80, true, &mut decoded).unwrap();
    assert_eq!(decoded.positions, walk.positions);
}

#[test]
fn the_exhaustive_search_refuses_what_would_take_minutes() {
    let settings = settings("spline:exhaustive", 1.0);
    let long = stretches("line", "all", 1, &[1025], 0).remove(0);
    let mut out = Vec::new();
    let error = settings.encoder().encode(long.rows(), &[], true, &mut out).unwrap_err();
    assert!(error.to_string().contains("at most 1024 samples"), "{error}");
    assert!(out.is_empty());
    let fits = stretches("line", "all", 1, &[1024], 0).remove(0);
    assert!(settings.encoder().encode(fits.rows(), &[], true, &mut out).is_ok());
}
