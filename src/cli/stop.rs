//! Ctrl-C, and a second one.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use anyhow::Context;
use mocapd::threads;
use signal_hook::{
    consts::{SIGINT, SIGTERM},
    flag,
    iterator::Signals,
};

/// `timeout` and service managers signal a process and its group, which is the same signal twice: one that comes so soon
/// is no second wish.
const SAME_WITHIN: Duration = Duration::from_millis(500);

/// Exit code of a program that was ended at once: what it was doing failed.
const ENDED_AT_ONCE: i32 = 1;

/// Set by Ctrl-C or SIGTERM; a second one ends the process at once, unless it comes within half a second.
pub(crate) fn stop_on_signal() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let watching = || "cannot watch for Ctrl-C";
    for signal in [SIGINT, SIGTERM] {
        flag::register(signal, Arc::clone(&stop)).with_context(watching)?;
    }
    let mut signals = Signals::new([SIGINT, SIGTERM]).with_context(watching)?;
    threads::spawn("mocapd-signal", move || {
        let mut first: Option<Instant> = None;
        for _ in signals.forever() {
            stopped.store(true, Ordering::Relaxed);
            if first.get_or_insert_with(Instant::now).elapsed() > SAME_WITHIN {
                signal_hook::low_level::exit(ENDED_AT_ONCE);
            }
        }
    })?;
    Ok(stop)
}
