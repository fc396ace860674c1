//! What the odds are before anything was seen: counted on real takes by `benches/lab`.
//!
//! `prior.bin`: a byte a context, its probability in 1/256 (0: nothing known), then three little-endian
//! i16 a mixer, its weights in 1/1024.

use super::layout::{N_CONTEXTS, N_MIXERS};

static TABLE: &[u8; N_CONTEXTS + 6 * N_MIXERS] = include_bytes!("prior.bin");

/// How many bits a counted probability weighs.
const SEEN: u8 = 12;

/// Probability in 2^-16 and weight of a context.
pub(super) fn context(index: usize) -> (u16, u8) {
    match TABLE[index] {
        0 => (1 << 15, 0),
        p => (u16::from(p) << 8 | 0x80, SEEN),
    }
}

/// The weights of a mixer, 1 being 2^16.
pub(super) fn weights(index: usize) -> [i32; 3] {
    std::array::from_fn(|i| {
        let at = N_CONTEXTS + 6 * index + 2 * i;
        i32::from(i16::from_le_bytes([TABLE[at], TABLE[at + 1]])) << 6
    })
}
