//! Sums of products of the residuals of a span, for all pairs of channels at once.

use crate::{GROUP_CHANNELS, coding::isa::Kernel};

use super::{SPAN, solve::Lane};

/// What a span leaves of the averages.
const DECAY: f64 = 0.9;

/// The rows of a class in the order in which they are coded: strides 32, 16, 8; 4; 2; 1. Anchors count as
/// they are coded.
const ROWS: [&[u8]; 5] = [
    &[],
    &[32, 16, 48, 8, 24, 40, 56],
    &[4, 12, 20, 28, 36, 44, 52, 60],
    &[2, 6, 10, 14, 18, 22, 26, 30, 34, 38, 42, 46, 50, 54, 58, 62],
    &[
        1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31, 33, 35, 37, 39, 41, 43, 45, 47,
        49, 51, 53, 55, 57, 59, 61, 63,
    ],
];

/// Vectors of all channels at the rows of a span, zero where there is none.
#[derive(Debug)]
pub(super) struct Span {
    /// By row, axis, channel.
    pub(super) rows: [[Lane; 3]; SPAN + 1],
}

impl Default for Span {
    fn default() -> Self {
        Self { rows: [[[0.0; GROUP_CHANNELS]; 3]; SPAN + 1] }
    }
}

impl Span {
    pub(super) fn clear(&mut self) {
        self.rows.as_flattened_mut().as_flattened_mut().fill(0.0);
    }
}

/// Channels by channels that are summed side by side.
const SIDE: usize = 4;
const _: () = assert!(GROUP_CHANNELS.is_multiple_of(SIDE));

/// One class at the end of a span of `n` channels.
#[derive(Debug)]
pub(super) struct Covarying<'a> {
    pub(super) class: usize,
    pub(super) n: usize,
    pub(super) covariances: &'a mut [Lane],
    pub(super) residuals: &'a Span,
    /// In 2^-16: each channel's own part. Zero at anchors.
    pub(super) learners: &'a Span,
}

impl Covarying<'_> {
    /// The covariances of `SIDE` channels from `j` on with as many from `k` on.
    #[inline(always)]
    fn tile(&mut self, j: usize, k: usize) {
        let part =
            |lane: &Lane, first: usize| -> [f64; SIDE] { std::array::from_fn(|i| lane[first + i]) };
        let mut sums: [[f64; SIDE]; SIDE] =
            std::array::from_fn(|i| part(&self.covariances[j + i], k));
        for &row in ROWS[self.class] {
            let (own, other) =
                (&self.learners.rows[usize::from(row)], &self.residuals.rows[usize::from(row)]);
            let [x, y, z] = [part(&own[0], j), part(&own[1], j), part(&own[2], j)];
            let [xs, ys, zs] = [part(&other[0], k), part(&other[1], k), part(&other[2], k)];
            for (i, sums) in sums.iter_mut().enumerate() {
                for (lane, sum) in sums.iter_mut().enumerate() {
                    *sum += x[i] * xs[lane] + y[i] * ys[lane] + z[i] * zs[lane];
                }
            }
        }
        for (i, sums) in sums.iter().enumerate() {
            for (lane, sum) in sums.iter().enumerate() {
                self.covariances[j + i][k + lane] = sum * DECAY;
            }
        }
    }
}

impl Kernel for Covarying<'_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        for j in (0..self.n).step_by(SIDE) {
            for k in (0..=j).step_by(SIDE) {
                self.tile(j, k);
            }
        }
        // What the later channel of a pair learnt holds for both.
        for j in 0..self.n {
            for k in 0..j {
                self.covariances[k][j] = self.covariances[j][k];
            }
        }
    }
}
