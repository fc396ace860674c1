//! One regression of the table that `benches/subject/face_glance.py` learned.

use super::{CELLS_LOOK, PATCHES_LOOK, TOLD, Told};

/// Ways in which the landmarks are told to move.
const WAYS: usize = 24;
/// x and y of each landmark.
const NUMBERS: usize = 2 * TOLD.len();
/// How many regressions look around landmarks.
const OTHERS: usize = 2;

/// Bytes of a number, and of what every stage begins with: where the landmarks are on the mean, how far each way moves them
/// (pixels of the crop); for each way, its constant, and the unit of its weights. A weight a byte follows, look by look,
/// for each way.
const F32: usize = 4;
const HEAD: usize = F32 * (NUMBERS + WAYS * NUMBERS + 2 * WAYS);
const FIRST: usize = HEAD + WAYS * CELLS_LOOK;
const OTHER: usize = HEAD + WAYS * PATCHES_LOOK;

/// Little-endian.
static TABLE: &[u8] = include_bytes!("../../../data/face-glance.bin");
const _: () = assert!(
    include_bytes!("../../../data/face-glance.bin").len() == FIRST + OTHERS * OTHER,
    "face-glance.bin is of another size: learn it again by benches/subject/face_glance.py"
);

/// A linear regression from the bytes of a look to all landmarks.
pub(super) struct Stage {
    bytes: &'static [u8],
}

impl Stage {
    /// From the cells of the crop to where the landmarks are.
    pub(super) fn first() -> Stage {
        Stage { bytes: TABLE.get(..FIRST).unwrap_or_default() }
    }

    /// From the patches around landmarks to how they are to be moved.
    pub(super) fn others() -> impl Iterator<Item = Stage> {
        TABLE.get(FIRST..).unwrap_or_default().chunks_exact(OTHER).map(|bytes| Stage { bytes })
    }

    /// Of each landmark, pixels of the crop.
    pub(super) fn told(&self, look: &[u8]) -> Told {
        let (head, weights) = self.bytes.split_at(HEAD.min(self.bytes.len()));
        let mut numbers = head.chunks_exact(F32).filter_map(|bytes| bytes.try_into().ok());
        let mut next = || numbers.next().map_or(0.0, f32::from_le_bytes);
        let mut all: [f32; NUMBERS] = std::array::from_fn(|_| next());
        let ways: [[f32; NUMBERS]; WAYS] = std::array::from_fn(|_| std::array::from_fn(|_| next()));
        let added: [f32; WAYS] = std::array::from_fn(|_| next());
        let unit: [f32; WAYS] = std::array::from_fn(|_| next());
        let mut sums = [0_i32; WAYS];
        for (byte, weights) in look.iter().zip(weights.chunks_exact(WAYS)) {
            // 2016 bytes of 255 times 127 are far from the end of 32 bits.
            for (sum, weight) in sums.iter_mut().zip(weights) {
                *sum += i32::from(*byte) * i32::from(weight.cast_signed());
            }
        }
        for (((way, sum), added), unit) in ways.iter().zip(sums).zip(added).zip(unit) {
            let amount = added + unit * sum as f32;
            all.iter_mut().zip(way).for_each(|(at, by)| *at += amount * by);
        }
        let mut told: Told = [[0.0; 2]; TOLD.len()];
        for (point, at) in told.iter_mut().zip(all.chunks_exact(2)) {
            for (to, from) in point.iter_mut().zip(at) {
                *to = f64::from(*from);
            }
        }
        told
    }
}
