//! The range coder alone.

use mocapd_codec::range::{BinaryCoder, Bit, RangeDecoder, RangeEncoder};

use crate::Input;

const MODELS: usize = 8;

/// Maximum number of bits of one input, which bounds a decoder that would never end.
const STEPS_MAX: usize = 1 << 14;

/// Encodes and decodes a program of bits, which must round-trip if it fits the limit; then decodes arbitrary bytes.
pub fn range_coder(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let limit = input.pair();
    let program = input;

    let mut out = vec![0xa5; 3];
    let mut encoder = RangeEncoder::new(&mut out, limit);
    let wanted = run(&mut encoder, program);
    let fits = encoder.finish();
    assert!(out.len() - 3 <= limit && out[..3] == [0xa5; 3]);
    if fits {
        assert!(out.len() == 3 || out.last() != Some(&0), "a zero that need not be stored");
        let mut decoder = RangeDecoder::new(&out[3..]);
        assert_eq!(run(&mut decoder, blank(program).input()), wanted);
        assert_eq!(decoder.finish(), Ok(()));
    }
    // The same steps, decoded from arbitrary bytes.
    for cut in [0, bytes.len() / 2] {
        let mut decoder = RangeDecoder::new(&bytes[cut..]);
        let answers = run(&mut decoder, program);
        assert!(answers.len() == wanted.len());
        let _ = decoder.finish();
    }
}

/// A program without its values.
struct Blank(Vec<u8>);

impl Blank {
    fn input(&self) -> Input<'_> {
        Input::new(&self.0)
    }
}

/// Clears the values of a program and keeps its steps: a decoder must not see the values.
fn blank(mut program: Input<'_>) -> Blank {
    let mut steps = Vec::new();
    while !program.is_empty() {
        let (step, _) = (program.byte(), program.byte());
        steps.extend([step, 0]);
    }
    Blank(steps)
}

/// Runs a program of steps and values; returns the result of each step.
fn run(coder: &mut impl BinaryCoder, mut program: Input<'_>) -> Vec<u64> {
    let mut models = [Bit::NEW; MODELS];
    for (model, odds) in models.iter_mut().skip(MODELS / 2).zip([0, 4, 128, 255]) {
        *model = Bit::expecting(odds);
    }
    let mut given = Vec::new();
    while !program.is_empty() && given.len() < STEPS_MAX {
        let (step, value) = (program.byte(), program.byte());
        let (at, bit) = (usize::from(step >> 2) % MODELS, value & 1 == 1);
        match step & 3 {
            0 => given
                .extend((0..8).map(|i| u64::from(coder.bit(&mut models[at], value >> i & 1 == 1)))),
            1 => {
                let (mut a, mut b) = (models[at], models[(at + 3) % MODELS]);
                given.push(u64::from(coder.mixed(&mut a, &mut b, bit)));
                (models[at], models[(at + 3) % MODELS]) = (a, b);
            }
            2 => {
                let n = u32::from(step >> 2);
                let read = coder.plain(u64::from(value) << (n / 2), n);
                assert!(n == 64 || read >> n == 0);
                given.push(read);
            }
            // The odds that the contract allows: at least 1, and less than the total.
            _ => {
                let odds = (u32::from(step >> 2) << 10 | 32).clamp(1, (1 << 16) - 1);
                given.push(u64::from(coder.split(odds, bit)));
            }
        }
    }
    given
}
