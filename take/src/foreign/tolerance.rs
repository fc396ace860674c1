//! Tolerances of analog channels: the samples of a C3D file replaced, at import, by others within a bound of error.

use std::{fmt, io, str::FromStr, sync::Arc};

use mocapd_codec::sampled::ChannelProfile;

use super::content::{PartStore, ScratchFile};
use crate::{
    TakeError,
    interchange::c3d::{self, columns::ANALOG, sample_parts},
    motion::MotionInfo,
    record::SampledChannel,
};

/// With as much, the middle of the range is within the tolerance of every sample.
const PERCENT_MAX: f64 = 50.0;

/// The unit in which the largest error is given.
#[derive(Debug, Clone, PartialEq)]
enum ToleranceUnit {
    /// Steps of the converter.
    Counts,
    /// Hundredths of the largest sample of the channel less the smallest.
    Percent,
    /// The channel's own unit.
    Own,
    /// This unit, which the channel must have.
    Named(String),
}

/// A tolerance of the channels whose names match a pattern.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelTolerance {
    /// With `*` for any characters and `?` for one; `None` for all channels.
    pattern: Option<String>,
    value: f64,
    unit: ToleranceUnit,
}

impl FromStr for ChannelTolerance {
    type Err = String;

    /// Parses `[PATTERN=]VALUE[UNIT]`, such as `1count`, `EMG*=0.1%`, `F?z*=0.5N`.
    fn from_str(text: &str) -> Result<Self, String> {
        let (pattern, size) = match text.rsplit_once('=') {
            Some((pattern, size)) => (Some(pattern.to_owned()), size.trim()),
            None => (None, text.trim()),
        };
        let expected = "expected [PATTERN=]VALUE, such as 1count, 0.1%, EMG*=0.1% or F?z*=0.5N";
        if pattern.as_ref().is_some_and(String::is_empty) {
            return Err(format!("no channels are named before `=`: {expected}"));
        }
        // An exponent is part of the number only if a digit follows: `2e-3V`, but `2eV`.
        let is_number = |end: &usize| size.get(..*end).is_some_and(|s| s.parse::<f64>().is_ok());
        let starts_like_one = size.starts_with(|c: char| c.is_ascii_digit() || c == '.');
        let end = (1..=size.len()).rev().find(is_number).filter(|_| starts_like_one);
        let Some((number, unit)) = end.and_then(|end| size.split_at_checked(end)) else {
            return Err(format!("`{size}` does not begin with a number of 0 or more: {expected}"));
        };
        let value = number.parse::<f64>().ok().filter(|value| value.is_finite());
        let value = value.ok_or_else(|| format!("`{number}` is too large"))?;
        if unit.trim() == "%" && value > PERCENT_MAX {
            return Err(format!(
                "{value} % is too large: above {PERCENT_MAX} % of its range, every channel may become constant"
            ));
        }
        let unit = match unit.trim() {
            "" => ToleranceUnit::Own,
            "%" => ToleranceUnit::Percent,
            "count" | "counts" => ToleranceUnit::Counts,
            unit => ToleranceUnit::Named(unit.to_owned()),
        };
        Ok(Self { pattern, value, unit })
    }
}

impl fmt::Display for ChannelTolerance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(pattern) = &self.pattern {
            write!(f, "{pattern}=")?;
        }
        let unit = match &self.unit {
            ToleranceUnit::Counts => "count",
            ToleranceUnit::Percent => "%",
            ToleranceUnit::Own => "",
            ToleranceUnit::Named(unit) => unit,
        };
        write!(f, "{}{unit}", self.value)
    }
}

impl ChannelTolerance {
    fn matches(&self, name: &str) -> bool {
        let name: Vec<char> = name.chars().collect();
        self.pattern
            .as_ref()
            .is_none_or(|pattern| matches_pattern(&pattern.chars().collect::<Vec<_>>(), &name))
    }

    /// The largest error in stored samples; 0 if the samples do not show what a count is.
    fn bound(&self, channel: &SampledChannel, profile: &ChannelProfile) -> f64 {
        match self.unit {
            ToleranceUnit::Counts => {
                profile.quantum().map_or(0.0, |quantum| self.value * quantum + profile.rounding())
            }
            ToleranceUnit::Percent => self.value / 100.0 * profile.range(),
            ToleranceUnit::Own | ToleranceUnit::Named(_) => self.value / channel.scale.abs(),
        }
    }
}

/// Whether a name matches a pattern with `*` and `?`. After each `*` the shortest match is tried first, and only the last
/// `*` is widened, so that the time is at most the product of both lengths.
fn matches_pattern(pattern: &[char], name: &[char]) -> bool {
    let (mut at, mut next, mut widened) = (0, 0, None);
    while next < name.len() {
        match pattern.get(at) {
            Some('*') => {
                widened = Some((at, next));
                at += 1;
            }
            Some(&c) if c == '?' || Some(&c) == name.get(next) => (at, next) = (at + 1, next + 1),
            _ => {
                let Some((star, from)) = widened else { return false };
                widened = Some((star, from + 1));
                (at, next) = (star + 1, from + 1);
            }
        }
    }
    pattern.get(at..).is_some_and(|rest| rest.iter().all(|c| *c == '*'))
}

/// The tolerances of all channels: the last that matches a channel holds. Channels without a match stay exact.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AnalogTolerance(pub Vec<ChannelTolerance>);

impl fmt::Display for AnalogTolerance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all: Vec<String> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&all.join(", "))
    }
}

impl AnalogTolerance {
    /// Replaces the analog samples of a motion that was read from a file by others within the tolerances, where blocks
    /// of these are smaller, and states the largest error of each channel. Every error is measured.
    ///
    /// # Errors
    /// `InvalidArgument` for a pattern that matches no channel, and for a unit that is not the channel's; `Io` of the
    /// scratch files.
    pub fn apply(
        &self,
        info: &mut MotionInfo,
        new_scratch: impl Fn() -> io::Result<Arc<dyn ScratchFile>>,
    ) -> Result<(), TakeError> {
        if self.0.is_empty() {
            return Ok(());
        }
        let parameters = c3d::kept_parameters(&info.foreign)?.map(|(_, parameters)| parameters);
        let parameters = parameters.unwrap_or_default();
        let part = info.foreign.iter_mut().find(|part| part.kind == ANALOG);
        let mut channels = Vec::new();
        let mut store = PartStore::new(true, &new_scratch);
        if let Some(n_signals) = part.as_deref().map(sample_parts::n_signals).transpose()? {
            let numbers: Vec<u32> = (0..n_signals as u32).collect();
            channels = c3d::describe_sampled(ANALOG, &numbers, &parameters, |_| String::new());
        }
        let rules = self.rules(&channels)?;
        let Some(part) = part else { return Ok(()) };
        let is_unsigned = c3d::is_analog_unsigned(&parameters);
        let replaced = sample_parts::bounded(part, is_unsigned, &mut store, |column, profile| {
            let (rule, channel) = (rules.get(column)?.as_ref()?, channels.get(column)?);
            Some(rule.bound(channel, profile))
        })?;
        if let Some(replaced) = replaced {
            *part = replaced;
        }
        Ok(())
    }

    /// The tolerance of each channel.
    fn rules(
        &self,
        channels: &[SampledChannel],
    ) -> Result<Vec<Option<&ChannelTolerance>>, TakeError> {
        let listed = |what: String| {
            let listed: Vec<String> = channels
                .iter()
                .map(|channel| format!("{} ({})", channel.name, channel.unit))
                .collect();
            let listed = if listed.is_empty() { "none".to_owned() } else { listed.join(", ") };
            TakeError::InvalidArgument(format!("{what}; the analog channels are: {listed}"))
        };
        let unused = self.0.iter().find(|rule| {
            rule.pattern.is_some() && !channels.iter().any(|channel| rule.matches(&channel.name))
        });
        if let Some(rule) = unused {
            return Err(listed(format!("analog tolerance {rule}: no channel has such a name")));
        }
        let of_channel = |channel: &SampledChannel| {
            let rule = self.0.iter().rev().find(|rule| rule.matches(&channel.name));
            match rule {
                Some(ChannelTolerance { unit: ToleranceUnit::Named(unit), .. })
                    if unit != channel.unit.trim() =>
                {
                    let rule = rule.map(ToString::to_string).unwrap_or_default();
                    Err(listed(format!(
                        "analog tolerance {rule}: {} is in `{}`, not in `{unit}`; give it in that unit, in % or in \
                         counts, or for channels in `{unit}` alone, with a pattern before it",
                        channel.name, channel.unit
                    )))
                }
                rule => Ok(rule),
            }
        };
        channels.iter().map(of_channel).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tolerance(texts: &[&str]) -> AnalogTolerance {
        AnalogTolerance(texts.iter().map(|text| text.parse().unwrap()).collect())
    }

    #[test]
    fn tolerances_are_read_and_written() {
        let texts = ["1count", "0.1%", "0.5", "EMG*=0.1%", "F?z*=0.5N", "a=b=0.002V", "2e-3V"];
        assert_eq!(
            tolerance(&texts).to_string(),
            "1count, 0.1%, 0.5, EMG*=0.1%, F?z*=0.5N, a=b=0.002V, 0.002V"
        );
        assert_eq!(tolerance(&["2 counts"]).to_string(), "2count");
        for wrong in ["", "N", "-1N", "=1N", "EMG*=", "nan", "inf%", "1e999N", "+1", "50.1%"] {
            let error = wrong.parse::<ChannelTolerance>().unwrap_err();
            assert!(error.contains("expected") || error.contains("too large"), "{wrong}: {error}");
        }
    }

    #[test]
    fn names_match_patterns() {
        let cases = [
            ("EMG*", "EMG left", true),
            ("EMG*", "emg left", false),
            ("F?z*", "F1z", true),
            ("F?z*", "Fz1", false),
            ("*z", "Fz", true),
            ("*a*b", "xaybab", true),
            ("*a*b", "xaybac", false),
            ("", "", true),
            ("?", "", false),
        ];
        for (pattern, name, expected) in cases {
            let [pattern, name]: [Vec<char>; 2] = [pattern, name].map(|s| s.chars().collect());
            assert_eq!(matches_pattern(&pattern, &name), expected, "{pattern:?} {name:?}");
        }
    }

    #[test]
    fn the_last_match_holds_and_every_mistake_lists_the_channels() {
        let channel = |name: &str, unit: &str| SampledChannel {
            name: name.to_owned(),
            unit: unit.to_owned(),
            scale: -0.5,
            ..SampledChannel::default()
        };
        let channels = [channel("Fz1", "N"), channel("EMG1", "V")];
        let found = tolerance(&["1count", "EMG*=0.1%", "F*=2N"]);
        let rules = found.rules(&channels).unwrap();
        let texts: Vec<String> = rules.iter().flatten().map(ToString::to_string).collect();
        assert_eq!(texts, ["F*=2N", "EMG*=0.1%"]);
        let bound = rules[0].unwrap().bound(&channels[0], &ChannelProfile::default());
        assert_eq!(bound, 4.0, "newtons over newtons per sample");
        assert!(tolerance(&["F*=1"]).rules(&channels).unwrap()[1].is_none());
        for (wrong, why) in [("EKG*=1", "no channel has such a name"), ("0.5N", "EMG1 is in `V`")] {
            let error = tolerance(&[wrong]).rules(&channels).unwrap_err().to_string();
            assert!(error.contains(why) && error.contains("Fz1 (N), EMG1 (V)"), "{error}");
        }
    }
}
