//! Misbehaving devices.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{Builder, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::anyhow;
use mocapd_simulator::{
    device::{Device, DeviceSettings},
    gadget::{Bulk, GadgetSettings},
    generator::JumpSpec,
    line::{Line, ServeOptions, serve},
};

use crate::attached::wait_for_usb;

/// How often a device's thread checks whether to stop.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// A device on its own thread, until it is dropped.
pub(crate) struct MisbehavingDevice {
    pub(crate) uri: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<anyhow::Result<()>>>,
}

impl MisbehavingDevice {
    /// Plugs in a device with this behaviour.
    pub(crate) fn start(
        serial: &str,
        behave: impl FnOnce(Bulk, &AtomicBool) -> anyhow::Result<()> + Send + 'static,
    ) -> anyhow::Result<Self> {
        let settings = GadgetSettings { serial: serial.to_owned(), controller: None };
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let work = move || behave(Bulk::plug_in(&settings)?, &stopped);
        let thread = Builder::new().name("device".to_owned()).spawn(work)?;
        wait_for_usb(serial)?;
        Ok(Self { uri: format!("usb:1209:0001:{serial}"), stop, thread: Some(thread) })
    }

    /// Stops the device, and returns its error.
    pub(crate) fn stop(mut self) -> anyhow::Result<()> {
        self.stop.store(true, Ordering::Relaxed);
        let thread = self.thread.take().map(JoinHandle::join);
        thread.map_or(Ok(()), |ended| ended.map_err(|_| anyhow!("the device panicked"))?)
    }
}

impl Drop for MisbehavingDevice {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().map(|thread| thread.join().ok());
    }
}

/// Takes commands, and sends nothing.
pub(crate) fn silent(mut line: Bulk, stop: &AtomicBool) -> anyhow::Result<()> {
    while !stop.load(Ordering::Relaxed) {
        line.wait(POLL_INTERVAL)?;
        line.read(&mut [0; 4096])?;
    }
    Ok(())
}

/// Takes commands, and sends random bytes as fast as they are taken.
pub(crate) fn garbage(mut line: Bulk, stop: &AtomicBool) -> anyhow::Result<()> {
    let mut state: u64 = 1;
    let mut bytes = vec![0; 64 << 10];
    for byte in &mut bytes {
        // Knuth's MMIX: any bytes will do, zeros among them.
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        *byte = (state >> 56) as u8;
    }
    while !stop.load(Ordering::Relaxed) {
        line.read(&mut [0; 4096])?;
        if line.write(&bytes)? == 0 {
            line.wait_for_room(POLL_INTERVAL)?;
        }
    }
    Ok(())
}

/// Takes no commands, and sends random bytes.
pub(crate) fn ignores_commands(mut line: Bulk, stop: &AtomicBool) -> anyhow::Result<()> {
    send_forever(&mut line, &[0x55; 4096], stop)
}

/// Sends the same bytes over and over.
pub(crate) fn send_forever(line: &mut Bulk, bytes: &[u8], stop: &AtomicBool) -> anyhow::Result<()> {
    while !stop.load(Ordering::Relaxed) {
        if line.write(bytes)? == 0 {
            line.wait_for_room(POLL_INTERVAL)?;
        }
    }
    Ok(())
}

/// Serves a normal device on a line that calls `fault` before each write and delays commands by `delay`.
pub(crate) fn serve_with_fault(
    line: Bulk,
    stop: &AtomicBool,
    delay: Duration,
    fault: impl FnMut(&mut Bulk, u64) -> io::Result<()>,
) -> anyhow::Result<()> {
    let spec = JumpSpec { seconds: Some(4.0), ..JumpSpec::new(5, 120.0) };
    let settings = DeviceSettings { looping: true, ..DeviceSettings::default() };
    let mut device = Device::new(spec.generate()?.motion, settings)?;
    let mut line = Faulty { line, fault, writes: 0, delay, received: Vec::new() };
    serve(&mut line, &mut device, ServeOptions::default(), stop)?;
    Ok(())
}

struct Faulty<F> {
    line: Bulk,
    fault: F,
    writes: u64,
    /// Time until the device sees a command.
    delay: Duration,
    received: Vec<(Instant, Vec<u8>)>,
}

impl<F: FnMut(&mut Bulk, u64) -> io::Result<()>> Line for Faulty<F> {
    fn name(&self) -> &'static str {
        "faulty USB gadget"
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        (self.fault)(&mut self.line, self.writes)?;
        let written = self.line.write(bytes)?;
        self.writes += u64::from(written > 0);
        Ok(written)
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.line.read(buffer)?;
        if n > 0 {
            self.received.push((Instant::now(), buffer.get(..n).unwrap_or_default().to_vec()));
        }
        let is_due = |(at, _): &(Instant, Vec<u8>)| at.elapsed() >= self.delay;
        if !self.received.first().is_some_and(is_due) {
            return Ok(0);
        }
        let (_, bytes) = self.received.remove(0);
        let to = buffer.iter_mut().zip(&bytes);
        Ok(to.map(|(to, from)| *to = *from).count())
    }

    fn wait(&mut self, at_most: Duration) -> io::Result<bool> {
        self.line.wait(at_most)?;
        Ok(true)
    }

    fn unread(&mut self) -> io::Result<u64> {
        self.line.unread()
    }
}
