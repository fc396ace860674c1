//! The file as written: its values by key, and what is no key of ours.

use std::collections::BTreeMap;

use toml::{
    Spanned,
    de::{DeString, DeTable, DeValue},
};

use super::{
    keys::{KEYS, SECTIONS},
    problem::{Place, Problem},
    value::{Entry, short},
};

/// The values of a file by their keys' paths.
#[derive(Debug, Default)]
pub(super) struct Written {
    pub(super) entries: BTreeMap<&'static str, Entry>,
    pub(super) problems: Vec<Problem>,
    /// Whether it is no TOML: what is missing in it may well be there.
    pub(super) is_broken: bool,
}

impl Written {
    /// Reads a text. Where its TOML is broken, that is all that is told: what follows from it would be guessed.
    pub(super) fn read(text: &str) -> Self {
        let place = |byte: usize| place(text, byte);
        let (document, errors) = DeTable::parse_recoverable(text);
        let mut written = Self::default();
        for error in &errors {
            let at = error.span().map_or(0, |span| span.start);
            let message = format!("{}{}", one_line(error.message()), hint(text, at));
            written.problems.push(Problem { place: place(at), key: None, message });
        }
        written.is_broken = !errors.is_empty();
        if !written.is_broken {
            for (name, value) in document.get_ref() {
                written.section(name, value, &place);
            }
        }
        written
    }

    fn section(
        &mut self,
        name: &Spanned<DeString<'_>>,
        value: &Spanned<DeValue<'_>>,
        place: &dyn Fn(usize) -> Place,
    ) {
        let word = name.get_ref().as_ref();
        let at = place(name.span().start);
        let known = SECTIONS.iter().map(|(section, _)| *section);
        let Some(section) = known.clone().find(|section| *section == word) else {
            let message = match of_section(word) {
                Some(section) => format!("'{word}' stands in no section: put it under [{section}]"),
                None => format!("unknown section [{}]: {}", short(word), meant(word, known)),
            };
            self.problems.push(Problem { place: at, key: None, message });
            return;
        };
        let Some(table) = value.get_ref().as_table() else {
            let found = Entry::of(value, place).value.found();
            let message = format!("{section} is {found}: write [{section}] above its keys");
            self.problems.push(Problem { place: at, key: None, message });
            return;
        };
        for (name, value) in table {
            let word = name.get_ref().as_ref();
            let here = KEYS.iter().filter(|key| key.section() == section);
            match here.clone().find(|key| key.name() == word) {
                Some(key) => {
                    self.entries.insert(key.path, Entry::of(value, place));
                }
                None => {
                    let message = match of_section(word) {
                        Some(other) => {
                            format!("'{word}' is no key of [{section}]: it stands in [{other}]")
                        }
                        None => format!(
                            "unknown key '{}' in [{section}]: {}",
                            short(word),
                            meant(word, here.map(|key| key.name()))
                        ),
                    };
                    let place = place(name.span().start);
                    self.problems.push(Problem { place, key: None, message });
                }
            }
        }
    }
}

/// The section of a key that was written elsewhere.
fn of_section(word: &str) -> Option<&'static str> {
    KEYS.iter().find(|key| key.name() == word).map(|key| key.section())
}

/// What was probably meant, or all that there is.
pub(super) fn meant(word: &str, known: impl Iterator<Item = &'static str> + Clone) -> String {
    suggestion(word, known.clone())
        .unwrap_or_else(|| format!("there are {}", known.collect::<Vec<_>>().join(", ")))
}

/// What was probably meant, when one is near.
pub(super) fn suggestion(word: &str, known: impl Iterator<Item = &'static str>) -> Option<String> {
    nearest(word, known).map(|name| format!("did you mean '{name}'?"))
}

/// A word that is compared with ours: longer ones are none of them.
const WORD_BYTES_MAX: usize = 64;

/// The known word that is meant, when one is near: at most two letters away, a third of a long word, or
/// `warning` for `warn`.
fn nearest(word: &str, known: impl Iterator<Item = &'static str>) -> Option<&'static str> {
    if word.len() > WORD_BYTES_MAX {
        return None;
    }
    let word = word.to_lowercase();
    let away = |name: &str| match word.strip_prefix(name) {
        Some(_) if name.len() > 2 => 1,
        _ => strsim::osa_distance(&word, name),
    };
    known
        .map(|name| (away(name), name))
        .filter(|(away, name)| *away <= 2.max(name.len() / 3))
        .min_by_key(|(away, _)| *away)
        .map(|(_, name)| name)
}

/// Line and column of a byte, from 1.
pub(super) fn place(text: &str, byte: usize) -> Place {
    let before = text.get(..byte).unwrap_or(text);
    let line_start = before.rfind('\n').map_or(0, |at| at + 1);
    let line = 1 + before.bytes().filter(|byte| *byte == b'\n').count();
    Place::At { line, column: 1 + before[line_start..].chars().count() }
}

fn one_line(message: &str) -> String {
    message.lines().collect::<Vec<_>>().join(", ")
}

/// For what people write most often: `pre_roll = 10s`, a value with a unit and without quotes.
fn hint(text: &str, byte: usize) -> &'static str {
    let start = text.get(..byte).and_then(|before| before.rfind('\n')).map_or(0, |at| at + 1);
    let line = text.get(start..).unwrap_or_default().lines().next().unwrap_or_default();
    let value = line.split_once('=').map_or("", |(_, value)| value.trim_start());
    let quoted = value.starts_with(['"', '\'', '[', '{']);
    let is_bare = !quoted && value.contains(|c: char| c.is_alphanumeric() || c == '/');
    if is_bare { "; texts, and values with a unit, stand in quotes, such as \"10s\"" } else { "" }
}
