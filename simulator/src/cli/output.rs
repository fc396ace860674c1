//! Printing: data goes to standard output, messages to standard error, escaped so that no text from a file controls the
//! terminal.

use std::io::{self, Write};

use anyhow::Context;
use mocapd_take::escape::{visible, visible_json, visible_lines};
use serde::Serialize;

/// Prints a one-line message on stderr, with the program's name before it.
pub(crate) fn notify(line: &str) {
    // A closed stderr is no reason to fail.
    drop(writeln!(io::stderr(), "mocapd-sim: {}", visible(line.trim_end())));
}

/// Prints lines for people on stdout.
pub(super) fn print(text: &str) -> anyhow::Result<()> {
    print_exact(&visible_lines(text))
}

/// Prints a value as one indented JSON document and a line end on stdout.
pub(super) fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    print_exact(&format!("{}\n", visible_json(&serde_json::to_string_pretty(value)?)))
}

/// Prints a value as a JSON document on one line: one of several documents.
pub(super) fn print_json_line(value: &impl Serialize) -> anyhow::Result<()> {
    print_exact(&format!("{}\n", visible_json(&serde_json::to_string(value)?)))
}

/// Prints data for programs on stdout, unescaped. A closed pipe (`| head`) is no error.
pub(super) fn print_exact(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("cannot write to standard output"),
    }
}
