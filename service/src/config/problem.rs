//! What is wrong with a configuration: every thing at once, each with its place and what to write.

use std::path::PathBuf;

/// Problems that are told at once: more help nobody.
pub const PROBLEMS_MAX: usize = 20;

/// Where a value stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Place {
    /// In the file, both from 1; columns count characters.
    At {
        /// The line.
        line: usize,
        /// The first character.
        column: usize,
    },
    /// On the command line, behind this option.
    Option(&'static str),
    /// Nowhere: it is a default, or left out.
    Nowhere,
}

/// One thing that is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// Where.
    pub place: Place,
    /// Of which key, such as `arm.pre_roll`; `None` for what is no key.
    pub key: Option<&'static str>,
    /// What was found, what is expected, and what to write.
    pub message: String,
}

/// Why there is no configuration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file is not there.
    #[error("{} does not exist: write one with `mocapd config example > {}`", .0.display(), .0.display())]
    NotFound(PathBuf),
    /// It cannot be read.
    #[error("cannot read {}: {error}", .file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Why; it is in the message, and so no source of its own.
        error: std::io::Error,
    },
    /// Something in it cannot be meant.
    #[error("{}", on_one_line(.name, .problems, *.more))]
    Refused {
        /// What the file is called.
        name: String,
        /// What is wrong, in the order of the file: at least one, at most [`PROBLEMS_MAX`].
        problems: Vec<Problem>,
        /// How many more there are.
        more: usize,
    },
}

impl ConfigError {
    /// One line for each thing that is wrong, with the file's name.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        match self {
            Self::Refused { name, problems, more } => {
                let mut lines: Vec<_> = problems.iter().map(|problem| problem.line(name)).collect();
                if *more > 0 {
                    lines.push(format!("{name}: and {more} more"));
                }
                lines
            }
            other => vec![other.to_string()],
        }
    }
}

impl Problem {
    /// One line that says where and what.
    #[must_use]
    pub fn line(&self, name: &str) -> String {
        let message = &self.message;
        match self.place {
            Place::At { line, column } => format!("{name} line {line}, column {column}: {message}"),
            Place::Option(option) => format!("{option}: {message}"),
            Place::Nowhere => format!("{name}: {message}"),
        }
    }
}

/// All of it on one line, for who prints an error as one.
fn on_one_line(name: &str, problems: &[Problem], more: usize) -> String {
    let first = problems.first().map(|problem| problem.line(name)).unwrap_or_default();
    match problems.len().saturating_sub(1) + more {
        0 => first,
        n => format!("{first}; and {n} more: see `mocapd config check`"),
    }
}

impl Place {
    /// Line and column of a byte of a text.
    pub(super) fn of_byte(text: &str, byte: usize) -> Self {
        let before = text.get(..byte).unwrap_or(text);
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        let line = 1 + before.bytes().filter(|byte| *byte == b'\n').count();
        Self::At { line, column: 1 + before[line_start..].chars().count() }
    }
}

/// Letters of a found text that a message repeats.
const SHOWN_MAX: usize = 60;

/// A text of anybody in a message: on its line, and no longer than a message bears.
pub(crate) fn short(text: &str) -> String {
    let mut shown: String = text.chars().take(SHOWN_MAX).flat_map(char::escape_debug).collect();
    if text.chars().nth(SHOWN_MAX).is_some() {
        shown.push_str("...");
    }
    shown
}

/// What was probably meant, or all that there is.
pub(super) fn meant(word: &str, known: impl Iterator<Item = &'static str> + Clone) -> String {
    suggestion(word, known.clone())
        .unwrap_or_else(|| format!("there are {}", known.collect::<Vec<_>>().join(", ")))
}

/// A word that is compared with ours: longer ones are none of them.
const WORD_BYTES_MAX: usize = 64;

/// What was probably meant, when one is near: at most two letters away, a third of a long word, or `warning` for `warn`.
pub(super) fn suggestion(word: &str, known: impl Iterator<Item = &'static str>) -> Option<String> {
    if word.len() > WORD_BYTES_MAX {
        return None;
    }
    let word = word.to_lowercase();
    let away = |name: &str| match word.strip_prefix(name) {
        Some(_) if name.len() > 2 => 1,
        _ => strsim::osa_distance(&word, name),
    };
    let (_, name) = known
        .map(|name| (away(name), name))
        .filter(|(away, name)| *away <= 2.max(name.len() / 3))
        .min_by_key(|(away, _)| *away)?;
    Some(format!("did you mean '{name}'?"))
}
