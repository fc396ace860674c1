//! The ANALOG group of a file to be written: whole, and of the types that others read.
//!
//! ezc3d reads past the end of a list that is shorter than the number of channels, and takes the samples a frame from the
//! two rates, rounded down; py-c3d reads OFFSET as words whatever its type.

use super::parameters::{Parameter, Parameters};

/// Name of the group.
const ANALOG: &str = "ANALOG";

/// Completes the group for so many channels with `ratio` samples a frame. Returns what has to be taken from the samples
/// of each channel, because OFFSET cannot say it: offsets that are no whole numbers, or too large for a word.
pub(super) fn complete(
    parameters: &mut Parameters,
    n_channels: usize,
    ratio: usize,
    rate_hz: f64,
) -> Vec<f64> {
    parameters.set_word(ANALOG, "USED", u16::try_from(n_channels).unwrap_or(u16::MAX));
    set_rate(parameters, ratio, rate_hz);
    if !is_float(parameters.get(ANALOG, "GEN_SCALE"), 1) {
        let value = parameters.number(ANALOG, "GEN_SCALE").unwrap_or(1.0);
        parameters.set_float(ANALOG, "GEN_SCALE", value as f32);
    }
    if !is_float(parameters.get(ANALOG, "SCALE"), n_channels.min(255)) {
        let known = parameters.get(ANALOG, "SCALE").or(parameters.get(ANALOG, "SCALES"));
        let known = known.map(Parameter::numbers).unwrap_or_default();
        let scales: Vec<f32> =
            (0..n_channels).map(|i| known.get(i).map_or(1.0, |&scale| scale as f32)).collect();
        parameters.set_float_list(ANALOG, "SCALE", &scales);
    }
    for (name, prefix) in [("LABELS", Some("A")), ("UNITS", None), ("DESCRIPTIONS", None)] {
        let mut texts = parameters.texts(ANALOG, name);
        if texts.len() >= n_channels {
            continue;
        }
        for index in texts.len()..n_channels {
            texts.push(prefix.map_or_else(String::new, |prefix| format!("{prefix}{}", index + 1)));
        }
        // None is longer than what was read.
        parameters.set_texts(ANALOG, name, &texts).unwrap_or_default();
    }
    set_offsets(parameters, n_channels)
}

/// Whether a parameter holds so many floats.
fn is_float(parameter: Option<&Parameter>, n: usize) -> bool {
    parameter.is_some_and(|parameter| parameter.floats().len() >= n)
}

/// ANALOG:RATE, where it does not say the samples a frame already: never less than they are, however it is rounded.
fn set_rate(parameters: &mut Parameters, ratio: usize, rate_hz: f64) {
    let point_hz = f64::from(rate_hz as f32);
    let says = |analog_hz: f64| (analog_hz / point_hz) as usize == ratio;
    let kept = parameters.get(ANALOG, "RATE").and_then(|p| p.floats().first().copied());
    if kept.is_some_and(|kept| says(f64::from(kept))) {
        return;
    }
    let mut analog_hz = (point_hz * ratio as f64) as f32;
    if !says(f64::from(analog_hz)) {
        analog_hz = analog_hz.next_up();
    }
    parameters.set_float(ANALOG, "RATE", analog_hz);
}

/// OFFSET as words, one a channel. Some software calls it OFFSETS.
fn set_offsets(parameters: &mut Parameters, n_channels: usize) -> Vec<f64> {
    let is_unsigned =
        parameters.text(ANALOG, "FORMAT").is_some_and(|text| text.eq_ignore_ascii_case("UNSIGNED"));
    let kept = parameters.get(ANALOG, "OFFSET").or(parameters.get(ANALOG, "OFFSETS"));
    let as_signed = |word: u16| if is_unsigned { f64::from(word) } else { f64::from(word as i16) };
    let known: Vec<f64> = match kept {
        Some(parameter) if parameter.kind == 2 => {
            parameter.words().into_iter().map(as_signed).collect()
        }
        Some(parameter) => parameter.numbers(),
        None => Vec::new(),
    };
    let is_whole = parameters
        .get(ANALOG, "OFFSET")
        .is_some_and(|p| p.kind == 2 && p.words().len() >= n_channels.min(255));
    if is_whole {
        return Vec::new();
    }
    let range = if is_unsigned { 0.0..=65535.0 } else { -32768.0..=32767.0 };
    let mut words = Vec::with_capacity(n_channels);
    let mut rest = Vec::with_capacity(n_channels);
    for channel in 0..n_channels {
        let offset = known.get(channel).copied().filter(|v| v.is_finite()).unwrap_or(0.0);
        let fits = offset.fract() == 0.0 && range.contains(&offset);
        words.push(if fits { offset as i32 as u16 } else { 0 });
        rest.push(if fits { 0.0 } else { offset });
    }
    parameters.set_word_list(ANALOG, "OFFSET", &words);
    if rest.iter().all(|&offset| offset == 0.0) { Vec::new() } else { rest }
}
