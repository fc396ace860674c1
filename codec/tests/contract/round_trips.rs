//! Round trips: for any motion, gaps, tolerance and blocks the bound holds and all counts agree.

use mocapd_codec::{BlockReport, CodecError, Position, Rows};
use proptest::prelude::*;

use super::{
    Channel, KINDS, Stretch, cut, decode_and_check, encode,
    motions::{MOTIONS, PRESENCES},
    settings,
};

fn round_trip(kind: &str, tolerance_mm: f64, stretches: &[Stretch]) {
    let settings = settings(kind, tolerance_mm);
    let blocks = encode(settings, stretches);
    assert_eq!(blocks, encode(settings, stretches), "the same samples gave other bytes");
    decode_and_check(settings, stretches, &blocks);
}

#[test]
fn every_motion_presence_and_kind() {
    for kind in KINDS {
        let (lengths, tolerances): (&[usize], &[f64]) = if kind.ends_with("exhaustive") {
            (&[40, 1, 9], &[0.5])
        } else {
            (&[60, 1, 30, 7, 130, 2], &[1e-4, 0.03, 1.0, 1e3])
        };
        let n = lengths.iter().sum();
        for motion in MOTIONS {
            for gaps in PRESENCES {
                for &tolerance in tolerances {
                    let channels = [
                        Channel::new(motion, gaps, 7, n),
                        Channel::new("smooth", "late", 8, n),
                        Channel::new(motion, gaps, 9, n),
                    ];
                    round_trip(kind, tolerance, &cut(&channels, lengths, 0b01_0000));
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn any_group(
        kind in proptest::sample::select(vec!["dense", "fast", "lossless", "lossless:predictive", "spline", "sync"]),
        channels in proptest::collection::vec(
            (
                proptest::sample::select(MOTIONS.to_vec()),
                proptest::sample::select(PRESENCES.to_vec()),
                any::<u64>(),
            ),
            1..6,
        ),
        lengths in proptest::collection::vec(0_usize..140, 1..6),
        keys in any::<u32>(),
        exponent in -4.0..3.0_f64,
    ) {
        let n = lengths.iter().sum();
        let channels: Vec<_> = channels
            .into_iter()
            .map(|(motion, gaps, seed)| Channel::new(motion, gaps, seed, n))
            .collect();
        round_trip(kind, 10_f64.powf(exponent), &cut(&channels, &lengths, keys));
    }

    /// Arbitrary bit patterns: finite samples keep the bound; the others are absent.
    #[test]
    fn any_bits(
        kind in proptest::sample::select(vec!["dense", "fast", "lossless", "lossless:predictive", "spline", "sync"]),
        bits in proptest::collection::vec(any::<[[u32; 3]; 2]>(), 1..50),
    ) {
        let channels = (0..2).map(|i| {
            let positions: Vec<Position> = bits.iter().map(|p| p[i].map(f32::from_bits)).collect();
            let present = positions.iter().map(|p| p.iter().all(|v| v.is_finite())).collect();
            Channel { positions, present }
        });
        round_trip(kind, 0.5, &[Stretch { channels: channels.collect(), key: true }]);
    }
}

#[test]
fn a_sample_that_is_not_finite_is_refused_and_changes_nothing() {
    for kind in KINDS {
        let settings = settings(kind, 0.5);
        let channels: Vec<_> = (0..3).map(|i| Channel::new("smooth", "all", i, 60)).collect();
        let good = cut(&channels, &[30, 30], 0);
        let mut bad = good[1].clone();
        bad.channels[2].positions[17][1] = f32::NAN;
        let mut encoder = settings.encoder();
        let mut out = vec![1, 2, 3];
        let mut reports = [BlockReport::default(); 3];
        let shared: Vec<Vec<u8>> = good.iter().map(|s| settings.plan(&s.rows()).unwrap()).collect();
        encoder.encode(&good[0].rows(), &shared[0], true, &mut out, &mut reports).unwrap();
        let before = out.clone();
        let error =
            encoder.encode(&bad.rows(), &shared[1], true, &mut out, &mut reports).unwrap_err();
        assert!(
            matches!(&error, CodecError::InvalidArgument(m) if m.contains("row 17")),
            "{error}"
        );
        assert_eq!(out, before);
        encoder.encode(&good[1].rows(), &shared[1], false, &mut out, &mut reports).unwrap();
        let expected: Vec<u8> =
            encode(settings, &good).into_iter().flat_map(|block| block.bytes).collect();
        assert_eq!(out[3..], expected, "{kind}: the refused block changed the state");
        // The bits of an absent sample do not matter.
        bad.channels[2].present[17] = false;
        round_trip(kind, 0.5, &[Stretch { key: true, ..bad }]);
    }
}

#[test]
fn one_plan_serves_channels_with_different_motion() {
    let settings = settings("sync", 0.2);
    let channels: Vec<Channel> = ["smooth", "walk", "steps", "constant", "line"]
        .iter()
        .zip(["all", "gaps", "late", "singles", "none"])
        .map(|(motion, gaps)| Channel::new(motion, gaps, 11, 300))
        .collect();
    let stretches = cut(&channels, &[300], 0);
    let blocks = encode(settings, &stretches);
    decode_and_check(settings, &stretches, &blocks);
    // A raw channel would have no error at all.
    assert!(blocks[0].reports[1].max_error_mm > 0.0, "the plan holds for every channel");
    let rows = stretches[0].rows();
    let odd = Rows::new(&rows[0].positions()[..9], &[true; 9]).unwrap();
    assert!(matches!(settings.plan(&[rows[0], odd]), Err(CodecError::InvalidArgument(_))));
}

#[test]
fn a_plan_of_other_samples_keeps_the_bound() {
    let settings = settings("sync", 0.2);
    let walk = Channel::new("walk", "all", 5, 80);
    let (mut out, mut reports) = (Vec::new(), [BlockReport::default()]);
    settings.encoder().encode(&[walk.rows()], &[], true, &mut out, &mut reports).unwrap();
    assert_eq!((reports[0].kept, reports[0].max_error_mm), (80, 0.0));
    let mut decoded = Vec::new();
    settings.decoder().decode(&out, &[], 80, true, &mut decoded).unwrap();
    assert_eq!(decoded[0].positions, walk.positions);
}

#[test]
fn the_exhaustive_search_refuses_long_runs() {
    let settings = settings("spline:exhaustive", 1.0);
    let long = Channel::new("line", "all", 1, 1025);
    let (mut out, mut reports) = (Vec::new(), [BlockReport::default()]);
    let mut encoder = settings.encoder();
    let error = encoder.encode(&[long.rows()], &[], true, &mut out, &mut reports).unwrap_err();
    assert!(matches!(&error, CodecError::InvalidArgument(m) if m.contains("1024")), "{error}");
    assert!(out.is_empty());
    let fits = long.part(0..1024);
    // After this error the encoder needs a key block.
    let next = encoder.encode(&[fits.rows()], &[], false, &mut out, &mut reports);
    assert_eq!(next, Err(CodecError::OutOfStep));
    assert!(encoder.encode(&[fits.rows()], &[], true, &mut out, &mut reports).is_ok());
}
