//! Printing: data goes to standard output, messages to standard error. Everything meant for people is escaped here, so
//! that no text from a file or device controls the terminal.

use std::{
    borrow::Cow,
    io::{self, IsTerminal, Write},
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use mocapd_acquire::threads;
use mocapd_take::escape::{visible, visible_json, visible_lines};
use serde::Serialize;

/// Prints a one-line message on stderr, with the program's name before it.
pub(crate) fn notify(line: &str) {
    // A closed stderr is no reason to fail.
    writeln!(io::stderr(), "mocapd: {}", plain(line)).ok();
}

/// Prints lines for people on stderr: a table, when stdout carries data.
pub(crate) fn eprint(text: &str) {
    io::stderr().write_all(visible_lines(text).as_bytes()).ok();
}

/// Prints lines for people on stdout. Pass values from outside through [`plain`] first: this function keeps line ends.
pub(crate) fn print(text: &str) -> anyhow::Result<()> {
    print_exact(&visible_lines(text))
}

/// Prints data for programs on stdout, unescaped; for JSON use [`print_json_text`]. A closed pipe (`| head`) is no
/// error.
pub(crate) fn print_exact(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("cannot write to standard output"),
    }
}

/// Prints a value as one indented JSON document and a line end on stdout.
pub(crate) fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    print_json_text(&serde_json::to_string_pretty(value)?)
}

/// Prints JSON text and a line end on stdout, escaped for a terminal.
pub(crate) fn print_json_text(text: &str) -> anyhow::Result<()> {
    print_exact(&format!("{}\n", visible_json(text.trim_end_matches('\n'))))
}

/// Escapes text from a file, a device or the system: one line, without terminal control characters.
pub(crate) fn plain(text: &str) -> Cow<'_, str> {
    visible(text.trim_end())
}

/// A path on one line, escaped as by [`plain`].
pub(crate) fn plain_path(path: &Path) -> String {
    visible(&path.to_string_lossy()).into_owned()
}

/// A progress display on stderr, updated by its own thread until dropped; nothing if stderr is no terminal.
#[derive(Debug)]
pub(crate) struct Progress {
    done: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Refresh interval of a progress display.
const STEP: Duration = Duration::from_millis(100);
/// Refreshes before it appears (1 s), so that quick commands show none.
const APPEARS_AFTER_STEPS: u32 = 10;

impl Progress {
    /// Shows a bar of `counter` towards `total`.
    pub(crate) fn follow(what: &'static str, counter: &Arc<AtomicU64>, total: u64) -> Self {
        let counter = Arc::clone(counter);
        let style = ProgressStyle::with_template("{msg} {wide_bar} {percent} % {eta}");
        Self::start(
            move || {
                let bar = ProgressBar::new(total).with_message(what);
                if let Ok(style) = &style { bar.with_style(style.clone()) } else { bar }
            },
            move |bar| bar.set_position(counter.load(Ordering::Relaxed)),
        )
    }

    /// Shows a spinner and the current value of `text`, for work without a known end.
    pub(crate) fn status(text: impl Fn() -> String + Send + 'static) -> Self {
        Self::start(ProgressBar::new_spinner, move |bar| {
            bar.set_message(visible(&text()).into_owned());
            bar.tick();
        })
    }

    fn start(
        make: impl Fn() -> ProgressBar + Send + 'static,
        update: impl Fn(&ProgressBar) + Send + 'static,
    ) -> Self {
        let done = Arc::new(AtomicBool::new(false));
        if !io::stderr().is_terminal() {
            return Self { done, thread: None };
        }
        let stop = Arc::clone(&done);
        let thread = threads::spawn("mocapd-progress", move || {
            let mut bar = None;
            for step in 0_u32.. {
                std::thread::park_timeout(STEP);
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                if step == APPEARS_AFTER_STEPS {
                    bar = Some(make());
                }
                if let Some(bar) = &bar {
                    update(bar);
                }
            }
            if let Some(bar) = bar {
                bar.finish_and_clear();
            }
        });
        // If no thread can be started there is no display; the work goes on.
        Self { done, thread: thread.ok() }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.done.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            thread.join().ok();
        }
    }
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
