//! The published method: asynchronous greedy knots on a natural cubic spline (Shi et al. 2012).
//!
//! Offline: a block is meant to be a whole take, so that runs are cut by gaps only.

mod greedy;
mod natural;
mod payload;
mod proof;

pub(crate) use self::{payload::Spline, proof::RunFit};
use crate::{CodecError, Position, SplineVariant, Tolerance, coding::bytes::Bytes};

/// The byte before a channel that is coded.
pub(crate) const CODED: u8 = 0;

/// The byte before a channel that is stored as it is.
pub(crate) const RAW: u8 = 1;

/// Reads the byte before a channel.
pub(crate) fn is_raw(input: &mut Bytes<'_>) -> Result<bool, CodecError> {
    match input.byte("the mode of a channel")? {
        CODED => Ok(false),
        RAW => Ok(true),
        _ => Err(CodecError::Corrupt("an unknown mode of a channel")),
    }
}

/// Bytes of a stored position: three little-endian float32.
pub(crate) const POSITION_BYTES: usize = 12;

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
