//! Replaces samples by others within a bound of error that need fewer bytes: the middles of the cells of a coarser
//! lattice. The blocks of the result are those of any channel that takes few values.
//!
//! Samples that no number of the lattice represents within the bound stay unchanged, bit for bit: NaN, infinities, and
//! numbers so large that float32 is coarser there. So do exact zeros. In a channel whose zeros form long runs, such as
//! the force of an unloaded plate, no other sample becomes zero: the zeros show when there was no contact.

use super::{
    SampledEncoder,
    fit::{Fit, spacing},
};

/// Minimum mean length of runs of zeros that are preserved. Zero crossings of a signal of noise have runs of one or two
/// samples; an unloaded plate has runs of many samples.
const ZERO_RUN_MIN: u64 = 8;

/// Minimum number of samples in which a lattice is sought: fewer are on one by chance.
const LATTICE_SAMPLES_MIN: usize = 64;

/// Maximum number of pieces in which a lattice is sought: a channel without one in this many pieces is not on a
/// lattice.
const PIECES_SOUGHT_MAX: usize = 8;

/// Samples of a channel that are encoded to test whether a coarser lattice saves bytes: those of a channel that was
/// interpolated along lines need more bytes on one, because the lines are no longer exact.
const TRIED_SAMPLES: usize = 1 << 14;

/// The properties of a channel that decide how its samples are replaced, collected from all samples in any number of
/// pieces.
#[derive(Debug, Clone, Default)]
pub struct ChannelProfile {
    /// The smallest and the largest finite sample.
    range: Option<[f32; 2]>,
    n_zeros: u64,
    n_zero_runs: u64,
    ends_in_zero: bool,
    /// Quantum and offset of the lattice that the samples are on, if one was found.
    lattice: Option<[f64; 2]>,
    /// Number of pieces in which a lattice was sought.
    n_sought: usize,
    /// The range of the samples, if they are integers.
    integers: Option<[f32; 2]>,
    /// The first samples from the first change on, for the trial encoding.
    tried: Vec<f32>,
}

impl ChannelProfile {
    /// The profile of a channel whose samples are integers within a range, and stay in it.
    #[must_use]
    pub fn of_integers(range: [f32; 2]) -> Self {
        Self { lattice: Some([1.0, 0.0]), integers: Some(range), ..Self::default() }
    }

    /// Adds the next samples.
    pub fn add(&mut self, samples: &[f32]) {
        let mut is_changed = false;
        for &sample in samples {
            if sample.is_finite() {
                let [low, high] = self.range.unwrap_or([sample; 2]);
                self.range = Some([low.min(sample), high.max(sample)]);
            }
            let is_zero = sample == 0.0;
            self.n_zeros += u64::from(is_zero);
            self.n_zero_runs += u64::from(is_zero && !self.ends_in_zero);
            self.ends_in_zero = is_zero;
            is_changed |= self.range.is_some_and(|[low, high]| low < high);
            if is_changed && self.tried.len() < TRIED_SAMPLES {
                self.tried.push(sample);
            }
        }
        let may_be_on_lattice = self.lattice.is_none() && self.n_sought < PIECES_SOUGHT_MAX;
        if may_be_on_lattice && is_changed && samples.len() >= LATTICE_SAMPLES_MIN {
            self.n_sought += 1;
            self.lattice = Fit::default().lattice_of(samples);
        }
    }

    /// The largest finite sample less the smallest; 0 if none is finite.
    #[must_use]
    pub fn range(&self) -> f64 {
        self.range.map_or(0.0, |[low, high]| f64::from(high) - f64::from(low))
    }

    /// The step of the converter in units of the samples, if one was found in them.
    #[must_use]
    pub fn quantum(&self) -> Option<f64> {
        self.lattice.map(|[quantum, _]| quantum)
    }

    /// The error by which the distance of two samples may deviate from whole quanta, because each is a float32.
    #[must_use]
    pub fn rounding(&self) -> f64 {
        let largest = self.range.map_or(0.0, |[low, high]| low.abs().max(high.abs()));
        if self.integers.is_some() { 0.0 } else { spacing(largest.into()) }
    }

    /// Whether zeros are preserved, so that no other sample becomes zero.
    fn keeps_zeros(&self) -> bool {
        self.n_zeros >= ZERO_RUN_MIN * self.n_zero_runs.max(1)
    }
}

/// Replaces the samples of a channel, in any number of pieces.
#[derive(Debug, Clone)]
pub struct SampleBound {
    bound: f64,
    /// Distance between the values, and one of the values.
    step: f64,
    offset: f64,
    keeps_zeros: bool,
    integers: Option<[f32; 2]>,
}

impl SampleBound {
    /// For a channel and the largest allowed error, in the unit of the samples; `None` if replacing saves nothing.
    #[must_use]
    pub fn new(profile: &ChannelProfile, bound: f64) -> Option<Self> {
        let rounding = profile.rounding();
        let keeps_zeros = profile.keeps_zeros();
        let (mut step, mut offset) = (2.0 * (bound - rounding), 0.0);
        let mut step_min = 2.0 * rounding;
        if let Some([quantum, of_lattice]) = profile.lattice {
            // As many values of the channel on both sides of the middle of a cell as the bound allows; slightly more,
            // so that a bound of one quantum allows one.
            let reach = ((bound - rounding / 2.0) / quantum + 1e-6).floor();
            (step, offset) = ((2.0 * reach + 1.0) * quantum, of_lattice);
            if keeps_zeros {
                step = 2.0 * reach * quantum;
            }
            step_min = step_min.max(1.5 * quantum);
        }
        if !bound.is_finite() || step.is_nan() || step <= step_min {
            return None;
        }
        if keeps_zeros {
            // Zero lies between two cells.
            offset = step / 2.0;
        }
        let found = Self { bound, step, offset, keeps_zeros, integers: profile.integers };
        found.pays(&profile.tried).then_some(found)
    }

    /// Whether blocks of samples on the lattice are smaller.
    fn pays(&self, samples: &[f32]) -> bool {
        let bytes = |samples: &[f32]| {
            let mut block = Vec::new();
            let encoded = SampledEncoder::new().encode(&[samples], true, &mut block);
            encoded.map_or(usize::MAX, |()| block.len())
        };
        let mut replaced = samples.to_vec();
        self.apply(&mut replaced);
        bytes(&replaced) < bytes(samples)
    }

    /// Replaces samples. Returns the largest error, measured on what is left in `samples`.
    pub fn apply(&self, samples: &mut [f32]) -> f64 {
        let mut largest = 0.0_f64;
        for sample in samples {
            let replaced = self.replaced(*sample);
            // Other bits that are equal, such as those of NaN, are not an error.
            if replaced != *sample && sample.is_finite() {
                largest = largest.max((f64::from(replaced) - f64::from(*sample)).abs());
                *sample = replaced;
            }
        }
        largest
    }

    fn replaced(&self, sample: f32) -> f32 {
        if sample == 0.0 || !sample.is_finite() {
            return sample;
        }
        let exact = f64::from(sample);
        let cell = ((exact - self.offset) / self.step).round_ties_even();
        let value = (cell * self.step + self.offset) as f32;
        let is_within = (f64::from(value) - exact).abs() <= self.bound;
        let is_possible = self.integers.is_none_or(|[low, high]| low <= value && value <= high);
        let is_contact_kept =
            !self.keeps_zeros || value != 0.0 && value.is_sign_negative() == (sample < 0.0);
        if is_within && is_possible && is_contact_kept { value } else { sample }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Deterministic noise of -1 to 1.
    fn noise(seed: u64, n: usize) -> Vec<f64> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f64 / (1_u64 << 23) as f64 - 1.0
        };
        (0..n).map(|_| (next() + next() + next()) / 3.0).collect()
    }

    fn block_bytes(samples: &[f32]) -> usize {
        let mut block = Vec::new();
        SampledEncoder::new().encode(&[samples], true, &mut block).unwrap();
        block.len()
    }

    fn profiled(samples: &[f32]) -> ChannelProfile {
        let mut profile = ChannelProfile::default();
        samples.chunks(1000).for_each(|piece| profile.add(piece));
        profile
    }

    #[test]
    fn bounded_noise_needs_fewer_bytes() {
        let samples: Vec<f32> = noise(3, 8000).iter().map(|&x| (x * 0.37) as f32).collect();
        let profile = profiled(&samples);
        for bound in [1e-9, 1e-4, 1e-3, 0.05] {
            let Some(found) = SampleBound::new(&profile, bound) else {
                assert!(bound < 1e-8, "{bound}");
                continue;
            };
            let mut replaced = samples.clone();
            let largest = found.apply(&mut replaced);
            assert!(largest <= bound && largest > 0.8 * bound, "{largest} for {bound}");
            let measured =
                samples.iter().zip(&replaced).map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs());
            assert_eq!(measured.fold(0.0, f64::max), largest);
            assert!(block_bytes(&replaced) * 5 < block_bytes(&samples) * 4, "{bound}");
        }
    }

    #[test]
    fn zeros_of_force_plates_and_bits_of_nan_are_kept() {
        let step =
            |x: usize| (x % 1000 > 700).then(|| ((x % 1000 - 700) as f64 / 95.0).sin().abs());
        let mut samples: Vec<f32> = noise(5, 6000)
            .iter()
            .enumerate()
            .map(|(x, noise)| step(x).map_or(0.0, |force| (force * 900.0 + noise * 0.4) as f32))
            .collect();
        let nan = f32::from_bits(0x7fc1_2345);
        (samples[10], samples[11], samples[12]) = (nan, f32::INFINITY, -0.0);
        let found = SampleBound::new(&profiled(&samples), 0.5).unwrap();
        let mut replaced = samples.clone();
        assert!(found.apply(&mut replaced) <= 0.5);
        for (row, (a, b)) in samples.iter().zip(&replaced).enumerate() {
            assert_eq!(*a == 0.0, *b == 0.0, "contact in row {row}: {a} became {b}");
            if *a == 0.0 || !a.is_finite() {
                assert_eq!(a.to_bits(), b.to_bits(), "row {row}");
            }
        }
        assert!(block_bytes(&replaced) * 3 < block_bytes(&samples) * 2);
    }

    #[test]
    fn integers_stay_integers_within_their_range() {
        let full = [f32::from(i16::MIN), f32::from(i16::MAX)];
        let mut samples: Vec<f32> =
            noise(7, 5000).iter().map(|x| (x * 300.0).round() as f32).collect();
        (samples[0], samples[1]) = (full[0], full[1]);
        let mut profile = ChannelProfile::of_integers(full);
        profile.add(&samples);
        assert!(SampleBound::new(&profile, 0.9).is_none(), "less than a count");
        for bound in [1.0, 2.5, 40.0] {
            let found = SampleBound::new(&profile, bound).unwrap();
            let mut replaced = samples.clone();
            assert_eq!(found.apply(&mut replaced), f64::floor(bound));
            let is_one = |&x: &f32| x.fract() == 0.0 && (full[0]..=full[1]).contains(&x);
            assert!(replaced.iter().all(is_one));
            assert!(block_bytes(&replaced) < block_bytes(&samples));
        }
    }

    #[test]
    fn the_quantum_of_scaled_integers_is_found_and_lines_are_kept() {
        let counts: Vec<f32> =
            noise(9, 5000).iter().map(|x| (x * 200.0).round() as f32 * 0.004_882_8).collect();
        let profile = profiled(&counts);
        let quantum = profile.quantum().unwrap();
        assert!((quantum - 0.004_882_8).abs() < 1e-8, "{quantum}");
        assert!(SampleBound::new(&profile, quantum + profile.rounding()).is_some());
        // A knot every 64 samples, and exact lines between: a coarser lattice would destroy them.
        let knots: Vec<f32> =
            noise(11, 100).iter().map(|x| (x * 500.0).round() as f32 * 64.0).collect();
        let line =
            |x: usize| knots[x / 64] + (knots[x / 64 + 1] - knots[x / 64]) / 64.0 * (x % 64) as f32;
        let lines: Vec<f32> = (0..6000).map(line).collect();
        assert!(SampleBound::new(&profiled(&lines), 1.0).is_none());
        // Nothing can be saved in a constant channel.
        assert!(SampleBound::new(&profiled(&[0.25; 500]), 1.0).is_none());
    }
}
