//! The ANALOG and `FORCE_PLATFORM` groups: labels, units and scaling of the stored samples of each channel, what the
//! parameters state about the sampled channels of the foreign parts, and the force plates whose channels they are.

use std::collections::HashMap;

use super::{
    columns::{self, MODEL_OUTPUTS},
    parameters::{Parameter, Parameters, is_unsigned},
};
use crate::{
    foreign::force_plate::{ForcePlate, ForcePlates, PlateGeometry, PlateType, UnusablePlate},
    interchange::{counted, units::LengthUnit},
    record::SampledChannel,
};

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
        columns::ANALOG => {
            let channels = channels(parameters, numbers.len(), &mut Vec::new());
            let described = channels.into_iter().zip(numbers).map(|(channel, &index)| {
                let AnalogChannel { name, unit, scale, offset, .. } = channel;
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

/// Name of the group.
pub(super) const FORCE_PLATFORM: &str = "FORCE_PLATFORM";
/// Maximum number of plates of a file: the largest dimension of a parameter.
const PLATES_MAX: usize = super::parameters::DIMENSION_MAX;

/// Newtons in a pound-force.
const POUND_FORCE_N: f64 = 4.448_221_615_260_5;

/// The lists of the group, each with the elements of all plates one after another.
struct PlateLists<'a> {
    types: Vec<f64>,
    corners: Vec<f64>,
    origins: Vec<f64>,
    channels: Option<&'a Parameter>,
    calibrations: Option<&'a Parameter>,
    is_by_row: bool,
    n_plates: usize,
    /// Millimetres in the file's unit of length.
    unit_mm: f64,
}

/// The plates of a file with these analog channels, lengths converted from POINT:UNITS by `unit_mm`; `None` if it has no
/// plates. A plate that cannot be used is listed with the reason.
pub(crate) fn plates(
    parameters: &Parameters,
    analog: &[AnalogChannel],
    unit_mm: f64,
) -> Option<ForcePlates> {
    let numbers = |name: &str| {
        parameters.get(FORCE_PLATFORM, name).map(Parameter::numbers).unwrap_or_default()
    };
    let types = numbers("TYPE");
    let n_plates = parameters.number(FORCE_PLATFORM, "USED").map_or(types.len(), |n| n as usize);
    let order = parameters.text(FORCE_PLATFORM, "MATRIX_STORE").unwrap_or_default();
    let lists = PlateLists {
        types,
        corners: numbers("CORNERS"),
        origins: numbers("ORIGIN"),
        channels: parameters.get(FORCE_PLATFORM, "CHANNEL"),
        calibrations: parameters.get(FORCE_PLATFORM, "CAL_MATRIX"),
        is_by_row: order.eq_ignore_ascii_case("BYROW"),
        n_plates: n_plates.min(PLATES_MAX),
        unit_mm,
    };
    if lists.n_plates == 0 {
        return None;
    }
    let mut found = ForcePlates { baseline: baseline(&numbers("ZERO")), ..ForcePlates::default() };
    for index in 0..lists.n_plates {
        match lists.plate(index, analog, &mut found.warnings) {
            Ok(plate) => found.plates.push(plate),
            Err(reason) => found.unusable.push(UnusablePlate { number: index + 1, reason }),
        }
    }
    Some(found)
}

/// The first and the last frame number of ZERO. Two zeros, and a range that ends before it begins, state none; frame 0,
/// which does not exist, is 1.
fn baseline(zero: &[f64]) -> Option<(u64, u64)> {
    let &[first, last, ..] = zero else { return None };
    let (first, last) = ((first as u64).max(1), last as u64);
    (first <= last).then_some((first, last))
}

impl PlateLists<'_> {
    /// The plate with an index.
    ///
    /// # Errors
    /// Why it cannot be used.
    fn plate(
        &self,
        index: usize,
        analog: &[AnalogChannel],
        warnings: &mut Vec<String>,
    ) -> Result<ForcePlate, String> {
        let number = index + 1;
        let kind = self.types.get(index).ok_or("TYPE has no entry for it")?;
        let kind = PlateType::from_code(*kind)
            .ok_or_else(|| format!("it is of type {kind}, but types 1 to 4 are supported"))?;
        let corners_mm = self.corners_mm(index)?;
        let origin_mm = self.origin_mm(index, kind, warnings)?;
        let geometry = PlateGeometry::new(corners_mm, origin_mm)?;
        let channels = self.channels(index, kind, analog.len())?;
        let calibration = match kind {
            PlateType::Type4 => Some(self.calibration(index, warnings)?),
            _ => None,
        };
        let factors = self.factors(kind, number, &channels, analog, warnings);
        Ok(ForcePlate { number, kind, geometry, channels, calibration, factors })
    }

    fn corners_mm(&self, index: usize) -> Result<[[f64; 3]; 4], String> {
        let corners = self.corners.as_chunks::<3>().0.as_chunks::<4>().0;
        let corners = corners.get(index).ok_or("CORNERS does not state its four corners")?;
        Ok(corners.map(|corner| corner.map(|v| v * self.unit_mm)))
    }

    /// ORIGIN of a plate. Its third number is negative, because the z axis of a plate points down and its sensors are
    /// below the surface; early documentation of plates had the vector in the opposite direction.
    fn origin_mm(
        &self,
        index: usize,
        kind: PlateType,
        warnings: &mut Vec<String>,
    ) -> Result<[f64; 3], String> {
        let origin = self.origins.as_chunks::<3>().0.get(index);
        let origin = match (origin, kind) {
            (Some(origin), _) => *origin,
            // The channels already give the centre of pressure.
            (None, PlateType::Type1) => [0.0; 3],
            (None, _) => return Err("ORIGIN has no entry for it".to_owned()),
        };
        let [x, y, z] = origin.map(|v| v * self.unit_mm);
        if !z.is_finite() || z <= 0.0 || kind == PlateType::Type1 {
            return Ok([x, y, z]);
        }
        warnings.push(format!(
            "ORIGIN of force plate {} is above its surface ({} mm); it was read with the opposite sign.",
            index + 1,
            z as f32
        ));
        // In type 3 the other two are distances between sensors.
        Ok(if kind == PlateType::Type3 { [x, y, -z] } else { [-x, -y, -z] })
    }

    /// Indices of the analog channels of a plate.
    fn channels(&self, index: usize, kind: PlateType, n: usize) -> Result<Vec<usize>, String> {
        let parameter = self.channels.ok_or("CHANNEL is missing")?;
        let numbers = parameter.numbers();
        let n_channels = kind.n_channels();
        let per_plate = match parameter.dimensions[..] {
            [per_plate, _, ..] => usize::from(per_plate),
            _ => (numbers.len() / self.n_plates).max(n_channels),
        };
        let of_plate = numbers.get(index * per_plate..).unwrap_or(&[]);
        let of_plate = of_plate.get(..n_channels.min(per_plate)).unwrap_or(&[]);
        if of_plate.len() < n_channels {
            return Err(format!("CHANNEL does not list its {n_channels} channels"));
        }
        let channel = |&number: &f64| {
            let channel = (number as usize).checked_sub(1).filter(|&channel| channel < n);
            channel
                .ok_or_else(|| format!("CHANNEL has number {number}, but there are {n} channels"))
        };
        of_plate.iter().map(channel).collect()
    }

    /// `CAL_MATRIX` of a plate by rows, with moments converted to N m. Without one, the channels are forces and moments
    /// themselves, as in files of Motion Analysis.
    fn calibration(
        &self,
        index: usize,
        warnings: &mut Vec<String>,
    ) -> Result<[[f64; 6]; 6], String> {
        let numbers = self.calibrations.map(Parameter::numbers).unwrap_or_default();
        let mut matrix = [[0.0; 6]; 6];
        if numbers.is_empty() {
            warnings.push(format!(
                "Force plate {} has no CAL_MATRIX; its channels were read as forces and moments.",
                index + 1
            ));
            matrix.iter_mut().enumerate().for_each(|(i, row)| row[i] = 1.0);
        } else {
            let dimensions = self.calibrations.map_or(&[][..], |parameter| &parameter.dimensions);
            let (rows, columns) = match *dimensions {
                [rows, columns, _, ..] => (usize::from(rows), usize::from(columns)),
                _ => (6, 6),
            };
            let of_plate = numbers.get(index * rows * columns..).unwrap_or(&[]);
            if rows < 6 || columns < 6 || of_plate.len() < rows * columns {
                return Err("CAL_MATRIX does not state its 6 x 6 numbers".to_owned());
            }
            for (i, row) in matrix.iter_mut().enumerate() {
                for (j, cell) in row.iter_mut().enumerate() {
                    // Columns are stored one after another, as in Fortran.
                    let at = if self.is_by_row { i * columns + j } else { j * rows + i };
                    *cell = of_plate.get(at).copied().unwrap_or_default();
                }
            }
        }
        let to_metres = self.unit_mm / 1000.0;
        matrix.iter_mut().skip(3).flatten().for_each(|cell| *cell *= to_metres);
        if matrix.iter().flatten().any(|cell| !cell.is_finite()) {
            return Err("CAL_MATRIX has a number that is not finite".to_owned());
        }
        Ok(matrix)
    }

    /// For each channel, the factor from its unit to N, N m or mm. A moment without a unit is in N times POINT:UNITS.
    fn factors(
        &self,
        kind: PlateType,
        number: usize,
        channels: &[usize],
        analog: &[AnalogChannel],
        warnings: &mut Vec<String>,
    ) -> Vec<f64> {
        if kind == PlateType::Type4 {
            return vec![1.0; channels.len()]; // The calibration has the units.
        }
        let mut unknown: Vec<&str> = Vec::new();
        let mut factor = |(place, channel): (usize, &usize)| {
            let unit = analog.get(*channel).map_or("", |channel| channel.unit.trim());
            let known = factor_of_unit(kind, place, unit);
            let default = match (kind, place) {
                (PlateType::Type3, _) | (_, 0..=2) => 1.0,
                (PlateType::Type1, 3 | 4) => self.unit_mm,
                _ => self.unit_mm / 1000.0,
            };
            if known.is_none() && !unit.is_empty() && !unknown.contains(&unit) {
                unknown.push(unit);
            }
            known.unwrap_or(default)
        };
        let factors = channels.iter().enumerate().map(&mut factor).collect();
        if !unknown.is_empty() {
            warnings.push(format!(
                "Channels of force plate {number} are in {}; they were read as N, moments as N times POINT:UNITS.",
                unknown.join(", ")
            ));
        }
        factors
    }
}

/// The factor from the unit of a plate's channel, at this place among its channels, to N, mm or N m; `None` for other
/// units.
pub(crate) fn factor_of_unit(kind: PlateType, place: usize, unit: &str) -> Option<f64> {
    match (kind, place) {
        (PlateType::Type3, _) | (_, 0..=2) => force_n(unit),
        (PlateType::Type1, 3 | 4) => LengthUnit::from_file(unit).map(LengthUnit::mm),
        _ => moment_nm(unit),
    }
}

/// Newtons in a unit of force; `None` for other units.
fn force_n(unit: &str) -> Option<f64> {
    match unit.to_lowercase().as_str() {
        "n" | "newton" | "newtons" => Some(1.0),
        "kn" => Some(1000.0),
        "lbf" | "lb" | "lbs" => Some(POUND_FORCE_N),
        _ => None,
    }
}

/// Newton metres in a unit of moment, such as `Nmm`, `N m`, `N.mm`; `None` for other units.
fn moment_nm(unit: &str) -> Option<f64> {
    let plain: String =
        unit.chars().filter(|c| !c.is_whitespace() && !"-.*·⋅".contains(*c)).collect();
    let length = plain.strip_prefix(['N', 'n'])?;
    LengthUnit::from_file(length).map(|unit| unit.mm() / 1000.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_moments_are_a_force_times_a_length() {
        for (unit, expected) in [
            ("Nmm", Some(1e-3)),
            ("N.mm", Some(1e-3)),
            ("N m", Some(1.0)),
            ("Nm", Some(1.0)),
            ("N-cm", Some(1e-2)),
            ("N", None),
            ("V", None),
            ("", None),
        ] {
            assert_eq!(moment_nm(unit), expected, "{unit}");
        }
        assert_eq!(["N", "kN", "V"].map(force_n), [Some(1.0), Some(1000.0), None]);
    }

    #[test]
    fn a_baseline_is_a_range_of_frame_numbers() {
        assert_eq!(baseline(&[1.0, 10.0]), Some((1, 10)));
        assert_eq!(baseline(&[0.0, 10.0]), Some((1, 10)));
        for none in [&[0.0, 0.0][..], &[1.0, 0.0], &[5.0], &[]] {
            assert_eq!(baseline(none), None, "{none:?}");
        }
    }
}
