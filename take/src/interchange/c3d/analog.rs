//! The ANALOG group: labels, units and scaling of the stored samples of each channel.

use super::parameters::{Parameter, Parameters, is_unsigned};
use crate::interchange::counted;

/// Name of the group.
pub(super) const ANALOG: &str = "ANALOG";

/// A scalar signal at the analog rate: a component of a force plate, an electrode of an EMG, a switch.
#[derive(Debug, Clone, PartialEq)]
pub struct AnalogChannel {
    /// Its label; `A1`, `A2`... by number if it has none. Labels may repeat.
    pub name: String,
    /// The unit of its values, as written; may be empty.
    pub unit: String,
    /// A description; may be empty.
    pub description: String,
    /// Physical units per unit of the stored samples: SCALE times `GEN_SCALE`.
    pub scale: f64,
    /// The stored sample whose value is 0.
    pub offset: f64,
}

impl AnalogChannel {
    /// The value of a stored sample.
    #[must_use]
    pub fn value(&self, stored: f64) -> f64 {
        (stored - self.offset) * self.scale
    }
}

/// The stored offsets of the channels, fewer if the file states fewer: OFFSET with its continuations, or OFFSETS, as
/// some software calls it. 16-bit integers are signed unless the samples are unsigned.
pub(super) fn offsets(parameters: &Parameters) -> Vec<f64> {
    let is_unsigned = is_unsigned(parameters);
    let of_integer = |word: u16| if is_unsigned { f64::from(word) } else { f64::from(word as i16) };
    let numbers = |parameter: &Parameter| match parameter.kind {
        2 => parameter.integers().into_iter().map(of_integer).collect(),
        _ => parameter.numbers(),
    };
    list_or(parameters, "OFFSET", "OFFSETS").into_iter().flat_map(numbers).collect()
}

/// The stored scales of the channels, fewer if the file states fewer: SCALE with its continuations, or SCALES.
pub(super) fn scales(parameters: &Parameters) -> Vec<f64> {
    list_or(parameters, "SCALE", "SCALES").into_iter().flat_map(Parameter::numbers).collect()
}

fn list_or<'a>(parameters: &'a Parameters, name: &str, other: &str) -> Vec<&'a Parameter> {
    let found = parameters.list(ANALOG, name);
    if found.is_empty() { parameters.list(ANALOG, other) } else { found }
}

/// The name that a channel without a label gets, by its index: `A1`, `A2`...
pub(super) fn unlabelled_name(channel: usize) -> String {
    format!("A{}", channel + 1)
}

/// Describes `n_channels` channels. What the group does not state, or not as a usable number, is an offset of 0 and a
/// scale of 1, as an export to C3D writes it; `warnings` lists this.
pub(crate) fn channels(
    parameters: &Parameters,
    n_channels: usize,
    warnings: &mut Vec<String>,
) -> Vec<AnalogChannel> {
    let (scales, offsets) = (scales(parameters), offsets(parameters));
    let gen_scale = parameters.number(ANALOG, "GEN_SCALE").unwrap_or(1.0);
    let is_usable = gen_scale.is_finite() && gen_scale != 0.0;
    if !is_usable {
        warnings.push(format!("ANALOG:GEN_SCALE is {gen_scale}; 1 was used."));
    }
    let gen_scale = if is_usable { gen_scale } else { 1.0 };
    for (name, numbers, default) in [("SCALE", &scales, 1), ("OFFSET", &offsets, 0)] {
        let stated = numbers.iter().take(n_channels).filter(|number| number.is_finite()).count();
        if let Some(missing) = n_channels.checked_sub(stated).filter(|&missing| missing > 0) {
            warnings.push(format!(
                "ANALOG:{name} has no number for {} of {n_channels}; {default} was used.",
                counted(missing as u64, "channel")
            ));
        }
    }
    let number = |numbers: &[f64], channel: usize, default: f64| {
        numbers.get(channel).copied().filter(|number| number.is_finite()).unwrap_or(default)
    };
    let texts = ["LABELS", "UNITS", "DESCRIPTIONS"].map(|name| parameters.texts(ANALOG, name));
    let [names, units, descriptions] = &texts;
    let text = |texts: &[String], channel: usize| texts.get(channel).cloned().unwrap_or_default();
    let channel = |channel: usize| AnalogChannel {
        name: Some(text(names, channel))
            .filter(|name| !name.is_empty())
            .unwrap_or_else(|| unlabelled_name(channel)),
        unit: text(units, channel),
        description: text(descriptions, channel),
        scale: number(&scales, channel, 1.0) * gen_scale,
        offset: number(&offsets, channel, 0.0),
    };
    (0..n_channels).map(channel).collect()
}
