//! Rows stored axis by axis, for vector instructions: the rows of a level do not depend on one another.

use crate::Position;

/// x, y, z in millimetres or steps, and a lane that stays zero.
pub(super) type PaddedPoint = [f32; 4];

/// Rows of one vector operation. Values computed beyond the last row are not used.
pub(super) const LANES: usize = 8;
pub(super) type Lanes = [f32; LANES];

/// The x, y and z of many rows.
#[derive(Debug, Default)]
pub(super) struct Planes(pub(super) [Vec<f32>; 3]);

impl Planes {
    pub(super) fn grow(&mut self, padded_len: usize) {
        self.0.iter_mut().for_each(|plane| plane.resize(plane.len().max(padded_len), 0.0));
    }

    #[inline(always)]
    pub(super) fn get(&self, i: usize) -> PaddedPoint {
        let [x, y, z] = &self.0;
        [x[i], y[i], z[i], 0.0]
    }

    #[inline(always)]
    pub(super) fn set(&mut self, i: usize, point: PaddedPoint) {
        for (plane, value) in self.0.iter_mut().zip(point) {
            plane[i] = value;
        }
    }

    /// The three axes from row `from` on.
    #[inline(always)]
    pub(super) fn axes(&self, from: usize) -> [&[f32]; 3] {
        self.0.each_ref().map(|plane| &plane[from..])
    }
}

/// Moves the odd ones of the first `2 * n + 1` rows into `odd` and compacts the even ones. Works in whole vectors.
#[inline(always)]
pub(super) fn split(rows: &mut [f32], odd: &mut [f32], n: usize) {
    for (i, odd) in odd.as_chunks_mut::<LANES>().0[..n / LANES + 1].iter_mut().enumerate() {
        let mut both = [0.0; 2 * LANES];
        both.copy_from_slice(&rows[2 * LANES * i..][..2 * LANES]);
        *odd = std::array::from_fn(|j| both[2 * j + 1]);
        let even: Lanes = std::array::from_fn(|j| both[2 * j]);
        rows[LANES * i..][..LANES].copy_from_slice(&even);
    }
}

/// Interleaves `n + 1` even rows and the `n` odd rows between them. Works in whole vectors.
#[inline(always)]
pub(super) fn join(even: &[f32], odd: &[f32], n: usize, rows: &mut [f32]) {
    let n = n / LANES + 1;
    let (even, odd) = (lanes(even, n), lanes(odd, n));
    for (i, rows) in rows.as_chunks_mut::<{ 2 * LANES }>().0[..n].iter_mut().enumerate() {
        let (even, odd) = (&even[i], &odd[i]);
        let mut both = [0.0; 2 * LANES];
        for j in 0..LANES {
            both[2 * j] = even[j];
            both[2 * j + 1] = odd[j];
        }
        *rows = both;
    }
}

/// The first `n` vectors of a plane. Explicit vectors, because most levels of a live block are shorter than the vector
/// loops of the compiler.
#[inline(always)]
pub(super) fn lanes(plane: &[f32], n: usize) -> &[Lanes] {
    &plane.as_chunks().0[..n]
}

/// Interleaves the axes into positions; returns whether any coordinate is not finite.
#[inline(always)]
pub(super) fn gather(x: &[f32], y: &[f32], z: &[f32], positions: &mut [Position]) -> bool {
    let n = positions.len();
    let (x, y, z) = (&x[..n], &y[..n], &z[..n]);
    for (i, position) in positions.iter_mut().enumerate() {
        *position = [x[i], y[i], z[i]];
    }
    let mut not_finite = false;
    for i in 0..n {
        not_finite |= !x[i].is_finite() | !y[i].is_finite() | !z[i].is_finite();
    }
    not_finite
}

/// Separates positions into axes.
#[inline(always)]
pub(super) fn scatter(samples: &[Position], x: &mut [f32], y: &mut [f32], z: &mut [f32]) {
    for (((sample, x), y), z) in samples.iter().zip(x).zip(y).zip(z) {
        [*x, *y, *z] = *sample;
    }
}
