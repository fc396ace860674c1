use proptest::{collection::vec, prelude::*};

use super::{Fast, tans::Reader};
use crate::{
    BlockReport, CodecError, DecodedRows, Position, Rows, Tolerance,
    coding::isa::Isa,
    frame::{Payload, PayloadDecoder, PayloadEncoder},
};

/// The samples of a channel; `None` in gaps.
type Samples = Vec<Option<Position>>;

struct Pair {
    encoder: Fast,
    decoder: Fast,
    tolerance_mm: f64,
}

impl Pair {
    fn new(tolerance_mm: f64, isa: Isa) -> Self {
        let tolerance = Tolerance::from_mm(tolerance_mm).unwrap();
        Self {
            encoder: Fast::with_isa(tolerance, isa),
            decoder: Fast::with_isa(tolerance, isa),
            tolerance_mm,
        }
    }

    fn reset(&mut self) {
        self.encoder.reset();
        self.decoder.reset();
    }

    /// Codes one block, decodes it, and checks the error bound and the reports.
    fn block(&mut self, group: &[Samples]) -> (Vec<u8>, Vec<DecodedRows>) {
        let split = |track: &Samples| -> (Vec<Position>, Vec<bool>) {
            (
                track.iter().map(|s| s.unwrap_or([f32::NAN; 3])).collect(),
                track.iter().map(Option::is_some).collect(),
            )
        };
        let parts: Vec<_> = group.iter().map(split).collect();
        let rows: Vec<_> = parts.iter().map(|(x, p)| Rows::new(x, p).unwrap()).collect();
        let samples = |track: &Samples| track.iter().flatten().count() as u32;
        let mut reports: Vec<_> = group
            .iter()
            .map(|track| BlockReport { samples: samples(track), ..BlockReport::default() })
            .collect();
        if reports.iter().all(|report| report.samples == 0) {
            self.encoder.forget_rows();
            self.decoder.forget_rows();
            return (Vec::new(), blank(group));
        }
        let mut payload = vec![7; 3];
        let n_rows = group.iter().map(Vec::len).max().unwrap_or(0);
        let mut kept_rows = vec![false; n_rows];
        self.encoder.encode(&rows, false, &mut payload, &mut reports, &mut kept_rows).unwrap();
        assert_eq!(payload[..3], [7; 3]);
        let payload = payload.split_off(3);
        assert!(payload.len() <= Fast::max_payload_bytes(group.len(), n_rows));
        let mut decoded = blank(group);
        self.decoder.decode(&payload, &mut decoded).unwrap();
        for (row, kept) in kept_rows.into_iter().enumerate() {
            assert_eq!(decoded.iter().any(|rows| rows.kept[row]), kept, "row {row}");
        }
        for ((track, rows), report) in group.iter().zip(&decoded).zip(&reports) {
            let mut worst = 0.0_f64;
            for (sample, back) in track.iter().zip(&rows.positions) {
                match sample {
                    Some(sample) => worst = worst.max(crate::block::distance_mm(*sample, *back)),
                    None => assert_eq!(*back, [0.0; 3]),
                }
            }
            assert!(worst <= self.tolerance_mm, "{worst}");
            assert_eq!(worst, report.max_error_mm);
            assert_eq!(rows.kept.iter().filter(|k| **k).count(), report.kept as usize);
            assert!(rows.kept.iter().zip(&rows.present).all(|(kept, present)| *present || !kept));
        }
        (payload, decoded)
    }
}

fn blank(group: &[Samples]) -> Vec<DecodedRows> {
    group
        .iter()
        .map(|track| DecodedRows {
            positions: vec![[0.0; 3]; track.len()],
            present: track.iter().map(Option::is_some).collect(),
            kept: vec![false; track.len()],
            max_error_mm: 0.0,
        })
        .collect()
}

/// Smooth motion with noise, gaps, jumps, a far origin and extreme values.
fn track(n_rows: usize) -> impl Strategy<Value = Samples> {
    let offset = prop_oneof![Just(0.0_f32), Just(1e3), Just(-1e7), -1e4..1e4_f32];
    let odd = prop_oneof![
        Just(None),
        Just(Some([0.0; 3])),
        Just(Some([-0.0, 1e-45, -1e-40])),
        Just(Some([f32::MAX, f32::MIN, 3e38])),
        (-1e6..1e6_f32).prop_map(|x| Some([x, -x, x * 0.5])),
    ];
    let odds = prop_oneof![Just(0.0), Just(0.02), Just(0.5)];
    (offset, 0.0..1e3_f32, 0.0..0.5_f32, prop_oneof![Just(0.0_f32), 0.0..3_f32], odds)
        .prop_flat_map(move |(offset, size, speed, noise, odds)| {
            let cell = prop_oneof![
                // Weights must not be zero: one in a thousand means none.
                1000 => (-1.0..1.0_f32).prop_map(Ok),
                1 + (1000.0 * odds) as u32 => odd.clone().prop_map(Err),
            ];
            vec(cell, n_rows).prop_map(move |cells| {
                let sample = |(row, cell): (usize, &Result<f32, Option<Position>>)| match cell {
                    Ok(random) => {
                        let angle = row as f32 * speed;
                        let at =
                            |phase: f32| offset + size * (angle + phase).sin() + noise * random;
                        Some([at(0.0), at(1.0), at(2.5)])
                    }
                    Err(odd) => *odd,
                };
                cells.iter().enumerate().map(sample).collect()
            })
        })
}

/// Blocks of a group: the same number of channels throughout.
fn blocks() -> impl Strategy<Value = Vec<Vec<Samples>>> {
    let n_rows = prop_oneof![Just(1_usize), 1..40_usize, Just(33), 1..300_usize];
    (1..5_usize)
        .prop_flat_map(move |n| vec(n_rows.clone().prop_flat_map(move |r| vec(track(r), n)), 1..5))
}

fn tolerance() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(1e-4),
        Just(1e6),
        Just(0.1),
        Just(1.0),
        Just(20.0),
        (-4.0..6.0_f64).prop_map(|e| 10_f64.powf(e))
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn every_sample_is_within_the_tolerance_and_both_instruction_sets_agree(
        tolerance in tolerance(),
        blocks in blocks(),
        reset_at in 0..5_usize,
    ) {
        let mut wide = Pair::new(tolerance, Isa::detect());
        let mut plain = Pair::new(tolerance, Isa::plain());
        for (i, block) in blocks.iter().enumerate() {
            if i == reset_at {
                wide.reset();
                plain.reset();
            }
            let (payload, decoded) = wide.block(block);
            let (other, other_decoded) = plain.block(block);
            prop_assert_eq!(payload, other);
            prop_assert_eq!(decoded, other_decoded);
        }
    }

    #[test]
    fn any_bytes_give_an_error_or_finite_samples(
        tolerance in tolerance(),
        blocks in blocks(),
        noise in vec(any::<u8>(), 0..200),
        changes in vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut pair = Pair::new(tolerance, Isa::detect());
        for block in &blocks {
            let (good, _) = pair.block(block);
            let mut bad = good.clone();
            for (at, value) in &changes {
                if !bad.is_empty() {
                    let at = at.index(bad.len());
                    bad[at] ^= value;
                }
            }
            for bytes in [&bad[..], &good[..cut.index(good.len() + 1)], &noise[..]] {
                let mut decoder = Fast::new(Tolerance::from_mm(tolerance).unwrap());
                let mut decoded = blank(block);
                if decoder.decode(bytes, &mut decoded).is_ok() {
                    let mut all = decoded.iter().flat_map(|rows| rows.positions.iter().flatten());
                    prop_assert!(all.all(|x| x.is_finite()));
                }
            }
        }
    }
}

#[test]
fn a_still_marker_costs_almost_nothing() {
    let mut pair = Pair::new(1.0, Isa::detect());
    let still: Vec<Samples> = vec![vec![Some([100.0, 200.0, 300.0]); 500]; 10];
    pair.block(&still);
    let (payload, decoded) = pair.block(&still);
    assert!(payload.len() < 30, "{} bytes", payload.len());
    assert!(decoded.iter().all(|rows| rows.kept.iter().all(|k| !k)));
}

#[test]
fn only_a_channel_out_of_range_is_stored_raw() {
    let mut pair = Pair::new(0.1, Isa::detect());
    let near: Samples = (0..100).map(|row| Some([row as f32, 0.0, 1.0])).collect();
    let far: Samples = near.iter().map(|s| s.map(|[x, y, z]| [x + 1e20, y, z])).collect();
    let (payload, decoded) = pair.block(&[near.clone(), far.clone(), near.clone()]);
    assert_eq!(payload[..3], [0, 4, 0]);
    let back: Samples = decoded[1].positions.iter().map(|p| Some(*p)).collect();
    assert_eq!(back, far);
    // A raw channel can be coded in the next block, and the other way round.
    let (payload, _) = pair.block(&[far, near.clone(), near]);
    assert_eq!(payload[..3], [4, 0, 0]);
}

#[test]
fn a_payload_needs_its_end_mark() {
    let mut padded = Vec::new();
    Reader::pad(&[0], &mut padded);
    assert!(Reader::new(&padded).is_err());
    Reader::pad(&[], &mut padded);
    assert!(matches!(Reader::new(&padded), Err(CodecError::Truncated(_))));
}
