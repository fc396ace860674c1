//! The problems of a configuration, reported all at once, each with its location and the correction.

use std::path::PathBuf;

/// Maximum number of problems that are reported: more would not help.
pub const PROBLEMS_MAX: usize = 20;

/// The location of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum SourceLocation {
    /// In the file. Line and column count from 1, the column in characters.
    At {
        /// The line.
        line: usize,
        /// The first character.
        column: usize,
    },
    /// On the command line, in this option.
    Option(&'static str),
    /// Nowhere: the value is a default or missing.
    Nowhere,
}

/// One problem of a configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConfigProblem {
    /// The location of the value.
    pub place: SourceLocation,
    /// The key, such as `arm.pre_roll`; `None` if the problem is not about a known key.
    pub key: Option<&'static str>,
    /// What was found, what is expected, and what to write.
    pub message: String,
}

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file does not exist.
    #[error("{} does not exist: write one with `mocapd config example > {}`", .0.display(), .0.display())]
    NotFound(PathBuf),
    /// The file cannot be read.
    #[error("cannot read {}: {error}", .file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The cause. It is part of the message, and therefore not a `source`.
        error: std::io::Error,
    },
    /// The file has problems.
    #[error("{}", on_one_line(.name, .problems, *.more))]
    Refused {
        /// The name of the file.
        name: String,
        /// The problems in the order of the file: at least one, at most [`PROBLEMS_MAX`].
        problems: Vec<ConfigProblem>,
        /// How many problems were left out.
        more: usize,
    },
}

impl ConfigError {
    /// One line per problem, each with the name of the file.
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

impl ConfigProblem {
    /// The problem on one line, with its location.
    #[must_use]
    pub fn line(&self, name: &str) -> String {
        let message = &self.message;
        match self.place {
            SourceLocation::At { line, column } => {
                format!("{name} line {line}, column {column}: {message}")
            }
            SourceLocation::Option(option) => format!("{option}: {message}"),
            SourceLocation::Nowhere => format!("{name}: {message}"),
        }
    }
}

/// The first problem and the number of the others, on one line.
fn on_one_line(name: &str, problems: &[ConfigProblem], more: usize) -> String {
    let first = problems.first().map(|problem| problem.line(name)).unwrap_or_default();
    match problems.len().saturating_sub(1) + more {
        0 => first,
        n => format!("{first}; and {n} more: see `mocapd config check`"),
    }
}

impl SourceLocation {
    /// The line and column of a byte of the text.
    pub(super) fn of_byte(text: &str, byte: usize) -> Self {
        let before = text.get(..byte).unwrap_or(text);
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        let line = 1 + before.bytes().filter(|byte| *byte == b'\n').count();
        Self::At { line, column: 1 + before[line_start..].chars().count() }
    }
}

/// Longest quotation of a value in a message, in characters.
const SHOWN_MAX: usize = 60;

/// Quotes a text in a message: on one line, shortened.
pub(crate) fn excerpt(text: &str) -> String {
    let mut shown: String = text.chars().take(SHOWN_MAX).flat_map(char::escape_debug).collect();
    if text.chars().nth(SHOWN_MAX).is_some() {
        shown.push_str("...");
    }
    shown
}

/// A suggestion for a misspelled name, or the list of valid names.
pub(crate) fn suggestion_or_list(
    word: &str,
    known: impl Iterator<Item = &'static str> + Clone,
) -> String {
    suggestion(word, known.clone())
        .unwrap_or_else(|| format!("expected one of {}", known.collect::<Vec<_>>().join(", ")))
}

/// Longest word in bytes for which a suggestion is searched: no valid name is longer.
const SUGGESTION_BYTES_MAX: usize = 64;

/// The nearest valid name: at most two edits away, or a third of a long name, or a prefix as in `warning` for `warn`.
pub(super) fn suggestion(word: &str, known: impl Iterator<Item = &'static str>) -> Option<String> {
    if word.len() > SUGGESTION_BYTES_MAX {
        return None;
    }
    let word = word.to_lowercase();
    let distance = |name: &str| match word.strip_prefix(name) {
        Some(_) if name.len() > 2 => 1,
        _ => strsim::osa_distance(&word, name),
    };
    let (_, name) = known
        .map(|name| (distance(name), name))
        .filter(|(distance, name)| *distance <= 2.max(name.len() / 3))
        .min_by_key(|(distance, _)| *distance)?;
    Some(format!("did you mean '{name}'?"))
}
