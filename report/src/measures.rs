//! The storage measures SR1 and SR2 of (Shi et al. 2012), over samples present. Numbers in parentheses are the paper's
//! equations.

use std::ops::AddAssign;

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
