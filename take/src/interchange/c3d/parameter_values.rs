//! All parameters as plain values.

use super::{
    analog::is_unsigned,
    parameters::{Parameter, Parameters},
};
use crate::interchange::text::decode;

/// A parameter of a C3D file.
#[derive(Debug, Clone, PartialEq)]
pub struct C3dParameter {
    /// Its group, as written; empty if the file does not define the group.
    pub group: String,
    /// Its name, as written.
    pub name: String,
    /// Free text; may be empty.
    pub description: String,
    /// Its dimensions as the file has them, the fastest first; of texts, the first is their length. None for a scalar.
    pub dimensions: Vec<u8>,
    /// Its values in the order of the file.
    pub values: C3dValues,
}

/// The values of a parameter.
#[derive(Debug, Clone, PartialEq)]
pub enum C3dValues {
    /// Texts, without the trailing spaces that pad them.
    Texts(Vec<String>),
    /// Bytes.
    Bytes(Vec<u8>),
    /// 16-bit integers. Counts, frame numbers and the offsets of unsigned samples are unsigned, others signed.
    Integers(Vec<i32>),
    /// Floats.
    Floats(Vec<f32>),
}

impl C3dParameter {
    /// Whether it has this group and name, ignoring case.
    #[must_use]
    pub fn is(&self, group: &str, name: &str) -> bool {
        self.group.eq_ignore_ascii_case(group) && self.name.eq_ignore_ascii_case(name)
    }
}

/// Integers that the user guide defines as unsigned: counts, block numbers, and the 16-bit halves of frame
/// numbers.
const UNSIGNED: [(&str, &str); 7] = [
    ("POINT", "USED"),
    ("POINT", "FRAMES"),
    ("POINT", "LONG_FRAMES"),
    ("POINT", "DATA_START"),
    ("ANALOG", "USED"),
    ("TRIAL", "ACTUAL_START_FIELD"),
    ("TRIAL", "ACTUAL_END_FIELD"),
];

/// The parameters with the names of their groups, in the order of the file.
pub(crate) fn parameter_values(parameters: &Parameters) -> Vec<C3dParameter> {
    let has_unsigned_offsets = is_unsigned(parameters);
    let plain = |parameter: &Parameter| {
        let group = parameters.groups.iter().find(|group| group.id == parameter.group);
        let group = group.map_or_else(String::new, |group| decode(&group.name));
        let name = decode(&parameter.name);
        let is = |&(of, known): &(&str, &str)| {
            group.eq_ignore_ascii_case(of) && name.eq_ignore_ascii_case(known)
        };
        let is_offset = ["OFFSET", "OFFSETS"].iter().any(|known| is(&("ANALOG", known)));
        let is_unsigned = UNSIGNED.iter().any(is) || is_offset && has_unsigned_offsets;
        let integer =
            |word: u16| if is_unsigned { i32::from(word) } else { i32::from(word as i16) };
        C3dParameter {
            description: decode(&parameter.description),
            dimensions: parameter.dimensions.clone(),
            values: match parameter.kind {
                -1 => C3dValues::Texts(parameter.texts()),
                2 => C3dValues::Integers(parameter.integers().into_iter().map(integer).collect()),
                4 => C3dValues::Floats(parameter.floats()),
                _ => C3dValues::Bytes(parameter.data.clone()),
            },
            group,
            name,
        }
    };
    parameters.parameters.iter().map(plain).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_the_types_of_the_file() {
        let mut parameters = Parameters::default();
        parameters.set_integer("POINT", "FRAMES", 40_000);
        parameters.set_integer_list("ANALOG", "OFFSET", &[5, 0xFFFA]);
        parameters.set_float("POINT", "RATE", 100.5);
        parameters.set_texts("ANALOG", "LABELS", &["Fz".to_owned(), "EMG 1".to_owned()]).unwrap();
        let values = |parameters: &Parameters| {
            let plain = parameter_values(parameters).into_iter();
            plain.map(|p| (p.group, p.name, p.dimensions, p.values)).collect::<Vec<_>>()
        };
        let expected = |offset: i32| {
            let row = |group: &str, name: &str, dimensions: &[u8], values| {
                (group.to_owned(), name.to_owned(), dimensions.to_vec(), values)
            };
            let labels = vec!["Fz".to_owned(), "EMG 1".to_owned()];
            vec![
                row("POINT", "FRAMES", &[], C3dValues::Integers(vec![40_000])),
                row("ANALOG", "OFFSET", &[2], C3dValues::Integers(vec![5, offset])),
                row("POINT", "RATE", &[], C3dValues::Floats(vec![100.5])),
                row("ANALOG", "LABELS", &[5, 2], C3dValues::Texts(labels)),
            ]
        };
        assert_eq!(values(&parameters), expected(-6));
        parameters.set_text("ANALOG", "FORMAT", "UNSIGNED");
        assert_eq!(values(&parameters)[..4], expected(65_530)[..]);
    }
}
