//! `spline` and `sync`: the methods of (Shi et al. 2012) on a natural cubic spline.
//!
//! `spline` samples asynchronously: every channel has its own greedily chosen knots. It works offline: a block should
//! be a whole take, so that only gaps end runs. `sync` samples synchronously, for comparison: one set of key times for
//! all channels (equations 5 and 7). A channel keeps its samples at the key times and both ends of each of its runs;
//! the key times are stored outside the block, once for all channels.
//!
//! The natural cubic spline goes through samples at whole rows, and is given by its second derivatives (moments). Inside an interval of length `h` from knot 0 to knot 1, with `a = (x1 - x)/h` and `b = 1 - a`: `y = a y0 + b y1 +
//! ((a^3 - a) M0 + (b^3 - b) M1) h^2 / 6` (de Boor, A Practical Guide to Splines, chapter IV). It uses additions,
//! multiplications and divisions in f64 in a fixed order, so that every machine gets the same bits.

mod knots;

pub use self::knots::SplineVariant;
pub(crate) use self::knots::plan;
use self::knots::resample_run;
use crate::{
    BlockReport, CodecError, DecodedRows, Position, Result, Rows, Tolerance,
    block::{self, Vector, widen},
    coding::{Bytes, write_varint},
    ensure,
    frame::{Payload, PayloadDecoder, PayloadEncoder},
    lossless::{Histories, Raw},
};

/// First byte of a coded channel.
const CODED: u8 = 0;

/// First byte of a channel that is stored exactly.
const RAW: u8 = 1;

/// Bytes of a stored position: three little-endian float32.
const POSITION_BYTES: usize = 12;

/// Maximum number of bytes of a channel's knots: a position and two bytes of time per sample.
const fn max_bytes(samples: usize) -> usize {
    (POSITION_BYTES + 2) * samples
}

/// The rows that a channel keeps.
#[derive(Debug)]
enum Times {
    /// Its own knots.
    Own(SplineVariant),
    /// The key times of the stretch, one flag per row.
    Shared(Vec<bool>),
}

/// Encoder and decoder of one group. It has no state between blocks.
#[derive(Debug)]
pub(crate) struct Spline {
    tolerance: Tolerance,
    times: Times,
    fit: RunFit,
    raw: Raw,
}

impl Spline {
    fn new(tolerance: Tolerance, times: Times) -> Self {
        Self { tolerance, times, fit: RunFit::default(), raw: Raw::default() }
    }

    /// The method `spline`.
    pub(crate) fn asynchronous(tolerance: Tolerance, variant: SplineVariant) -> Self {
        Self::new(tolerance, Times::Own(variant))
    }

    /// The method `sync`.
    pub(crate) fn synchronous(tolerance: Tolerance) -> Self {
        Self::new(tolerance, Times::Shared(Vec::new()))
    }

    /// Appends the knots of one channel; `false` when they miss the tolerance.
    fn write(
        &mut self,
        rows: Rows<'_>,
        out: &mut Vec<u8>,
        report: &mut BlockReport,
        kept_rows: &mut [bool],
    ) -> Result<bool> {
        for run in rows.runs() {
            let samples = &rows.positions()[run.clone()];
            match &self.times {
                Times::Own(variant) => {
                    resample_run(samples, self.tolerance, *variant, &mut self.fit)?;
                    write_times(&self.fit, samples.len(), out);
                }
                Times::Shared(keys) => {
                    self.fit.start(knots::kept_rows(&keys[run.clone()]));
                    self.fit.measure(samples);
                }
            }
            if self.fit.max_error_mm > self.tolerance.mm() {
                return Ok(false);
            }
            for value in self.fit.rows().flat_map(|row| samples[row]) {
                out.extend_from_slice(&value.to_le_bytes());
            }
            report.kept += self.fit.rows().len() as u32;
            self.fit.rows().for_each(|row| kept_rows[run.start + row] = true);
            report.max_error_mm = report.max_error_mm.max(self.fit.max_error_mm);
        }
        Ok(true)
    }

    /// Stores the samples of one channel exactly.
    fn store(
        &mut self,
        rows: Rows<'_>,
        out: &mut Vec<u8>,
        report: &mut BlockReport,
        kept_rows: &mut [bool],
    ) {
        out.push(RAW);
        self.raw.write(rows, &mut Histories::default(), out);
        report.keep_all(rows, kept_rows);
    }

    /// Reads the knots of one channel and reconstructs its samples.
    fn read(&mut self, input: &mut Bytes<'_>, rows: &mut DecodedRows) -> Result<()> {
        let DecodedRows { positions, present, kept, .. } = rows;
        for run in block::runs(present) {
            match &self.times {
                Times::Own(_) => read_times(input, run.len(), &mut self.fit)?,
                Times::Shared(keys) => self.fit.start(knots::kept_rows(&keys[run.clone()])),
            }
            for (_, position) in &mut self.fit.knots {
                *position = widen(read_position(input)?);
            }
            self.fit.rebuild(run.len());
            ensure(
                self.fit.rebuilt.iter().flatten().all(|v| v.is_finite()),
                "a spline that is not finite",
            )?;
            positions[run.clone()].copy_from_slice(&self.fit.rebuilt);
            self.fit.rows().for_each(|row| kept[run.start + row] = true);
        }
        Ok(())
    }
}

/// Appends the rows of the inner knots of a run.
fn write_times(fit: &RunFit, len: usize, out: &mut Vec<u8>) {
    if len <= 2 {
        return;
    }
    let inner = fit.rows().len() - 2;
    write_varint(inner as u64, out);
    let mut next = 1;
    for row in fit.rows().skip(1).take(inner) {
        write_varint((row - next) as u64, out);
        next = row + 1;
    }
}

/// Reads the rows of the knots of a run of `len` rows into `fit`.
fn read_times(input: &mut Bytes<'_>, len: usize, fit: &mut RunFit) -> Result<()> {
    fit.start([0, len - 1].into_iter().take(len));
    if len <= 2 {
        return Ok(());
    }
    let inner = input.varint("the number of knots")?;
    ensure(inner <= len as u64 - 2, "more knots than samples")?;
    let mut next = 1;
    for _ in 0..inner {
        let row = knots::read_row(input, "the time of a knot", next..len - 1)?
            .ok_or(CodecError::Corrupt("a knot beyond its run"))?;
        fit.insert(row);
        next = row + 1;
    }
    Ok(())
}

fn read_position(input: &mut Bytes<'_>) -> Result<Position> {
    let (values, _) = input.take(POSITION_BYTES, "the position of a knot")?.as_chunks::<4>();
    let mut position = [0.0; 3];
    for (axis, &value) in position.iter_mut().zip(values) {
        *axis = f32::from_le_bytes(value);
    }
    if position.iter().all(|v| v.is_finite()) {
        return Ok(position);
    }
    Err(CodecError::Corrupt("a knot that is not finite"))
}

impl Payload for Spline {
    fn begin(&mut self, shared: &[u8], n_rows: usize) -> Result<()> {
        match &mut self.times {
            Times::Own(_) => Ok(()),
            Times::Shared(keys) => knots::read_key_times(shared, n_rows, keys),
        }
    }
}

impl PayloadEncoder for Spline {
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        n_channels * (1 + max_bytes(n_rows).max(Raw::max_bytes(n_rows)))
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        exact: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) -> Result<()> {
        for (rows, report) in channels.iter().zip(reports).filter(|(_, r)| r.samples > 0) {
            if exact {
                self.store(*rows, out, report, kept_rows);
                continue;
            }
            let start = out.len();
            out.push(CODED);
            let is_within = self.write(*rows, out, report, kept_rows)?;
            // Not where raw samples would merely be smaller: the knots are the subject of study. A plan made from other
            // samples may miss the tolerance; raw samples keep the bound.
            if !is_within || out.len() - start - 1 > max_bytes(report.samples as usize) {
                out.truncate(start);
                self.store(*rows, out, report, kept_rows);
            }
        }
        Ok(())
    }
}

impl PayloadDecoder for Spline {
    fn decode(&mut self, payload: &[u8], channels: &mut [DecodedRows]) -> Result<()> {
        let mut input = Bytes::new(payload);
        for rows in channels.iter_mut().filter(|rows| rows.has_samples()) {
            match input.byte("the mode of a channel")? {
                CODED => self.read(&mut input, rows)?,
                RAW => self.raw.read(&mut input, &mut Histories::default(), rows)?,
                _ => return Err(CodecError::Corrupt("an unknown channel mode")),
            }
        }
        input.finish()
    }
}

/// The moments at the knots, and memory for solving for them.
#[derive(Debug, Clone, Default)]
struct Moments {
    values: Vec<Vector>,
    /// Forward sweep of the Thomas algorithm: upper diagonal and right-hand side, divided.
    sweep: Vec<(f64, Vector)>,
}

/// A knot: its row within the run, and its position.
type Knot = (usize, Vector);

impl Moments {
    /// Solves for the moments of the whole spline, which are zero at both ends.
    fn solve(&mut self, knots: &[Knot]) {
        self.values.clear();
        self.values.resize(knots.len(), [0.0; 3]);
        if let Some(last) = knots.len().checked_sub(1) {
            self.solve_between(knots, 0, last);
        }
    }

    /// Solves for the moments strictly between the knots `low` and `high`, whose own moments are fixed.
    fn solve_between(&mut self, knots: &[Knot], low: usize, high: usize) {
        let (mut upper, mut right) = (0.0, self.values[low]);
        self.sweep.clear();
        for i in low + 1..high {
            let [(x0, y0), (x1, y1), (x2, y2)] = [knots[i - 1], knots[i], knots[i + 1]];
            let (h0, h1) = ((x1 - x0) as f64, (x2 - x1) as f64);
            // Row i: h0 M[i-1] + 2 (h0 + h1) M[i] + h1 M[i+1] = 6 (slope1 - slope0).
            let pivot = 2.0 * (h0 + h1) - h0 * upper;
            for (axis, right) in right.iter_mut().enumerate() {
                let bend = 6.0 * ((y2[axis] - y1[axis]) / h1 - (y1[axis] - y0[axis]) / h0);
                *right = (bend - h0 * *right) / pivot;
            }
            upper = h1 / pivot;
            self.sweep.push((upper, right));
        }
        for (i, &(upper, right)) in (low + 1..high).zip(&self.sweep).rev() {
            let next = self.values[i + 1];
            self.values[i] = std::array::from_fn(|axis| right[axis] - upper * next[axis]);
        }
    }

    /// The spline at `row`, which lies between the knots `interval` and `interval + 1`.
    /// At a knot it equals the knot's position exactly.
    fn at(&self, knots: &[Knot], interval: usize, row: usize) -> Vector {
        let [(x0, y0), (x1, y1)] = [knots[interval], knots[interval + 1]];
        let [m0, m1] = [self.values[interval], self.values[interval + 1]];
        let h = (x1 - x0) as f64;
        let (a, b) = ((x1 - row) as f64 / h, (row - x0) as f64 / h);
        let (ca, cb) = ((a * a * a - a) * (h * h / 6.0), (b * b * b - b) * (h * h / 6.0));
        std::array::from_fn(|axis| a * y0[axis] + b * y1[axis] + (ca * m0[axis] + cb * m1[axis]))
    }
}

/// Reconstructs a run from its knots as float32, as decoders do.
///
/// The first knot is row 0 and the last the run's last row; rows of `run` in between are written.
fn rebuild(knots: &[Knot], moments: &mut Moments, run: &mut [Position]) {
    if let [(_, only)] = knots {
        run.fill(only.map(|v| v as f32));
        return;
    }
    moments.solve(knots);
    for (interval, pair) in knots.windows(2).enumerate() {
        let (from, to) = (pair[0].0, pair[1].0);
        for (row, position) in (from..=to).zip(&mut run[from..]) {
            *position = moments.at(knots, interval, row).map(|v| v as f32);
        }
    }
}

/// A run's knots and its reconstruction. Its memory is reused from run to run.
#[derive(Debug, Clone, Default)]
struct RunFit {
    /// The kept rows, in order.
    knots: Vec<Knot>,
    moments: Moments,
    /// The reconstruction.
    rebuilt: Vec<Position>,
    /// The largest error of the last measurement.
    max_error_mm: f64,
}

impl RunFit {
    /// Starts a run with the given kept rows, in order.
    fn start(&mut self, rows: impl IntoIterator<Item = usize>) {
        self.knots.clear();
        self.knots.extend(rows.into_iter().map(|row| (row, [0.0; 3])));
        self.max_error_mm = 0.0;
    }

    /// Adds a kept row.
    fn insert(&mut self, row: usize) {
        let index = self.knots.partition_point(|&(knot, _)| knot < row);
        self.knots.insert(index, (row, [0.0; 3]));
    }

    /// The kept rows.
    fn rows(&self) -> impl ExactSizeIterator<Item = usize> {
        self.knots.iter().map(|&(row, _)| row)
    }

    /// Reconstructs all `len` rows of the run.
    fn rebuild(&mut self, len: usize) {
        self.rebuilt.resize(len, [0.0; 3]);
        rebuild(&self.knots, &mut self.moments, &mut self.rebuilt);
    }

    /// Reconstructs the run from its kept samples and measures its error; returns the row with the largest error, the
    /// first of equals.
    fn measure(&mut self, samples: &[Position]) -> usize {
        for (row, position) in &mut self.knots {
            *position = widen(samples[*row]);
        }
        self.rebuild(samples.len());
        let (mut worst, mut at) = (0.0, 0);
        for (row, (&a, &b)) in self.rebuilt.iter().zip(samples).enumerate() {
            let error = block::distance_mm(a, b);
            // Infinity less infinity, after an overflow, counts as the largest error.
            let error = if error.is_nan() { f64::INFINITY } else { error };
            if error > worst {
                (worst, at) = (error, row);
            }
        }
        self.max_error_mm = worst;
        at
    }

    /// Inserts the worst sample until the float32 reconstruction is within `tolerance_mm`.
    fn prove(&mut self, samples: &[Position], tolerance_mm: f64) {
        loop {
            let worst = self.measure(samples);
            // Knots are reconstructed exactly, so the loop ends at the latest when every sample is kept.
            if self.max_error_mm <= tolerance_mm {
                return;
            }
            self.insert(worst);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn knots(points: &[(usize, f64)]) -> Vec<Knot> {
        points.iter().map(|&(x, y)| (x, [y, -y, 2.0 * y])).collect()
    }

    #[test]
    fn known_moments_of_three_knots() {
        // 2 (h0 + h1) M1 = 6 ((y2 - y1)/h1 - (y1 - y0)/h0): with h = 1 and y = 0, 1, 0 this is M1 = -3.
        let mut moments = Moments::default();
        moments.solve(&knots(&[(0, 0.0), (1, 1.0), (2, 0.0)]));
        assert_eq!(moments.values, [[0.0; 3], [-3.0, 3.0, -6.0], [0.0; 3]]);
        // Uneven: h = 2, 4 and y = 0, 6, 0: 12 M1 = 6 (-1.5 - 3), so M1 = -2.25.
        let uneven = knots(&[(0, 0.0), (2, 6.0), (6, 0.0)]);
        moments.solve(&uneven);
        assert_eq!(moments.values[1], [-2.25, 2.25, -4.5]);
        // Halfway along the first interval: (0 + 6)/2 + (1/8 - 1/2) * -2.25 * 4/6.
        assert_eq!(moments.at(&uneven, 0, 1)[0], 3.0 + 0.375 * 2.25 * 4.0 / 6.0);
    }

    #[test]
    fn knots_are_exact_and_lines_are_kept() {
        let line: Vec<Knot> = [0, 3, 4, 9, 20].iter().map(|&x| (x, [x as f64; 3])).collect();
        let mut run = vec![[0.0; 3]; 21];
        let mut moments = Moments::default();
        rebuild(&line, &mut moments, &mut run);
        for (row, position) in run.iter().enumerate() {
            assert!((f64::from(position[0]) - row as f64).abs() < 1e-5);
        }
        let odd = knots(&[(0, 0.1), (5, f64::from(f32::MAX)), (7, -0.3)]);
        moments.solve(&odd);
        for (i, &(row, value)) in odd[..2].iter().enumerate() {
            assert_eq!(moments.at(&odd, i, row), value);
        }
        assert_eq!(moments.at(&odd, 1, 7), odd[2].1);
    }
}
