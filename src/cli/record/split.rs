//! `--split`: when to begin the next take of a recording that is divided.

use std::{path::Path, time::Duration};

use mocapd::outcome::UsageError;
use mocapd_acquire::series::{SeriesOptions, TakeLength, TakeNames};
use mocapd_service::units;

use crate::cli::paths;

/// The shortest take: two stretches of the default length. Shorter ones would consist mostly of the header, the key
/// stretch and the end that every take has.
const TIME_MIN: Duration = Duration::from_secs(1);

/// The smallest take, for the same reason: a device of many markers fills it in about a second.
const BYTES_MIN: u64 = 1_000_000;

/// The value of `--split`.
#[derive(Debug, Clone)]
pub(super) struct SplitValue {
    length: TakeLength,
    text: String,
}

/// Parses the length of a take: a time or a size, told apart by the unit.
///
/// # Errors
/// What is wrong, and what to type instead.
pub(super) fn split(text: &str) -> Result<SplitValue, String> {
    let text = text.trim();
    let value = |length| Ok(SplitValue { length, text: text.to_owned() });
    if text.ends_with('B') {
        let bytes = units::size_bytes(text)?;
        if bytes < BYTES_MIN {
            return Err(format!(
                "takes of '{text}' would be mostly header and key stretch: give at least 1MB"
            ));
        }
        return value(TakeLength::Bytes(bytes));
    }
    if !text.ends_with(char::is_alphabetic) {
        return Err(format!(
            "'{text}' has no unit: give a time such as 10s, or a size such as 500MB"
        ));
    }
    let time = units::duration(text)
        .map_err(|error| format!("{error}, or a size in B, kB, MB, GB, MiB or GiB"))?;
    if time < TIME_MIN {
        return Err(format!(
            "takes of '{text}' would be mostly header and key stretch: give at least 1s"
        ));
    }
    value(TakeLength::Time(time))
}

impl SplitValue {
    /// How to divide a recording to `output` that ends after `length`, with stretches of this length.
    ///
    /// # Errors
    /// A usage error for takes shorter than a stretch, and for an output that cannot be numbered.
    pub(super) fn options(
        &self,
        output: &Path,
        length: Option<Duration>,
        stretch: Duration,
    ) -> anyhow::Result<SeriesOptions> {
        if paths::is_dash(output) || output.is_dir() {
            let output = output.display();
            return Err(UsageError(format!(
                "--output {output} cannot be numbered: with --split, give a name such as run.take"
            ))
            .into());
        }
        let mut n_takes_max = None;
        if let TakeLength::Time(time) = self.length {
            if time < stretch {
                let split = &self.text;
                return Err(UsageError(format!(
                    "takes of {split} are shorter than a stretch of {stretch:?}: give a longer --split, or a shorter --stretch"
                ))
                .into());
            }
            n_takes_max = length.map(|length| length.as_nanos().div_ceil(time.as_nanos()) as u64);
        }
        let names = TakeNames::new(output, n_takes_max);
        Ok(SeriesOptions { length: self.length, length_text: self.text.clone(), names })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_tells_a_time_from_a_size() {
        for (text, length) in [
            ("10s", TakeLength::Time(Duration::from_secs(10))),
            ("1500ms", TakeLength::Time(Duration::from_millis(1500))),
            ("2min", TakeLength::Time(Duration::from_secs(120))),
            ("10m", TakeLength::Time(Duration::from_secs(600))),
            ("1h", TakeLength::Time(Duration::from_secs(3600))),
            ("500MB", TakeLength::Bytes(500_000_000)),
            ("2 GiB", TakeLength::Bytes(2 << 30)),
        ] {
            assert_eq!(split(text).unwrap().length, length, "{text}");
        }
        for text in ["10", "", "0s", "999ms", "999kB", "-1s", "-5MB", "1 floppy", "MB", "s"] {
            assert!(split(text).is_err(), "{text}");
        }
    }

    #[test]
    fn the_numbers_have_digits_for_all_takes() {
        let options = |split_text: &str, length| {
            let length = Some(Duration::from_secs(length));
            let stretch = Duration::from_secs(2);
            split(split_text).unwrap().options(Path::new("a.take"), length, stretch)
        };
        let first = |options: SeriesOptions| options.names.path(1);
        assert_eq!(first(options("10s", 9990).unwrap()), Path::new("a-001.take"));
        assert_eq!(first(options("10s", 9991).unwrap()), Path::new("a-0001.take"));
        assert_eq!(first(options("10MB", 9991).unwrap()), Path::new("a-001.take"));
        assert!(options("1s", 10).unwrap_err().is::<UsageError>(), "shorter than a stretch");
    }
}
