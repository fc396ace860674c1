//! What the parameters of a C3D file state about the sampled channels of its foreign parts: names, units, scales
//! and offsets.

use std::collections::HashMap;

use super::{
    analog,
    columns::{ANALOG, MODEL_OUTPUTS},
    parameters::Parameters,
};
use crate::record::SampledChannel;

/// The lists of model outputs with the parameter that has their unit.
const OUTPUT_UNITS: [(&str, &str); 5] = [
    ("ANGLES", "ANGLE_UNITS"),
    ("FORCES", "FORCE_UNITS"),
    ("REACTIONS", "FORCE_UNITS"),
    ("MOMENTS", "MOMENT_UNITS"),
    ("POWERS", "POWER_UNITS"),
];

/// The columns of a model output.
const OUTPUT_COLUMNS: [&str; 4] = ["x", "y", "z", "residual"];

/// Longest name or unit, in bytes. A label of a C3D file has at most 255.
const TEXT_BYTES_MAX: usize = 512;

/// Describes the columns of a part of a kind whose signals have the numbers `numbers`. `marker` gives the name of a
/// marker by its column.
pub(crate) fn describe(
    kind: &str,
    numbers: &[u32],
    parameters: &Parameters,
    marker: impl Fn(usize) -> String,
) -> Vec<SampledChannel> {
    let plain = |index: u32, name: String, unit: String| SampledChannel {
        name: short(name),
        unit: short(unit),
        index,
        scale: 1.0,
        offset: 0.0,
    };
    match kind {
        ANALOG => {
            let channels = analog::channels(parameters, numbers.len(), &mut Vec::new());
            let described = channels.into_iter().zip(numbers).map(|(channel, &index)| {
                let analog::AnalogChannel { name, unit, scale, offset, .. } = channel;
                SampledChannel { scale, offset, ..plain(index, name, unit) }
            });
            described.collect()
        }
        MODEL_OUTPUTS => {
            let labels = parameters.texts("POINT", "LABELS");
            let units: HashMap<String, String> = OUTPUT_UNITS
                .iter()
                .flat_map(|(list, unit)| {
                    let unit = parameters.text("POINT", unit).unwrap_or_default();
                    parameters.texts("POINT", list).into_iter().map(move |of| (of, unit.clone()))
                })
                .collect();
            let described = numbers.iter().flat_map(|&index| {
                let label = labels.get(index as usize).cloned().unwrap_or_default();
                let unit = units.get(&label).cloned().unwrap_or_default();
                OUTPUT_COLUMNS.map(|column| {
                    let unit = if column == "residual" { String::new() } else { unit.clone() };
                    plain(index, format!("{label}.{column}"), unit)
                })
            });
            described.collect()
        }
        _ => numbers.iter().map(|&n| plain(n, marker(n as usize), String::new())).collect(),
    }
}

fn short(mut text: String) -> String {
    text.truncate(text.floor_char_boundary(TEXT_BYTES_MAX));
    text
}
