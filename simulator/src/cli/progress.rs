//! A progress display for long work.

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Work of less than this shows no display.
const APPEARS_AFTER: Duration = Duration::from_secs(1);

/// A bar on stderr with the percentage and the time left, like those of `mocapd`. Nothing where stderr is no terminal.
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

    /// Shows how much is done. To be called several times a second, so that the time left is current.
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
