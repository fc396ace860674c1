//! A uniform lattice and packed differences: the error bound at bus speed.
//!
//! The lattice step is the edge of the cube inside the tolerance ball, 2/sqrt(3) of the tolerance,
//! halved up to three times where float32 rounding of the reconstruction would break the bound.

use crate::{
    BlockReport, CodecError, DecodedRows, Rows, Tolerance, bound,
    coding::{
        bytes::Bytes,
        columns::{self, History},
    },
    frame::{Outcome, PayloadDecoder, PayloadEncoder},
};

/// 2/sqrt(3), less 2^-9 for the float32 rounding of the reconstruction.
const STEP_PER_TOLERANCE: f64 = 2.0 / 1.732_050_807_568_877_2 * (1.0 - 1.0 / 512.0);

/// How often the step may be halved; two bits.
const MAX_HALVINGS: u8 = 3;

/// Lattice coordinates beyond this are stored raw: an f64 holds them all, and their half, exactly.
const MAX_COORDINATE: f64 = (1_i64 << 50) as f64;

/// Encoder and decoder state.
#[derive(Debug)]
pub(crate) struct Fast {
    tolerance: Tolerance,
    columns: [Vec<i64>; 3],
    history: [History; 3],
    /// Halvings that `history` is in.
    halvings: u8,
}

impl Fast {
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self { tolerance, columns: Default::default(), history: Default::default(), halvings: 0 }
    }

    fn reserve(&mut self, n_rows: usize) {
        for column in &mut self.columns {
            column.reserve(n_rows.saturating_sub(column.len()));
        }
    }

    fn step_mm(&self, halvings: u8) -> f64 {
        self.tolerance.mm() * STEP_PER_TOLERANCE / f64::from(1_u8 << halvings)
    }

    fn forget(&mut self) {
        self.history = Default::default();
        self.halvings = 0;
    }

    /// Quantises all samples; gives the largest error, or nothing when the lattice does not reach.
    fn quantise(&mut self, rows: Rows<'_>, halvings: u8) -> Option<f64> {
        let step = self.step_mm(halvings);
        let inverse = step.recip();
        let mut worst = 0.0_f64;
        self.columns.iter_mut().for_each(Vec::clear);
        for (&sample, _) in rows.positions().iter().zip(rows.present()).filter(|(_, p)| **p) {
            let mut rebuilt = [0.0; 3];
            for axis in 0..3 {
                let scaled = f64::from(sample[axis]) * inverse;
                if scaled.abs() > MAX_COORDINATE {
                    return None;
                }
                let coordinate = nearest(scaled);
                rebuilt[axis] = rebuild(coordinate, step);
                self.columns[axis].push(coordinate);
            }
            worst = worst.max(bound::distance_mm(rebuilt, sample));
        }
        Some(worst)
    }
}

/// Nearest integer of a value within [`MAX_COORDINATE`]: adding 1.5 * 2^52 leaves it in the mantissa.
fn nearest(value: f64) -> i64 {
    const MAGIC: f64 = ((1_i64 << 52) + (1_i64 << 51)) as f64;
    (value + MAGIC).to_bits().wrapping_sub(MAGIC.to_bits()) as i64
}

fn rebuild(coordinate: i64, step_mm: f64) -> f32 {
    (coordinate as f64 * step_mm) as f32
}

/// History in another step: a shift, so that both sides agree on every machine.
fn rescale(history: [History; 3], from: u8, to: u8) -> [History; 3] {
    history.map(|axis| {
        axis.map(|v| if to >= from { v.wrapping_shl((to - from).into()) } else { v >> (from - to) })
    })
}

impl PayloadEncoder for Fast {
    type Decoder = Self;

    fn prepare(&mut self, n_rows: usize) {
        self.reserve(n_rows);
    }

    fn reset(&mut self) {
        self.forget();
    }

    fn break_off(&mut self) {
        self.forget();
    }

    fn encode(
        &mut self,
        rows: Rows<'_>,
        _shared: &[u8],
        limit: usize,
        out: &mut Vec<u8>,
    ) -> Result<Outcome, CodecError> {
        let tolerance_mm = self.tolerance.mm();
        for halvings in 0..=MAX_HALVINGS {
            match self.quantise(rows, halvings) {
                None => return Ok(Outcome::Escape),
                Some(max_error_mm) if bound::stated_step(max_error_mm, tolerance_mm).is_some() => {
                    self.history = rescale(self.history, self.halvings, halvings);
                    self.halvings = halvings;
                    if !columns::write(&self.columns, &mut self.history, halvings, limit, out) {
                        return Ok(Outcome::Escape);
                    }
                    let samples = self.columns[0].len() as u32;
                    let recoded = u32::from(halvings > 0);
                    return Ok(Outcome::Coded(BlockReport {
                        samples,
                        kept: samples,
                        max_error_mm,
                        recoded,
                    }));
                }
                Some(_) => {}
            }
        }
        Ok(Outcome::Escape)
    }
}

impl PayloadDecoder for Fast {
    #[cfg(debug_assertions)]
    fn prepare(&mut self, n_rows: usize) {
        self.reserve(n_rows);
    }

    fn reset(&mut self) {
        self.forget();
    }

    fn break_off(&mut self) {
        self.forget();
    }

    fn decode(
        &mut self,
        payload: &[u8],
        _shared: &[u8],
        rows: &mut DecodedRows,
    ) -> Result<(), CodecError> {
        let mut input = Bytes::new(payload);
        let n = rows.present.iter().filter(|&&p| p).count();
        let (history, from) = (self.history, self.halvings);
        let halvings = &mut self.halvings;
        let scaled = |bits| {
            *halvings = bits;
            rescale(history, from, bits)
        };
        self.history = columns::read(&mut input, n, scaled, &mut self.columns)?;
        input.finish()?;
        let step = self.step_mm(self.halvings);
        let [xs, ys, zs] = &self.columns;
        let samples = xs.iter().zip(ys).zip(zs);
        let present = rows.positions.iter_mut().zip(&rows.present).filter(|(_, p)| **p);
        for ((position, _), ((&x, &y), &z)) in present.zip(samples) {
            *position = [x, y, z].map(|c| rebuild(c, step));
        }
        rows.kept.copy_from_slice(&rows.present);
        Ok(())
    }
}
