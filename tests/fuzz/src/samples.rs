//! Arbitrary samples and bytes into the encoder and the decoder of sampled channels.

use mocapd_codec::{
    CodecError,
    sampled::{SampledDecoder, SampledEncoder, max_block_bytes},
};

use crate::Input;

/// Maximum number of blocks of one input.
const BLOCKS_MAX: usize = 12;

/// Maximum number of rows of a block.
const ROWS_MAX: usize = 1 << 8;

/// Maximum number of samples of a block that is encoded: with all rows of 64 channels the fuzzer runs half as many inputs a second.
const SAMPLES_MAX: usize = 1 << 10;

/// Encodes arbitrary samples, which come back bit for bit, and decodes arbitrary, damaged and skipped blocks. Each gives
/// an error or samples. After an error the decoder accepts only a key block, and after that works normally.
pub fn decode_samples(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let n_channels = usize::from(input.byte()) % 64 + 1;
    let (mut encoder, mut decoder) = (SampledEncoder::new(), SampledDecoder::new());
    let (mut is_in_step, mut is_broken, mut has_begun) = (false, true, false);
    for _ in 0..BLOCKS_MAX {
        if input.is_empty() {
            break;
        }
        let head = input.byte();
        // An encoder begins with a key block.
        let (operation, key) = (head & 3, head & 4 != 0 || !has_begun);
        if operation == 3 {
            is_in_step = false;
            decoder = SampledDecoder::new();
            is_broken = true;
            continue;
        }
        if operation == 0 {
            let (n_rows, len) = (input.pair() % (ROWS_MAX + 1), input.pair());
            let decoded = decoder.decode(input.take(len), n_rows, key).map(<[f32]>::len);
            if n_rows > 0 {
                assert!(!is_broken || key || decoded == Err(CodecError::OutOfStep));
                is_broken = decoded.is_err();
                is_in_step = false;
            }
            continue;
        }
        let channels = channels(&mut input, n_channels, usize::from(head >> 3));
        let rows: Vec<&[f32]> = channels.iter().map(Vec::as_slice).collect();
        let n_rows = rows[0].len();
        let mut block = Vec::new();
        has_begun = true;
        encoder.encode(&rows, key, &mut block).expect("channels of one length");
        assert!(block.len() <= max_block_bytes(n_channels, n_rows), "longer than the limit");
        let whole = block.clone();
        if operation == 2 {
            let at = input.pair() % block.len().max(1);
            let change = input.byte();
            block.get_mut(at).into_iter().for_each(|byte| *byte ^= change);
            if head & 8 != 0 {
                block.truncate(input.pair() % (block.len() + 1));
            }
        }
        let is_faithful = block == whole && (key || is_in_step);
        let decoded = decoder.decode(&block, n_rows, key);
        assert!(!is_broken || key || decoded == Err(CodecError::OutOfStep));
        if is_faithful {
            let decoded = decoded.expect("an encoder's block");
            let wanted = channels.iter().flatten();
            assert!(decoded.iter().zip(wanted).all(|(a, b)| a.to_bits() == b.to_bits()));
            (is_in_step, is_broken) = (true, false);
        } else {
            is_broken = decoded.is_err();
            is_in_step = false;
        }
    }
}

/// Samples of channels: of integers, of scaled ones, of repeated ones, or of any bits.
fn channels(input: &mut Input<'_>, n_channels: usize, mode: usize) -> Vec<Vec<f32>> {
    let n_rows = usize::from(input.byte()) % ROWS_MAX.min(SAMPLES_MAX / n_channels) + 1;
    let channel = |channel: usize| {
        let mut last = 0.0;
        let mut sample = |_| {
            last = match (mode + channel) % 5 {
                0 => f32::from(input.byte() as i8),
                1 => last + f32::from(input.byte() as i8) * 0.125,
                2 => f32::from(input.pair() as u16 as i16) * 0.000_305_18,
                3 if input.byte() & 3 != 0 => last,
                _ => input.float(),
            };
            last
        };
        (0..n_rows).map(&mut sample).collect()
    };
    (0..n_channels).map(channel).collect()
}
