//! `mocapd-sim serve` as a USB device.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::PathBuf,
    process::{Child, Command, Stdio},
    sync::atomic::{AtomicU32, Ordering},
    time::Instant,
};

use anyhow::{Context, ensure};
use rustix::process::{Pid, Signal, kill_process};

use crate::attached::{TIMEOUT, wait_for_port, wait_for_usb, wait_until};

static STARTED: AtomicU32 = AtomicU32::new(0);

/// A simulated device, plugged in.
pub(crate) struct Simulator {
    child: Child,
    /// The URI under which a host opens it.
    pub(crate) uri: String,
    log: PathBuf,
}

/// What became of the frames, by the simulator's own log.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sent {
    pub(crate) produced: u64,
    pub(crate) dropped: u64,
    pub(crate) samples: u64,
}

impl Simulator {
    /// Starts a bulk device. `more` are options of `mocapd-sim serve`.
    pub(crate) fn bulk(serial: &str, more: &[&str]) -> anyhow::Result<Self> {
        let simulator = Self::start(false, serial, more)?;
        wait_for_usb(serial)?;
        Ok(simulator)
    }

    /// Starts a CDC-ACM port.
    pub(crate) fn port(serial: &str, more: &[&str]) -> anyhow::Result<Self> {
        let simulator = Self::start(true, serial, more)?;
        wait_for_port(simulator.uri.trim_start_matches("serial:"))?;
        Ok(simulator)
    }

    fn start(serial_port: bool, serial: &str, more: &[&str]) -> anyhow::Result<Self> {
        let log = format!("/tmp/sent-{}.csv", STARTED.fetch_add(1, Ordering::Relaxed));
        let line = if serial_port { "--usb-serial" } else { "--usb-gadget" };
        let mut child = Command::new("mocapd-sim")
            .args(["serve", "--generate", "jump:7", line, "--serial", serial, "--log", &log])
            .args(more)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .context("mocapd-sim")?;
        let mut name = String::new();
        let stdout = child.stdout.take().context("its stdout")?;
        BufReader::new(stdout).read_line(&mut name)?;
        ensure!(!name.is_empty(), "mocapd-sim ended: {}", child.wait()?);
        let name = name.trim();
        let uri = if serial_port { format!("serial:{name}") } else { name.to_owned() };
        Ok(Self { child, uri, log: log.into() })
    }

    fn controller(&self) -> PathBuf {
        format!("/sys/kernel/config/usb_gadget/mocapd-sim-{}-0/UDC", self.child.id()).into()
    }

    /// Pulls the cable; returns the controller's name, for plugging it in again, and the time.
    pub(crate) fn unplug(&self) -> anyhow::Result<(String, Instant)> {
        let controller = fs::read_to_string(self.controller())?;
        let at = Instant::now();
        fs::write(self.controller(), "\n").context("unbinding")?;
        Ok((controller, at))
    }

    /// Plugs the cable in again; returns the time.
    pub(crate) fn plug(&self, controller: &str) -> anyhow::Result<Instant> {
        let at = Instant::now();
        fs::write(self.controller(), controller.trim()).context("binding")?;
        Ok(at)
    }

    /// Stops it cleanly; returns its log's totals.
    pub(crate) fn stop(mut self) -> anyhow::Result<Sent> {
        if self.child.try_wait()?.is_none() {
            kill_process(Pid::from_child(&self.child), Signal::TERM)?;
        }
        let status = wait_until("mocapd-sim's end", TIMEOUT, || self.child.try_wait().ok()?)?;
        ensure!(status.success(), "mocapd-sim: {status}");
        self.sent()
    }

    /// Kills it, like a crash. A bulk device disappears with its program; a port belongs to the kernel and stays,
    /// silent, until the next simulator removes it.
    pub(crate) fn kill(mut self) -> anyhow::Result<()> {
        self.child.kill()?;
        self.child.wait()?;
        Ok(())
    }

    fn sent(&self) -> anyhow::Result<Sent> {
        let mut sent = Sent::default();
        for line in fs::read_to_string(&self.log)?.lines().skip(1) {
            let mut cells = line.split(',').skip(3).map(str::parse::<u64>);
            let (present, dropped) = (cells.next(), cells.next());
            let (Some(Ok(present)), Some(Ok(dropped))) = (present, dropped) else { continue };
            if cells.nth(1) == Some(Ok(1)) {
                // Produced after the last request: no recorder can know of it.
                continue;
            }
            sent.produced += 1;
            sent.dropped += dropped;
            sent.samples += if dropped == 0 { present } else { 0 };
        }
        Ok(sent)
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|status| status.is_none()) {
            kill_process(Pid::from_child(&self.child), Signal::TERM).ok();
            self.child.wait().ok();
        }
        fs::remove_file(&self.log).ok();
    }
}
