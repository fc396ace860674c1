//! Printing: data goes to standard output, messages to standard error, escaped so that no text from a file controls the
//! terminal.

use std::{
    io::{self, IsTerminal, Write},
    time::{Duration, Instant},
};

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
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

/// Prints data for programs on stdout, unescaped. A closed pipe (`| head`) is not an error.
pub(super) fn print_exact(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("cannot write to standard output"),
    }
}

/// Work shorter than this shows no display.
const APPEARS_AFTER: Duration = Duration::from_secs(1);

/// A bar on stderr with the percentage and the time left, like those of `mocapd`. Nothing where stderr is not a
/// terminal.
#[derive(Debug)]
pub(super) struct ProgressDisplay {
    message: &'static str,
    total: u64,
    begun: Instant,
    is_shown: bool,
    bar: Option<ProgressBar>,
}

impl ProgressDisplay {
    pub(super) fn new(message: &'static str, total: u64) -> Self {
        let is_shown = io::stderr().is_terminal();
        Self { message, total, begun: Instant::now(), is_shown, bar: None }
    }

    /// Shows how much is done. Call it several times a second, so that the time left is current.
    pub(super) fn update(&mut self, done: u64) {
        if !self.is_shown || self.begun.elapsed() < APPEARS_AFTER {
            return;
        }
        let bar = self.bar.get_or_insert_with(|| {
            let bar = ProgressBar::new(self.total)
                .with_message(self.message)
                .with_elapsed(self.begun.elapsed());
            match ProgressStyle::with_template("{msg} {wide_bar} {percent} % {eta}") {
                Ok(style) => bar.with_style(style),
                Err(_) => bar,
            }
        });
        bar.set_position(done);
    }
}

impl Drop for ProgressDisplay {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
