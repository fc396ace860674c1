//! Parsing of argument values that only the command line has, and formatting of numbers for people.

use std::{ffi::OsStr, str::FromStr, time::Duration};

use anyhow::bail;
use clap::{
    Args, ValueEnum,
    builder::{PossibleValue, TypedValueParser},
};
use mocapd::outcome::UsageError;
use mocapd_acquire::{
    inspect::size_ratio,
    pipeline::{STRETCH_LENGTHS, SYNC_MAX, TakeAccount},
};
use mocapd_codec::{Effort, ResamplerKind, Settings, Tolerance};
use mocapd_service::units;
use mocapd_take::{interchange::Direction, motion::UpAxis, record::KeyDistance};
use serde::Serialize;

pub(crate) use mocapd_cli::numbers::{bytes, count, count_of, thousands};

/// Parses a tolerance.
///
/// # Errors
/// What is wrong, and what to type instead.
pub(super) fn tolerance(text: &str) -> Result<Tolerance, String> {
    units::tolerance(text, "--lossless")
}

/// Parses a length of time above 0.
///
/// # Errors
/// What is wrong, and what to type instead.
pub(super) fn length(text: &str) -> Result<Duration, String> {
    units::duration_above_zero(text)
}

/// Parses the length of a stretch.
///
/// # Errors
/// What is wrong, and what to type instead.
pub(super) fn stretch(text: &str) -> Result<Duration, String> {
    let stretch = length(text)?;
    if STRETCH_LENGTHS.contains(&stretch) {
        return Ok(stretch);
    }
    Err(format!("a stretch of '{text}' is out of range: give 50ms to 10s"))
}

/// Parses the distance of key stretches in an import.
///
/// # Errors
/// What is wrong, and what to type instead.
pub(super) fn key_distance(text: &str) -> Result<KeyDistance, String> {
    if text == "none" {
        return Ok(KeyDistance::FirstOnly);
    }
    let distance = length(text)?;
    if distance >= *STRETCH_LENGTHS.start() {
        return Ok(KeyDistance::Every(distance));
    }
    Err(format!("a distance of '{text}' is out of range: give 50ms or more, or none"))
}

/// Parses the time between syncs; 0 syncs after each stretch.
///
/// # Errors
/// What is wrong, and what to type instead.
pub(super) fn sync(text: &str) -> Result<Duration, String> {
    let sync = units::duration(text)?;
    if sync <= SYNC_MAX {
        return Ok(sync);
    }
    Err(format!("a sync interval of '{text}' is out of range: give 0s to 60s"))
}

/// `12 345 frames`, or `300 of 12 345 frames` if some rows are empty.
pub(crate) fn frames_of(recorded: u64, rows: u64) -> String {
    if recorded < rows {
        format!("{} of {}", thousands(recorded), count(rows, "frame"))
    } else {
        count(rows, "frame")
    }
}

/// A length of time with its unit: `9.5 s`, `12 min 5 s`, `3 h 2 min`.
pub(crate) fn length_of_time(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..60 => format!("{seconds:.1} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        _ => format!("{} h {} min", thousands(whole / 3600), whole / 60 % 60),
    }
}

/// A rate with its unit: `59.94 Hz`. Files state rates as float32, which have more digits in double precision.
pub(crate) fn rate(hz: f64) -> String {
    let single = hz as f32;
    if f64::from(single) == hz {
        return format!("{single} Hz");
    }
    // No clock of a device is exact to a millionth of a hertz.
    let text = format!("{hz:.6}");
    format!("{} Hz", text.trim_end_matches('0').trim_end_matches('.'))
}

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

/// A parser whose values are not a list, with those that shells complete.
#[derive(Debug, Clone)]
pub(crate) struct Completed<P> {
    parser: P,
    values: Vec<PossibleValue>,
}

impl<P: TypedValueParser> TypedValueParser for Completed<P> {
    type Value = P::Value;

    fn parse_ref(
        &self,
        command: &clap::Command,
        argument: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<Self::Value, clap::Error> {
        self.parser.parse_ref(command, argument, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.values.iter().cloned()))
    }
}

/// Parses a time or a format; shells complete the formats. The argument hides them in its help.
pub(super) fn time_or_format<F>() -> Completed<impl TypedValueParser<Value = TimeOrFormat<F>>>
where
    F: ValueEnum + Send + Sync + 'static,
{
    let values = F::value_variants().iter().filter_map(F::to_possible_value).collect();
    Completed { parser: str::parse::<TimeOrFormat<F>>, values }
}

/// Parses a resampler; shells complete the names without variants.
pub(super) fn resampler() -> Completed<impl TypedValueParser<Value = ResamplerKind>> {
    let names = ["dense", "fast", "lossless", "spline", "sync"];
    Completed { parser: str::parse::<ResamplerKind>, values: names.map(PossibleValue::new).into() }
}

/// The time and the format among the values of `--to`.
///
/// # Errors
/// A usage error if there are two of either.
pub(super) fn split_to<F: Copy>(
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

/// Widest label column of a table, in characters; a longer label shifts its own line.
pub(crate) const LABEL_COLUMNS_MAX: usize = 64;

/// The default tolerance: 5 to 15 times the noise of an optical rig, with files 2.5 times smaller than at 0.1 mm.
const DEFAULT_TOLERANCE_MM: f64 = 0.5;

#[derive(Debug, Args)]
pub(crate) struct CodecArgs {
    /// Largest allowed distance between a sample and its reconstruction: 0.5mm, 100um, 2cm [default: 0.5mm]
    #[arg(long, value_name = "LENGTH", value_parser = tolerance, allow_hyphen_values = true)]
    tolerance: Option<Tolerance>,
    /// Keep every bit: short for --resampler lossless (record: faster) or lossless:predictive (import: smaller)
    #[arg(long, conflicts_with_all = ["tolerance", "resampler"])]
    lossless: bool,
    /// Resampler: dense, fast, lossless or lossless:predictive; for whole takes (import, bench codec) also
    /// spline[:worst-sample|:exhaustive] and sync[:worst-sample|:exhaustive]
    #[arg(long, value_name = "NAME", default_value = "dense", value_parser = resampler(), hide_possible_values = true)]
    resampler: ResamplerKind,
}

/// The default effort of an import: the highest that takes at most four times as long as the lowest.
const DEFAULT_EFFORT: u8 = 3;

/// The effort of an encoder of whole takes, where none is given.
///
/// # Errors
/// Never: the level is a valid one.
pub(crate) fn default_effort() -> anyhow::Result<Effort> {
    Ok(Effort::new(DEFAULT_EFFORT)?)
}

/// Parses the axis that points up.
///
/// # Errors
/// If it is none.
pub(crate) fn up_axis(text: &str) -> Result<UpAxis, String> {
    let direction = text.parse::<Direction>().ok().filter(|direction| !direction.is_negative());
    direction
        .map(Direction::axis)
        .ok_or_else(|| format!("'{text}' is not an axis to point up: use x, y or z"))
}

// The effort of encoding a whole take, and the distance of its key stretches. (A doc comment would replace the texts of
// the commands, in which clap builds these options.)
#[derive(Debug, Args)]
pub(crate) struct EffortArgs {
    /// Effort of the resampler dense, 1 to 9: higher levels need more time and make smaller files; recordings use 1. Level
    /// 9 also searches the order of the markers, with the take in memory [default: 3]
    #[arg(long, value_name = "N", value_parser = str::parse::<Effort>)]
    effort: Option<Effort>,
    /// Longest time from one key stretch to the next, 50ms or more, or `none` for the first one only. Reading can start at
    /// each, and damage ends at the next. Takes longer than 10s with keys further apart than 10s are of format version 7,
    /// which earlier versions of mocapd refuse [default: 10s; with an effort of 2 or more, up to 5min where nothing moves]
    #[arg(long, value_name = "TIME", value_parser = key_distance, allow_hyphen_values = true)]
    keys: Option<KeyDistance>,
}

impl EffortArgs {
    /// The distance of key stretches, if one is given.
    ///
    /// # Errors
    /// A usage error if one is given for a resampler that encodes a take as one stretch.
    pub(crate) fn key_distance(&self, codec: &Settings) -> anyhow::Result<Option<KeyDistance>> {
        if self.keys.is_some() && !codec.kind.is_live() {
            let kind = codec.kind;
            bail!(UsageError(format!(
                "--keys divides a take, and {kind} encodes it as one stretch: omit it"
            )));
        }
        Ok(self.keys)
    }

    /// The effort for a resampler, 1 for those that have one way to encode.
    ///
    /// # Errors
    /// A usage error if one is given for another resampler than `dense`.
    pub(crate) fn effort(&self, codec: &Settings) -> anyhow::Result<Effort> {
        match (codec.kind, self.effort) {
            (ResamplerKind::Dense, Some(effort)) => Ok(effort),
            (ResamplerKind::Dense, None) => default_effort(),
            (_, None) => Ok(Effort::MIN),
            (kind, Some(_)) => {
                bail!(UsageError(format!(
                    "--effort is for the resampler dense: omit it with {kind}"
                )))
            }
        }
    }
}

impl CodecArgs {
    /// Settings to code a whole take.
    ///
    /// # Errors
    /// A usage error if a tolerance is given for a lossless resampler.
    pub(crate) fn settings(&self) -> anyhow::Result<Settings> {
        self.settings_with(ResamplerKind::LosslessPredictive)
    }

    /// Settings in which `--lossless` selects the given resampler.
    fn settings_with(&self, lossless: ResamplerKind) -> anyhow::Result<Settings> {
        let kind = if self.lossless { lossless } else { self.resampler };
        if kind.is_lossless() && self.tolerance.is_some() {
            bail!(UsageError("a lossless take has no tolerance: omit --tolerance".to_owned()));
        }
        let tolerance = self.tolerance.map_or(Tolerance::from_mm(DEFAULT_TOLERANCE_MM), Ok)?;
        Ok(Settings { kind, tolerance })
    }

    /// Settings to code the samples of a device as they arrive.
    ///
    /// # Errors
    /// A usage error for a resampler that needs the whole take.
    pub(crate) fn live_settings(&self) -> anyhow::Result<Settings> {
        let settings = self.settings_with(ResamplerKind::Lossless)?;
        if settings.kind.is_live() {
            return Ok(settings);
        }
        bail!(UsageError(format!(
            "{0} needs the whole take: record with dense, fast or lossless, then export the take and import it with {0}",
            settings.kind
        )))
    }
}

/// The tolerance as reports show it: 0 for lossless.
pub(crate) fn tolerance_mm(codec: &Settings) -> f64 {
    if codec.kind.is_lossless() { 0.0 } else { codec.tolerance.mm() }
}

/// The size and accuracy of a new take, part of every report about one.
#[derive(Debug, Serialize)]
pub(crate) struct SizeReport {
    samples: u64,
    raw_bytes: u64,
    file_bytes: u64,
    ratio: f64,
    resampler: String,
    tolerance_mm: f64,
    max_error_mm: f64,
}

impl SizeReport {
    pub(crate) fn new(written: &TakeAccount, codec: &Settings) -> Self {
        Self {
            samples: written.samples,
            raw_bytes: 12 * written.samples,
            file_bytes: written.file_bytes,
            ratio: size_ratio(written.samples, written.file_bytes),
            resampler: codec.kind.to_string(),
            tolerance_mm: tolerance_mm(codec),
            max_error_mm: written.max_error_mm,
        }
    }

    pub(crate) fn text(&self) -> String {
        let bound = if self.tolerance_mm > 0.0 {
            format!("max error {:.4} mm <= {} mm", self.max_error_mm, self.tolerance_mm)
        } else {
            "every bit of the positions kept".to_owned()
        };
        let (raw, file) = (bytes(self.raw_bytes), bytes(self.file_bytes));
        format!("{raw} as float32, {file} on disk ({:.1}:1), {bound}", self.ratio)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_stretches_and_syncs_have_limits() {
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

#[cfg(test)]
mod tests_of_numbers {
    use super::*;

    #[test]
    fn numbers_for_people() {
        assert_eq!(frames_of(1200, 1200), "1 200 frames");
        assert_eq!(frames_of(300, 1200), "300 of 1 200 frames");
        assert_eq!(length_of_time(9.54), "9.5 s");
        assert_eq!(length_of_time(725.2), "12 min 5 s");
        assert_eq!(length_of_time(10_931.0), "3 h 2 min");
        assert_eq!(bytes(999), "999 B");
        assert_eq!(bytes(1_250_000), "1.2 MB");
        for (hz, text) in [
            (240.0, "240 Hz"),
            (59.94, "59.94 Hz"),
            (f64::from(59.94_f32), "59.94 Hz"),
            (f64::from(119.880_12_f32), "119.88012 Hz"),
            (120_000.0 / 1001.0, "119.88012 Hz"),
            (0.5, "0.5 Hz"),
        ] {
            assert_eq!(rate(hz), text);
        }
    }
}

#[cfg(test)]
mod tests_of_to {
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
        assert_eq!(
            split_to(&[time, c3d]).unwrap(),
            (Some(Duration::from_secs(10)), Some(Name::C3d))
        );
        assert!(split_to(&[time, time]).unwrap_err().is::<UsageError>());
    }
}
