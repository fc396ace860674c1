//! Ctrl-C, and other signals that end a program; and a second one.

use std::{
    fs,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use anyhow::Context;
use mocapd_acquire::threads;
use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM},
    flag,
    iterator::Signals,
};

/// `timeout` and service managers signal a process and its group, which is the same signal twice: one that comes so soon
/// is no second wish.
const SAME_WITHIN: Duration = Duration::from_millis(500);

/// Exit code of a program that was ended at once: what it was doing failed.
const ENDED_AT_ONCE: i32 = 1;

/// Signals that end a program: Ctrl-C, a service manager's, Ctrl-\\, and that of a terminal or an SSH connection that was
/// closed. Under `nohup` the last is ignored, and stays so.
fn ending_signals() -> Vec<i32> {
    let mut signals = vec![SIGINT, SIGTERM, SIGQUIT];
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    if !is_ignored(&status, SIGHUP) {
        signals.push(SIGHUP);
    }
    signals
}

/// Whether a process with this `/proc/PID/status` ignores a signal.
fn is_ignored(status: &str, signal: i32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// Set by the first signal that ends programs; a second one ends the process at once, unless it comes within half a second.
pub(crate) fn stop_on_signal() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let watching = || "cannot watch for Ctrl-C";
    let signals = ending_signals();
    for &signal in &signals {
        flag::register(signal, Arc::clone(&stop)).with_context(watching)?;
    }
    let mut signals = Signals::new(signals).with_context(watching)?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_ignored_is_known() {
        // As the kernel has it under `nohup`.
        let status = "Name:\tmocapd\nSigBlk:\t0000000000000000\nSigIgn:\t0000000000001001\n";
        assert!(is_ignored(status, SIGHUP));
        assert!(!is_ignored(status, SIGTERM));
        assert!(!is_ignored("", SIGHUP));
    }
}
