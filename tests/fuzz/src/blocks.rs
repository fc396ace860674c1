//! Arbitrary bytes into the decoders of blocks.

use mocapd_codec::CodecError;

use crate::{Input, check, motion::Group};

/// Maximum number of blocks of one input.
const BLOCKS_MAX: usize = 24;

/// Maximum number of rows requested with arbitrary bytes: 64 channels of them take milliseconds.
const ROWS_MAX: usize = 1 << 10;

/// Decodes a sequence of arbitrary, valid, damaged and skipped blocks. Each gives an error or samples. After an error
/// the decoder accepts only a key block, and after that works normally.
pub fn decode_block(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let settings = input.settings();
    let mut group = Group::new(settings, &mut input);
    let n_shared = usize::from(input.byte());
    let any_shared = input.take(n_shared);
    let mut encoder = settings.encoder();
    let mut decoder = settings.decoder();
    let mut decoded = Vec::new();
    let mut lost = false;
    // The decoder follows the encoder only while no block was changed or skipped.
    let mut in_step = true;
    for _ in 0..BLOCKS_MAX {
        if input.is_empty() {
            break;
        }
        let head = input.byte();
        let (operation, key, times) = (head & 3, head & 4 != 0, usize::from(head >> 3));
        if operation == 3 {
            decoder.skip(key);
            lost &= !key;
            in_step = false;
            continue;
        }
        let (block, shared, n_rows, honest) = if operation == 0 {
            let n_rows = input.pair() % (ROWS_MAX + 1);
            let len = input.pair();
            (input.take(len).to_vec(), any_shared.to_vec(), n_rows, None)
        } else {
            let stretch = group.stretch(key, &mut input);
            let block = check::encode(settings, &mut *encoder, &stretch);
            let mut bytes = block.bytes.clone();
            let n_rows = stretch.n_rows();
            if operation == 2 {
                for _ in 0..times % 8 {
                    let at = input.pair() % bytes.len().max(1);
                    let change = input.byte();
                    bytes.get_mut(at).into_iter().for_each(|byte| *byte ^= change);
                }
                if times & 8 != 0 {
                    bytes.truncate(input.pair() % (bytes.len() + 1));
                }
            }
            let same = bytes == block.bytes;
            let shared = block.shared.clone();
            (bytes, shared, n_rows, same.then_some((stretch, block)))
        };
        let outcome = decoder.decode(&block, &shared, n_rows, key, &mut decoded);
        assert!(outcome.is_ok() || decoded.is_empty(), "a failed block leaves rows behind");
        check::well_formed(settings, n_rows, &decoded);
        if lost && !key {
            assert_eq!(outcome, Err(CodecError::OutOfStep), "taken without a key");
        }
        lost = outcome.is_err();
        in_step = honest.is_some() && (key || in_step);
        if let Some((stretch, block)) = honest.filter(|_| in_step) {
            assert_eq!(outcome, Ok(()), "a block of our own");
            check::faithful(settings, &stretch, &block, &decoded);
        }
    }
    // A key block restores the decoder from any state.
    let stretch = group.stretch(true, &mut Input::new(&[40, 0x42, 0x11, 0x63, 0]));
    let block = check::encode(settings, &mut *encoder, &stretch);
    decoder
        .decode(&block.bytes, &block.shared, stretch.n_rows(), true, &mut decoded)
        .expect("a key block of our own");
    check::faithful(settings, &stretch, &block, &decoded);
}
