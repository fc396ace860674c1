//! What the odds are before anything was seen: counted on real takes by `benches/lab`.
//!
//! `prior.bin`: three bytes a context, a little-endian u16, its probability in 2^-16, and how many bits that
//! weighs; then three little-endian i16 a mixer, its weights in 1/1024.

use super::layout::{N_CONTEXTS, N_MIXERS};

static TABLE: &[u8; 3 * N_CONTEXTS + 6 * N_MIXERS] = include_bytes!("prior.bin");

/// Probability in 2^-16 and weight of a context.
pub(super) const fn context(index: usize) -> (u16, u8) {
    let at = 3 * index;
    (u16::from_le_bytes([TABLE[at], TABLE[at + 1]]), TABLE[at + 2])
}

/// The weights of a mixer, 1 being 2^16.
pub(super) fn weights(index: usize) -> [i32; 3] {
    std::array::from_fn(|i| {
        let at = 3 * N_CONTEXTS + 6 * index + 2 * i;
        i32::from(i16::from_le_bytes([TABLE[at], TABLE[at + 1]])) << 6
    })
}
