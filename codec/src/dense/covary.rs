//! Sums of products of the residuals of a span, for all pairs of channels at once.

use crate::{GROUP_CHANNELS, coding::isa::Kernel};

use super::{
    SPAN,
    solve::Lane,
    weave::{CLASSES, SpanVectors},
};

/// What a span leaves of the averages.
const DECAY: f64 = 0.9;
/// Products are in squares of 256 units.
pub(super) const SCALE: f64 = 65536.0;

/// Where the rows of a class lie side by side ([`slot`](super::track::slot)): strides 32, 16 and 8; 4; 2; 1.
/// Anchors count as they are coded.
const SLOTS: [(usize, usize); CLASSES] = [(0, 0), (0, 8), (8, 16), (16, 32), (32, 64)];

/// Channels by channels that are summed side by side.
const HIGH: usize = 4;
pub(super) const WIDE: usize = 8;
const _: () = assert!(GROUP_CHANNELS.is_multiple_of(WIDE) && WIDE.is_multiple_of(HIGH));

/// The residuals of a span by slot, axis and channel; zero where there is none, and at anchors.
#[derive(Debug)]
pub(super) struct Span([[[f32; GROUP_CHANNELS]; 3]; SPAN]);

impl Default for Span {
    fn default() -> Self {
        Self([[[0.0; GROUP_CHANNELS]; 3]; SPAN])
    }
}

/// The end of a span of `n` channels.
#[derive(Debug)]
pub(super) struct Covarying<'a> {
    pub(super) n: usize,
    /// By class, channel, channel, both ways around.
    pub(super) covariances: &'a mut [Lane],
    /// By channel; those from `n` to the next multiple of [`WIDE`] are zero.
    pub(super) residuals: &'a [SpanVectors],
    /// Room to work in.
    pub(super) span: &'a mut Span,
}

impl Covarying<'_> {
    #[inline(always)]
    fn turn(&mut self) {
        let n = self.n.next_multiple_of(WIDE);
        for (channel, vectors) in self.residuals.iter().enumerate().take(n) {
            for (axis, lane) in vectors.0.iter().enumerate() {
                for (row, residual) in self.span.0.iter_mut().zip(lane) {
                    row[axis][channel] = *residual;
                }
            }
        }
    }

    /// The covariances of a few channels from `j` on with a few from `k` on.
    #[inline(always)]
    fn tile(&mut self, class: usize, j: usize, k: usize) {
        let (first, end) = SLOTS[class];
        let mut sums = [[0.0_f32; WIDE]; HIGH];
        for row in &self.span.0[first..end] {
            for lane in row {
                let own: [f32; HIGH] = std::array::from_fn(|i| lane[j + i]);
                let other: [f32; WIDE] = std::array::from_fn(|i| lane[k + i]);
                for (own, sums) in own.into_iter().zip(&mut sums) {
                    for (sum, other) in sums.iter_mut().zip(other) {
                        *sum += own * other;
                    }
                }
            }
        }
        let covariances = &mut self.covariances[class * GROUP_CHANNELS + j..][..HIGH];
        for (covariances, sums) in covariances.iter_mut().zip(sums) {
            for (covariance, sum) in covariances[k..k + WIDE].iter_mut().zip(sums) {
                *covariance = (*covariance + f64::from(sum) / SCALE) * DECAY;
            }
        }
    }
}

impl Kernel for Covarying<'_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        self.turn();
        for class in 0..CLASSES {
            for j in (0..self.n).step_by(HIGH) {
                for k in (0..j + HIGH).step_by(WIDE) {
                    self.tile(class, j, k);
                }
            }
            // What the later channel of a pair learnt holds for both.
            let covariances = &mut self.covariances[class * GROUP_CHANNELS..][..self.n];
            for j in 0..covariances.len() {
                let (before, from) = covariances.split_at_mut(j);
                for (other, covariance) in before.iter_mut().zip(&from[0]) {
                    other[j] = *covariance;
                }
            }
        }
    }
}
