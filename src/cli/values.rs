//! Values of arguments that only the command line refuses.

use std::{ops::RangeInclusive, time::Duration};

use mocapd_service::units;

/// The length of something that is to be made: more than nothing.
///
/// # Errors
/// What is wrong and what to type.
pub(super) fn length(text: &str) -> Result<Duration, String> {
    match units::duration(text)? {
        Duration::ZERO => Err(format!("'{text}' is no time at all: give something like 10s")),
        length => Ok(length),
    }
}

/// Stretches of a recording: above them a kill costs more than anybody wants, below them a take is mostly fronts
/// of stretches.
const STRETCH: RangeInclusive<Duration> = Duration::from_millis(50)..=Duration::from_secs(10);

/// Time between syncs at most: what a disk loses with its power.
const SYNC_MAX: Duration = Duration::from_secs(60);

/// The length of a stretch.
///
/// # Errors
/// What is wrong and what to type.
pub(super) fn stretch(text: &str) -> Result<Duration, String> {
    let stretch = length(text)?;
    if STRETCH.contains(&stretch) {
        return Ok(stretch);
    }
    Err(format!("stretches of '{text}' are not written: give 50ms to 10s"))
}

/// The time between syncs; 0 is one with each stretch.
///
/// # Errors
/// What is wrong and what to type.
pub(super) fn sync(text: &str) -> Result<Duration, String> {
    let sync = units::duration(text)?;
    if sync <= SYNC_MAX {
        return Ok(sync);
    }
    Err(format!("syncs '{text}' apart are too few: give 0s to 60s"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_is_more_than_nothing() {
        assert_eq!(length("250ms").unwrap(), Duration::from_millis(250));
        for text in ["49ms", "11s", "0"] {
            assert!(stretch(text).is_err(), "{text}");
        }
        assert_eq!(sync("0").unwrap(), Duration::ZERO);
        assert!(sync("61s").is_err());
        for text in ["0", "0s", "-0", "-1s", "1e-12s", "nan"] {
            assert!(length(text).is_err(), "{text}");
        }
    }
}
