//! The choice of knots: greedily for each channel, or as key times that all channels share.
//!
//! Greedy choice inserts one knot after another. The system for the moments is diagonally dominant by a factor of two, so the effect of an insertion on a moment at
//! least halves with every knot in between. Only the moments within [`REACH`] knots are solved again; beyond, the
//! change is below the resolution of f64.

use std::ops::Range;

use super::{Knot, Moments, RunFit};
use crate::{
    CodecError, Position, Result, Rows, Tolerance,
    block::{squared_distance, widen},
    coding::{Bytes, write_varint},
    frame,
};

/// How `spline` chooses the next knot: two readings of step 2 of (Shi et al. 2012, section 2.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum SplineVariant {
    /// Insert the sample whose current error is largest.
    #[default]
    WorstSample,
    /// Try every sample; insert the one whose insertion leaves the smallest sum of squared errors.
    Exhaustive,
}

impl SplineVariant {
    /// Longest run that [`Exhaustive`](Self::Exhaustive) accepts, in samples. Its time grows with the third power of
    /// the length and reaches some seconds per channel at this length.
    pub const EXHAUSTIVE_MAX_RUN_ROWS: usize = 1024;
}

/// Number of knots over which a change fades to 2^-64.
const REACH: usize = 64;

/// The errors of an interval between two knots.
#[derive(Debug, Clone, Copy, Default)]
struct Misfit {
    /// Largest squared error of a sample between the knots, in mm^2.
    worst: f64,
    /// The first sample with this error.
    row: usize,
    /// Sum of squared errors, in mm^2.
    sum: f64,
}

/// One run while its knots are chosen.
#[derive(Debug)]
struct Greedy<'a> {
    samples: &'a [Position],
    knots: Vec<Knot>,
    moments: Moments,
    /// One per interval.
    misfits: Vec<Misfit>,
    trial: (Vec<Knot>, Moments),
}

impl<'a> Greedy<'a> {
    /// Starts with the first and the last sample of a run of at least three.
    fn new(samples: &'a [Position]) -> Self {
        let last = samples.len() - 1;
        let knots = vec![(0, widen(samples[0])), (last, widen(samples[last]))];
        let mut moments = Moments::default();
        moments.solve(&knots);
        let misfits = vec![misfit(samples, &knots, &moments, 0)];
        Self { samples, knots, moments, misfits, trial: Default::default() }
    }

    /// The errors of the interval with the worst sample, the first of equals.
    fn worst(&self) -> Misfit {
        self.misfits.iter().fold(
            Misfit::default(),
            |worst, m| {
                if m.worst > worst.worst { *m } else { worst }
            },
        )
    }

    /// Index of the interval that contains `row`, which is not a knot.
    fn interval_of(&self, row: usize) -> usize {
        self.knots.partition_point(|&(knot, _)| knot < row) - 1
    }

    fn insert(&mut self, row: usize) {
        let interval = self.interval_of(row);
        let index = interval + 1;
        self.knots.insert(index, (row, widen(self.samples[row])));
        // A placeholder, solved for below.
        self.moments.values.insert(index, [0.0; 3]);
        self.misfits.insert(interval, Misfit::default());
        let (low, high) = (index.saturating_sub(REACH), (index + REACH).min(self.knots.len() - 1));
        self.moments.solve_between(&self.knots, low, high);
        for i in low..high {
            self.misfits[i] = misfit(self.samples, &self.knots, &self.moments, i);
        }
    }

    /// The decrease of the sum of squared errors if `row` is inserted; negative if it would grow.
    fn gain(&mut self, row: usize) -> f64 {
        let interval = self.interval_of(row);
        let low = (interval + 1).saturating_sub(REACH);
        let high = (interval + REACH).min(self.knots.len() - 1);
        let (knots, moments) = &mut self.trial;
        knots.clear();
        knots.extend_from_slice(&self.knots[low..=high]);
        moments.values.clear();
        moments.values.extend_from_slice(&self.moments.values[low..=high]);
        knots.insert(interval + 1 - low, (row, widen(self.samples[row])));
        moments.values.insert(interval + 1 - low, [0.0; 3]);
        moments.solve_between(knots, 0, knots.len() - 1);
        let before: f64 = self.misfits[low..high].iter().map(|m| m.sum).sum();
        let after: f64 =
            (0..knots.len() - 1).map(|i| misfit(self.samples, knots, moments, i).sum).sum();
        before - after
    }

    /// The sample whose insertion leaves the smallest sum of squared errors, the first of equals.
    fn best_candidate(&mut self) -> Option<usize> {
        let mut best: Option<(f64, usize)> = None;
        let mut next_knot = 0;
        for row in 0..self.samples.len() {
            if self.knots[next_knot].0 == row {
                next_knot += 1;
                continue;
            }
            let gain = self.gain(row);
            if best.is_none_or(|(most, _)| gain > most) {
                best = Some((gain, row));
            }
        }
        best.map(|(_, row)| row)
    }
}

fn misfit(samples: &[Position], knots: &[Knot], moments: &Moments, interval: usize) -> Misfit {
    let (from, to) = (knots[interval].0 + 1, knots[interval + 1].0);
    let mut misfit = Misfit::default();
    for (row, &sample) in samples.iter().enumerate().take(to).skip(from) {
        let squared = squared_distance(moments.at(knots, interval, row), widen(sample));
        misfit.sum += squared;
        if squared > misfit.worst {
            (misfit.worst, misfit.row) = (squared, row);
        }
    }
    misfit
}

/// Chooses the rows of a run to keep, in order, such that the f64 spline through them keeps the tolerance.
fn knots(samples: &[Position], tolerance_mm: f64, variant: SplineVariant) -> Vec<usize> {
    if samples.len() <= 2 {
        return (0..samples.len()).collect();
    }
    let mut greedy = Greedy::new(samples);
    loop {
        let worst = greedy.worst();
        if worst.worst.sqrt() <= tolerance_mm {
            return greedy.knots.iter().map(|&(row, _)| row).collect();
        }
        let next = match variant {
            SplineVariant::WorstSample => Some(worst.row),
            SplineVariant::Exhaustive => greedy.best_candidate(),
        };
        greedy.insert(next.unwrap_or(worst.row));
    }
}

/// Chooses the kept rows of one run, counted from its first, and checks them on the float32 reconstruction.
pub(super) fn resample_run(
    samples: &[Position],
    tolerance: Tolerance,
    variant: SplineVariant,
    fit: &mut RunFit,
) -> Result<()> {
    let longest = SplineVariant::EXHAUSTIVE_MAX_RUN_ROWS;
    if variant == SplineVariant::Exhaustive && samples.len() > longest {
        return Err(CodecError::InvalidArgument(format!(
            "the exhaustive search accepts runs of at most {longest} samples, but one has {}: \
             use :worst-sample, or a shorter part of the take",
            samples.len()
        )));
    }
    fit.start(knots(samples, tolerance.mm(), variant));
    fit.prove(samples, tolerance.mm());
    Ok(())
}

/// Computes and encodes K: the union of all channels' knots (Shi et al. 2012, section 2.1), extended until every
/// channel's spline through K keeps the tolerance.
///
/// Channels keep the ends of their runs anyway; these are in K only where another channel needs them.
pub(crate) fn plan(
    channels: &[Rows<'_>],
    tolerance: Tolerance,
    variant: SplineVariant,
) -> Result<Vec<u8>> {
    let n_rows = channels.first().map_or(0, Rows::len);
    let mut keys = vec![false; n_rows];
    let mut fit = RunFit::default();
    for rows in channels {
        if rows.len() != n_rows {
            return Err(CodecError::InvalidArgument(format!(
                "channels of {} and of {n_rows} rows: pass the same stretch of each",
                rows.len()
            )));
        }
        frame::count_finite(*rows)?;
        for run in rows.runs() {
            let samples = &rows.positions()[run.clone()];
            resample_run(samples, tolerance, variant, &mut fit)?;
            let last = samples.len() - 1;
            fit.rows().filter(|&row| row != 0 && row != last).for_each(|row| {
                keys[run.start + row] = true;
            });
        }
    }
    // A key time of one channel moves the splines of all others, so repeat until a pass adds none.
    let mut added = true;
    while std::mem::take(&mut added) {
        for rows in channels {
            for run in rows.runs() {
                added |= add_missing(*rows, run, tolerance, &mut keys, &mut fit);
            }
        }
    }
    Ok(write_key_times(&keys))
}

/// Adds rows of worst samples until the run's spline through K keeps the tolerance; returns whether any was added.
fn add_missing(
    rows: Rows<'_>,
    run: Range<usize>,
    tolerance: Tolerance,
    keys: &mut [bool],
    fit: &mut RunFit,
) -> bool {
    let keys = &mut keys[run.clone()];
    fit.start(kept_rows(keys));
    fit.prove(&rows.positions()[run], tolerance.mm());
    let last = keys.len() - 1;
    let mut added = false;
    for row in fit.rows().filter(|&row| row != 0 && row != last) {
        added |= !std::mem::replace(&mut keys[row], true);
    }
    added
}

/// The kept rows of a run: its key times and both ends.
pub(super) fn kept_rows(run_keys: &[bool]) -> impl Iterator<Item = usize> {
    let last = run_keys.len().wrapping_sub(1);
    run_keys
        .iter()
        .enumerate()
        .filter(move |&(row, &key)| key || row == 0 || row == last)
        .map(|(row, _)| row)
}

fn write_key_times(keys: &[bool]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut next = 0;
    for (row, _) in keys.iter().enumerate().filter(|(_, key)| **key) {
        write_varint((row - next) as u64, &mut out);
        next = row + 1;
    }
    out
}

/// Reads the next row of `rows`, coded as the number of rows before it; `None` where it lies beyond `rows`.
pub(super) fn read_row(
    input: &mut Bytes<'_>,
    what: &'static str,
    rows: Range<usize>,
) -> Result<Option<usize>> {
    let skipped = usize::try_from(input.varint(what)?).unwrap_or(usize::MAX);
    Ok(skipped.checked_add(rows.start).filter(|row| rows.contains(row)))
}

/// Decodes K into `keys`, one flag per row.
pub(super) fn read_key_times(shared: &[u8], n_rows: usize, keys: &mut Vec<bool>) -> Result<()> {
    keys.clear();
    keys.resize(n_rows, false);
    let mut input = Bytes::new(shared);
    let mut next = 0;
    while !input.is_empty() {
        let row = read_row(&mut input, "a key time", next..n_rows)?
            .ok_or(CodecError::Corrupt("a key time beyond the block's rows"))?;
        keys[row] = true;
        next = row + 1;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;
    use crate::spline::rebuild;

    /// The algorithm as published: solves the whole spline for every insertion.
    fn brute_force(samples: &[Position], tolerance_mm: f64, variant: SplineVariant) -> Vec<usize> {
        let fit = |rows: &[usize]| -> Vec<f64> {
            let knots: Vec<Knot> = rows.iter().map(|&row| (row, widen(samples[row]))).collect();
            let mut moments = Moments::default();
            moments.solve(&knots);
            (0..samples.len())
                .map(|row| {
                    let interval = rows.partition_point(|&k| k <= row).min(rows.len() - 1) - 1;
                    squared_distance(moments.at(&knots, interval, row), widen(samples[row]))
                })
                .collect()
        };
        let with = |rows: &[usize], row: usize| {
            let mut more = rows.to_vec();
            more.push(row);
            more.sort_unstable();
            more
        };
        let mut rows = vec![0, samples.len() - 1];
        loop {
            let errors = fit(&rows);
            let first_of = |values: &[(usize, f64)]| {
                values.iter().fold((0, f64::NEG_INFINITY), |a, &b| if b.1 > a.1 { b } else { a })
            };
            let all: Vec<(usize, f64)> = errors.into_iter().enumerate().collect();
            let (worst_row, worst) = first_of(&all);
            if worst.sqrt() <= tolerance_mm {
                return rows;
            }
            let row = match variant {
                SplineVariant::WorstSample => worst_row,
                SplineVariant::Exhaustive => {
                    let candidates: Vec<(usize, f64)> = (0..samples.len())
                        .filter(|row| !rows.contains(row))
                        .map(|row| (row, -fit(&with(&rows, row)).iter().sum::<f64>()))
                        .collect();
                    first_of(&candidates).0
                }
            };
            rows = with(&rows, row);
        }
    }

    fn wobble(seed: u64, n: usize) -> Vec<Position> {
        let mut random = Random::new(seed);
        let mut noise = || random.unit() as f32;
        (0..n)
            .map(|i| {
                let t = i as f32 * 0.1;
                [100.0 * t.sin() + noise(), 50.0 * (2.3 * t).cos() + noise(), 3.0 * t + noise()]
            })
            .collect()
    }

    #[test]
    fn equal_to_brute_force() {
        for seed in 0..6 {
            for (n, tolerance) in [(3, 0.1), (40, 0.3), (120, 0.4), (300, 0.25)] {
                let samples = wobble(seed, n);
                let expected = brute_force(&samples, tolerance, SplineVariant::WorstSample);
                assert_eq!(knots(&samples, tolerance, SplineVariant::WorstSample), expected);
                if n <= 120 {
                    let expected = brute_force(&samples, tolerance, SplineVariant::Exhaustive);
                    assert_eq!(knots(&samples, tolerance, SplineVariant::Exhaustive), expected);
                }
            }
        }
    }

    #[test]
    fn ties_are_broken_by_the_lowest_row() {
        // Off a straight line by the same amount at rows 2 and 6: the first insertion decides.
        let mut samples = vec![[0.0_f32; 3]; 9];
        samples[2][0] = 4.0;
        samples[6][0] = 4.0;
        assert_eq!(Greedy::new(&samples).worst().row, 2);
        // No insertion gains anything: all candidates are equal.
        assert_eq!(Greedy::new(&[[0.0; 3]; 9]).best_candidate(), Some(1));
    }

    #[test]
    fn a_straight_line_needs_two_knots() {
        let line: Vec<Position> = (0..500).map(|i| [i as f32, 2.0 * i as f32, 0.0]).collect();
        assert_eq!(knots(&line, 1e-4, SplineVariant::WorstSample), [0, 499]);
        let mut run = vec![[0.0; 3]; 500];
        let ends = [(0, widen(line[0])), (499, widen(line[499]))];
        rebuild(&ends, &mut Moments::default(), &mut run);
        assert!(run.iter().zip(&line).all(|(a, b)| crate::block::distance_mm(*a, *b) < 1e-4));
    }

    #[test]
    fn key_times_round_trip() {
        for pattern in 0..1 << 9_u32 {
            let keys: Vec<bool> = (0..9).map(|i| pattern >> i & 1 == 1).collect();
            let mut back = Vec::new();
            read_key_times(&write_key_times(&keys), 9, &mut back).unwrap();
            assert_eq!(back, keys);
        }
        assert!(matches!(read_key_times(&[9], 9, &mut Vec::new()), Err(CodecError::Corrupt(_))));
        assert!(matches!(
            read_key_times(&[0x80], 9, &mut Vec::new()),
            Err(CodecError::Truncated(_))
        ));
    }
}
