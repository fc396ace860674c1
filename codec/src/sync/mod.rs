//! The published rival: one set of key times for all channels (Shi et al. 2012, equations 5 and 7).
//!
//! A channel keeps its samples at the key times, and both ends of each of its runs. The key times
//! travel outside the block, once for all channels.

mod key_times;

pub(crate) use self::key_times::plan;
use crate::{
    BlockReport, CodecError, DecodedRows, Rows, Tolerance, block,
    coding::bytes::Bytes,
    frame::{PayloadDecoder, PayloadEncoder},
    raw::Raw,
    spline::{CODED, RAW, RunFit, is_raw, place_run, read_position, write_position},
};

/// Encoder and decoder of one group; there is no state between blocks.
#[derive(Debug)]
pub(crate) struct Sync {
    tolerance: Tolerance,
    keys: Vec<bool>,
    fit: RunFit,
    raw: Raw,
}

impl Sync {
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self { tolerance, keys: Vec::new(), fit: RunFit::default(), raw: Raw::default() }
    }

    /// Appends the positions of one channel's knots; `false` when these do not keep the tolerance.
    fn write(&mut self, rows: Rows<'_>, out: &mut Vec<u8>, report: &mut BlockReport) -> bool {
        for run in rows.runs() {
            let samples = &rows.positions()[run.clone()];
            self.fit.start(key_times::kept_rows(&self.keys[run]));
            self.fit.measure(samples);
            if self.fit.max_error_mm() > self.tolerance.mm() {
                return false;
            }
            self.fit.rows().for_each(|row| write_position(samples[row], out));
            report.kept += self.fit.rows().len() as u32;
            report.max_error_mm = report.max_error_mm.max(self.fit.max_error_mm());
        }
        true
    }

    fn read(&mut self, input: &mut Bytes<'_>, rows: &mut DecodedRows) -> Result<(), CodecError> {
        let DecodedRows { positions, present, kept, .. } = rows;
        for run in block::runs(present) {
            self.fit.start(key_times::kept_rows(&self.keys[run.clone()]));
            self.fit.fill(|_| read_position(input))?;
            self.fit.rebuild(run.len());
            place_run(&self.fit, &mut positions[run.clone()], &mut kept[run])?;
        }
        Ok(())
    }
}

impl PayloadEncoder for Sync {
    type Decoder = Self;

    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        n_channels * (1 + Raw::max_bytes(n_rows))
    }

    /// Works on whole takes, where nothing is hot.
    fn prepare(&mut self, _n_channels: usize, _n_rows: usize) {}

    fn reset(&mut self) {}

    fn break_off(&mut self) {}

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        shared: &[u8],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<(), CodecError> {
        let n_rows = channels.first().map_or(0, Rows::len);
        key_times::read(shared, n_rows, &mut self.keys).map_err(|error| {
            CodecError::InvalidArgument(format!(
                "{error}: pass what Settings::plan gave for the same {n_rows} rows"
            ))
        })?;
        for (rows, report) in channels.iter().zip(reports).filter(|(_, r)| r.samples > 0) {
            let start = out.len();
            out.push(CODED);
            if !self.write(*rows, out, report) {
                // Not the plan of these samples: the bound stands all the same.
                out.truncate(start);
                out.push(RAW);
                self.raw.write(*rows, out);
                let samples = report.samples;
                *report = BlockReport { samples, kept: samples, max_error_mm: 0.0 };
            }
        }
        Ok(())
    }
}

impl PayloadDecoder for Sync {
    #[cfg(debug_assertions)]
    fn prepare(&mut self, _n_channels: usize, _n_rows: usize) {}

    fn reset(&mut self) {}

    fn break_off(&mut self) {}

    fn decode(
        &mut self,
        payload: &[u8],
        shared: &[u8],
        channels: &mut [DecodedRows],
    ) -> Result<(), CodecError> {
        let n_rows = channels.first().map_or(0, |rows| rows.present.len());
        key_times::read(shared, n_rows, &mut self.keys)?;
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
