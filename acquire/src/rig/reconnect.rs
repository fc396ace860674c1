//! Reconnecting: waits for a device that was disconnected, finds it and starts it again, so that the take goes on.

use std::time::Duration;

use anyhow::ensure;
use mocapd_drivers::{
    registry,
    transport::{Transport, TransportError, usb::UsbWatch},
};

use super::{ReadOptions, Rig, reader::Reader};
use crate::{host_clock::monotonic_ns, setting};

/// Polling interval where udev does not notify: twenty attempts in the two seconds within which a device that is back
/// has to be recording again.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Time to wait after a device that is present could not be started: it may be starting up, or be another one.
const LOOK_AFTER_FAILURE: Duration = Duration::from_millis(500);

/// Report an obstacle that lasts this long: udev needs a moment to set permissions.
const TELL_AFTER: Duration = Duration::from_secs(1);

/// The result of an attempt to reconnect.
enum Attempt {
    Back,
    /// It is not there, or may not be opened.
    Absent(String),
    /// It is there but cannot be started.
    Failed(String),
}

/// The reason why the device cannot be reconnected, reported once if it lasts.
struct Obstacle {
    words: String,
    since_ns: u64,
    told: bool,
}

impl Obstacle {
    fn met(&mut self, words: String, say: &dyn Fn(&str)) {
        let now_ns = monotonic_ns();
        if words != self.words {
            *self = Self { words, since_ns: now_ns, told: false };
        } else if !self.told && now_ns - self.since_ns > TELL_AFTER.as_nanos() as u64 {
            say(&format!("still waiting: {}", self.words));
            self.told = true;
        }
    }
}

impl Rig {
    /// Sets how long a recording waits for a disconnected device before the take ends. By default it does not wait.
    /// does not wait.
    pub fn wait_for_replug(&mut self, patience: Duration) {
        self.patience = patience;
    }

    /// Waits for the device and starts it. Returns `false` if it did not come back in time, or `is_over`.
    pub(super) fn reconnect(
        &mut self,
        reader: &mut Reader<'_>,
        options: &ReadOptions<'_>,
        is_over: &dyn Fn(&Reader<'_>) -> bool,
    ) -> bool {
        // Closed before anything else: an open port keeps its name from the device that comes back.
        self.transport = Box::new(Unplugged);
        if self.patience.is_zero() || is_over(reader) {
            return false;
        }
        let gone_ns = monotonic_ns();
        (options.say)(&format!(
            "{} is gone: plug it in again within {} s to continue {}{}",
            self.uri,
            (self.patience.as_secs_f64() * 10.0).round() / 10.0,
            if options.for_one_take { "the take" } else { "recording" },
            options.how_to_end
        ));
        let mut obstacle = Obstacle { words: String::new(), since_ns: gone_ns, told: true };
        let mut watch = UsbWatch::new();
        while !is_over(reader) && monotonic_ns() - gone_ns < self.patience.as_nanos() as u64 {
            let give_up_ns = gone_ns.saturating_add(self.patience.as_nanos() as u64);
            let give_up = |reader: &Reader<'_>| {
                // Called between any two attempts: a handshake may take longer than the watchdog's limit.
                reader.intake.alive();
                is_over(reader) || monotonic_ns() > give_up_ns
            };
            let wait = match self.attempt(reader, options, &give_up) {
                Attempt::Back => {
                    // The first frame shows how long it was away.
                    (options.say)("the device is back");
                    return true;
                }
                Attempt::Absent(words) => {
                    obstacle.met(words, options.say);
                    LOOK_EVERY
                }
                Attempt::Failed(words) => {
                    obstacle.met(words, options.say);
                    LOOK_AFTER_FAILURE
                }
            };
            watch.wait(wait);
            // Meanwhile what was recorded goes to disk.
            reader.intake.tick(monotonic_ns());
        }
        false
    }

    fn attempt(
        &mut self,
        reader: &mut Reader<'_>,
        options: &ReadOptions<'_>,
        give_up: &dyn Fn(&Reader<'_>) -> bool,
    ) -> Attempt {
        match registry::open_again(&self.uri, &self.identity) {
            Ok(line) => {
                let line = match &self.raw_log {
                    Some(tap) => tap.on(self.family, line),
                    None => line,
                };
                self.transport = self.protocol.attach(line);
            }
            Err(error) => return Attempt::Absent(error.to_string()),
        }
        match self.rejoin(reader, options, give_up) {
            Ok(()) => Attempt::Back,
            Err(error) => {
                self.transport = Box::new(Unplugged);
                Attempt::Failed(setting::words(&error, options.how_to_set))
            }
        }
    }

    /// Checks that it is the same device, restores its rate and starts it.
    fn rejoin(
        &mut self,
        reader: &mut Reader<'_>,
        options: &ReadOptions<'_>,
        give_up: &dyn Fn(&Reader<'_>) -> bool,
    ) -> anyhow::Result<()> {
        let before = self.hello.clone();
        let introduced = self.introduce(&|| give_up(reader));
        let now = std::mem::replace(&mut self.hello, before);
        introduced?;
        let was = &self.hello;
        ensure!(
            (&now.model, &now.serial) == (&was.model, &was.serial),
            "another device answers, {} {}, but the take needs {} {}: plug that one in",
            now.model,
            now.serial,
            was.model,
            was.serial
        );
        if now.rate_mhz != was.rate_mhz {
            self.set_rate_unless(self.rate_hz(), &|| give_up(reader))?;
        }
        reader.restart(&self.markers);
        self.start(reader, options).map(drop)
    }
}

/// The transport while no device is attached.
#[derive(Debug)]
struct Unplugged;

impl Unplugged {
    fn gone() -> TransportError {
        TransportError::Disconnected { device: "the device".to_owned() }
    }
}

impl Transport for Unplugged {
    fn read(&mut self, _buf: &mut [u8]) -> Result<usize, TransportError> {
        Err(Self::gone())
    }

    fn write_all(&mut self, _bytes: &[u8]) -> Result<(), TransportError> {
        Err(Self::gone())
    }
}
