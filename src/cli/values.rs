//! Values of arguments that only the command line refuses.

use std::time::Duration;

use mocapd::units;

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_is_more_than_nothing() {
        assert_eq!(length("250ms").unwrap(), Duration::from_millis(250));
        for text in ["0", "0s", "-0", "-1s", "1e-12s", "nan"] {
            assert!(length(text).is_err(), "{text}");
        }
    }
}
