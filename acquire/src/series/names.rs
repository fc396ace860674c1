//! The names of the takes of a series.

use std::path::{Path, PathBuf};

/// Digits of the numbers in the names, at least.
const DIGITS_MIN: usize = 3;

/// Numbers that [`TakeNames::any_exists`] looks for, each of which costs a system call: a day of takes of ten seconds.
const NAMES_SOUGHT_MAX: u64 = 8640;

/// The names of the takes of a series: `run-001.take`, `run-002.take` and so on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TakeNames {
    base: PathBuf,
    digits: usize,
}

impl TakeNames {
    /// Names made from `base`, such as `run.take`. The numbers have at least three digits; if the largest number of
    /// takes is known, as many as it, so that the names sort in the order of the takes.
    #[must_use]
    pub fn new(base: &Path, n_takes_max: Option<u64>) -> Self {
        let digits = n_takes_max.map_or(0, |n| n.to_string().len());
        Self { base: base.to_owned(), digits: digits.max(DIGITS_MIN) }
    }

    /// The path of the take with this number, from 1.
    #[must_use]
    pub fn path(&self, number: u64) -> PathBuf {
        let mut name = self.base.file_stem().unwrap_or_default().to_owned();
        name.push(format!("-{number:0digits$}", digits = self.digits));
        if let Some(extension) = self.base.extension() {
            name.push(".");
            name.push(extension);
        }
        self.base.with_file_name(name)
    }

    /// Whether a file has one of these names. Takes that were moved away are not counted.
    #[must_use]
    pub fn any_exists(&self) -> bool {
        (1..=NAMES_SOUGHT_MAX).any(|number| self.path(number).exists())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_their_number_before_the_extension() {
        let name = |base: &str, n_max, number| {
            TakeNames::new(Path::new(base), n_max).path(number).to_str().unwrap().to_owned()
        };
        assert_eq!(name("a/run.take", None, 1), "a/run-001.take");
        assert_eq!(name("run.1.take", Some(6), 42), "run.1-042.take");
        assert_eq!(name("run", Some(999), 999), "run-999");
        assert_eq!(name("run.take", Some(1000), 7), "run-0007.take");
        assert_eq!(name("run.take", None, 1000), "run-1000.take");
    }

    #[test]
    fn a_later_take_is_found_when_the_first_was_moved() {
        let folder = tempfile::tempdir().unwrap();
        let names = TakeNames::new(&folder.path().join("run.take"), None);
        assert!(!names.any_exists());
        std::fs::write(names.path(3), b"").unwrap();
        assert!(names.any_exists());
    }

    #[test]
    fn names_sort_in_the_order_of_the_takes() {
        let names = TakeNames::new(Path::new("run.take"), Some(2000));
        assert!((1..=2000).map(|number| names.path(number)).is_sorted());
    }
}
