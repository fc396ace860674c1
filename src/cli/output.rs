//! What is printed: data on stdout, messages on stderr. Text for people is escaped here, in one place.

use std::{
    borrow::Cow,
    io::{self, Write},
    path::Path,
};

use anyhow::Context;
use mocapd_take::escape::{visible, visible_lines};
use serde::Serialize;

/// One line of words, on stderr.
pub(crate) fn say(line: &str) {
    // Nobody to tell when stderr is closed.
    writeln!(io::stderr(), "mocapd: {}", plain(line)).ok();
}

/// Lines for people on stderr: a table whose place on stdout is taken by data.
pub(crate) fn tell(text: &str) {
    io::stderr().write_all(visible_lines(text).as_bytes()).ok();
}

/// Lines for people, on stdout. A value in them that comes from outside is made [`plain`] by itself, since a line end in
/// it would stay.
pub(crate) fn print(text: &str) -> anyhow::Result<()> {
    print_exact(&visible_lines(text))
}

/// Data for programs, on stdout, as it is. A reader that has seen enough (`| head`) is no failure.
pub(crate) fn print_exact(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("cannot write to standard output"),
    }
}

/// One JSON document and a line end, on stdout.
pub(crate) fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    print_exact(&(serde_json::to_string_pretty(value)? + "\n"))
}

/// A text from a file, a device or the system on one line, with nothing that a terminal would obey.
pub(crate) fn plain(text: &str) -> Cow<'_, str> {
    visible(text.trim_end())
}

/// A file's name on one line, as [`plain`] makes it.
pub(crate) fn shown(path: &Path) -> String {
    visible(&path.to_string_lossy()).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hostile_label_stays_on_its_line() {
        assert_eq!(plain("l_knee"), "l_knee");
        assert_eq!(plain("knie é"), "knie é");
        assert_eq!(plain("a\nb\x1b[2Jc\n"), "a\\nb\\u{1b}[2Jc");
    }
}
