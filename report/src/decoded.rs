//! A take decoded into memory: its samples, which of them are knots, and the storage measures SR1 and SR2 of (Shi et
//! al. 2012) over samples present. Numbers in parentheses are the paper's equations.

use std::ops::AddAssign;

use mocapd_codec::Settings;
use mocapd_take::{
    TakeError, TakeEvent, TakeTraversal,
    damage::Problem,
    motion::{GAP, Motion, MotionInfo},
    reader::TakeInput,
    stretch::Span,
    traversal::{Decode, Progress},
};

use crate::{ReportError, column};

/// Largest take that is decoded into memory, rows times markers: 100 million, 1.3 GB.
pub const SAMPLES_MAX: u64 = 100_000_000;

/// A take decoded into memory.
#[derive(Debug, Clone)]
pub struct DecodedTake {
    /// The samples. Of the metadata only the rate, the up axis, the markers, the subject and the number of frames are
    /// set.
    pub motion: Motion,
    /// By channel and row: whether the sample was kept (a knot) rather than interpolated.
    pub kept: Vec<Vec<bool>>,
    /// The resampler and tolerance of the take.
    pub settings: Option<Settings>,
    /// Damage found while reading.
    pub problems: Vec<Problem>,
}

/// The rows of a channel in one stretch.
struct StretchRows {
    first_row: usize,
    positions: Vec<[f32; 3]>,
    present: Vec<bool>,
    kept: Vec<bool>,
}

impl DecodedTake {
    /// Reads a take to its end. Damaged samples become gaps, and the damage is listed in `problems`.
    ///
    /// # Errors
    /// If it is not a take, or is larger than [`SAMPLES_MAX`].
    pub fn read(take: impl TakeInput) -> Result<Self, ReportError> {
        let mut stretches: Vec<Vec<StretchRows>> = Vec::new();
        let mut n_stored = 0;
        let traversal = TakeTraversal::new(take, Decode::All);
        let take = traversal.run(|found, progress| match &found.event {
            TakeEvent::Stretch(stretch) if !found.is_refused && stretch.span.n_rows > 0 => {
                store(progress, stretch.span, &mut stretches, &mut n_stored)
            }
            _ => Ok(()),
        })?;
        let take = take.take;
        let info = MotionInfo {
            rate_hz: take.header.rate_hz,
            up: take.header.up_axis,
            n_frames: take.n_rows,
            markers: take.channels.iter().map(Into::into).collect(),
            subject: take.subject,
            ..MotionInfo::default()
        };
        let mut decoded = Self {
            motion: Motion { info, positions_mm: Vec::new() },
            kept: Vec::new(),
            settings: Some(take.header.codec()?),
            problems: take.problems,
        };
        decoded.place(&stretches)?;
        Ok(decoded)
    }

    /// Copies the decoded stretches of each channel to their rows.
    fn place(&mut self, stretches: &[Vec<StretchRows>]) -> Result<(), ReportError> {
        let MotionInfo { n_frames, markers, .. } = &self.motion.info;
        let (n_rows, n_markers) = (*n_frames as usize, markers.len());
        let n_samples = n_frames.saturating_mul(n_markers as u64);
        if n_samples > SAMPLES_MAX {
            return Err(too_large(n_samples).into());
        }
        self.motion.positions_mm = vec![GAP; n_rows * n_markers];
        self.kept = vec![vec![false; n_rows]; n_markers];
        for ((marker, kept), stretches) in self.kept.iter_mut().enumerate().zip(stretches) {
            for stretch in stretches {
                for (i, position) in stretch.positions.iter().enumerate() {
                    if stretch.present[i] {
                        let row = stretch.first_row + i;
                        self.motion.positions_mm[row * n_markers + marker] = *position;
                        kept[row] = stretch.kept[i];
                    }
                }
            }
        }
        Ok(())
    }

    /// Counts of samples present and kept, for the storage measures.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let present: Vec<Vec<bool>> = (0..self.kept.len())
            .map(|marker| column::Column::of(&self.motion, marker).0)
            .map(|column| column.iter().map(Option::is_some).collect())
            .collect();
        let channels: Vec<(&[bool], &[bool])> =
            present.iter().zip(&self.kept).map(|(p, k)| (&p[..], &k[..])).collect();
        Counts::of(&channels)
    }

    /// The largest distance between a sample and that of `original`, mm.
    #[must_use]
    pub fn max_error_mm(&self, original: &Motion) -> f64 {
        let pairs = self.motion.positions_mm.iter().zip(&original.positions_mm);
        pairs
            .filter_map(|(&a, &b)| Some(column::distance(column::sample(a)?, column::sample(b)?)))
            .fold(0.0, f64::max)
    }

    /// The resampler and tolerance as text: `dense at 0.5 mm`.
    #[must_use]
    pub fn coding(&self) -> String {
        match self.settings {
            Some(Settings { kind, .. }) if kind.is_lossless() => "lossless".to_owned(),
            Some(Settings { kind, tolerance }) => format!("{kind} at {} mm", tolerance.mm()),
            None => String::new(),
        }
    }
}

fn too_large(n_samples: u64) -> TakeError {
    TakeError::InvalidArgument(format!(
        "{n_samples} positions do not fit into memory (at most {SAMPLES_MAX}): export a part of the take with --from \
         and --to, and import that"
    ))
}

/// Stores the decoded rows of a stretch.
fn store(
    progress: &Progress,
    span: Span,
    stretches: &mut Vec<Vec<StretchRows>>,
    n_stored: &mut u64,
) -> Result<(), TakeError> {
    for (channel, rows) in progress.rows().enumerate() {
        let Some(rows) = rows.filter(|rows| rows.has_samples()) else { continue };
        *n_stored += rows.positions.len() as u64;
        if *n_stored > SAMPLES_MAX {
            return Err(too_large(*n_stored));
        }
        if stretches.len() <= channel {
            stretches.resize_with(channel + 1, Vec::new);
        }
        stretches[channel].push(StretchRows {
            first_row: span.first_row as usize,
            positions: rows.positions.clone(),
            present: rows.present.clone(),
            kept: rows.kept.clone(),
        });
    }
    Ok(())
}

/// The counts that the measures are computed from. Counts of several takes can be added.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Rows in which some channel has a sample: |T|.
    pub rows: u64,
    /// Samples present: |T| N where there are no gaps.
    pub samples: u64,
    /// Samples kept: the sum of `|TS_i|`.
    pub kept: u64,
    /// Rows in which some channel keeps its sample: |K|.
    pub key_rows: u64,
    /// Samples present in these key rows: |K| N where there are no gaps.
    pub samples_in_key_rows: u64,
}

impl Counts {
    /// Counts over channels, each given as the flags `present` and `kept` by row.
    #[must_use]
    pub fn of(channels: &[(&[bool], &[bool])]) -> Self {
        let n_rows = channels.iter().map(|(present, _)| present.len()).max().unwrap_or(0);
        let mut counts = Self::default();
        for row in 0..n_rows {
            let is = |flags: &[bool]| flags.get(row).copied().unwrap_or(false);
            let samples = channels.iter().filter(|(present, _)| is(present)).count() as u64;
            let kept = channels.iter().filter(|(_, kept)| is(kept)).count() as u64;
            counts.rows += u64::from(samples > 0);
            counts.samples += samples;
            counts.kept += kept;
            if kept > 0 {
                counts.key_rows += 1;
                counts.samples_in_key_rows += samples;
            }
        }
        counts
    }

    /// Stored items of the original: positions and times (4).
    #[must_use]
    pub fn original_items(&self) -> u64 {
        self.samples + self.rows
    }

    /// Stored items of synchronous resampling (5).
    #[must_use]
    pub fn synchronous_items(&self) -> u64 {
        self.samples_in_key_rows + self.key_rows
    }

    /// Stored items of asynchronous resampling (6).
    #[must_use]
    pub fn asynchronous_items(&self) -> u64 {
        2 * self.kept
    }

    /// SR1 (7): the compression ratio of synchronous resampling, in items; `None` without samples.
    #[must_use]
    pub fn sr1(&self) -> Option<f64> {
        ratio(self.original_items(), self.synchronous_items())
    }

    /// SR2 (8): the compression ratio of asynchronous resampling, in items; `None` without samples.
    #[must_use]
    pub fn sr2(&self) -> Option<f64> {
        ratio(self.original_items(), self.asynchronous_items())
    }

    /// Whether asynchronous resampling needs fewer items than synchronous (10).
    #[must_use]
    pub fn asynchronous_wins(&self) -> bool {
        self.asynchronous_items() < self.synchronous_items()
    }
}

impl AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.rows += other.rows;
        self.samples += other.samples;
        self.kept += other.kept;
        self.key_rows += other.key_rows;
        self.samples_in_key_rows += other.samples_in_key_rows;
    }
}

/// The quotient `of / by`; `None` if `by` is 0.
#[must_use]
pub fn ratio(of: u64, by: u64) -> Option<f64> {
    (by > 0).then(|| of as f64 / by as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flags(text: &str) -> Vec<bool> {
        text.chars().map(|c| c == '1').collect()
    }

    fn counts(channels: &[(&str, &str)]) -> Counts {
        let flags: Vec<_> = channels.iter().map(|(p, k)| (flags(p), flags(k))).collect();
        let slices: Vec<(&[bool], &[bool])> = flags.iter().map(|(p, k)| (&p[..], &k[..])).collect();
        Counts::of(&slices)
    }

    /// Ten rows of two channels, computed by hand: K has 4 rows, the channels keep 3 each.
    #[test]
    fn without_gaps_the_measures_are_the_formulas() {
        let all = "1111111111";
        let found = counts(&[(all, "1000100001"), (all, "1010000001")]);
        assert_eq!((found.rows, found.samples, found.kept, found.key_rows), (10, 20, 6, 4));
        // (7): |T| / |K|; (8): (N + 1) |T| / (2 sum |TS_i|).
        assert_eq!(found.sr1(), Some(10.0 / 4.0));
        assert_eq!(found.sr2(), Some(3.0 * 10.0 / 12.0));
        // (10): 3 * 4 > 2 * 6 does not hold.
        assert!(!found.asynchronous_wins());
    }

    /// (11) to (13): where no two channels share a time, asynchronous resampling wins for every N > 1.
    #[test]
    fn no_shared_time_always_wins_for_more_than_one_channel() {
        for n in 1..12 {
            let present = "1".repeat(12);
            let kept: Vec<String> = (0..n)
                .map(|i| (0..12).map(|row| if row == i { '1' } else { '0' }).collect())
                .collect();
            let channels: Vec<(&str, &str)> =
                kept.iter().map(|kept| (present.as_str(), kept.as_str())).collect();
            assert_eq!(counts(&channels).asynchronous_wins(), n > 1, "{n}");
        }
    }

    #[test]
    fn gaps_are_not_samples() {
        let found = counts(&[("110011", "100001"), ("000111", "000101"), ("000000", "000000")]);
        assert_eq!((found.rows, found.samples, found.kept), (5, 7, 4));
        assert_eq!((found.key_rows, found.samples_in_key_rows), (3, 4));
        assert_eq!(Counts::default().sr2(), None);
    }
}
