//! `--to`: the end of a range of time, or, as the name of a format, the format of the outputs.

use std::{str::FromStr, time::Duration};

use clap::ValueEnum;
use mocapd::outcome::UsageError;
use mocapd_service::units;

/// A value of `--to`: no name of a format is a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TimeOrFormat<F> {
    Time(Duration),
    Format(F),
}

impl<F: ValueEnum> FromStr for TimeOrFormat<F> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Ok(format) = F::from_str(text, true) {
            return Ok(Self::Format(format));
        }
        units::duration(text).map(Self::Time).map_err(|error| {
            let formats = F::value_variants().iter().filter_map(F::to_possible_value);
            let names: Vec<String> = formats.map(|value| value.get_name().to_owned()).collect();
            format!("{error}; or a format: {}", names.join(", "))
        })
    }
}

/// The time and the format among the values of `--to`.
///
/// # Errors
/// A usage error if there are two of either.
pub(super) fn split<F: Copy>(
    values: &[TimeOrFormat<F>],
) -> anyhow::Result<(Option<Duration>, Option<F>)> {
    let (mut time, mut format) = (None, None);
    for value in values {
        let before = match *value {
            TimeOrFormat::Time(to) => time.replace(to).is_some(),
            TimeOrFormat::Format(to) => format.replace(to).is_some(),
        };
        if before {
            let message = "--to is given twice: give one time, and at most one format";
            return Err(UsageError(message.to_owned()).into());
        }
    }
    Ok((time, format))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
    enum Name {
        C3d,
        Csv,
    }

    #[test]
    fn a_value_is_a_time_or_a_format() {
        let parse = |text: &str| text.parse::<TimeOrFormat<Name>>();
        let c3d = TimeOrFormat::Format(Name::C3d);
        let time = TimeOrFormat::Time(Duration::from_secs(10));
        assert_eq!((parse("c3d").unwrap(), parse("C3D").unwrap()), (c3d, c3d));
        assert_eq!(parse("10s").unwrap(), time);
        assert!(parse("c4d").unwrap_err().contains("c3d, csv"));
        assert_eq!(split(&[time, c3d]).unwrap(), (Some(Duration::from_secs(10)), Some(Name::C3d)));
        assert!(split(&[time, time]).unwrap_err().is::<UsageError>());
    }
}
