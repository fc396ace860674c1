//! What one marker's residuals say about another's.
//!
//! Markers of one body accelerate together. For every pair of channels and every class of levels an
//! average remembers the inner products of their residuals at the same rows; the residual of a channel
//! is then expected from up to three channels before it, by least squares. Before anything was seen,
//! markers that are close together are taken to move alike: the covariance starts from a function of
//! their distance, as in kriging.

use crate::{
    GROUP_CHANNELS,
    coding::isa::{Isa, Kernel},
};

use super::{
    SPAN,
    ahead::PADDED,
    code::{Points, copy},
    covary::{self, Covarying, SCALE, Span},
    solve::{Lane, SolvingAll, Work, ridged},
};

/// Classes of levels: anchors; strides 8 and more; 4; 2; 1.
pub(super) const CLASSES: usize = 5;
/// Channels that a residual is expected from, at most.
pub(super) const REFERENCES: usize = 3;

/// The weight of the distances, in averages of all channels' energies.
const KERNEL_WEIGHT: f64 = 0.3;
/// The least such average, in squared tolerances.
const LEAST_ENERGY: f64 = 10.0;
/// Residuals count up to this length, in units: 500 tolerances.
const MAX_RESIDUAL: f64 = 128_000.0;

/// The references of one channel in one class.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct References {
    /// How many are filled.
    pub(super) n: usize,
    /// Their channels.
    pub(super) channels: [usize; REFERENCES],
    /// Whether each goes along or against.
    pub(super) signs: [f64; REFERENCES],
    /// All 0 where they do not explain enough to be used for the expectation.
    pub(super) weights: [f64; REFERENCES],
}

/// The residuals of a channel in a span, by axis and [`slot`]; zero where there is none.
#[derive(Debug, Clone)]
pub(super) struct SpanVectors(pub(super) [[f32; PADDED]; 3]);

impl Default for SpanVectors {
    fn default() -> Self {
        Self([[0.0; PADDED]; 3])
    }
}

/// All averages of a group.
#[derive(Debug)]
pub(super) struct Weave {
    pub(super) isa: Isa,
    /// By class, channel, channel, both ways around.
    covariances: Vec<Lane>,
    /// By channel and channel, both ways around.
    kernel: Vec<Lane>,
    /// Of the span, by axis: where the channels are, in units; NaN where that is not known.
    places: [Lane; 3],
    /// Of the span, by class: the weight of the kernel, and one over the variances with their ridge. Only anchors
    /// change theirs within a span.
    energies: [f64; CLASSES],
    inverse: [Lane; CLASSES],
    references: Vec<References>,
    /// The residuals of the current span, by channel.
    pub(super) by_channel: Vec<SpanVectors>,
    /// Which of them are of anchors, a bit a slot.
    anchors: [u64; GROUP_CHANNELS],
    span: Box<Span>,
    work: Box<Work>,
}

impl Weave {
    pub(super) fn new() -> Self {
        Self {
            isa: Isa::detect(),
            covariances: vec![[0.0; GROUP_CHANNELS]; CLASSES * GROUP_CHANNELS],
            kernel: vec![[0.0; GROUP_CHANNELS]; GROUP_CHANNELS],
            places: [[f64::NAN; GROUP_CHANNELS]; 3],
            energies: [0.0; CLASSES],
            inverse: [[1.0; GROUP_CHANNELS]; CLASSES],
            references: vec![References::default(); CLASSES * GROUP_CHANNELS],
            by_channel: vec![SpanVectors::default(); GROUP_CHANNELS],
            anchors: [0; GROUP_CHANNELS],
            span: Box::default(),
            work: Box::new(Work::new()),
        }
    }

    pub(super) fn reset(&mut self) {
        self.covariances.fill([0.0; GROUP_CHANNELS]);
        self.references.fill(References::default());
    }

    /// A span of `n` channels begins.
    pub(super) fn begin(&mut self, n: usize) {
        self.by_channel[..n.next_multiple_of(covary::WIDE)].fill(SpanVectors::default());
        // Those of a span that was not ended, because its bytes were damaged.
        self.anchors = [0; GROUP_CHANNELS];
        for (k, lane) in self.kernel.iter_mut().enumerate().take(n) {
            lane[..n].fill(0.0);
            lane[k] = 1.0;
        }
        self.places.iter_mut().for_each(|axis| axis[..n].fill(f64::NAN));
        for class in 0..CLASSES {
            self.weigh_kernel(class, n);
        }
    }

    /// What the solving of a class needs of all its variances.
    fn weigh_kernel(&mut self, class: usize, n: usize) {
        let covariances = &self.covariances[class * GROUP_CHANNELS..][..n];
        let variances = covariances.iter().enumerate().map(|(k, lane)| lane[k]);
        let energies = variances.clone().fold(0.0, |sum, variance| sum + variance);
        let energy = (energies / n as f64).max(LEAST_ENERGY) * KERNEL_WEIGHT;
        self.energies[class] = energy;
        for (out, variance) in self.inverse[class].iter_mut().zip(variances) {
            *out = 1.0 / ridged(variance + energy);
        }
    }

    /// The span is over: what was seen in it is remembered, and the averages forget a little.
    pub(super) fn end(&mut self, n: usize) {
        // Anchors were learnt from at once.
        for (vectors, anchors) in self.by_channel.iter_mut().zip(&mut self.anchors) {
            while *anchors != 0 {
                let slot = anchors.trailing_zeros() as usize;
                vectors.0.iter_mut().for_each(|lane| lane[slot] = 0.0);
                *anchors &= *anchors - 1;
            }
        }
        self.isa.run(Covarying {
            n,
            covariances: &mut self.covariances,
            residuals: &self.by_channel,
            span: &mut self.span,
        });
    }

    /// States where a channel is in this span, in units.
    pub(super) fn place(&mut self, channel: usize, point: [f64; 3]) {
        for (axis, units) in self.places.iter_mut().zip(point) {
            axis[channel] = units;
        }
    }

    /// Whether that has been stated.
    pub(super) fn has_place(&self, channel: usize) -> bool {
        !self.places[0][channel].is_nan()
    }

    /// Works out how near channel `j` is to those before it.
    pub(super) fn find_near(&mut self, j: usize, unit_mm: f64) {
        let Self { isa, places, kernel, .. } = self;
        isa.run(Nearing { j, unit_mm, places, kernel });
    }

    /// How alike two channels are taken to move for their distance.
    pub(super) fn nearness(&self, j: usize, k: usize) -> f64 {
        self.kernel[j][k]
    }

    pub(super) fn references(&self, class: usize, j: usize) -> &References {
        &self.references[class * GROUP_CHANNELS + j]
    }

    /// Remembers the residuals of some rows: where they are, less where time alone put them. The first has the
    /// place `slot` in the span.
    #[inline(always)]
    pub(super) fn remember<const N: usize>(
        &mut self,
        j: usize,
        (slot, n): (usize, usize),
        residuals: &mut Points<N>,
    ) {
        let [x, y, z] = &*residuals;
        let mut squares = [0.0; N];
        for i in 0..N {
            squares[i] = x[i] * x[i] + y[i] * y[i] + z[i] * z[i];
        }
        let most = MAX_RESIDUAL * MAX_RESIDUAL;
        if squares.iter().fold(false, |far, &squares| far | (squares > most)) {
            for (i, squares) in squares.into_iter().enumerate().filter(|&(_, s)| s > most) {
                let share = MAX_RESIDUAL / squares.sqrt();
                residuals.iter_mut().for_each(|axis| axis[i] *= share);
            }
        }
        for (out, residuals) in self.by_channel[j].0.iter_mut().zip(residuals) {
            copy(&residuals.map(|units| units as f32), &mut out[slot..], n);
        }
    }

    /// Learns from the residual of the anchor that was ahead. It counts at once: the anchors of one span come one
    /// after another and choose their references in between. Levels count at the end of the span.
    pub(super) fn learn_anchor(&mut self, j: usize, place: usize) {
        self.anchors[j] |= 1 << place;
        let residual = |k: usize, axis: usize| f64::from(self.by_channel[k].0[axis][place]);
        let [x, y, z] = [residual(j, 0), residual(j, 1), residual(j, 2)];
        for k in 0..=j {
            let product = x * residual(k, 0) + y * residual(k, 1) + z * residual(k, 2);
            let covariance = self.covariances[j][k] + product / SCALE;
            self.covariances[j][k] = covariance;
            self.covariances[k][j] = covariance;
        }
    }

    /// Chooses and weighs the references of channel `j` of `n`, for every class.
    pub(super) fn solve(&mut self, j: usize, n: usize) {
        self.weigh_kernel(0, n);
        self.isa.run(SolvingAll {
            j,
            covariances: &self.covariances,
            kernel: &self.kernel,
            energies: &self.energies,
            inverse: &self.inverse,
            references: &mut self.references,
            work: &mut self.work,
        });
    }
}

/// How near a channel is to those before it.
struct Nearing<'a> {
    j: usize,
    unit_mm: f64,
    places: &'a [Lane; 3],
    kernel: &'a mut [Lane],
}

impl Kernel for Nearing<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { j, unit_mm, places: [xs, ys, zs], kernel } = self;
        let (before, own) = kernel.split_at_mut(j);
        let (own, n) = (&mut own[0][..j], j);
        let (x, y, z) = (xs[j], ys[j], zs[j]);
        for (((near, other_x), other_y), other_z) in own.iter_mut().zip(xs).zip(ys).zip(zs) {
            let (x, y, z) = (x - other_x, y - other_y, z - other_z);
            let mm = (x * x + y * y + z * z).sqrt() * unit_mm;
            let ratio = 800.0 / (800.0 + mm);
            let cube = ratio * ratio * ratio;
            // Not so where one of them is nowhere.
            *near = if cube >= 0.0 { cube } else { 0.0 };
        }
        for (other, near) in before.iter_mut().zip(own) {
            other[n] = *near;
        }
    }
}

const _: () = assert!(SPAN == 64);
