//! Round trips from samples to blocks and back.

use crate::{
    Input, check,
    motion::{Group, Stretch},
};

/// Maximum number of stretches of one input.
const STRETCHES_MAX: usize = 12;

/// Encodes and decodes any float32 samples, presence, tolerance and stretches: the bound holds, the encoder is
/// deterministic, and a decoder can start at any key.
pub fn round_trip(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let settings = input.settings();
    let mut group = Group::new(settings, &mut input);
    let mut stretches: Vec<Stretch> = Vec::new();
    while !input.is_empty() && stretches.len() < STRETCHES_MAX {
        let key = input.byte() & 3 == 0 || stretches.is_empty();
        stretches.push(group.stretch(key, &mut input));
    }
    let (mut encoder, mut again) = (settings.encoder(), settings.encoder());
    let (mut decoder, mut late) = (settings.decoder(), settings.decoder());
    let mut decoded = Vec::new();
    let mut prepared = false;
    for (i, stretch) in stretches.iter().enumerate() {
        let block = check::encode(settings, &mut *encoder, stretch);
        if stretch.key {
            // A key resets both encoder and decoder.
            (again, late) = (settings.encoder(), settings.decoder());
            prepared = i % 2 == 1;
        }
        if prepared {
            again.prepare(stretch.channels.len(), stretch.n_rows());
        }
        assert_eq!(check::encode(settings, &mut *again, stretch), block, "not deterministic");
        for decoder in [&mut decoder, &mut late] {
            decoder
                .decode(&block.bytes, &block.shared, stretch.n_rows(), stretch.key, &mut decoded)
                .expect("a block of our own");
            check::faithful(settings, stretch, &block, &decoded);
        }
    }
}
