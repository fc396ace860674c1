//! Parameters -> bytes, and the parameters of a file to be written.

use super::events::{EVENT, Entry};
use super::parameters::{Group, Parameter, Parameters};
use crate::interchange::turn::Turn;
use crate::motion::UpAxis;

/// Most strings that one dimension counts.
const MAX_STRINGS: usize = 255;
/// Most bytes of one parameter's data: with name, dimensions and description its record stays within a signed word.
const MAX_DATA: usize = 32_000;

/// Appends the records of all groups and parameters, each group before its parameters, and the end mark.
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

/// A record's length of name (negative when locked), id, and name.
fn encode_name(name: &[u8], locked: bool, id: i8, out: &mut Vec<u8>) {
    let name = name.get(..127).unwrap_or(name);
    let length = name.len() as i8;
    out.extend((if locked { -length } else { length }).to_le_bytes());
    out.extend(id.to_le_bytes());
    out.extend(name);
}

/// A description's length and text.
fn encode_description(text: &[u8], out: &mut Vec<u8>) {
    let text = text.get(..255).unwrap_or(text);
    out.push(text.len() as u8);
    out.extend(text);
}

fn encode_group(group: &Group, out: &mut Vec<u8>) {
    // A group 128 is -128 in the file.
    encode_name(&group.name, group.locked, (group.id as i8).wrapping_neg(), out);
    out.extend((group.description.len().min(255) as u16 + 3).to_le_bytes());
    encode_description(&group.description, out);
}

fn encode_parameter(parameter: &Parameter, out: &mut Vec<u8>) {
    let body = 4
        + parameter.dimensions.len()
        + parameter.data.len()
        + 1
        + parameter.description.len().min(255);
    // Only a last record without an offset can have been longer than an offset can say: it is the last again.
    let offset = u16::try_from(body).unwrap_or(0);
    encode_name(&parameter.name, parameter.locked, parameter.group as i8, out);
    out.extend(offset.to_le_bytes());
    out.extend(parameter.kind.to_le_bytes());
    out.push(parameter.dimensions.len().min(255) as u8);
    out.extend(&parameter.dimensions);
    out.extend(&parameter.data);
    encode_description(&parameter.description, out);
}

impl Parameters {
    /// The id of a group, which is made when there is none; `None` when all ids are taken.
    fn group_or_new(&mut self, name: &str) -> Option<u8> {
        if let Some(id) = self.group_id(name) {
            return Some(id);
        }
        let taken = |id: u8| {
            self.groups.iter().any(|group| group.id == id)
                || self.parameters.iter().any(|p| p.group == id)
        };
        let id = (1..=127).find(|&id| !taken(id))?;
        self.groups.push(Group {
            id,
            name: name.as_bytes().to_vec(),
            locked: false,
            description: Vec::new(),
        });
        Some(id)
    }

    /// Sets a parameter's values: in place where it exists, else at the end.
    fn set(&mut self, group: &str, name: &str, kind: i8, dimensions: Vec<u8>, data: Vec<u8>) {
        let Some(id) = self.group_or_new(group) else { return };
        let found = self
            .parameters
            .iter_mut()
            .find(|p| p.group == id && p.name.eq_ignore_ascii_case(name.as_bytes()));
        if let Some(parameter) = found {
            (parameter.kind, parameter.dimensions, parameter.data) = (kind, dimensions, data);
            return;
        }
        self.parameters.push(Parameter {
            group: id,
            name: name.as_bytes().to_vec(),
            locked: false,
            kind,
            dimensions,
            data,
            description: Vec::new(),
        });
    }

    /// Sets a single word.
    pub(super) fn set_word(&mut self, group: &str, name: &str, value: u16) {
        self.set(group, name, 2, Vec::new(), value.to_le_bytes().to_vec());
    }

    /// Sets a list of at most 255 words.
    pub(super) fn set_words(&mut self, group: &str, name: &str, values: &[u16]) {
        let data = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.set(group, name, 2, vec![values.len().min(255) as u8], data);
    }

    /// Sets a number of 32 bits as two words, the lower one first.
    pub(super) fn set_double_word(&mut self, group: &str, name: &str, value: u32) {
        self.set(group, name, 2, vec![2], value.to_le_bytes().to_vec());
    }

    /// Sets a single float.
    pub(super) fn set_float(&mut self, group: &str, name: &str, value: f32) {
        self.set(group, name, 4, Vec::new(), value.to_le_bytes().to_vec());
    }

    /// Sets a single text.
    pub(super) fn set_text(&mut self, group: &str, name: &str, text: &str) {
        let text = text.as_bytes();
        let text = text.get(..255).unwrap_or(text);
        self.set(group, name, -1, vec![text.len() as u8], text.to_vec());
    }

    /// Sets a list of texts, going on in NAME2, NAME3... where one parameter is full. Lists that say the same
    /// already stay as they are. `Err` with the first text that is too long.
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
        let per_parameter = (MAX_DATA / length).min(MAX_STRINGS);
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

    /// Removes NAME2, NAME3... and, where the list no longer fits, NAME.
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

    /// Turns what is a place in the laboratory: the corners of force plates.
    pub(super) fn turn(&mut self, turn: Turn) {
        self.map_floats("FORCE_PLATFORM", "CORNERS", |floats| {
            let (corners, rest) = floats.as_chunks::<3>();
            corners.iter().flat_map(|&corner| turn.of(corner)).chain(rest.iter().copied()).collect()
        });
    }

    /// Puts as many other floats in the place of a parameter's.
    fn map_floats(&mut self, group: &str, name: &str, map: impl Fn(&[f32]) -> Vec<f32>) {
        let Some(parameter) = self.get(group, name).filter(|p| p.kind == 4) else { return };
        let data = map(&parameter.floats()).into_iter().flat_map(f32::to_le_bytes).collect();
        let dimensions = parameter.dimensions.clone();
        self.set(group, name, 4, dimensions, data);
    }

    /// Sets a list of floats, going on in NAME2, NAME3... where one parameter is full.
    pub(super) fn set_float_list(&mut self, group: &str, name: &str, values: &[f32]) {
        let values: Vec<[u8; 4]> = values.iter().map(|value| value.to_le_bytes()).collect();
        self.set_list(group, name, 4, &values);
    }

    /// The same of words.
    pub(super) fn set_word_list(&mut self, group: &str, name: &str, values: &[u16]) {
        let values: Vec<[u8; 2]> = values.iter().map(|value| value.to_le_bytes()).collect();
        self.set_list(group, name, 2, &values);
    }

    fn set_list<const N: usize>(&mut self, group: &str, name: &str, kind: i8, values: &[[u8; N]]) {
        for (index, some) in values.chunks(MAX_STRINGS).enumerate() {
            let name = if index == 0 { name.to_owned() } else { format!("{name}{}", index + 1) };
            self.set(group, &name, kind, vec![some.len() as u8], some.concat());
        }
    }

    /// Adds what readers expect of an ANALOG group when there are no analog samples.
    pub(super) fn set_no_analog(&mut self) {
        self.set_word("ANALOG", "USED", 0);
        for (name, kind, dimensions) in [
            ("LABELS", -1, vec![0, 0]),
            ("DESCRIPTIONS", -1, vec![0, 0]),
            ("UNITS", -1, vec![0, 0]),
            ("SCALE", 4, vec![0]),
            ("OFFSET", 2, vec![0]),
        ] {
            if self.get("ANALOG", name).is_none() {
                self.set("ANALOG", name, kind, dimensions, Vec::new());
            }
        }
        for (name, value) in [("GEN_SCALE", 1.0), ("RATE", 0.0)] {
            if self.get("ANALOG", name).is_none() {
                self.set_float("ANALOG", name, value);
            }
        }
    }

    /// Says who wrote the file, where it does not say who made it.
    pub(super) fn set_manufacturer(&mut self) {
        if self.group_id("MANUFACTURER").is_none() {
            self.set_text("MANUFACTURER", "COMPANY", "mocapd");
            self.set_text("MANUFACTURER", "SOFTWARE", "mocapd");
            self.set_text("MANUFACTURER", "VERSION_LABEL", env!("CARGO_PKG_VERSION"));
        }
    }

    /// Sets the EVENT group: at most 255 events, whose texts together stay within what a parameter holds.
    pub(super) fn set_events(&mut self, entries: &[Entry]) {
        let n = entries.len().min(MAX_STRINGS) as u8;
        // What the group had of its own would stand beside other events.
        if let Some(id) = self.group_id(EVENT) {
            self.parameters.retain(|parameter| parameter.group != id);
        }
        self.set_word(EVENT, "USED", u16::from(n));
        let texts = |text: fn(&Entry) -> &String| entries.iter().map(text).cloned().collect();
        let lists: [(&str, Vec<String>); 4] = [
            ("CONTEXTS", texts(|entry| &entry.context)),
            ("LABELS", texts(|entry| &entry.label)),
            ("DESCRIPTIONS", texts(|entry| &entry.description)),
            ("SUBJECTS", texts(|entry| &entry.subject)),
        ];
        for (name, texts) in &lists {
            // None is longer than what was read or cut.
            self.set_texts(EVENT, name, texts).unwrap_or_default();
        }
        let times = entries.iter().flat_map(|entry| entry.time).flat_map(f32::to_le_bytes);
        self.set(EVENT, "TIMES", 4, vec![2, n], times.collect());
        let icons: Vec<u16> = entries.iter().map(|entry| entry.icon).collect();
        self.set_words(EVENT, "ICON_IDS", &icons);
        let flags = entries.iter().map(|entry| entry.flag).collect();
        self.set(EVENT, "GENERIC_FLAGS", 1, vec![n], flags);
    }

    /// Says which axes point right and up on a screen, where that is known and not said yet, or said otherwise.
    pub(super) fn set_screen(&mut self, up: UpAxis) {
        let (right, up) = match up {
            UpAxis::Unknown => return,
            UpAxis::X => ("+Y", "+X"),
            UpAxis::Y => ("+X", "+Y"),
            UpAxis::Z => ("+X", "+Z"),
        };
        let said = self.text("POINT", "Y_SCREEN").unwrap_or_default();
        if !matches!(said.trim(), said if said.eq_ignore_ascii_case(up) || up.eq_ignore_ascii_case(&format!("+{said}")))
        {
            self.set_text("POINT", "X_SCREEN", right);
            self.set_text("POINT", "Y_SCREEN", up);
        }
    }
}
