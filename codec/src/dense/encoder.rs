//! The coding half of a group: what is stored raw, the walk, and the proof.

use super::{
    DenseDecoder,
    ahead::ROOM,
    choice::Encoding,
    code::TOGETHER,
    lattice::{Grid, UNITS_PER_TOLERANCE},
    walk::Group,
};
use crate::{
    BlockReport, CodecError, GROUP_CHANNELS, Rows, Tolerance,
    coding::range::{BinaryCoder, RangeEncoder},
    frame::{Payload, PayloadEncoder},
};

/// The odds of a block that is stored raw as a whole, in 2^-16.
pub(super) const STORED: u32 = 65536 - 8;

/// The encoder of one group.
#[derive(Debug)]
pub(crate) struct DenseEncoder {
    group: Group,
}

impl DenseEncoder {
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self { group: Group::new(Grid::new(tolerance)) }
    }

    #[cfg(feature = "training")]
    pub(crate) fn tally(&self) -> &super::training::Tally {
        &self.group.model.tally
    }
}

/// Of the f64 numbers, the largest whose root is not over the tolerance.
fn largest_square(grid: Grid) -> f64 {
    let tolerance_mm = grid.unit_mm * UNITS_PER_TOLERANCE as f64;
    let mut squares = tolerance_mm * tolerance_mm;
    while squares.sqrt() > tolerance_mm {
        squares = squares.next_down();
    }
    while squares.next_up().sqrt() <= tolerance_mm {
        squares = squares.next_up();
    }
    squares
}

/// The largest coordinate of a channel, which are finite; none when it has no samples.
fn largest(rows: Rows<'_>) -> Option<f32> {
    // Without their signs, their bits are in the order of the numbers.
    let (mut some, mut bits) = (false, 0);
    for (position, &present) in rows.positions().iter().zip(rows.present()) {
        let counted = if present { !(1 << 31) } else { 0 };
        let most = position.map(|coordinate| coordinate.to_bits() & counted);
        bits = most.into_iter().fold(bits, u32::max);
        some |= present;
    }
    some.then(|| f32::from_bits(bits))
}

impl Payload for DenseEncoder {
    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.group.prepare(n_channels, n_rows);
    }

    fn reset(&mut self) {
        self.group.reset();
    }

    fn break_off(&mut self) {
        self.group.break_off();
    }
}

impl PayloadEncoder for DenseEncoder {
    type Decoder = DenseDecoder;

    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        // Stored raw: the samples, and the end of the range coder.
        n_channels * n_rows * 12 + 8
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        _shared: &[u8],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<(), CodecError> {
        let start = out.len();
        // What is larger is stored raw.
        let limit = reports.iter().map(|report| report.samples as usize * 12).sum();
        let n_rows = channels.first().map_or(0, Rows::len);
        let mut side = Encoding {
            channels,
            grid: self.group.grid,
            coder: RangeEncoder::new(out, limit),
            reports,
            allowed: largest_square(self.group.grid),
            squares: [0.0; GROUP_CHANNELS],
            samples: [[0.0; ROOM]; 3],
            expected: [0.0; TOGETHER],
            off: [[0.0; ROOM]; 3],
        };
        side.coder.split(STORED, false);
        let mut present: [Option<&[bool]>; GROUP_CHANNELS] = [None; GROUP_CHANNELS];
        for (channel, rows) in channels.iter().enumerate() {
            let Some(max_mm) = largest(*rows) else {
                present[channel] = Some(rows.present());
                continue;
            };
            let fineness = side.grid.fineness(max_mm);
            if self.group.storage(&mut side.coder, channel, fineness).is_some() {
                present[channel] = Some(rows.present());
            } else {
                store(&mut side.coder, *rows);
                side.reports[channel].kept = side.reports[channel].samples;
            }
        }
        let coded = self.group.block(&mut side, n_rows, &present[..channels.len()]);
        let Encoding { coder, reports, squares, allowed, .. } = side;
        for (report, squares) in reports.iter_mut().zip(squares) {
            report.max_error_mm = squares.sqrt();
        }
        let within = squares.iter().all(|&squares| squares <= allowed);
        if coder.finish() && coded.is_ok() && within {
            return Ok(());
        }
        self.store_all(channels, start, out, reports);
        Ok(())
    }
}

impl DenseEncoder {
    /// A block that says less than its samples take: as they are, and everything forgotten.
    fn store_all(
        &mut self,
        channels: &[Rows<'_>],
        start: usize,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) {
        out.truncate(start);
        self.group.reset();
        let mut coder = RangeEncoder::new(out, usize::MAX);
        coder.split(STORED, true);
        for (rows, report) in channels.iter().zip(reports) {
            store(&mut coder, *rows);
            report.kept = report.samples;
            report.max_error_mm = 0.0;
        }
        let finished = coder.finish();
        debug_assert!(finished, "there is no limit");
    }
}

/// A channel's samples, bit by bit.
fn store(coder: &mut impl BinaryCoder, rows: Rows<'_>) {
    for sample in (0..rows.len()).filter_map(|row| rows.get(row)) {
        for coordinate in sample {
            coder.plain(u64::from(coordinate.to_bits()), 32);
        }
    }
}
