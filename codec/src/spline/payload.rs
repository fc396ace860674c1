//! The payload: the knots of every run of every channel.

use super::{CODED, RAW, RunFit, is_raw, place_run, read_position, resample_run, write_position};
use crate::{
    BlockReport, CodecError, DecodedRows, Rows, SplineVariant, Tolerance, block,
    coding::bytes::{Bytes, write_varint},
    frame::{PayloadDecoder, PayloadEncoder},
    raw::Raw,
};

/// Most bytes of a channel's knots: a position and two bytes of its time a sample.
fn max_bytes(samples: usize) -> usize {
    14 * samples
}

/// Encoder and decoder of one group; there is no state between blocks.
#[derive(Debug)]
pub(crate) struct Spline {
    tolerance: Tolerance,
    variant: SplineVariant,
    fit: RunFit,
    raw: Raw,
}

impl Spline {
    pub(crate) fn new(tolerance: Tolerance, variant: SplineVariant) -> Self {
        Self { tolerance, variant, fit: RunFit::default(), raw: Raw::default() }
    }

    /// Appends the knots of one channel.
    fn write(
        &mut self,
        rows: Rows<'_>,
        out: &mut Vec<u8>,
        report: &mut BlockReport,
    ) -> Result<(), CodecError> {
        for run in rows.runs() {
            let samples = &rows.positions()[run];
            resample_run(samples, self.tolerance, self.variant, &mut self.fit)?;
            let knots = self.fit.rows().len();
            if samples.len() > 2 {
                write_varint(knots as u64 - 2, out);
                let mut before = 0;
                for row in self.fit.rows().skip(1).take(knots - 2) {
                    write_varint((row - before - 1) as u64, out);
                    before = row;
                }
            }
            self.fit.rows().for_each(|row| write_position(samples[row], out));
            report.kept += knots as u32;
            report.max_error_mm = report.max_error_mm.max(self.fit.max_error_mm());
        }
        Ok(())
    }

    fn read(&mut self, input: &mut Bytes<'_>, rows: &mut DecodedRows) -> Result<(), CodecError> {
        let DecodedRows { positions, present, kept, .. } = rows;
        for run in block::runs(present) {
            let len = run.len();
            self.fit.clear();
            self.fit.keep(0);
            if len > 2 {
                let inner = input.varint("the number of knots")?;
                if inner > len as u64 - 2 {
                    return Err(CodecError::Corrupt("more knots than samples"));
                }
                let mut before = 0;
                for _ in 0..inner {
                    let delta = input.varint("the time of a knot")?;
                    before = usize::try_from(delta)
                        .ok()
                        .and_then(|delta| delta.checked_add(before + 1))
                        .filter(|&row| row < len - 1)
                        .ok_or(CodecError::Corrupt("a knot beyond its run"))?;
                    self.fit.keep(before);
                }
            }
            if len > 1 {
                self.fit.keep(len - 1);
            }
            self.fit.fill(|_| read_position(input))?;
            self.fit.rebuild(len);
            place_run(&self.fit, &mut positions[run.clone()], &mut kept[run])?;
        }
        Ok(())
    }
}

impl PayloadEncoder for Spline {
    type Decoder = Self;

    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        n_channels * (1 + max_bytes(n_rows).max(Raw::max_bytes(n_rows)))
    }

    /// Works on whole takes, where nothing is hot.
    fn prepare(&mut self, _n_channels: usize, _n_rows: usize) {}

    fn reset(&mut self) {}

    fn break_off(&mut self) {}

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        _shared: &[u8],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<(), CodecError> {
        let mut coded = Vec::new();
        for (rows, report) in channels.iter().zip(reports).filter(|(_, r)| r.samples > 0) {
            coded.clear();
            self.write(*rows, &mut coded, report)?;
            let samples = report.samples;
            // Not where raw would merely be smaller: the knots are what is studied.
            if coded.len() > max_bytes(samples as usize) {
                out.push(RAW);
                self.raw.write(*rows, out);
                *report = BlockReport { samples, kept: samples, max_error_mm: 0.0 };
            } else {
                out.push(CODED);
                out.extend_from_slice(&coded);
            }
        }
        Ok(())
    }
}

impl PayloadDecoder for Spline {
    #[cfg(debug_assertions)]
    fn prepare(&mut self, _n_channels: usize, _n_rows: usize) {}

    fn reset(&mut self) {}

    fn break_off(&mut self) {}

    fn decode(
        &mut self,
        payload: &[u8],
        _shared: &[u8],
        channels: &mut [DecodedRows],
    ) -> Result<(), CodecError> {
        let mut input = Bytes::new(payload);
        for rows in channels.iter_mut().filter(|rows| rows.has_samples()) {
            if is_raw(&mut input)? {
                self.raw.read(&mut input, rows)?;
            } else {
                self.read(&mut input, rows)?;
            }
        }
        input.finish()
    }
}
