//! Samples of a recording at other instants: a windowed sinc, which is an interpolator and a low-pass at once.
//!
//! Source: Smith, "Digital Audio Resampling", section "Theory of Ideal Bandlimited Interpolation", and Kaiser's window (Oppenheim and
//! Schafer, Discrete-Time Signal Processing, section 7.5.3). The weights of an instant are divided by their sum, so that a
//! constant stays exactly what it is.

use std::{collections::VecDeque, f64::consts::PI, io};

use super::{RecordedSamples, SampleBlock};

/// Zero crossings of the sinc on each side of an instant.
const ZERO_CROSSINGS: f64 = 16.0;

/// Shape of Kaiser's window: side lobes of -80 dB.
const KAISER_BETA: f64 = 8.0;

/// The cutoff, as a share of half the lower one of the two rates: with 16 zero crossings, the filter falls from its
/// passband to -80 dB in a tenth of that.
const CUTOFF: f64 = 0.9;

/// The filter, as text for the user.
pub(crate) const FILTER: &str =
    "windowed sinc (Kaiser, beta 8, 16 zero crossings), low-pass at 90 % of half the lower rate";

/// Distance of two instants, in samples, below which they are one.
const SAME: f64 = 1e-6;

/// The samples of a group at instants in ascending order.
#[derive(Debug)]
pub(crate) struct Resampler<'a> {
    samples: RecordedSamples<'a>,
    block: SampleBlock,
    /// Samples of the block that were moved to the window.
    moved: usize,
    is_ended: bool,
    n_channels: usize,
    /// Places among the rows of consecutive samples, and to which gap-free series each belongs.
    window: VecDeque<(f64, u64)>,
    /// Their values, all channels of a sample in order.
    values: VecDeque<f32>,
    last_number: Option<u64>,
    series: u64,
    /// Cutoff in cycles of two samples, and samples on each side of an instant.
    cutoff: f64,
    half: usize,
}

impl<'a> Resampler<'a> {
    /// From `from_hz` to `to_hz`.
    pub(crate) fn new(samples: RecordedSamples<'a>, from_hz: f64, to_hz: f64) -> Self {
        let lower = (to_hz / from_hz).min(1.0);
        Self {
            n_channels: samples.channels().len(),
            samples,
            block: SampleBlock::default(),
            moved: 0,
            is_ended: false,
            window: VecDeque::new(),
            values: VecDeque::new(),
            last_number: None,
            series: 0,
            cutoff: CUTOFF * lower,
            half: (ZERO_CROSSINGS / lower).ceil().clamp(1.0, 1e5) as usize,
        }
    }

    /// Appends the samples at a place among the rows, as the take stores them. Returns `false`, and appends nothing, where
    /// samples are lost or there are none on both sides.
    ///
    /// # Errors
    /// Those of reading the take.
    pub(crate) fn at(&mut self, position: f64, out: &mut Vec<f32>) -> io::Result<bool> {
        let after =
            |window: &VecDeque<(f64, u64)>| window.partition_point(|(at, _)| *at <= position);
        while !self.is_ended && self.window.len() < after(&self.window) + self.half {
            self.advance()?;
        }
        let after = after(&self.window);
        let Some(before) = after.checked_sub(1) else { return Ok(false) };
        let Some(&(left, series)) = self.window.get(before) else { return Ok(false) };
        let next = self.window.get(after).filter(|(_, other)| *other == series);
        let fraction = match next {
            Some((right, _)) => (position - left) / (right - left),
            None if position - left < SAME => 0.0,
            None => return Ok(false),
        };
        self.interpolate(before, series, fraction, out);
        // The samples before the longest reach of later instants are not needed any more.
        for _ in 0..before.saturating_sub(self.half) {
            self.window.pop_front();
            self.values.drain(..self.n_channels);
        }
        Ok(true)
    }

    fn interpolate(&self, before: usize, series: u64, fraction: f64, out: &mut Vec<f32>) {
        let reach = self.half as f64;
        let from = before as i64 - self.half as i64 + 1;
        let (mut sums, mut total) = (vec![0.0; self.n_channels], 0.0);
        // The ends of a series are held.
        let is_of = |at: usize| self.window.get(at).is_some_and(|(_, other)| *other == series);
        let mut first = before;
        while first > 0 && first as i64 > from && is_of(first - 1) {
            first -= 1;
        }
        let mut last = before;
        while last < before + self.half && is_of(last + 1) {
            last += 1;
        }
        for tap in from..from + 2 * self.half as i64 {
            let distance = tap as f64 - before as f64 - fraction;
            let weight = sinc(distance * self.cutoff) * kaiser(distance / reach);
            total += weight;
            let held = tap.clamp(first as i64, last as i64) as usize * self.n_channels;
            for (sum, value) in sums.iter_mut().zip(self.values.range(held..held + self.n_channels))
            {
                *sum += weight * f64::from(*value);
            }
        }
        out.extend(sums.into_iter().map(|sum| (sum / total) as f32));
    }

    /// Moves the next sample into the window.
    fn advance(&mut self) -> io::Result<()> {
        if self.moved >= self.block.numbers.len() {
            self.moved = 0;
            self.is_ended = !self.samples.next_block(&mut self.block)?;
            if self.is_ended {
                self.block = SampleBlock::default();
                return Ok(());
            }
        }
        let at = self.moved;
        self.moved += 1;
        let (number, position) = (self.block.numbers[at], self.block.positions[at]);
        let values = &self.block.stored[at * self.n_channels..(at + 1) * self.n_channels];
        let last = self.window.back().map_or(f64::NEG_INFINITY, |(last, _)| *last);
        // Time does not go back, even where the device's clock begins again.
        if self.block.is_lost || values.iter().any(|value| !value.is_finite()) || position <= last {
            self.last_number = None;
            return Ok(());
        }
        if self.last_number.is_none_or(|last| last + 1 != number) {
            self.series += 1;
        }
        self.last_number = Some(number);
        self.window.push_back((position, self.series));
        self.values.extend(values);
        Ok(())
    }
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { (PI * x).sin() / (PI * x) }
}

/// Kaiser's window, without its constant factor, at a share of its half length.
fn kaiser(x: f64) -> f64 {
    let inside = 1.0 - x * x;
    if inside <= 0.0 { 0.0 } else { bessel_i0(KAISER_BETA * inside.sqrt()) }
}

/// The modified Bessel function of the first kind and order 0, by its power series.
fn bessel_i0(x: f64) -> f64 {
    let quarter = x * x / 4.0;
    let (mut sum, mut term, mut k) = (1.0, 1.0, 1.0);
    while term > sum * 1e-12 {
        term *= quarter / (k * k);
        sum += term;
        k += 1.0;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_is_that_of_kaiser() {
        // I0(8) = 427.564115721804785177..., Abramowitz and Stegun, table 9.11.
        assert!((bessel_i0(8.0) - 427.564_115_721_804_8).abs() < 1e-9);
        assert_eq!((kaiser(0.0), kaiser(1.0), kaiser(-1.5)), (bessel_i0(8.0), 0.0, 0.0));
        assert!((sinc(0.5) - 2.0 / PI).abs() < 1e-15 && sinc(3.0).abs() < 1e-15);
    }
}
