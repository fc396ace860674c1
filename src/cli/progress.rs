//! A bar for anything that takes more than a second, when somebody watches.

use std::{
    io::IsTerminal,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

use indicatif::{ProgressBar, ProgressStyle};
use mocapd_acquire::threads;
use mocapd_take::escape::visible;

/// Follows a counter from a thread of its own until it is dropped.
#[derive(Debug)]
pub(crate) struct Progress {
    done: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Time before a bar appears, and between its steps.
const STEP: Duration = Duration::from_millis(100);
const APPEARS_AFTER_STEPS: u32 = 10;

impl Progress {
    /// Shows `counter` on its way to `total`.
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

    /// Shows a line that `words` makes, for what has no known end.
    pub(crate) fn status(words: impl Fn() -> String + Send + 'static) -> Self {
        Self::start(ProgressBar::new_spinner, move |bar| {
            bar.set_message(visible(&words()).into_owned());
            bar.tick();
        })
    }

    fn start(
        make: impl Fn() -> ProgressBar + Send + 'static,
        update: impl Fn(&ProgressBar) + Send + 'static,
    ) -> Self {
        let done = Arc::new(AtomicBool::new(false));
        if !std::io::stderr().is_terminal() {
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
        // Without a thread there is no bar; the work goes on.
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
