//! Threads that hang on command: for tests of the watchdog and of stalls, in builds with the feature `fault-hooks` alone.
//!
//! SIGUSR2 hangs the thread that `MOCAPD_HANG` names (`reader`, `worker` or `writer`), and every one of these when it
//! names none. SIGUSR1 lets them go on.

use std::{
    sync::{
        Arc, OnceLock,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use anyhow::Context;
use signal_hook::{
    consts::{SIGUSR1, SIGUSR2},
    flag::register_usize,
};

use crate::heartbeat::Who;

/// How soon a thread goes on after SIGUSR1.
const LOOK_EVERY: Duration = Duration::from_millis(20);

static HANGS: OnceLock<Arc<AtomicUsize>> = OnceLock::new();
static WHOM: OnceLock<String> = OnceLock::new();

/// Listens for both signals from now on.
///
/// # Errors
/// When the system lets nobody listen.
pub fn install() -> anyhow::Result<()> {
    WHOM.get_or_init(|| std::env::var("MOCAPD_HANG").unwrap_or_default());
    for (signal, hangs) in [(SIGUSR2, 1), (SIGUSR1, 0)] {
        let flag = Arc::clone(HANGS.get_or_init(Arc::default));
        register_usize(signal, flag, hangs).context("cannot listen for signals")?;
    }
    Ok(())
}

pub(crate) fn hang_if_told(who: Option<Who>) {
    let hangs = || HANGS.get().is_some_and(|hangs| hangs.load(Ordering::Relaxed) != 0);
    let is_meant = |who: Who| {
        let whom = WHOM.get().map_or("", String::as_str);
        who != Who::Supervisor && (whom.is_empty() || whom == who.to_string())
    };
    while hangs() && who.is_some_and(is_meant) {
        std::thread::sleep(LOOK_EVERY);
    }
}
