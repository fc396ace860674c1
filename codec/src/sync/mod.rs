//! The published rival: one set of key times for all channels (Shi et al. 2012, equations 5 and 7).
//!
//! A channel keeps its samples at the key times, and both ends of each of its runs. The key times
//! travel outside the block, once for all channels.

mod key_times;

pub(crate) use self::key_times::plan;
use crate::{
    BlockReport, CodecError, DecodedRows, Rows, Tolerance, block,
    coding::bytes::Bytes,
    frame::{Outcome, PayloadDecoder, PayloadEncoder},
    spline::{RunFit, place_run, read_position, write_position},
};

/// Encoder and decoder of one channel; there is no state between blocks.
#[derive(Debug)]
pub(crate) struct Sync {
    tolerance: Tolerance,
    keys: Vec<bool>,
    fit: RunFit,
}

impl Sync {
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self { tolerance, keys: Vec::new(), fit: RunFit::default() }
    }
}

impl PayloadEncoder for Sync {
    type Decoder = Self;

    /// Works on whole takes, where nothing is hot.
    fn prepare(&mut self, _n_rows: usize) {}

    fn reset(&mut self) {}

    fn break_off(&mut self) {}

    fn encode(
        &mut self,
        rows: Rows<'_>,
        shared: &[u8],
        _limit: usize,
        out: &mut Vec<u8>,
    ) -> Result<Outcome, CodecError> {
        key_times::read(shared, rows.len(), &mut self.keys).map_err(|error| {
            CodecError::InvalidArgument(format!(
                "{error}: pass what Settings::plan gave for the same {} rows",
                rows.len()
            ))
        })?;
        let mut report = BlockReport::default();
        for run in rows.runs() {
            let samples = &rows.positions()[run.clone()];
            self.fit.start(key_times::kept_rows(&self.keys[run]));
            self.fit.measure(samples);
            if self.fit.max_error_mm() > self.tolerance.mm() {
                // Not the plan of these samples: the bound stands all the same.
                return Ok(Outcome::Escape);
            }
            self.fit.rows().for_each(|row| write_position(samples[row], out));
            report.samples += samples.len() as u32;
            report.kept += self.fit.rows().len() as u32;
            report.max_error_mm = report.max_error_mm.max(self.fit.max_error_mm());
        }
        Ok(Outcome::Coded(report))
    }
}

impl PayloadDecoder for Sync {
    #[cfg(debug_assertions)]
    fn prepare(&mut self, _n_rows: usize) {}

    fn reset(&mut self) {}

    fn break_off(&mut self) {}

    fn decode(
        &mut self,
        payload: &[u8],
        shared: &[u8],
        rows: &mut DecodedRows,
    ) -> Result<(), CodecError> {
        key_times::read(shared, rows.present.len(), &mut self.keys)?;
        let mut input = Bytes::new(payload);
        let DecodedRows { positions, present, kept, .. } = rows;
        for run in block::runs(present) {
            self.fit.start(key_times::kept_rows(&self.keys[run.clone()]));
            self.fit.fill(|_| read_position(&mut input))?;
            self.fit.rebuild(run.len());
            place_run(&self.fit, &mut positions[run.clone()], &mut kept[run])?;
        }
        input.finish()
    }
}
