//! The parameter section: reading, writing and editing of groups and their parameters, and all parameters as plain
//! values.

use super::header::ByteOrder;
use crate::{
    interchange::{counted, text::decode},
    motion::UpAxis,
    up_axis::{Direction, Rotation},
};

/// A group of parameters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ParameterGroup {
    /// 1 to 127.
    pub(super) id: u8,
    /// The name as stored.
    pub(super) name: Vec<u8>,
    /// Whether the group is locked against editing.
    pub(super) locked: bool,
    /// Free text.
    pub(super) description: Vec<u8>,
}

/// A parameter: an array of characters, bytes, 16-bit integers or floats in Intel order, first dimension fastest.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Parameter {
    /// Id of its group.
    pub(super) group: u8,
    /// The name as stored.
    pub(super) name: Vec<u8>,
    /// Whether the parameter is locked against editing.
    pub(super) locked: bool,
    /// Element type: -1 characters, 1 bytes, 2 integers, 4 floats.
    pub(super) kind: i8,
    /// The dimensions; none for a scalar.
    pub(super) dimensions: Vec<u8>,
    /// The values.
    pub(super) data: Vec<u8>,
    /// Free text.
    pub(super) description: Vec<u8>,
}

/// The parameter section.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Parameters {
    /// Groups in file order.
    pub(super) groups: Vec<ParameterGroup>,
    /// Parameters of all groups in file order.
    pub(super) parameters: Vec<Parameter>,
}

impl Parameter {
    /// Whether the parameter has this group and name, ignoring case.
    fn is(&self, group: u8, name: &str) -> bool {
        self.group == group && self.name.eq_ignore_ascii_case(name.as_bytes())
    }

    /// The values as numbers, integers unsigned. Empty for characters.
    pub(super) fn numbers(&self) -> Vec<f64> {
        match self.kind {
            1 => self.data.iter().map(|&v| f64::from(v)).collect(),
            2 => self.integers().into_iter().map(f64::from).collect(),
            4 => self.floats().into_iter().map(f64::from).collect(),
            _ => Vec::new(),
        }
    }

    /// The values as unsigned 16-bit integers; empty for other types.
    pub(super) fn integers(&self) -> Vec<u16> {
        if self.kind != 2 {
            return Vec::new();
        }
        self.data.as_chunks().0.iter().map(|&b| u16::from_le_bytes(b)).collect()
    }

    /// The values as floats; empty for other types.
    pub(super) fn floats(&self) -> Vec<f32> {
        if self.kind != 4 {
            return Vec::new();
        }
        self.data.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect()
    }

    /// The texts: the first dimension is their length. Trailing spaces and zeros are removed. Empty for other types.
    pub(super) fn texts(&self) -> Vec<String> {
        if self.kind != -1 {
            return Vec::new();
        }
        let length = usize::from(self.dimensions.first().copied().unwrap_or(1));
        if length == 0 {
            let n_strings = self.dimensions.iter().skip(1).map(|&d| usize::from(d)).product();
            return vec![String::new(); usize::from(u16::MAX).min(n_strings)];
        }
        let text = |text: &[u8]| {
            let end = text.iter().rposition(|b| !matches!(b, b' ' | 0)).map_or(0, |last| last + 1);
            decode(text.get(..end).unwrap_or(text))
        };
        self.data.chunks(length).map(text).collect()
    }
}

impl Parameters {
    /// The id of a group by its name, ignoring case.
    pub(super) fn group_id(&self, name: &str) -> Option<u8> {
        let found = self.groups.iter().find(|g| g.name.eq_ignore_ascii_case(name.as_bytes()))?;
        Some(found.id)
    }

    /// A parameter by group and name, ignoring case.
    pub(super) fn get(&self, group: &str, name: &str) -> Option<&Parameter> {
        let id = self.group_id(group)?;
        self.parameters.iter().find(|p| p.is(id, name))
    }

    /// The first value of a parameter as a number.
    pub(super) fn number(&self, group: &str, name: &str) -> Option<f64> {
        self.get(group, name)?.numbers().first().copied()
    }

    /// The first value of a parameter of floats.
    pub(super) fn float(&self, group: &str, name: &str) -> Option<f32> {
        self.get(group, name)?.floats().first().copied()
    }

    /// The up axis from `POINT:Y_SCREEN`; unknown if the parameter is missing or names a negative direction.
    pub(super) fn up_axis(&self) -> UpAxis {
        let axis = self.text("POINT", "Y_SCREEN").unwrap_or_default();
        let up = axis.trim().parse().ok().filter(|up: &Direction| !up.is_negative());
        up.map_or(UpAxis::Unknown, Direction::axis)
    }

    /// The first text of a parameter.
    pub(super) fn text(&self, group: &str, name: &str) -> Option<String> {
        self.get(group, name)?.texts().into_iter().next()
    }

    /// The texts of a parameter and its continuations: NAME, NAME2, NAME3...
    pub(super) fn texts(&self, group: &str, name: &str) -> Vec<String> {
        let mut texts = self.get(group, name).map(Parameter::texts).unwrap_or_default();
        for more in 2..=u8::MAX {
            let Some(parameter) = self.get(group, &format!("{name}{more}")) else { break };
            if texts.len() > usize::from(u16::MAX) {
                break; // Texts of length 0 take no bytes, so a damaged file could claim any number of them.
            }
            texts.extend(parameter.texts());
        }
        texts
    }

    /// A parameter and its continuations: NAME, NAME2, NAME3...
    pub(super) fn list(&self, group: &str, name: &str) -> Vec<&Parameter> {
        let more = (2..=u8::MAX).map(|number| self.get(group, &format!("{name}{number}")));
        std::iter::once(self.get(group, name)).chain(more).map_while(|found| found).collect()
    }

    /// Parses the records of a section up to the first invalid one. `section` begins at the first record.
    pub(super) fn parse(section: &[u8], order: ByteOrder, warnings: &mut Vec<String>) -> Self {
        let mut parameters = Self::default();
        let mut at = 0;
        loop {
            let Some(record) = ParameterRecord::parse(section, at, order) else {
                if section.get(at).is_none_or(|&length| length != 0) {
                    warnings.push(format!(
                        "The parameter section is damaged from its byte {} on; {} and {} were read.",
                        at + 4,
                        counted(parameters.groups.len() as u64, "group"),
                        counted(parameters.parameters.len() as u64, "parameter")
                    ));
                }
                return parameters;
            };
            record.read_into(&mut parameters, order, warnings);
            match record.next {
                Some(next) => at = next,
                None => return parameters,
            }
        }
    }
}

/// A record of the section: a group or a parameter whose body is not parsed yet.
struct ParameterRecord<'a> {
    id: i8,
    locked: bool,
    name: &'a [u8],
    body: &'a [u8],
    next: Option<usize>,
}

impl<'a> ParameterRecord<'a> {
    /// Parses the record at `at`; `None` at the end mark and for an invalid record.
    fn parse(section: &'a [u8], at: usize, order: ByteOrder) -> Option<Self> {
        let length = i8::from_le_bytes([*section.get(at)?]);
        let id = i8::from_le_bytes([*section.get(at + 1)?]);
        if length == 0 || id == 0 {
            return None;
        }
        let name_end = at + 2 + usize::from(length.unsigned_abs());
        let name = section.get(at + 2..name_end)?;
        let offset = usize::from(order.word_at(section, name_end)?);
        let next = (offset >= 2).then_some(name_end + offset);
        let body = section.get(name_end + 2..next.unwrap_or(section.len()))?;
        Some(Self { id, locked: length < 0, name, body, next })
    }

    /// Parses the body and adds the group or parameter to `to`.
    fn read_into(&self, to: &mut Parameters, order: ByteOrder, warnings: &mut Vec<String>) {
        if self.id < 0 {
            to.groups.push(ParameterGroup {
                id: self.id.unsigned_abs(),
                name: self.name.to_vec(),
                locked: self.locked,
                description: description(self.body).unwrap_or_default().to_vec(),
            });
            return;
        }
        match self.parameter(order) {
            Ok((parameter, None)) => to.parameters.push(parameter),
            Ok((parameter, Some(wrong))) => {
                warnings.push(format!("Parameter {}: {wrong}.", decode(self.name)));
                to.parameters.push(parameter);
            }
            Err(wrong) => {
                warnings.push(format!("Parameter {} was left out: {wrong}.", decode(self.name)));
            }
        }
    }

    /// Parses the body of a parameter, with a description of its fault, if it has one.
    fn parameter(&self, order: ByteOrder) -> Result<(Parameter, Option<String>), String> {
        let (kind, rest) = self.body.split_first().ok_or("no data")?;
        let kind = i8::from_le_bytes([*kind]);
        let width = match kind {
            -1 | 1 => 1,
            2 => 2,
            4 => 4,
            other => return Err(format!("expected type -1, 1, 2 or 4, found {other}")),
        };
        let (&n, rest) = rest.split_first().ok_or("the number of dimensions is missing")?;
        let dimensions = rest.split_at_checked(usize::from(n));
        let (dimensions, rest) = dimensions.ok_or("the dimensions are cut off")?;
        let mut dimensions = dimensions.to_vec();
        let announced = dimensions.iter().fold(width, |n: usize, &d| n.saturating_mul(d.into()));
        let (data, after, mut wrong) = match rest.split_at_checked(announced) {
            Some((data, after)) => (data, after, None),
            None => {
                let whole = rest.get(..rest.len() / width * width).unwrap_or(rest);
                let wrong = format!("expected {announced} bytes, found {}", rest.len());
                dimensions = vec![(whole.len() / width).min(255) as u8];
                let kept = usize::from(dimensions.first().copied().unwrap_or(0)) * width;
                (whole.get(..kept).unwrap_or(whole), &[][..], Some(wrong))
            }
        };
        let description = description(after).map(<[u8]>::to_vec);
        if description.is_none() && wrong.is_none() {
            wrong = Some("the length of the description is missing".to_owned());
        }
        let parameter = Parameter {
            group: self.id.unsigned_abs(),
            name: self.name.to_vec(),
            locked: self.locked,
            kind,
            dimensions,
            data: to_intel(data, kind, order),
            description: description.unwrap_or_default(),
        };
        Ok((parameter, wrong))
    }
}

/// The description after its length byte, cut off at the end of `bytes`.
fn description(bytes: &[u8]) -> Option<&[u8]> {
    let (length, text) = bytes.split_first()?;
    Some(text.get(..usize::from(*length)).unwrap_or(text))
}

/// Converts parameter values to Intel order.
fn to_intel(data: &[u8], kind: i8, order: ByteOrder) -> Vec<u8> {
    match (kind, order) {
        (2, ByteOrder::Mips) => {
            data.as_chunks().0.iter().flat_map(|&b| order.word(b).to_le_bytes()).collect()
        }
        (4, ByteOrder::Dec | ByteOrder::Mips) => {
            data.as_chunks().0.iter().flat_map(|&b| order.float(b).to_le_bytes()).collect()
        }
        _ => data.to_vec(),
    }
}

/// Maximum number of elements of one dimension.
pub(super) const DIMENSION_MAX: usize = 255;
/// Maximum number of bytes of one parameter's data: with dimensions and description the record's offset fits a signed
/// 16-bit integer.
const PARAMETER_BYTES_MAX: usize = 32_000;

/// Appends the records of all groups, each followed by its parameters, then parameters without a group, and the end
/// mark.
pub(super) fn encode_records(parameters: &Parameters, out: &mut Vec<u8>) {
    let known = |id: u8| parameters.groups.iter().any(|group| group.id == id);
    for group in &parameters.groups {
        encode_group(group, out);
        let of_group = parameters.parameters.iter().filter(|p| p.group == group.id);
        of_group.for_each(|parameter| encode_parameter(parameter, out));
    }
    let orphans = parameters.parameters.iter().filter(|p| !known(p.group));
    orphans.for_each(|parameter| encode_parameter(parameter, out));
    out.extend([0, 0]);
}

/// Appends a record's name length (negative if locked), id and name.
fn encode_name(name: &[u8], locked: bool, id: i8, out: &mut Vec<u8>) {
    let name = name.get(..127).unwrap_or(name);
    let length = name.len() as i8;
    out.extend((if locked { -length } else { length }).to_le_bytes());
    out.extend(id.to_le_bytes());
    out.extend(name);
}

/// Appends a description: length byte and text.
fn encode_description(text: &[u8], out: &mut Vec<u8>) {
    let text = text.get(..255).unwrap_or(text);
    out.push(text.len() as u8);
    out.extend(text);
}

fn encode_group(group: &ParameterGroup, out: &mut Vec<u8>) {
    // Group 128 is -128 in the file.
    encode_name(&group.name, group.locked, (group.id as i8).wrapping_neg(), out);
    out.extend((group.description.len().min(255) as u16 + 3).to_le_bytes());
    encode_description(&group.description, out);
}

fn encode_parameter(parameter: &Parameter, out: &mut Vec<u8>) {
    let Parameter { dimensions, data, description, .. } = parameter;
    let body = 4 + dimensions.len() + data.len() + 1 + description.len().min(255);
    // A record too long for its offset was read from the end of a section, where the offset is 0. It is the last one
    // again.
    let offset = u16::try_from(body).unwrap_or(0);
    encode_name(&parameter.name, parameter.locked, parameter.group as i8, out);
    out.extend(offset.to_le_bytes());
    out.extend(parameter.kind.to_le_bytes());
    out.push(dimensions.len().min(255) as u8);
    out.extend(dimensions);
    out.extend(data);
    encode_description(description, out);
}

impl Parameters {
    /// The id of a group, which is created if it does not exist; `None` if all 127 ids are taken.
    fn group_or_new(&mut self, name: &str) -> Option<u8> {
        if let Some(id) = self.group_id(name) {
            return Some(id);
        }
        let taken = self.groups.iter().map(|group| group.id);
        let taken: Vec<u8> = taken.chain(self.parameters.iter().map(|p| p.group)).collect();
        let id = (1..=127).find(|id| !taken.contains(id))?;
        self.groups.push(ParameterGroup {
            id,
            name: name.as_bytes().to_vec(),
            locked: false,
            description: Vec::new(),
        });
        Some(id)
    }

    /// Sets a parameter: in place if it exists, otherwise as the last one.
    pub(super) fn set(&mut self, group: &str, name: &str, kind: i8, shape: Vec<u8>, data: Vec<u8>) {
        let Some(id) = self.group_or_new(group) else { return };
        if let Some(parameter) = self.parameters.iter_mut().find(|p| p.is(id, name)) {
            (parameter.kind, parameter.dimensions, parameter.data) = (kind, shape, data);
            return;
        }
        self.parameters.push(Parameter {
            group: id,
            name: name.as_bytes().to_vec(),
            locked: false,
            kind,
            dimensions: shape,
            data,
            description: Vec::new(),
        });
    }

    /// Sets a single 16-bit integer.
    pub(super) fn set_integer(&mut self, group: &str, name: &str, value: u16) {
        self.set(group, name, 2, Vec::new(), value.to_le_bytes().to_vec());
    }

    /// Sets a 32-bit integer as two 16-bit ones, the lower one first.
    pub(super) fn set_long_integer(&mut self, group: &str, name: &str, value: u32) {
        self.set(group, name, 2, vec![2], value.to_le_bytes().to_vec());
    }

    /// Sets a single float.
    pub(super) fn set_float(&mut self, group: &str, name: &str, value: f32) {
        self.set(group, name, 4, Vec::new(), value.to_le_bytes().to_vec());
    }

    /// Sets a single text, cut off at 255 bytes.
    pub(super) fn set_text(&mut self, group: &str, name: &str, text: &str) {
        let text = text.as_bytes();
        let text = text.get(..255).unwrap_or(text);
        self.set(group, name, -1, vec![text.len() as u8], text.to_vec());
    }

    /// Sets a list of texts, continued in NAME2, NAME3... where a parameter is full. A list with the same texts stays
    /// unchanged.
    ///
    /// # Errors
    /// The first text that is longer than 255 bytes.
    pub(super) fn set_texts<'a>(
        &mut self,
        group: &str,
        name: &str,
        texts: &'a [String],
    ) -> Result<(), &'a str> {
        if self.get(group, name).is_some() && self.texts(group, name) == texts {
            return Ok(());
        }
        if let Some(long) = texts.iter().find(|text| text.len() > 255) {
            return Err(long);
        }
        self.remove_list(group, name);
        let length = texts.iter().map(String::len).max().unwrap_or(0).max(1);
        let per_parameter = (PARAMETER_BYTES_MAX / length).min(DIMENSION_MAX);
        if texts.is_empty() {
            self.set(group, name, -1, vec![0, 0], Vec::new());
        }
        for (index, some) in texts.chunks(per_parameter).enumerate() {
            let mut data = Vec::with_capacity(length * some.len());
            for text in some {
                data.extend(text.as_bytes());
                data.extend(std::iter::repeat_n(b' ', length - text.len()));
            }
            let name = if index == 0 { name.to_owned() } else { format!("{name}{}", index + 1) };
            self.set(group, &name, -1, vec![length as u8, some.len() as u8], data);
        }
        Ok(())
    }

    /// Removes a group with its parameters.
    pub(super) fn remove_group(&mut self, group: &str) {
        let Some(id) = self.group_id(group) else { return };
        self.groups.retain(|group| group.id != id);
        self.parameters.retain(|parameter| parameter.group != id);
    }

    /// Removes NAME and its continuations NAME2, NAME3...
    pub(super) fn remove_list(&mut self, group: &str, name: &str) {
        let Some(id) = self.group_id(group) else { return };
        let is_of_list = |found: &[u8]| {
            found.split_at_checked(name.len()).is_some_and(|(start, number)| {
                start.eq_ignore_ascii_case(name.as_bytes()) && number.iter().all(u8::is_ascii_digit)
            })
        };
        self.parameters.retain(|p| p.group != id || !is_of_list(&p.name));
    }

    /// Multiplies the floats of a parameter.
    pub(super) fn scale_floats(&mut self, group: &str, name: &str, factor: f64) {
        self.map_floats(group, name, |floats| {
            floats.iter().map(|&v| (f64::from(v) * factor) as f32).collect()
        });
    }

    /// Rotates the corners of force plates, the parameters that are positions in the laboratory.
    pub(super) fn rotate(&mut self, rotation: Rotation) {
        self.map_floats("FORCE_PLATFORM", "CORNERS", |floats| {
            let (corners, rest) = floats.as_chunks::<3>();
            let corners = corners.iter().flat_map(|&corner| rotation.apply(corner));
            corners.chain(rest.iter().copied()).collect()
        });
    }

    /// Replaces the floats of a parameter by as many others.
    fn map_floats(&mut self, group: &str, name: &str, map: impl Fn(&[f32]) -> Vec<f32>) {
        let Some(parameter) = self.get(group, name).filter(|p| p.kind == 4) else { return };
        let data = map(&parameter.floats()).into_iter().flat_map(f32::to_le_bytes).collect();
        let dimensions = parameter.dimensions.clone();
        self.set(group, name, 4, dimensions, data);
    }

    /// Sets a list of floats, continued in NAME2, NAME3... where a parameter is full.
    pub(super) fn set_float_list(&mut self, group: &str, name: &str, values: &[f32]) {
        let values: Vec<[u8; 4]> = values.iter().map(|value| value.to_le_bytes()).collect();
        self.set_list(group, name, 4, &values);
    }

    /// Sets a list of 16-bit integers, continued in NAME2, NAME3... where a parameter is full.
    pub(super) fn set_integer_list(&mut self, group: &str, name: &str, values: &[u16]) {
        let values: Vec<[u8; 2]> = values.iter().map(|value| value.to_le_bytes()).collect();
        self.set_list(group, name, 2, &values);
    }

    fn set_list<const N: usize>(&mut self, group: &str, name: &str, kind: i8, values: &[[u8; N]]) {
        if values.is_empty() {
            self.set(group, name, kind, vec![0], Vec::new());
        }
        for (index, some) in values.chunks(DIMENSION_MAX).enumerate() {
            let name = if index == 0 { name.to_owned() } else { format!("{name}{}", index + 1) };
            self.set(group, &name, kind, vec![some.len() as u8], some.concat());
        }
    }
}

/// Whether analog samples are unsigned integers.
pub(crate) fn is_unsigned(parameters: &Parameters) -> bool {
    parameters.text("ANALOG", "FORMAT").is_some_and(|text| text.eq_ignore_ascii_case("UNSIGNED"))
}

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
