//! Importers and exporters together: generated files of every dialect, round trips, hostile bytes, real takes.

#![expect(clippy::expect_used, clippy::panic, reason = "helpers of tests")]

mod c3d;
mod c3d_file;
#[cfg(feature = "full")]
mod columns;
mod events;
mod forces;
mod hostile;
#[cfg(test)]
mod poses;
#[cfg(test)]
mod recorded;
mod restored;
mod round_trip;
mod subjects;
mod takes;
mod text;
mod written;

use mocapd_take::motion::{Motion, is_gap};

/// Panics unless both have identical samples, bit by bit; a gap equals a gap.
fn assert_same_samples(found: &Motion, expected: &Motion) {
    assert_eq!(found.positions_mm.len(), expected.positions_mm.len());
    for (index, (&a, &b)) in found.positions_mm.iter().zip(&expected.positions_mm).enumerate() {
        assert_eq!(is_gap(a), is_gap(b), "sample {index}: {a:?} for {b:?}");
        if !is_gap(b) {
            assert_eq!(a.map(f32::to_bits), b.map(f32::to_bits), "sample {index}: {a:?} for {b:?}");
        }
    }
}

/// The whole numbers in a text.
fn numbers(text: &str) -> Vec<u64> {
    text.split(|c: char| !c.is_alphanumeric()).filter_map(|word| word.parse().ok()).collect()
}

/// The labels of a motion.
fn labels(motion: &Motion) -> Vec<&str> {
    motion.info.markers.iter().map(|marker| marker.label.as_str()).collect()
}
