//! Ctrl-C and the other signals that end a program: the first one stops it in order, a second one immediately.

use std::{
    fs,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::Builder,
    time::{Duration, Instant},
};

use anyhow::Context;
use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM},
    flag,
    iterator::Signals,
    low_level,
};

/// `timeout` and service managers signal a process and its group, so that the same signal arrives twice: within this
/// time it counts as one.
const SAME_SIGNAL_WINDOW: Duration = Duration::from_millis(500);

/// Exit code after the second signal: the command failed.
const EXIT_FAILED: i32 = 1;

/// The signals that end a program: Ctrl-C, a service manager's, Ctrl-\\, and that of a closed terminal or SSH
/// connection. `nohup` ignores the last one; it then stays ignored.
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

/// Returns a flag that is set by the first signal that would end the program. A second one ends the process
/// immediately, unless it comes within half a second of the first.
///
/// # Errors
/// If the system refuses the handlers or their thread.
pub fn stop_on_signal() -> anyhow::Result<Arc<AtomicBool>> {
    stop_on_signal_or(|| ())
}

/// Returns a flag like [`stop_on_signal`]. If a second signal ends the process, `clean_up` runs before.
///
/// # Errors
/// If the system refuses the handlers or their thread.
pub fn stop_on_signal_or(
    clean_up: impl FnOnce() + Send + 'static,
) -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let watching = || "cannot watch for Ctrl-C";
    let signals = ending_signals();
    for &signal in &signals {
        flag::register(signal, Arc::clone(&stop)).with_context(watching)?;
    }
    let mut signals = Signals::new(signals).with_context(watching)?;
    let watch = move || {
        let mut first: Option<Instant> = None;
        for _ in signals.forever() {
            stopped.store(true, Ordering::Relaxed);
            if first.get_or_insert_with(Instant::now).elapsed() > SAME_SIGNAL_WINDOW {
                break;
            }
        }
        clean_up();
        low_level::exit(EXIT_FAILED);
    };
    Builder::new().name("mocapd-signal".to_owned()).spawn(watch).with_context(watching)?;
    Ok(stop)
}

/// Ends the program at the first signal that would end it, as without a handler, but runs `clean_up` before and holds
/// its result until the end.
///
/// # Errors
/// If the system refuses the handlers or their thread.
pub fn end_on_signal<T>(clean_up: impl FnOnce() -> T + Send + 'static) -> anyhow::Result<()> {
    let watching = || "cannot watch for Ctrl-C";
    let mut signals = Signals::new(ending_signals()).with_context(watching)?;
    let watch = move || {
        let signal = signals.forever().next();
        let _held = clean_up();
        if let Some(signal) = signal {
            // The shell sees that the signal ended the program.
            low_level::emulate_default_handler(signal).ok();
        }
        low_level::exit(EXIT_FAILED);
    };
    Builder::new().name("mocapd-signal".to_owned()).spawn(watch).with_context(watching)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ignored_signals_are_detected() {
        // The kernel's status of a process under `nohup`.
        let status = "Name:\tmocapd\nSigBlk:\t0000000000000000\nSigIgn:\t0000000000001001\n";
        assert!(is_ignored(status, SIGHUP));
        assert!(!is_ignored(status, SIGTERM));
        assert!(!is_ignored("", SIGHUP));
    }
}
