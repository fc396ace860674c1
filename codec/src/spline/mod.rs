//! `spline` and `sync`: the methods of (Shi et al. 2012) on a natural cubic spline.
//!
//! `spline` samples asynchronously: every channel has its own greedily chosen knots. It works offline: a block should
//! be a whole take, so that only gaps end runs. `sync` samples synchronously, for comparison: one set of key times for
//! all channels (equations 5 and 7). A channel keeps its samples at the key times and both ends of each of its runs;
//! the key times are stored outside the block, once for all channels.

mod greedy;
mod key_times;
mod natural;

pub use self::greedy::SplineVariant;
pub(crate) use self::key_times::plan;
use self::{greedy::resample_run, natural::RunFit};
use crate::{
    BlockReport, CodecError, DecodedRows, Position, Result, Rows, Tolerance, block,
    bound::widen,
    coding::{
        bytes::{Bytes, write_varint},
        columns::{Histories, Raw},
    },
    ensure,
    frame::{Payload, PayloadDecoder, PayloadEncoder},
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
                    self.fit.start(key_times::kept_rows(&keys[run.clone()]));
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
                Times::Shared(keys) => self.fit.start(key_times::kept_rows(&keys[run.clone()])),
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
        let row = key_times::read_row(input, "the time of a knot", next..len - 1)?
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
            Times::Shared(keys) => key_times::read(shared, n_rows, keys),
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
