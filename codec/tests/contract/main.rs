//! What every resampler promises, checked on generated motion, on hostile bytes and on real takes.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod hostile;
mod motions;
mod round_trips;
mod state;
mod takes;

use mocapd_codec::{BlockReport, DecodedRows, Position, ResamplerKind, Rows, Settings, Tolerance};

/// Every resampler by name.
const KINDS: [&str; 7] = [
    "dense",
    "fast",
    "lossless",
    "spline:worst-sample",
    "spline:exhaustive",
    "sync:worst-sample",
    "sync:exhaustive",
];

/// One block's worth of a channel.
#[derive(Debug, Clone)]
struct Stretch {
    positions: Vec<Position>,
    present: Vec<bool>,
    key: bool,
}

impl Stretch {
    fn rows(&self) -> Rows<'_> {
        Rows::new(&self.positions, &self.present).unwrap()
    }
}

/// One encoded block, with what the encoder said about it.
#[derive(Debug, Clone, PartialEq)]
struct Block {
    bytes: Vec<u8>,
    shared: Vec<u8>,
    report: BlockReport,
}

fn settings(kind: &str, tolerance_mm: f64) -> Settings {
    Settings {
        kind: kind.parse::<ResamplerKind>().unwrap(),
        tolerance: Tolerance::from_mm(tolerance_mm).unwrap(),
    }
}

/// Encodes all stretches of one channel, each into exactly the room that was promised to be enough.
fn encode(settings: Settings, stretches: &[Stretch]) -> Vec<Block> {
    let mut encoder = settings.encoder();
    stretches
        .iter()
        .map(|stretch| {
            let shared = settings.plan(&[stretch.rows()]).unwrap();
            let room = settings.max_block_bytes(stretch.present.len());
            let mut bytes = Vec::with_capacity(room);
            let capacity = bytes.capacity();
            let report = encoder.encode(stretch.rows(), &shared, stretch.key, &mut bytes).unwrap();
            assert!(bytes.len() <= room, "{} bytes in a room of {room}", bytes.len());
            assert_eq!(bytes.capacity(), capacity, "the room was outgrown on the way");
            Block { bytes, shared, report }
        })
        .collect()
}

/// Checks one decoded block against its samples and everything that was said about it.
fn check(settings: Settings, stretch: &Stretch, block: &Block, decoded: &DecodedRows) {
    assert_eq!(decoded.present, stretch.present);
    let tolerance = settings.tolerance.mm();
    let mut worst = 0.0_f64;
    for (row, &present) in stretch.present.iter().enumerate() {
        let (sample, rebuilt) = (stretch.positions[row], decoded.positions[row]);
        if !present {
            assert_eq!(rebuilt, [0.0; 3]);
            assert!(!decoded.kept[row]);
        } else if settings.kind.is_lossless() {
            assert_eq!(sample.map(f32::to_bits), rebuilt.map(f32::to_bits), "row {row}");
        } else {
            let error = distance_mm(sample, rebuilt);
            assert!(error <= tolerance, "row {row}: {error} mm of {tolerance}");
            worst = worst.max(error);
        }
    }
    assert_eq!(block.report.max_error_mm, worst);
    assert!(decoded.max_error_mm >= worst);
    if !settings.kind.is_lossless() {
        assert!(decoded.max_error_mm <= tolerance);
    }
    let count = |flags: &[bool]| flags.iter().filter(|&&f| f).count() as u32;
    assert_eq!(block.report.samples, count(&stretch.present));
    assert_eq!(block.report.kept, count(&decoded.kept));
    assert_eq!(block.bytes.is_empty(), block.report.samples == 0);
}

fn distance_mm(a: Position, b: Position) -> f64 {
    let [x, y, z] = std::array::from_fn(|axis| f64::from(a[axis]) - f64::from(b[axis]));
    (x * x + y * y + z * z).sqrt()
}
