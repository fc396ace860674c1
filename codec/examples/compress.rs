//! Codes twenty markers for 25 seconds as a recorder does: half a second per block, a key every ten seconds.
//! Then decodes all blocks, decodes again from the second key as a player that seeks does, and checks the
//! error bound independently.
//!
//!     cargo run --release -p mocapd-codec --example compress

#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use std::ops::Range;

use mocapd_codec::{BlockReport, CodecError, Position, ResamplerKind, Rows, Settings, Tolerance};

const RATE_HZ: usize = 120;
const N_MARKERS: usize = 20;
const N_ROWS: usize = 25 * RATE_HZ;
const TOLERANCE_MM: f64 = 0.5;

/// One marker: a position in millimetres per row, and whether the marker was seen.
struct Marker {
    positions: Vec<Position>,
    present: Vec<bool>,
}

impl Marker {
    fn rows(&self, stretch: Range<usize>) -> Result<Rows<'_>, CodecError> {
        Rows::new(&self.positions[stretch.clone()], &self.present[stretch])
    }
}

/// A block and the arguments of its decoder. A file would store the number of rows of a full stretch once.
struct Block {
    bytes: Vec<u8>,
    shared: Vec<u8>,
    first_row: usize,
    n_rows: usize,
    key: bool,
}

fn main() -> Result<(), CodecError> {
    let markers = motion(2026);
    let samples: usize = markers.iter().flat_map(|m| &m.present).filter(|&&seen| seen).count();
    let raw_bytes = 12 * samples;
    println!("{samples} samples of {N_MARKERS} markers, {raw_bytes} bytes as float32");
    println!("{:<20} {:>8} {:>8} {:>14}", "resampler", "bytes", "ratio", "max error, mm");
    for name in ["dense", "fast", "lossless", "lossless:predictive", "spline", "sync"] {
        let kind: ResamplerKind = name.parse()?;
        let settings = Settings { kind, tolerance: Tolerance::from_mm(TOLERANCE_MM)? };
        let blocks = encode(&settings, &markers)?;
        let bytes: usize = blocks.iter().map(|block| block.bytes.len() + block.shared.len()).sum();
        let ratio = raw_bytes as f64 / bytes as f64;
        let error_mm = decode_and_check(&settings, &blocks, &markers)?;
        println!("{name:<20} {bytes:>8} {ratio:>6.1}:1 {error_mm:>14.4}");
    }
    Ok(())
}

/// Codes half a second per block with a live resampler, all rows in one block with an offline one.
fn encode(settings: &Settings, markers: &[Marker]) -> Result<Vec<Block>, CodecError> {
    let stretch_rows = if settings.kind.is_live() { RATE_HZ / 2 } else { N_ROWS };
    let mut encoder = settings.encoder();
    encoder.prepare(markers.len(), stretch_rows);
    let mut reports = vec![BlockReport::default(); markers.len()];
    let mut blocks = Vec::new();
    for first_row in (0..N_ROWS).step_by(stretch_rows) {
        let key = first_row % (10 * RATE_HZ) == 0;
        let stretch = first_row..(first_row + stretch_rows).min(N_ROWS);
        // A recorder reuses this list, the memory of `bytes` and the reports from block to block.
        let channels: Vec<_> =
            markers.iter().map(|marker| marker.rows(stretch.clone())).collect::<Result<_, _>>()?;
        let shared = settings.plan(&channels)?;
        let mut bytes = Vec::with_capacity(settings.max_block_bytes(channels.len(), stretch.len()));
        encoder.encode(&channels, &shared, key, &mut bytes, &mut reports)?;
        blocks.push(Block { bytes, shared, first_row, n_rows: stretch.len(), key });
    }
    Ok(blocks)
}

/// Decodes all blocks, then again from the second key on; returns the largest error found, in millimetres.
fn decode_and_check(
    settings: &Settings,
    blocks: &[Block],
    markers: &[Marker],
) -> Result<f64, CodecError> {
    let worst_mm = decode(settings, blocks, markers)?;
    let second_key = blocks.iter().skip(1).position(|block| block.key).map(|i| i + 1);
    if let Some(middle) = second_key {
        assert_eq!(blocks[middle].first_row, 10 * RATE_HZ);
        assert!(decode(settings, &blocks[middle..], markers)? <= worst_mm);
    }
    // The encoder has proven this already; the check here is independent of the crate.
    assert!(worst_mm <= if settings.kind.is_lossless() { 0.0 } else { TOLERANCE_MM });
    Ok(worst_mm)
}

/// The largest distance of a decoded sample from its original, in millimetres.
fn decode(settings: &Settings, blocks: &[Block], markers: &[Marker]) -> Result<f64, CodecError> {
    let mut decoder = settings.decoder();
    let mut decoded = Vec::new();
    let mut worst_mm = 0.0_f64;
    for block in blocks {
        decoder.decode(&block.bytes, &block.shared, block.n_rows, block.key, &mut decoded)?;
        // A block omits the last markers if they have not been seen since the key.
        for (i, marker) in markers.iter().enumerate() {
            for row in 0..block.n_rows {
                let seen = decoded.get(i).is_some_and(|rows| rows.present[row]);
                assert_eq!(seen, marker.present[block.first_row + row], "marker {i}, row {row}");
                if seen {
                    let original = marker.positions[block.first_row + row];
                    worst_mm = worst_mm.max(distance_mm(decoded[i].positions[row], original));
                }
            }
        }
    }
    Ok(worst_mm)
}

fn distance_mm(a: Position, b: Position) -> f64 {
    a.iter().zip(b).map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2)).sum::<f64>().sqrt()
}

/// Markers on a swaying body, each with its own swing and noise, and hidden now and then.
fn motion(seed: u64) -> Vec<Marker> {
    let mut random = Random(seed);
    let marker = |i: usize| {
        let (phase, swing_mm) = (random.next(), 20.0 + 200.0 * random.next().abs());
        let mut hidden_rows = 0;
        let (mut positions, mut present) = (Vec::new(), Vec::new());
        for row in 0..N_ROWS {
            let t_s = row as f32 / RATE_HZ as f32;
            let swing = swing_mm * (5.0 * t_s + 6.0 * phase).sin();
            let at =
                [400.0 * t_s.sin() + swing, 150.0 * (0.7 * t_s).cos(), 80.0 * i as f32 + swing];
            positions.push(at.map(|axis| axis + 0.05 * random.next()));
            if random.next() > 0.995 {
                hidden_rows = 10;
            }
            present.push(hidden_rows == 0);
            hidden_rows = usize::saturating_sub(hidden_rows, 1);
        }
        Marker { positions, present }
    };
    (0..N_MARKERS).map(marker).collect()
}

/// A small random generator (Knuth's MMIX constants) that gives the same numbers on every machine.
struct Random(u64);

impl Random {
    /// From -1 to 1.
    fn next(&mut self) -> f32 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_example_runs() {
        assert_eq!(super::main(), Ok(()));
    }
}
