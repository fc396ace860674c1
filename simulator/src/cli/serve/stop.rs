//! Ctrl-C, and a second one.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use signal_hook::consts::TERM_SIGNALS;
use signal_hook::flag;
use signal_hook::iterator::Signals;

use crate::cli::Failure;

/// `timeout` and service managers signal a process and its group, which is the same signal twice: one that comes so soon
/// is no second wish.
const SAME_WITHIN: Duration = Duration::from_millis(500);

/// Exit code of a program that was ended at once: 128 and the number of Ctrl-C, as shells have it.
const ENDED_AT_ONCE: i32 = 130;

/// Set by the first signal that ends programs. A later one ends this one at once, should the first not.
pub(super) fn on_signal() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in TERM_SIGNALS {
        flag::register(*signal, Arc::clone(&stop))?;
    }
    let mut signals = Signals::new(TERM_SIGNALS)?;
    let stopped = Arc::clone(&stop);
    let watch = move || {
        let mut first: Option<Instant> = None;
        for _ in signals.forever() {
            stopped.store(true, Ordering::Relaxed);
            if first.get_or_insert_with(Instant::now).elapsed() > SAME_WITHIN {
                signal_hook::low_level::exit(ENDED_AT_ONCE);
            }
        }
    };
    std::thread::Builder::new()
        .name("mocapd-signal".to_owned())
        .spawn(watch)
        .context("cannot watch for Ctrl-C")?;
    Ok(stop)
}
