//! Threads that hang on command: for the watchdog's test, in builds with the feature `fault-hooks` alone.
//!
//! SIGUSR2 hangs the thread that `MOCAPD_HANG` names (`reader`, `worker` or `writer`), and every one of these when it
//! names none.

use std::{
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use anyhow::Context;
use signal_hook::consts::SIGUSR2;

use crate::heartbeat::Who;

static TOLD: OnceLock<Arc<AtomicBool>> = OnceLock::new();
static WHOM: OnceLock<String> = OnceLock::new();

/// Listens for SIGUSR2 from now on.
///
/// # Errors
/// When the system lets nobody listen.
pub fn install() -> anyhow::Result<()> {
    WHOM.get_or_init(|| std::env::var("MOCAPD_HANG").unwrap_or_default());
    let told = Arc::clone(TOLD.get_or_init(Arc::default));
    signal_hook::flag::register(SIGUSR2, told).context("cannot listen for SIGUSR2").map(drop)
}

pub(crate) fn hang_if_told(who: Option<Who>) {
    let is_told = TOLD.get().is_some_and(|told| told.load(Ordering::Relaxed));
    let is_meant = |who: Who| {
        let whom = WHOM.get().map_or("", String::as_str);
        who != Who::Supervisor && (whom.is_empty() || whom == who.to_string())
    };
    while is_told && who.is_some_and(is_meant) {
        std::thread::sleep(Duration::from_secs(1));
    }
}
