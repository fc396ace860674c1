//! The decoder of a group.

use super::{
    Fast, MAX_ZEROS, Mode,
    model::{
        Activity, PLACES, QUIET_PLACE, QUIET_ROWS, SYMBOLS, ScaledActivity, WAKE_PLACE, axis_code,
        clamp_magnitude,
    },
    tans::{MAGNITUDE, MORE, PAD, Reader, SYMBOLS_FILLED, Tables},
    walk::{self, Channel, LEAD, LevelRows, PaddedPoint, Planes, RunCodec, RunPoints, gather},
};
use crate::{
    CodecError, DecodedRows, Result, block,
    coding::{Bytes, isa::Kernel},
    ensure,
    frame::PayloadDecoder,
    lossless::Histories,
};

/// Scratch memory: the padded payload of a block, and the residuals of a level.
#[derive(Debug, Default)]
pub(super) struct DecodeBuffers {
    padded: Vec<u8>,
    steps: Vec<PaddedPoint>,
}

impl DecodeBuffers {
    pub(super) fn grow(&mut self, padded_len: usize, payload_bytes: usize) {
        self.padded.reserve((PAD + payload_bytes).saturating_sub(self.padded.len()));
        if self.steps.len() < padded_len {
            self.steps.resize(padded_len, PaddedPoint::default());
        }
    }
}

impl PayloadDecoder for Fast {
    fn decode(&mut self, payload: &[u8], channels: &mut [DecodedRows]) -> Result<()> {
        let n_rows = channels.first().map_or(0, |rows| rows.present.len());
        self.grow(channels.len(), n_rows);
        self.decode_buffers.grow(walk::padded_len(n_rows), payload.len());
        self.modes.fill(Mode::default());
        Reader::pad(payload, &mut self.decode_buffers.padded);
        let mut reader = Reader::new(&self.decode_buffers.padded)?;
        if reader.flag()? {
            let mut input = Bytes::new(payload);
            for (mode, rows) in self.modes.iter_mut().zip(channels.iter()) {
                if rows.has_samples() {
                    *mode = Mode::read(&mut input)?;
                }
            }
            for (mode, rows) in self.modes.iter().zip(channels.iter_mut()) {
                if *mode == Mode::RAW && rows.has_samples() {
                    self.raw.read(&mut input, &mut Histories::default(), rows)?;
                }
            }
            reader.set_floor(payload.len() - input.rest().len());
        }
        let coded = |(rows, mode): (&DecodedRows, &Mode)| *mode != Mode::RAW && rows.has_samples();
        if channels.iter().zip(&self.modes).any(coded) {
            reader.read_state()?;
        }
        for ((rows, channel), mode) in channels.iter_mut().zip(&mut self.channels).zip(&self.modes)
        {
            if *mode == Mode::RAW || !rows.has_samples() {
                channel.known = 0;
                continue;
            }
            self.isa.run(DecodeChannel {
                tables: self.tables,
                reader: &mut reader,
                channel,
                rows,
                points: &mut self.points,
                steps: &mut self.decode_buffers.steps,
                step: mode.step(self.tolerance_mm),
                cap: walk::error_cap(self.tolerance_mm),
            })?;
        }
        reader.finish()
    }
}

/// Decodes one channel of one block.
struct DecodeChannel<'a, 'p> {
    tables: &'static Tables,
    reader: &'a mut Reader<'p>,
    channel: &'a mut Channel,
    rows: &'a mut DecodedRows,
    points: &'a mut RunPoints,
    steps: &'a mut [PaddedPoint],
    step: f32,
    cap: f32,
}

impl Kernel for DecodeChannel<'_, '_> {
    type Output = Result<()>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { tables, reader, channel, rows, points, steps, step, cap } = self;
        let DecodedRows { positions, present, kept, .. } = rows;
        let mut end = 0;
        for run in block::runs(present) {
            if run.start != 0 {
                channel.known = 0;
            }
            end = run.end;
            let origin = usize::from(channel.known == 0);
            let n = run.len();
            let kept = &mut kept[run.clone()];
            let mut codec = RunDecoder { tables, reader, steps, kept, at: 0, step, origin };
            walk::run(&mut codec, channel, points, n, cap)?;
            let [x, y, z] = points.known.axes(LEAD + 1 - origin);
            if gather(x, y, z, &mut positions[run]) {
                return Err(CodecError::Corrupt("a position out of range"));
            }
        }
        if end != present.len() {
            channel.known = 0;
        }
        Ok(())
    }
}

/// The decoder of one run.
struct RunDecoder<'a, 'p> {
    tables: &'static Tables,
    reader: &'a mut Reader<'p>,
    /// Residuals of the current level, in steps.
    steps: &'a mut [PaddedPoint],
    kept: &'a mut [bool],
    at: usize,
    step: f32,
    /// 1 where row 0 is a sample of the run, else 0.
    origin: usize,
}

impl RunCodec for RunDecoder<'_, '_> {
    #[inline(always)]
    fn begin_level(&mut self, rows: LevelRows, activity: &mut Activity) -> Result<()> {
        self.at = 0;
        // A local copy stays in registers.
        let mut reader = *self.reader;
        let mut recent = ScaledActivity::new(*activity);
        let steps = &mut self.steps[..rows.count];
        steps.fill(PaddedPoint::default());
        let mut i = 0;
        while i < steps.len() {
            reader.refill()?;
            // Index up to which symbols can be read without a refill.
            let mut filled_to = i + SYMBOLS_FILLED;
            let mut place = recent.place();
            if recent.is_quiet() {
                let zeros = reader.entry(self.tables, QUIET_PLACE)? as usize % 64;
                i = (i + zeros).min(steps.len());
                if zeros == QUIET_ROWS {
                    continue;
                }
                place = WAKE_PLACE;
                filled_to = i + 1;
            }
            loop {
                let slot =
                    steps.get_mut(i).ok_or(CodecError::Corrupt("too many rows in a level"))?;
                let entry = reader.entry(self.tables, place)?;
                let symbol = entry as usize % 64;
                *slot = self.tables.residuals[symbol];
                // Taken from the entry, not looked up: the next read depends on it.
                let mut magnitude = entry & MAGNITUDE;
                if entry & MORE != 0 {
                    let sum = residual(&mut reader, self.tables, symbol, place, slot)?;
                    magnitude = clamp_magnitude(sum);
                    filled_to = i + 1;
                }
                recent.push(magnitude);
                // The last anchor may lie beyond the samples.
                if let Some(kept) = self.kept.get_mut(rows.row(i) + self.origin - 1) {
                    *kept = magnitude != 0;
                }
                i += 1;
                if i >= filled_to || i >= steps.len() || recent.is_quiet() {
                    break;
                }
                place = recent.place();
            }
        }
        *self.reader = reader;
        *activity = recent.activity();
        Ok(())
    }

    #[inline(always)]
    fn reconstruct(&mut self, _row: usize, prediction: PaddedPoint) -> PaddedPoint {
        let steps = self.steps[self.at];
        self.at += 1;
        std::array::from_fn(|i| prediction[i] + steps[i] * self.step)
    }

    #[inline(always)]
    fn reconstruct_level(&mut self, _level: usize, count: usize, rows: &mut Planes) {
        let [x, y, z] = &mut rows.0;
        reconstruct_rows(&self.steps[..count], self.step, x, y, z);
    }
}

/// Adds residuals to predictions.
#[inline(always)]
fn reconstruct_rows(steps: &[PaddedPoint], step: f32, x: &mut [f32], y: &mut [f32], z: &mut [f32]) {
    let n = steps.len();
    let (x, y, z) = (&mut x[..n], &mut y[..n], &mut z[..n]);
    for (i, steps) in steps.iter().enumerate() {
        x[i] += steps[0] * step;
        y[i] += steps[1] * step;
        z[i] += steps[2] * step;
    }
}

/// Reads one magnitude of 2 or more, with its sign.
#[inline(always)]
fn larger(reader: &mut Reader<'_>, order: u32) -> Result<i32> {
    let word = reader.peek()?;
    let zeros = word.leading_zeros();
    ensure(zeros <= MAX_ZEROS, "a residual too large")?;
    let width = zeros + 1 + order;
    let value = (word << zeros >> (63 - width)) as u32;
    reader.skip(zeros + width + 1);
    let magnitude = ((value >> 1) - (1 << order) + 2) as i32;
    Ok(if value & 1 == 0 { magnitude } else { -magnitude })
}

/// Reads the larger magnitudes after a symbol of the table at `place` into the residual `steps`, and returns the sum
/// of all magnitudes.
#[inline(always)]
fn residual(
    reader: &mut Reader<'_>,
    tables: &Tables,
    symbol: usize,
    place: usize,
    steps: &mut PaddedPoint,
) -> Result<u32> {
    if tables.low_bits[place % PLACES] > 0 {
        return wide_residual(reader, tables, symbol, place, steps);
    }
    let mut magnitude = u32::from(tables.axes[symbol % SYMBOLS].ones);
    let mut axes = tables.axes[symbol % SYMBOLS].larger;
    while axes != 0 {
        let axis = axes.trailing_zeros() as usize % 4;
        axes &= axes - 1;
        let value = larger(reader, tables.golomb[place % PLACES])?;
        steps[axis] = value as f32;
        magnitude += value.unsigned_abs();
    }
    Ok(magnitude)
}

/// Reads a residual of a table with low bits, which precede the larger magnitudes, and returns the sum of magnitudes.
#[inline(always)]
fn wide_residual(
    reader: &mut Reader<'_>,
    tables: &Tables,
    symbol: usize,
    place: usize,
    steps: &mut PaddedPoint,
) -> Result<u32> {
    let low_bits = tables.low_bits[place % PLACES];
    let low = (reader.peek()? >> (64 - 3 * low_bits)) as i32;
    reader.skip(3 * low_bits);
    let mut magnitude = 0;
    for (axis, steps) in steps[..3].iter_mut().enumerate() {
        let high = match axis_code(symbol, axis) {
            0 => 0,
            1 => 1,
            2 => -1,
            _ => larger(reader, tables.golomb[place % PLACES])?,
        };
        let low = low >> (low_bits * (2 - axis as u32)) & ((1 << low_bits) - 1);
        let value = high * (1 << low_bits) + low - (1 << (low_bits - 1));
        *steps = value as f32;
        magnitude += value.unsigned_abs();
    }
    Ok(magnitude)
}
