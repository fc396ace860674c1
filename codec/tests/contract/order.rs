//! Valid blocks in the wrong place: missing, repeated, swapped, or from another take.

use super::{
    Block, KINDS, check,
    damage::{NEXT_KEY, ROWS, group, well_formed},
    settings,
};

/// Missing, repeated and swapped blocks.
#[test]
fn blocks_out_of_order() {
    for kind in KINDS {
        let (settings, stretches, blocks) = group(kind);
        for order in [&[0, 2, 3, 4, 5][..], &[0, 1, 1, 2, 4, 5], &[0, 3, 2, 1, 4, 5], &[1, 2, 4, 5]]
        {
            let (mut decoder, mut decoded) = (settings.decoder(), Vec::new());
            for &i in order {
                let Block { bytes, shared, .. } = &blocks[i];
                let outcome = decoder.decode(bytes, shared, ROWS, stretches[i].key, &mut decoded);
                assert!(outcome.is_ok() || !stretches[i].key);
                well_formed(ROWS, &decoded);
                if i >= NEXT_KEY {
                    check(settings, &stretches[i], &blocks[i], &decoded);
                }
            }
        }
    }
}

/// The blocks of one resampler, decoded by another one with another tolerance.
#[test]
fn blocks_of_another_take() {
    for kind in KINDS {
        for other in KINDS {
            let (_, stretches, blocks) = group(other);
            let (mut decoder, mut decoded) = (settings(kind, 0.4).decoder(), Vec::new());
            for (stretch, Block { bytes, shared, .. }) in stretches.iter().zip(&blocks) {
                let outcome = decoder.decode(bytes, shared, ROWS, stretch.key, &mut decoded);
                assert!(outcome.is_ok() || decoded.is_empty());
                well_formed(ROWS, &decoded);
            }
        }
    }
}
