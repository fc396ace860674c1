//! A recording that shows how it goes, and that Ctrl-C finishes.

use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use anyhow::Context;
use mocapd::{
    record::{RecordOptions, Recorded, record},
    rig::Rig,
};
use mocapd_codec::Settings;
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::cli::{
    numbers::{bytes, thousands},
    output::say,
    progress::Progress,
};

/// Set by Ctrl-C or SIGTERM; a second Ctrl-C ends the process at once.
pub(crate) fn stop_on_signal() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))
            .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop)))
            .context("cannot watch for Ctrl-C")?;
    }
    Ok(stop)
}

/// Records `rig` into `take`, showing how it goes.
pub(crate) fn record_and_watch(
    rig: Rig,
    take: &Path,
    codec: Settings,
    length: Option<Duration>,
    stop: &AtomicBool,
) -> anyhow::Result<Recorded> {
    let mut watching = None;
    let mut started = |progress: &Arc<mocapd::pipeline::Progress>| {
        let progress = Arc::clone(progress);
        watching = Some(Progress::status(move || {
            let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
            format!(
                "recording: {} frames, {} lost, {} on disk{}",
                thousands(get(&progress.frames)),
                thousands(get(&progress.lost)),
                bytes(get(&progress.file_bytes)),
                clock(&progress)
            )
        }));
    };
    let mut options = RecordOptions { take, codec, length, stop, say: &say, started: &mut started };
    let recorded = record(rig, &mut options);
    drop(watching);
    recorded
}

/// How the clocks run, once that is known.
fn clock(progress: &mocapd::pipeline::Progress) -> String {
    let p99_us = progress.jitter_p99_us.load(Ordering::Relaxed);
    if p99_us == 0 {
        return String::new();
    }
    let drift_ppm = progress.drift_ppb.load(Ordering::Relaxed) as f64 / 1e3;
    format!(", drift {drift_ppm:+.1} ppm, jitter {:.1} ms (p99)", p99_us as f64 * 1e-3)
}
