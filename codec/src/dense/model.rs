//! The probabilities of a channel, and the syntax of one residual.

use super::{grid::Point, prior, schedule::LEVELS};
use crate::{
    CodecError,
    coding::range::{BinaryCoder, Bit},
};

/// Kinds of rows: first of a run, anchor of a long, a middling and a short span, and the strides.
pub(super) const KINDS: usize = 4 + LEVELS;
pub(super) const ORIGIN: usize = 0;

/// Classes of recent activity.
pub(super) const ACTIVITIES: usize = 6;
/// Classes of the neighbours' residuals.
pub(super) const NEAR: usize = 3;
/// Classes of local curvature.
pub(super) const BENDS: usize = 5;

/// Magnitudes up to this are unary, the rest Exp-Golomb.
pub(super) const UNARY: usize = 12;
/// Exponent of the largest magnitude that an encoder can need, and one to spare.
const MAX_EXPONENT: usize = 42;

/// Averages of recent magnitudes, in 1/256, forgetting an eighth a row.
#[derive(Debug, Clone, Copy, Default)]
struct Recent(u16);

impl Recent {
    fn class(self) -> usize {
        match self.0 {
            0..12 => 0,
            12..48 => 1,
            48..128 => 2,
            128..320 => 3,
            320..1024 => 4,
            _ => 5,
        }
    }

    fn push(&mut self, magnitude: u64) {
        let new = 256 * magnitude.min(31) as u16;
        self.0 = self.0 - (self.0 >> 3) + (new >> 3);
    }
}

/// What is known about a row before its residual.
#[derive(Debug, Clone, Copy)]
pub(super) struct Context {
    /// Below [`KINDS`].
    pub(super) kind: usize,
    /// Below [`NEAR`].
    pub(super) near: usize,
    /// Below [`BENDS`].
    pub(super) bend: usize,
}

/// Everything of a channel that adapts to its residuals.
#[derive(Debug, Clone)]
pub(super) struct Model {
    moving: [[[[Bit; BENDS]; NEAR]; ACTIVITIES]; KINDS],
    nonzero: [[[Bit; 3]; ACTIVITIES]; KINDS],
    unary: [[Bit; UNARY]; ACTIVITIES],
    exponent: [Bit; MAX_EXPONENT + 1],
    sign: [[Bit; 3]; KINDS],
    row_activity: [Recent; KINDS],
    axis_activity: [[Recent; 3]; KINDS],
    last_sign: [[u8; 3]; KINDS],
}

impl Default for Model {
    fn default() -> Self {
        Self {
            moving: prior::MOVING
                .map(|kind| kind.map(|activity| activity.map(|near| near.map(Bit::expecting)))),
            nonzero: prior::NONZERO.map(|kind| kind.map(|activity| activity.map(Bit::expecting))),
            unary: prior::LONGER.map(|activity| activity.map(Bit::expecting)),
            exponent: [Bit::NEW; MAX_EXPONENT + 1],
            sign: [[Bit::NEW; 3]; KINDS],
            row_activity: Default::default(),
            axis_activity: Default::default(),
            last_sign: Default::default(),
        }
    }
}

impl Model {
    /// Codes one residual in lattice steps; none is a skipped row.
    ///
    /// A residual that is there is never zero on all axes: that would be a skip.
    pub(super) fn residual(
        &mut self,
        coder: &mut impl BinaryCoder,
        context: Context,
        residual: Option<Point>,
    ) -> Result<Option<Point>, CodecError> {
        let Context { kind, near, bend } = context;
        let activity = self.row_activity[kind].class();
        let moving = coder.bit(&mut self.moving[kind][activity][near][bend], residual.is_some());
        let mut steps = residual.unwrap_or_default();
        if moving {
            let mut nonzero_axes = 0;
            for (axis, steps) in steps.iter_mut().enumerate() {
                let certain = axis == 2 && nonzero_axes == 0;
                self.axis(coder, kind, axis, (nonzero_axes, certain), steps)?;
                nonzero_axes += usize::from(*steps != 0);
            }
        }
        let magnitudes = steps.map(i64::unsigned_abs);
        self.row_activity[kind].push(magnitudes.iter().fold(0, |sum, m| sum + m.min(&31)));
        for (recent, magnitude) in self.axis_activity[kind].iter_mut().zip(magnitudes) {
            recent.push(magnitude);
        }
        Ok(moving.then_some(steps))
    }

    fn axis(
        &mut self,
        coder: &mut impl BinaryCoder,
        kind: usize,
        axis: usize,
        (nonzero_axes, certain): (usize, bool),
        steps: &mut i64,
    ) -> Result<(), CodecError> {
        let activity = self.axis_activity[kind][axis].class();
        let order = if axis == 0 { 0 } else { 1 + nonzero_axes.min(1) };
        let nonzero = certain || coder.bit(&mut self.nonzero[kind][activity][order], *steps != 0);
        if !nonzero {
            *steps = 0;
            return Ok(());
        }
        let last = &mut self.last_sign[kind][axis];
        let negative = coder.bit(&mut self.sign[kind][usize::from(*last)], *steps < 0);
        *last = 1 + u8::from(negative);
        let beyond_one = self.magnitude(coder, activity, steps.unsigned_abs().saturating_sub(1))?;
        let magnitude = 1 + beyond_one as i64;
        *steps = if negative { -magnitude } else { magnitude };
        Ok(())
    }

    fn magnitude(
        &mut self,
        coder: &mut impl BinaryCoder,
        activity: usize,
        value: u64,
    ) -> Result<u64, CodecError> {
        for (below, model) in self.unary[activity].iter_mut().enumerate() {
            if !coder.bit(model, value > below as u64) {
                return Ok(below as u64);
            }
        }
        let rest = value.wrapping_sub(UNARY as u64).wrapping_add(1);
        let wanted = rest.checked_ilog2().unwrap_or(0) as usize;
        let mut exponent = 0;
        while coder.bit(&mut self.exponent[exponent], wanted > exponent) {
            exponent += 1;
            if exponent > MAX_EXPONENT {
                return Err(CodecError::Corrupt("a residual beyond every coordinate"));
            }
        }
        let low = coder.plain(rest, exponent as u32);
        Ok((1 << exponent) + low - 1 + UNARY as u64)
    }
}
