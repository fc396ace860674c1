//! What is printed: data on stdout, words on stderr.

use std::{
    borrow::Cow,
    io::{self, Write},
};

use anyhow::Context;
use serde::Serialize;

/// One line of words, on stderr.
pub(crate) fn say(line: &str) {
    // Nobody to tell when stderr is closed.
    writeln!(io::stderr(), "mocapd: {}", plain(line)).ok();
}

/// Lines for people on stderr, as they are: a table whose place on stdout is taken by data.
pub(crate) fn tell(text: &str) {
    io::stderr().write_all(text.as_bytes()).ok();
}

/// Data, on stdout. A reader that has seen enough (`| head`) is no failure.
pub(crate) fn print(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("cannot write to standard output"),
    }
}

/// One JSON document and a line end, on stdout.
pub(crate) fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    print(&(serde_json::to_string_pretty(value)? + "\n"))
}

/// A text from a file, a device or the system on one line, with nothing that a terminal would obey.
pub(crate) fn plain(text: &str) -> Cow<'_, str> {
    if !text.contains(char::is_control) {
        return Cow::Borrowed(text);
    }
    let shown = |c: char| match c {
        '\n' | '\r' | '\t' => ' ',
        c if c.is_control() => char::REPLACEMENT_CHARACTER,
        c => c,
    };
    Cow::Owned(text.trim_end().chars().map(shown).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hostile_label_stays_on_its_line() {
        assert_eq!(plain("l_knee"), "l_knee");
        assert_eq!(plain("knie é"), "knie é");
        assert_eq!(plain("a\nb\x1b[2Jc\n"), "a b\u{fffd}[2Jc");
    }
}
