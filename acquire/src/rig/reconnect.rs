//! Reconnecting: waits for a device that was disconnected, finds it and starts it again, so that the take continues.

use std::{cell::RefCell, time::Duration};

use anyhow::ensure;
use crossbeam_channel::{RecvTimeoutError, bounded};
use mocapd_drivers::{
    device::Hello,
    registry,
    transport::{Transport, TransportError, usb::UsbWatch},
    uri::Location,
};

use super::{
    ReadOptions, Rig,
    reader::{Outage, Reader},
};
use crate::{host_clock::monotonic_ns, setting, threads};

/// Polling interval where udev does not notify: twenty attempts in the two seconds within which a device that is back
/// has to be recording again.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Time between two looks whether a connection attempt is still wanted: a stop is answered within 0.3 s.
const CONNECT_POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Time to wait after a device that is present could not be started: it may be starting up, or be another one.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);

/// Report an obstacle that lasts this long: udev needs a moment to set permissions.
const REPORT_AFTER: Duration = Duration::from_secs(1);

/// The result of an attempt to reconnect.
enum ReconnectAttempt {
    Back,
    /// It is not there, or may not be opened.
    Absent(String),
    /// It is there but cannot be started.
    Failed(String),
}

/// The reason why the device cannot be reconnected, reported once if it lasts.
struct Obstacle {
    message: String,
    since_ns: u64,
    reported: bool,
}

impl Obstacle {
    fn update(&mut self, message: String, notify: &dyn Fn(&str)) {
        let now_ns = monotonic_ns();
        if message != self.message {
            *self = Self { message, since_ns: now_ns, reported: false };
        } else if !self.reported && now_ns - self.since_ns > REPORT_AFTER.as_nanos() as u64 {
            notify(&format!("still waiting: {}", self.message));
            self.reported = true;
        }
    }
}

impl Rig {
    /// Sets how long a recording waits for a disconnected device before the take ends. By default it does not wait.
    pub fn wait_for_replug(&mut self, replug_timeout: Duration) {
        self.replug_timeout = replug_timeout;
    }

    /// Waits for the device and starts it. Returns `false` if it did not come back in time, or `is_over`.
    pub(super) fn reconnect(
        &mut self,
        (reader, outage): (&mut Reader<'_>, &mut Outage),
        options: &ReadOptions<'_>,
        is_over: &dyn Fn(&Reader<'_>) -> bool,
    ) -> bool {
        // Closed before anything else: an open port keeps its name from the device that comes back.
        self.transport = Box::new(UnpluggedTransport);
        if self.replug_timeout.is_zero() || is_over(reader) {
            return false;
        }
        let lost_ns = outage.lost_ns;
        let is_reported = outage.is_reported();
        let notify = |text: &str| {
            if is_reported {
                (options.notify)(text);
            }
        };
        let what = match reader.lost_connection.take() {
            Some(cause) => format!("{}: {cause}: start it again", self.uri),
            None => format!("{} is gone: plug it in again", self.uri),
        };
        notify(&format!(
            "{what} within {} s to continue {}{}",
            (self.replug_timeout.as_secs_f64() * 10.0).round() / 10.0,
            if options.single_take { "the take" } else { "recording" },
            options.how_to_end
        ));
        let mut obstacle = Obstacle { message: String::new(), since_ns: lost_ns, reported: true };
        let mut watch = UsbWatch::new();
        let tries_ns = monotonic_ns().saturating_add(outage.pause().as_nanos() as u64);
        while !is_over(reader) && monotonic_ns() - lost_ns < self.replug_timeout.as_nanos() as u64 {
            if monotonic_ns() < tries_ns {
                std::thread::sleep(POLL_INTERVAL);
                reader.intake.tick(monotonic_ns());
                continue;
            }
            let give_up_ns = lost_ns.saturating_add(self.replug_timeout.as_nanos() as u64);
            let shared = RefCell::new(&mut *reader);
            let cancel = || {
                let mut reader = shared.borrow_mut();
                // Called between any two attempts, which take seconds: meanwhile what was recorded goes to disk, marks are
                // executed, and the watchdog sees that the thread lives.
                reader.intake.tick(monotonic_ns());
                is_over(&reader) || monotonic_ns() > give_up_ns
            };
            let (message, wait) = match self.attempt(&shared, options, &cancel) {
                ReconnectAttempt::Back => {
                    // The first frame shows how long it was away.
                    notify("the device is back");
                    outage.came_back(monotonic_ns());
                    return true;
                }
                ReconnectAttempt::Absent(message) => (message, POLL_INTERVAL),
                ReconnectAttempt::Failed(message) => (message, RETRY_INTERVAL),
            };
            obstacle.update(message, &notify);
            watch.wait(wait);
            reader.intake.tick(monotonic_ns());
        }
        false
    }

    fn attempt(
        &mut self,
        reader: &RefCell<&mut Reader<'_>>,
        options: &ReadOptions<'_>,
        cancel: &dyn Fn() -> bool,
    ) -> ReconnectAttempt {
        let Some(opened) = self.reopen_line(cancel) else {
            return ReconnectAttempt::Absent("no answer yet".to_owned());
        };
        match opened {
            Ok(line) => {
                let line = match &self.raw_log {
                    Some(tap) => tap.wrap(self.family, line),
                    None => line,
                };
                self.transport = self.protocol.attach(line);
            }
            Err(error) => return ReconnectAttempt::Absent(error.to_string()),
        }
        match self.rejoin(reader, options, cancel) {
            Ok(()) => ReconnectAttempt::Back,
            Err(error) => {
                self.transport = Box::new(UnpluggedTransport);
                ReconnectAttempt::Failed(setting::message(&error, options.how_to_set))
            }
        }
    }

    /// Opens the line again; `None` if cancelled. Looking up a name and connecting can take seven seconds, and finding streams
    /// almost as long. A separate thread does it, so that neither a stop nor the watchdog has to wait; it ends when the attempt does.
    fn reopen_line(
        &self,
        cancel: &dyn Fn() -> bool,
    ) -> Option<Result<Box<dyn Transport>, TransportError>> {
        let (uri, identity) = (self.uri.clone(), self.identity.clone());
        if !matches!(uri.location, Location::Network(_) | Location::Streams(_)) {
            return Some(registry::reopen(&uri, &identity));
        }
        let (sender, receiver) = bounded(1);
        let open = move || {
            // If nobody waits any longer, the connection is closed again.
            sender.try_send(registry::reopen(&uri, &identity)).ok();
        };
        if let Err(source) = threads::spawn("mocapd-connect", open) {
            let (device, action) = (self.uri.to_string(), "starting a thread to connect");
            let source = std::io::Error::other(source.to_string());
            return Some(Err(TransportError::Io { device, action, source }));
        }
        loop {
            match receiver.recv_timeout(CONNECT_POLL_INTERVAL) {
                Ok(opened) => return Some(opened),
                Err(RecvTimeoutError::Timeout) if !cancel() => {}
                Err(RecvTimeoutError::Timeout) => return None,
                Err(RecvTimeoutError::Disconnected) => {
                    let source = std::io::Error::other("the thread that connects has failed");
                    let (device, action) = (self.uri.to_string(), "connecting");
                    return Some(Err(TransportError::Io { device, action, source }));
                }
            }
        }
    }

    /// The message that the device which identified itself, `now`, is not that of the take.
    pub(super) fn another_device(&self, now: &Hello) -> String {
        let was = &self.hello;
        format!(
            "another device answers, {} {}, but the take needs {} {}: plug that one in",
            now.model, now.serial, was.model, was.serial
        )
    }

    /// Checks that it is the same device, restores its rate and starts it.
    fn rejoin(
        &mut self,
        reader: &RefCell<&mut Reader<'_>>,
        options: &ReadOptions<'_>,
        cancel: &dyn Fn() -> bool,
    ) -> anyhow::Result<()> {
        let before = self.hello.clone();
        let queried = self.query_identity(cancel);
        let now = std::mem::replace(&mut self.hello, before);
        queried?;
        let was = &self.hello;
        ensure!(
            (&now.model, &now.serial) == (&was.model, &was.serial),
            "{}",
            self.another_device(&now)
        );
        if now.rate_millihertz != was.rate_millihertz {
            self.try_set_rate(self.rate_hz(), cancel)?;
        }
        let mut reader = reader.borrow_mut();
        reader.restart(&self.channels);
        self.start(&mut reader, options).map(drop)
    }
}

/// The transport while no device is attached.
#[derive(Debug)]
struct UnpluggedTransport;

impl UnpluggedTransport {
    fn error() -> TransportError {
        TransportError::Disconnected { device: "the device".to_owned() }
    }
}

impl Transport for UnpluggedTransport {
    fn read(&mut self, _buf: &mut [u8]) -> Result<usize, TransportError> {
        Err(Self::error())
    }

    fn write_all(&mut self, _bytes: &[u8]) -> Result<(), TransportError> {
        Err(Self::error())
    }
}
