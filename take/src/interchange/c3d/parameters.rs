//! The parameter section: groups, and parameters in them.

use super::super::text::decode;
use super::bytes::ByteOrder;

/// A group of parameters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Group {
    /// 1 to 127.
    pub(super) id: u8,
    /// Its name as stored.
    pub(super) name: Vec<u8>,
    /// Whether users should leave it alone.
    pub(super) locked: bool,
    /// Free text.
    pub(super) description: Vec<u8>,
}

/// A parameter: an array of characters, bytes, 16-bit words or floats, Intel order, first dimension fastest.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Parameter {
    /// The group it belongs to.
    pub(super) group: u8,
    /// Its name as stored.
    pub(super) name: Vec<u8>,
    /// Whether users should leave it alone.
    pub(super) locked: bool,
    /// -1 characters, 1 bytes, 2 words, 4 floats.
    pub(super) kind: i8,
    /// At most 255 each; none for a single value.
    pub(super) dimensions: Vec<u8>,
    /// The values.
    pub(super) data: Vec<u8>,
    /// Free text.
    pub(super) description: Vec<u8>,
}

/// The parameter section.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Parameters {
    /// In the order found.
    pub(super) groups: Vec<Group>,
    /// In the order found.
    pub(super) parameters: Vec<Parameter>,
}

impl Parameter {
    /// Its values as numbers; words unsigned. Empty for characters.
    pub(super) fn numbers(&self) -> Vec<f64> {
        match self.kind {
            1 => self.data.iter().map(|&v| f64::from(v)).collect(),
            2 => self.words().into_iter().map(f64::from).collect(),
            4 => self.floats().into_iter().map(f64::from).collect(),
            _ => Vec::new(),
        }
    }

    /// Its values as unsigned words; empty when it holds none.
    pub(super) fn words(&self) -> Vec<u16> {
        if self.kind != 2 {
            return Vec::new();
        }
        self.data.as_chunks().0.iter().map(|&b| u16::from_le_bytes(b)).collect()
    }

    /// Its values as floats; empty when it holds none.
    pub(super) fn floats(&self) -> Vec<f32> {
        if self.kind != 4 {
            return Vec::new();
        }
        self.data.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect()
    }

    /// Its texts: one for each string of the first dimension's length, trailing spaces and zeros cut off.
    pub(super) fn texts(&self) -> Vec<String> {
        let length = usize::from(self.dimensions.first().copied().unwrap_or(1));
        if self.kind != -1 || length == 0 {
            let n_strings =
                self.dimensions.iter().skip(1).map(|&d| usize::from(d)).product::<usize>();
            let n_strings = if self.kind == -1 { n_strings.min(usize::from(u16::MAX)) } else { 0 };
            return vec![String::new(); n_strings];
        }
        self.data
            .chunks(length)
            .map(|text| {
                let end =
                    text.iter().rposition(|b| !matches!(b, b' ' | 0)).map_or(0, |last| last + 1);
                decode(text.get(..end).unwrap_or(text))
            })
            .collect()
    }
}

impl Parameters {
    /// The id of a group by its name, in any case.
    pub(super) fn group_id(&self, name: &str) -> Option<u8> {
        let found =
            self.groups.iter().find(|group| group.name.eq_ignore_ascii_case(name.as_bytes()))?;
        Some(found.id)
    }

    /// A parameter by group and name, in any case.
    pub(super) fn get(&self, group: &str, name: &str) -> Option<&Parameter> {
        let id = self.group_id(group)?;
        self.parameters
            .iter()
            .find(|p| p.group == id && p.name.eq_ignore_ascii_case(name.as_bytes()))
    }

    /// The first value of a parameter as a number.
    pub(super) fn number(&self, group: &str, name: &str) -> Option<f64> {
        self.get(group, name)?.numbers().first().copied()
    }

    /// The first text of a parameter.
    pub(super) fn text(&self, group: &str, name: &str) -> Option<String> {
        self.get(group, name)?.texts().into_iter().next()
    }

    /// The texts of a parameter and of those that go on where it is full: NAME, NAME2, NAME3...
    pub(super) fn texts(&self, group: &str, name: &str) -> Vec<String> {
        let mut texts = self.get(group, name).map(Parameter::texts).unwrap_or_default();
        for more in 2..=u8::MAX {
            let Some(parameter) = self.get(group, &format!("{name}{more}")) else { break };
            if texts.len() > usize::from(u16::MAX) {
                break; // More than a frame can have points: texts of length 0 take no bytes.
            }
            texts.extend(parameter.texts());
        }
        texts
    }

    /// Reads the records of a section, as far as they make sense. `section` begins at the first record.
    pub(super) fn parse(section: &[u8], order: ByteOrder, warnings: &mut Vec<String>) -> Self {
        let mut parameters = Self::default();
        let mut at = 0;
        loop {
            let Some(record) = Record::parse(section, at, order) else {
                if section.get(at).is_none_or(|&length| length != 0) {
                    warnings.push(format!(
                        "The parameter section breaks off after {} groups and {} parameters, at its byte {}.",
                        parameters.groups.len(),
                        parameters.parameters.len(),
                        at + 4
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

/// A record of the section: a group or a parameter, not looked into yet.
struct Record<'a> {
    id: i8,
    locked: bool,
    name: &'a [u8],
    body: &'a [u8],
    next: Option<usize>,
}

impl<'a> Record<'a> {
    /// The record at `at`; `None` at the end of the list and where there cannot be a record.
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

    /// Adds the record to what was read before it.
    fn read_into(&self, to: &mut Parameters, order: ByteOrder, warnings: &mut Vec<String>) {
        if self.id < 0 {
            to.groups.push(Group {
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

    /// The parameter in the body, and what is wrong with it.
    fn parameter(&self, order: ByteOrder) -> Result<(Parameter, Option<String>), String> {
        let (kind, rest) = self.body.split_first().ok_or("it is empty")?;
        let kind = i8::from_le_bytes([*kind]);
        let width = match kind {
            -1 | 1 => 1,
            2 => 2,
            4 => 4,
            other => return Err(format!("its type is {other}, expected -1, 1, 2 or 4")),
        };
        let (n_dimensions, rest) = rest.split_first().ok_or("it has no dimensions")?;
        let (dimensions, rest) = rest
            .split_at_checked(usize::from(*n_dimensions))
            .ok_or("its dimensions are cut off")?;
        let mut dimensions = dimensions.to_vec();
        let announced =
            dimensions.iter().fold(width, |n: usize, &d| n.saturating_mul(usize::from(d)));
        let (data, after, mut wrong) = match rest.split_at_checked(announced) {
            Some((data, after)) => (data, after, None),
            None => {
                let whole = rest.get(..rest.len() / width * width).unwrap_or(rest);
                let wrong = format!("{announced} bytes announced, {} present", rest.len());
                dimensions = vec![(whole.len() / width).min(255) as u8];
                let kept = usize::from(dimensions.first().copied().unwrap_or(0)) * width;
                (whole.get(..kept).unwrap_or(whole), &[][..], Some(wrong))
            }
        };
        let description = description(after).map(<[u8]>::to_vec);
        if description.is_none() && wrong.is_none() {
            wrong = Some("the byte with the length of its description is missing".to_owned());
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

/// A length byte and that many bytes, or what is there of them.
fn description(bytes: &[u8]) -> Option<&[u8]> {
    let (length, text) = bytes.split_first()?;
    Some(text.get(..usize::from(*length)).unwrap_or(text))
}

/// Parameter values in Intel order.
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
