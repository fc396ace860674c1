//! A simulated device on a pty, on a thread of its own.

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
};

use anyhow::{Context, anyhow};
use mocapd_acquire::threads;
use mocapd_simulator::{
    device::{Device, SentLog},
    pty::{PtyError, ServeOptions, serve_pty},
};

/// Runs until it is stopped.
pub(super) struct SimulatedDevice {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<SentLog, PtyError>>,
    /// What a host opens.
    pub(super) path: PathBuf,
}

impl SimulatedDevice {
    pub(super) fn start(mut device: Device) -> anyhow::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let (path_in, path) = crossbeam_channel::bounded(1);
        let stopped = Arc::clone(&stop);
        let thread = threads::spawn("mocapd-sim", move || {
            serve_pty(&mut device, None, ServeOptions::default(), &stopped, |path| {
                path_in.send(path.to_owned()).ok();
            })
        })?;
        match path.recv() {
            Ok(path) => Ok(Self { stop, thread, path }),
            Err(_) => Err(match threads::join(thread)? {
                Err(error) => anyhow!(error).context("cannot simulate a device"),
                Ok(_) => anyhow!("the simulated device ended at once"),
            }),
        }
    }

    /// What it says it sent.
    pub(super) fn stop(self) -> anyhow::Result<SentLog> {
        self.stop.store(true, Ordering::Relaxed);
        threads::join(self.thread)?.context("the simulated device failed")
    }
}
