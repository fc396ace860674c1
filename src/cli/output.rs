//! Printing: data goes to standard output, messages to standard error. Everything meant for people is escaped here, so
//! that no text from a file or device controls the terminal.

use std::{
    borrow::Cow,
    fs::File,
    io::{self, IsTerminal, Seek, SeekFrom, Write},
    path::Path,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
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

/// Copies a whole file to stdout.
///
/// # Errors
/// If it cannot be read or written. A closed pipe (`| head`) is not an error.
pub(crate) fn copy_to_stdout(mut file: &File) -> io::Result<()> {
    file.seek(SeekFrom::Start(0))?;
    let mut stdout = io::stdout().lock();
    match io::copy(&mut file, &mut stdout).and_then(|_| stdout.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

/// Prints a value as one indented JSON document and a line end on stdout.
pub(crate) fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    print_json_text(&pretty_json(value)?)
}

/// A value as an indented JSON document.
pub(crate) fn pretty_json(value: &impl Serialize) -> anyhow::Result<String> {
    Ok(serde_json::to_string_pretty(value)?)
}

/// A value as JSON on one line.
pub(crate) fn json_line(value: &impl Serialize) -> anyhow::Result<String> {
    Ok(serde_json::to_string(value)?)
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

/// A progress display on stderr, updated by its own thread until dropped; nothing if stderr is not a terminal.
#[derive(Debug)]
pub(crate) struct Progress {
    done: Arc<AtomicBool>,
    /// The display, once it has appeared.
    bar: Arc<Mutex<Option<ProgressBar>>>,
    thread: Option<JoinHandle<()>>,
}

/// Refresh interval of a progress display.
const STEP: Duration = Duration::from_millis(100);
/// Refreshes before it appears (1 s), so that quick commands show none.
const APPEARS_AFTER_STEPS: u32 = 10;
/// Steps of a display of shares.
const SHARE_STEPS: u64 = 10_000;

impl Progress {
    /// Shows a bar of `counter` towards `total`.
    pub(crate) fn follow(what: &'static str, counter: &Arc<AtomicU64>, total: u64) -> Self {
        let counter = Arc::clone(counter);
        Self::start(
            move || bar(total).with_message(what),
            move |bar| bar.set_position(counter.load(Ordering::Relaxed)),
        )
    }

    /// Shows a bar of `share`, 0 to 1, next to the current value of `text`.
    pub(crate) fn share(
        text: impl Fn() -> String + Send + 'static,
        share: impl Fn() -> f64 + Send + 'static,
    ) -> Self {
        Self::start(
            || bar(SHARE_STEPS),
            move |bar| {
                bar.set_message(visible(&text()).into_owned());
                bar.set_position((share() * SHARE_STEPS as f64) as u64);
            },
        )
    }

    /// Shows a spinner and the current value of `text`, for work without a known end.
    pub(crate) fn status(text: impl Fn() -> String + Send + 'static) -> Self {
        Self::start(ProgressBar::new_spinner, move |bar| {
            bar.set_message(visible(&text()).into_owned());
            bar.tick();
        })
    }

    /// Prints with the display out of the way.
    pub(crate) fn suspend<T>(&self, print: impl FnOnce() -> T) -> T {
        match &*locked(&self.bar) {
            Some(bar) => bar.suspend(print),
            None => print(),
        }
    }

    fn start(
        make: impl Fn() -> ProgressBar + Send + 'static,
        update: impl Fn(&ProgressBar) + Send + 'static,
    ) -> Self {
        let (done, bar) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(None)));
        if !io::stderr().is_terminal() {
            return Self { done, bar, thread: None };
        }
        let (stop, shown) = (Arc::clone(&done), Arc::clone(&bar));
        let thread = threads::spawn("mocapd-progress", move || {
            for step in 0_u32.. {
                std::thread::park_timeout(STEP);
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                let mut shown = locked(&shown);
                if step == APPEARS_AFTER_STEPS {
                    *shown = Some(make());
                }
                if let Some(bar) = &*shown {
                    update(bar);
                }
            }
            if let Some(bar) = locked(&shown).take() {
                bar.finish_and_clear();
            }
        });
        // If no thread can be started there is no display; the work continues.
        Self { done, bar, thread: thread.ok() }
    }
}

/// A bar of `total` steps, with its percentage and the time that is left.
fn bar(total: u64) -> ProgressBar {
    let bar = ProgressBar::new(total);
    match ProgressStyle::with_template("{msg} {wide_bar} {percent} % {eta}") {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}

fn locked<T>(shown: &Mutex<T>) -> MutexGuard<'_, T> {
    shown.lock().unwrap_or_else(PoisonError::into_inner)
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
