//! The contract of every resampler, checked on generated motion, on hostile bytes and on recorded takes.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod effort;
mod embedding;
mod exact;
mod groups;
mod hostile;
mod motions;
mod portable;
mod predictive;
mod round_trips;
mod state;
mod takes;

use mocapd_codec::{
    BlockReport, DecodedRows, Effort, Position, ResamplerKind, Rows, Settings, Tolerance,
};

/// The names of all resamplers.
const KINDS: [&str; 8] = [
    "dense",
    "fast",
    "lossless",
    "lossless:predictive",
    "spline:worst-sample",
    "spline:exhaustive",
    "sync:worst-sample",
    "sync:exhaustive",
];

/// One channel over one stretch.
#[derive(Debug, Clone)]
struct Channel {
    positions: Vec<Position>,
    present: Vec<bool>,
}

impl Channel {
    fn new(motion: &str, gaps: &str, seed: u64, n: usize) -> Self {
        Self {
            positions: motions::positions(motion, seed, n),
            present: motions::presence(gaps, seed, n),
        }
    }

    fn rows(&self) -> Rows<'_> {
        Rows::new(&self.positions, &self.present).unwrap()
    }

    fn part(&self, rows: std::ops::Range<usize>) -> Self {
        Self {
            positions: self.positions[rows.clone()].to_vec(),
            present: self.present[rows].to_vec(),
        }
    }
}

/// The channels of a group over the rows of one block.
#[derive(Debug, Clone)]
struct Stretch {
    channels: Vec<Channel>,
    key: bool,
}

impl Stretch {
    fn rows(&self) -> Vec<Rows<'_>> {
        self.channels.iter().map(Channel::rows).collect()
    }

    fn n_rows(&self) -> usize {
        self.channels[0].present.len()
    }
}

/// Cuts a group into stretches of the given lengths. The first stretch is a key, and stretch `i` where bit `i` of
/// `keys` is set.
fn cut(channels: &[Channel], lengths: &[usize], keys: u32) -> Vec<Stretch> {
    let mut at = 0;
    lengths
        .iter()
        .enumerate()
        .map(|(i, &len)| {
            let rows = at..at + len;
            at += len;
            Stretch {
                channels: channels.iter().map(|channel| channel.part(rows.clone())).collect(),
                key: i == 0 || keys >> i & 1 == 1,
            }
        })
        .collect()
}

/// One encoded block and the encoder's reports.
#[derive(Debug, Clone, PartialEq)]
struct Block {
    bytes: Vec<u8>,
    shared: Vec<u8>,
    reports: Vec<BlockReport>,
}

fn settings(kind: &str, tolerance_mm: f64) -> Settings {
    Settings {
        kind: kind.parse::<ResamplerKind>().unwrap(),
        tolerance: Tolerance::from_mm(tolerance_mm).unwrap(),
    }
}

/// Encodes all stretches of one group, each into a buffer of exactly `max_block_bytes`.
fn encode(settings: Settings, stretches: &[Stretch]) -> Vec<Block> {
    encode_with(settings, Effort::MIN, stretches)
}

/// Encodes like [`encode`] with an effort.
fn encode_with(settings: Settings, effort: Effort, stretches: &[Stretch]) -> Vec<Block> {
    let mut encoder = settings.encoder_with(effort);
    stretches
        .iter()
        .map(|stretch| {
            let rows = stretch.rows();
            let shared = settings.plan(&rows).unwrap();
            let room = settings.max_block_bytes(rows.len(), stretch.n_rows());
            let mut bytes = Vec::with_capacity(room);
            let capacity = bytes.capacity();
            let mut reports = vec![BlockReport::default(); rows.len()];
            encoder.encode(&rows, &shared, stretch.key, &mut bytes, &mut reports).unwrap();
            assert!(bytes.len() <= room, "{} bytes, but at most {room} are promised", bytes.len());
            assert_eq!(bytes.capacity(), capacity, "the buffer grew while encoding");
            Block { bytes, shared, reports }
        })
        .collect()
}

/// Decodes all blocks with one decoder and checks each.
fn decode_and_check(settings: Settings, stretches: &[Stretch], blocks: &[Block]) {
    let mut decoder = settings.decoder();
    let mut decoded = Vec::new();
    for (stretch, block) in stretches.iter().zip(blocks) {
        let Block { bytes, shared, .. } = block;
        decoder.decode(bytes, shared, stretch.n_rows(), stretch.key, &mut decoded).unwrap();
        check(settings, stretch, block, &decoded);
    }
}

/// Checks one decoded block against its samples and the encoder's reports.
fn check(settings: Settings, stretch: &Stretch, block: &Block, decoded: &[DecodedRows]) {
    assert_eq!(block.bytes.is_empty(), decoded.is_empty());
    assert!(decoded.len() <= stretch.channels.len());
    for (i, (channel, report)) in stretch.channels.iter().zip(&block.reports).enumerate() {
        let samples = channel.present.iter().filter(|&&p| p).count() as u32;
        assert_eq!(report.samples, samples);
        match decoded.get(i) {
            Some(rows) => check_channel(settings, channel, report, rows),
            None => assert_eq!((samples, *report), (0, BlockReport::default())),
        }
    }
}

fn check_channel(settings: Settings, channel: &Channel, report: &BlockReport, rows: &DecodedRows) {
    assert_eq!(rows.present, channel.present);
    let tolerance = settings.tolerance.mm();
    let mut worst = 0.0_f64;
    for (row, &present) in channel.present.iter().enumerate() {
        let (sample, rebuilt) = (channel.positions[row], rows.positions[row]);
        if !present {
            assert_eq!(rebuilt, [0.0; 3]);
            assert!(!rows.kept[row]);
        } else if settings.kind.is_lossless() {
            assert_eq!(sample.map(f32::to_bits), rebuilt.map(f32::to_bits), "row {row}");
        } else {
            let error = distance_mm(sample, rebuilt);
            assert!(error <= tolerance, "row {row}: {error} mm of {tolerance}");
            worst = worst.max(error);
        }
    }
    assert_eq!(report.max_error_mm, worst);
    assert!(rows.max_error_mm >= worst);
    assert!(rows.max_error_mm <= if settings.kind.is_lossless() { 0.0 } else { tolerance });
    assert_eq!(report.kept, rows.kept.iter().filter(|&&f| f).count() as u32);
}

fn distance_mm(a: Position, b: Position) -> f64 {
    let [x, y, z] = std::array::from_fn(|axis| f64::from(a[axis]) - f64::from(b[axis]));
    (x * x + y * y + z * z).sqrt()
}
