//! Recovery after an error in the middle of a block, and equality of both instruction sets.

use super::{
    lattice::{Point, Points},
    level::{ResidualInputs, RowCodec},
    level_prediction::{Batch, LevelLayout, PAST_ROWS},
    walk::{Dense, SpanCodec},
};
use crate::{
    CodecError, Tolerance,
    coding::{isa::Isa, range::RangeEncoder},
    frame::Payload,
};

const CHANNELS: usize = 12;

/// Moves every row by an amount that channels partly share; can move one row out of range.
struct ScriptedCodec<'a> {
    coder: RangeEncoder<'a>,
    out_of_range: Option<(usize, usize)>,
    /// The level whose rows come next.
    next: LevelLayout,
}

/// A pseudo-random number from -8 to 7.
fn noise(seed: usize) -> i64 {
    (((seed + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) & 15) as i64 - 8
}

impl SpanCodec for ScriptedCodec<'_> {}

impl<'a> RowCodec for ScriptedCodec<'a> {
    type Coder = RangeEncoder<'a>;

    fn coder(&mut self) -> &mut RangeEncoder<'a> {
        &mut self.coder
    }

    fn choose(&mut self, inputs: ResidualInputs) -> Point {
        let channel = self.next.run.channel;
        let row = self.next.at(inputs.place) - PAST_ROWS;
        if self.out_of_range == Some((channel, row)) {
            return [1 << 40, 0, 0];
        }
        // Even, so that the point is on both lattices.
        std::array::from_fn(|axis| {
            2 * (5 * noise(3 * row + axis) + noise(1000 * channel + 3 * row + axis))
        })
    }

    fn begin(&mut self, layout: &LevelLayout) {
        self.next = *layout;
    }

    fn outside<const N: usize>(&mut self, _: Batch, _: &Points<N>) -> u32 {
        u32::MAX
    }

    fn finish_rows<const N: usize>(&mut self, _: Batch, _: &Points<N>, _: u32) {}
}

fn block(
    group: &mut Dense,
    n_rows: usize,
    out_of_range: Option<(usize, usize)>,
) -> Result<Vec<u8>, CodecError> {
    let mut out = Vec::new();
    let present = vec![true; n_rows];
    let coder = RangeEncoder::new(&mut out, usize::MAX);
    let mut codec = ScriptedCodec { coder, out_of_range, next: LevelLayout::default() };
    group.block(&mut codec, n_rows, &[Some(&present[..]); CHANNELS])?;
    assert!(codec.coder.finish());
    Ok(out)
}

#[test]
fn a_key_resets_the_state_after_an_error_within_a_block() {
    let group = || Dense::new(Tolerance::from_mm(0.5).unwrap());
    let mut fresh = group();
    let wanted = [block(&mut fresh, 128, None).unwrap(), block(&mut fresh, 128, None).unwrap()];
    // A whole span, and one that ends early, whose last row has another slot.
    for n_rows in [40, 64] {
        for row in [0, 20, n_rows - 1] {
            let mut group = group();
            let error = block(&mut group, n_rows, Some((5, row)));
            if row > 0 {
                assert!(matches!(error, Err(CodecError::Corrupt(_))), "row {row}: {error:?}");
            }
            group.reset();
            let got =
                [block(&mut group, 128, None).unwrap(), block(&mut group, 128, None).unwrap()];
            assert!(got == wanted, "after an error in row {row} of {n_rows}");
        }
    }
}

#[test]
fn both_instruction_sets_give_the_same_bytes() {
    let tolerance = Tolerance::from_mm(0.5).unwrap();
    let (mut wide, mut plain) =
        (Dense::with_isa(tolerance, Isa::detect()), Dense::with_isa(tolerance, Isa::plain()));
    for n_rows in [128, 100, 7, 128] {
        let (wide, plain) = (block(&mut wide, n_rows, None), block(&mut plain, n_rows, None));
        assert!(wide.is_ok() && wide == plain, "{n_rows} rows");
    }
}
