//! What is wrong with a configuration: every thing at once, each with its place and what to write.

use std::{fmt, path::PathBuf};

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
    #[error("{}", Refused(.name, .problems, *.more))]
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
struct Refused<'a>(&'a str, &'a [Problem], usize);

impl fmt::Display for Refused<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(name, problems, more) = self;
        if let Some(problem) = problems.first() {
            f.write_str(&problem.line(name))?;
        }
        match problems.len().saturating_sub(1) + more {
            0 => Ok(()),
            n => write!(f, "; and {n} more: see `mocapd config check`"),
        }
    }
}
