//! The published method: asynchronous greedy knots on a natural cubic spline (Shi et al. 2012).
//!
//! Offline: a block is meant to be a whole take, so that runs are cut by gaps only.

mod greedy;
mod natural;
mod proof;

pub(crate) use self::proof::RunFit;
use crate::{
    BlockReport, CodecError, DecodedRows, Position, Rows, SplineVariant, Tolerance, block,
    coding::bytes::{Bytes, write_varint},
    frame::{Outcome, PayloadDecoder, PayloadEncoder},
};

/// Bytes of a stored position: three little-endian float32.
pub(crate) const POSITION_BYTES: usize = 12;

/// Most bytes of a payload: every sample kept, a byte of time for each, and a count for each run.
pub(crate) fn max_payload_bytes(samples: usize) -> usize {
    (POSITION_BYTES + 2) * samples
}

/// The kept rows of one run, counted from its first, proven on the float32 reconstruction.
pub(crate) fn resample_run(
    samples: &[Position],
    tolerance: Tolerance,
    variant: SplineVariant,
    fit: &mut RunFit,
) -> Result<(), CodecError> {
    let longest = SplineVariant::EXHAUSTIVE_MAX_RUN_ROWS;
    if variant == SplineVariant::Exhaustive && samples.len() > longest {
        return Err(CodecError::InvalidArgument(format!(
            "the exhaustive search takes runs of at most {longest} samples, and here is one of {}: \
             use :worst-sample, or a shorter part of the take",
            samples.len()
        )));
    }
    fit.start(greedy::knots(samples, tolerance.mm(), variant));
    fit.prove(samples, tolerance.mm());
    Ok(())
}

/// Appends a position.
pub(crate) fn write_position(position: Position, out: &mut Vec<u8>) {
    for value in position {
        out.extend_from_slice(&value.to_le_bytes());
    }
}

/// Reads a position.
pub(crate) fn read_position(input: &mut Bytes<'_>) -> Result<Position, CodecError> {
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

/// Puts a rebuilt run in its place, which is as long as the run.
pub(crate) fn place_run(
    fit: &RunFit,
    positions: &mut [Position],
    kept: &mut [bool],
) -> Result<(), CodecError> {
    if !fit.rebuilt().iter().flatten().all(|v| v.is_finite()) {
        return Err(CodecError::Corrupt("a spline that is not finite"));
    }
    positions.copy_from_slice(fit.rebuilt());
    fit.rows().for_each(|row| kept[row] = true);
    Ok(())
}

/// Encoder and decoder of one channel; there is no state between blocks.
#[derive(Debug)]
pub(crate) struct Spline {
    tolerance: Tolerance,
    variant: SplineVariant,
    fit: RunFit,
}

impl Spline {
    pub(crate) fn new(tolerance: Tolerance, variant: SplineVariant) -> Self {
        Self { tolerance, variant, fit: RunFit::default() }
    }
}

impl PayloadEncoder for Spline {
    type Decoder = Self;

    /// Works on whole takes, where nothing is hot.
    fn prepare(&mut self, _n_rows: usize) {}

    fn reset(&mut self) {}

    fn break_off(&mut self) {}

    fn max_payload_bytes(samples: usize) -> usize {
        max_payload_bytes(samples)
    }

    fn encode(
        &mut self,
        rows: Rows<'_>,
        _shared: &[u8],
        _limit: usize,
        out: &mut Vec<u8>,
    ) -> Result<Outcome, CodecError> {
        let mut report = BlockReport::default();
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
            report.samples += samples.len() as u32;
            report.kept += knots as u32;
            report.recoded |= u32::from(self.fit.inserted());
            report.max_error_mm = report.max_error_mm.max(self.fit.max_error_mm());
        }
        Ok(Outcome::Coded(report))
    }
}

impl PayloadDecoder for Spline {
    #[cfg(debug_assertions)]
    fn prepare(&mut self, _n_rows: usize) {}

    fn reset(&mut self) {}

    fn break_off(&mut self) {}

    fn decode(
        &mut self,
        payload: &[u8],
        _shared: &[u8],
        rows: &mut DecodedRows,
    ) -> Result<(), CodecError> {
        let mut input = Bytes::new(payload);
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
            self.fit.fill(|_| read_position(&mut input))?;
            self.fit.rebuild(len);
            place_run(&self.fit, &mut positions[run.clone()], &mut kept[run])?;
        }
        input.finish()
    }
}
