//! The choices that the format leaves to an encoder.

use super::{
    DenseDecoder,
    grid::{self, Grid, Point, STEP},
    walk::{Adaptive, Channel, Side},
};
use crate::{
    BlockReport, CodecError, Rows, Tolerance, bound,
    coding::{bytes::write_varint, range::RangeEncoder},
    frame::PayloadEncoder,
    raw::Raw,
};

/// The encoder of one group.
#[derive(Debug)]
pub(crate) struct DenseEncoder {
    tolerance_mm: f64,
    grid: Grid,
    channels: Vec<Channel>,
    /// What to go back to when a channel is abandoned.
    saved: Adaptive,
    raw: Raw,
}

impl DenseEncoder {
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self {
            tolerance_mm: tolerance.mm(),
            grid: Grid::new(tolerance),
            channels: Vec::new(),
            saved: Adaptive::default(),
            raw: Raw::default(),
        }
    }

    fn channel(&mut self, i: usize, rows: Rows<'_>, out: &mut Vec<u8>) -> Option<BlockReport> {
        let samples = rows.present().iter().filter(|&&present| present).count();
        let channel = &mut self.channels[i];
        self.saved.clone_from(&channel.adaptive);
        let mut side = Encoding {
            rows,
            grid: self.grid,
            tolerance_mm: self.tolerance_mm,
            coder: RangeEncoder::new(out, Raw::max_bytes(samples)),
            report: BlockReport::default(),
        };
        if channel.block(&mut side, rows.len(), rows.runs()).is_ok() {
            let Encoding { coder, report, .. } = side;
            if coder.finish() {
                return Some(report);
            }
        }
        channel.adaptive.clone_from(&self.saved);
        channel.break_off();
        None
    }
}

impl PayloadEncoder for DenseEncoder {
    type Decoder = DenseDecoder;

    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        n_channels * (11 + Raw::max_bytes(n_rows))
    }

    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        if self.channels.len() < n_channels {
            self.channels.resize_with(n_channels, Channel::default);
        }
        self.channels.iter_mut().for_each(|channel| channel.prepare(n_rows));
        self.raw.reserve(n_rows);
    }

    fn reset(&mut self) {
        self.channels.iter_mut().for_each(Channel::reset);
    }

    fn break_off(&mut self) {
        self.channels.iter_mut().for_each(Channel::break_off);
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        _shared: &[u8],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<(), CodecError> {
        self.prepare(channels.len(), 0);
        for (i, (rows, report)) in channels.iter().zip(reports).enumerate() {
            if report.samples == 0 {
                self.channels[i].break_off();
                continue;
            }
            let start = out.len();
            out.push(0);
            if let Some(coded) = self.channel(i, *rows, out) {
                *report = coded;
                let end = out.len();
                write_varint((end - start - 1) as u64, out);
                out[start + 1..].rotate_left(end - start - 1);
            } else {
                out.truncate(start);
                out.push(1);
                self.raw.write(*rows, out);
                report.kept = report.samples;
            }
        }
        Ok(())
    }
}

struct Encoding<'a> {
    rows: Rows<'a>,
    grid: Grid,
    tolerance_mm: f64,
    coder: RangeEncoder<'a>,
    report: BlockReport,
}

impl Encoding<'_> {
    fn error_mm(&self, row: usize, point: Point) -> f64 {
        bound::distance_mm(self.grid.position(point), self.rows.positions()[row])
    }

    /// The error of the lattice point at `steps`, if it is inside the ball.
    fn reaches(&self, row: usize, prediction: Point, steps: Point) -> Option<f64> {
        let point = std::array::from_fn(|axis| prediction[axis] + steps[axis] * STEP);
        Some(self.error_mm(row, point)).filter(|&error| error <= self.tolerance_mm)
    }
}

impl<'a> Side for Encoding<'a> {
    type Coder = RangeEncoder<'a>;

    fn coder(&mut self) -> &mut Self::Coder {
        &mut self.coder
    }

    fn choose(
        &mut self,
        row: usize,
        prediction: Point,
        finest: bool,
    ) -> Result<Option<Point>, CodecError> {
        const OUT_OF_REACH: CodecError = CodecError::Corrupt("a sample the lattice does not reach");
        if grid::in_range(prediction) && self.error_mm(row, prediction) <= self.tolerance_mm {
            return Ok(None);
        }
        let units = self.grid.units(self.rows.positions()[row]).ok_or(OUT_OF_REACH)?;
        let mut steps: Point = std::array::from_fn(|axis| {
            ((units[axis] - prediction[axis] as f64) / STEP as f64).round() as i64
        });
        if self.reaches(row, prediction, steps).is_none() {
            // Float32 rounding has carried the nearest point over the edge: a neighbour may do.
            steps = neighbours(steps)
                .filter_map(|steps| Some((self.reaches(row, prediction, steps)?, steps)))
                .min_by(|(a, _), (b, _)| a.total_cmp(b))
                .map(|(_, steps)| steps)
                .ok_or(OUT_OF_REACH)?;
        }
        if finest {
            // Nothing is predicted from these rows: the point closest to the prediction is cheapest.
            while let Some((_, shorter)) = shortenings(steps)
                .filter_map(|steps| Some((self.reaches(row, prediction, steps)?, steps)))
                .min_by(|(a, _), (b, _)| a.total_cmp(b))
            {
                steps = shorter;
            }
        }
        Ok(Some(steps))
    }

    fn settle(&mut self, row: usize, point: Point, kept: bool) {
        self.report.samples += 1;
        self.report.kept += u32::from(kept);
        self.report.max_error_mm = self.report.max_error_mm.max(self.error_mm(row, point));
    }
}

/// The 26 lattice points around one, and itself; never all zero, which would be a skip.
fn neighbours(steps: Point) -> impl Iterator<Item = Point> {
    (0..27_i64)
        .map(move |i| [steps[0] + i / 9 - 1, steps[1] + i / 3 % 3 - 1, steps[2] + i % 3 - 1])
        .filter(|steps| *steps != [0; 3])
}

/// One step nearer to the prediction on one axis.
fn shortenings(steps: Point) -> impl Iterator<Item = Point> {
    (0..3)
        .filter(move |&axis| steps[axis] != 0)
        .map(move |axis| {
            let mut shorter = steps;
            shorter[axis] -= steps[axis].signum();
            shorter
        })
        .filter(|steps| *steps != [0; 3])
}
