//! Stops the program on Ctrl-C or SIGTERM, and ends it at once on a second signal.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use signal_hook::consts::TERM_SIGNALS;
use signal_hook::flag;
use signal_hook::iterator::Signals;

use crate::cli::Failure;

/// Signals within this time count as one: `timeout` and service managers signal a process and then its group.
const SAME_WITHIN: Duration = Duration::from_millis(500);

/// Exit code after a second signal: 128 plus the number of SIGINT, as in shells.
const ENDED_AT_ONCE: i32 = 130;

/// Returns a flag that the first termination signal sets. A later signal ends the program at once, in case it hangs.
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
