//! `lossless:predictive`: the number format of a file is detected, and no block is larger than that of `lossless`.

use mocapd_codec::{CodecError, Position, Rows};

use super::{
    Channel, cut, decode_and_check, encode,
    motions::{Random, presence},
    settings,
};

const PREDICTIVE: &str = "lossless:predictive";

/// Twelve markers on one body, 0.04 mm of noise, in millimetres, as a file holds them: `stored` makes a coordinate in f64
/// the float32 that an importer reads.
fn body(n_rows: usize, gaps: &str, stored: impl Fn(f64) -> f32) -> Vec<Channel> {
    let mut random = Random(7);
    let offsets: Vec<Position> = (0..12).map(|_| random.vector(400.0)).collect();
    let channel = |(marker, offset): (usize, &Position)| {
        let mut random = Random(marker as u64);
        let positions = (0..n_rows).map(|row| {
            let t = row as f64 / 100.0 + 0.02 * marker as f64;
            let path =
                [900.0 * (0.9 * t).sin(), 80.0 * (5.0 * t).cos(), 1000.0 + 60.0 * (7.0 * t).sin()];
            std::array::from_fn(|axis| {
                // Four uniform numbers are nearly normal.
                let noise: f64 = (0..4).map(|_| f64::from(random.signed())).sum();
                stored(path[axis] + f64::from(offset[axis]) + 0.035 * noise)
            })
        });
        Channel { positions: positions.collect(), present: presence(gaps, marker as u64, n_rows) }
    };
    offsets.iter().enumerate().map(channel).collect()
}

/// Bytes of all blocks of `lossless` and of `lossless:predictive`; every bit of the latter is compared.
fn bytes(channels: &[Channel], lengths: &[usize], keys: u32) -> (usize, usize) {
    let stretches = cut(channels, lengths, keys);
    let [columns, predicted] = ["lossless", PREDICTIVE].map(|kind| {
        let blocks = encode(settings(kind, 1.0), &stretches);
        decode_and_check(settings(kind, 1.0), &stretches, &blocks);
        blocks.iter().map(|block| block.bytes.len()).sum()
    });
    (columns, predicted)
}

#[track_caller]
fn assert_smaller(name: &str, channels: &[Channel], least: f64) {
    let n_rows = channels[0].present.len();
    let (columns, predicted) = bytes(channels, &[n_rows], 0);
    let ratio = columns as f64 / predicted as f64;
    assert!(ratio >= least, "{name}: {columns} bytes, {predicted} predicted, {ratio:.3} < {least}");
}

/// Text with this number of decimals, in a unit of `unit_mm` millimetres.
fn text(decimals: i32, unit_mm: f64) -> impl Fn(f64) -> f32 {
    let ten = 10_f64.powi(decimals);
    move |mm| ((mm / unit_mm * ten).round() / ten * unit_mm) as f32
}

/// 16-bit integers times the scale of a C3D file, a float32, in a unit of `unit_mm` millimetres.
fn integers(scale: f32, unit_mm: f64) -> impl Fn(f64) -> f32 {
    move |mm| {
        let word = (mm / unit_mm / f64::from(scale)).round().clamp(-32768.0, 32767.0);
        (word * f64::from(scale) * unit_mm) as f32
    }
}

#[test]
fn number_formats_of_files_are_detected() {
    // The ratios reached are 3 % to 20 % higher.
    assert_smaller("int16, 0.1 mm", &body(1000, "all", integers(0.1, 1.0)), 4.5);
    assert_smaller("int16, 0.05 cm", &body(1000, "all", integers(0.005, 10.0)), 4.0);
    assert_smaller("int16, metres", &body(1000, "all", integers(1e-4, 1000.0)), 4.5);
    assert_smaller("3 decimals", &body(1000, "all", text(3, 1.0)), 1.5);
    assert_smaller("6 decimals of metres", &body(1000, "all", text(6, 1000.0)), 1.5);
    assert_smaller("5 decimals", &body(1000, "all", text(5, 1.0)), 1.04);
    assert_smaller("float32", &body(1000, "all", |mm| mm as f32), 1.04);
    assert_smaller(
        "float32 metres",
        &body(1000, "all", |mm| (f64::from((mm / 1000.0) as f32) * 1000.0) as f32),
        1.04,
    );
}

#[test]
fn markers_with_gaps_stay_small() {
    for gaps in ["gaps", "late", "singles"] {
        let channels = body(1000, gaps, integers(0.1, 1.0));
        let (columns, predicted) = bytes(&channels, &[1000], 0);
        assert!(predicted * 2 < columns, "{gaps}: {columns} bytes, {predicted} predicted");
    }
}

#[test]
fn blocks_continue_each_other() {
    let channels = body(1000, "gaps", text(3, 1.0));
    let (_, whole) = bytes(&channels, &[1000], 0);
    let (_, continued) = bytes(&channels, &[50; 20], 0);
    let (_, keys) = bytes(&channels, &[50; 20], u32::MAX);
    assert!(continued < whole * 6 / 5, "{continued} bytes in 20 blocks, {whole} in one");
    assert!(continued < keys * 9 / 10, "{continued} bytes, {keys} in key blocks");
}

#[test]
fn no_block_is_larger_than_columns() {
    let mut random = Random(3);
    let noise: Vec<Position> =
        (0..90).map(|_| [0; 3].map(|_| f32::from_bits(random.below(1 << 30) as u32))).collect();
    let channel = |positions: &[Position]| Channel {
        positions: positions.to_vec(),
        present: vec![true; positions.len()],
    };
    // Single frames, noise, and zeros of both signs; what follows noise continues.
    let mut mixed = noise.clone();
    mixed.extend((0..90).map(|row| [row as f32, -0.0, 0.0]));
    for (channels, lengths) in [
        (vec![channel(&noise[..1]); 3], vec![1]),
        (vec![channel(&noise)], vec![90]),
        (vec![channel(&mixed); 2], vec![90, 90]),
    ] {
        for (columns, predicted) in
            [bytes(&channels, &lengths, u32::MAX), bytes(&channels, &lengths, 1)]
        {
            // One byte states the form.
            assert!(predicted <= columns + lengths.len(), "{predicted} bytes of {columns}");
        }
    }
}

#[test]
fn samples_that_are_not_finite_are_refused() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let positions = [[0.0; 3], [1.0, bad, 2.0]];
        let mut encoder = settings(PREDICTIVE, 1.0).encoder();
        let (mut out, mut reports) = (Vec::new(), [mocapd_codec::BlockReport::default()]);
        let rows = [Rows::new(&positions, &[true, true]).unwrap()];
        let outcome = encoder.encode(&rows, &[], true, &mut out, &mut reports);
        assert!(matches!(outcome, Err(CodecError::InvalidArgument(_))), "{outcome:?}");
        assert!(out.is_empty());
        let rows = [Rows::new(&positions, &[true, false]).unwrap()];
        encoder.encode(&rows, &[], true, &mut out, &mut reports).unwrap();
    }
}
