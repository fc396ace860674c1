//! A device that went away: waited for, found again, and started again, so that the take goes on.

use std::time::Duration;

use anyhow::ensure;
use mocapd_drivers::{
    registry,
    transport::{Transport, TransportError, usb::UsbWatch},
};

use super::{ReadOptions, Rig, reader::Reader};
use crate::{host_clock::monotonic_ns, setting};

/// How often it is looked for where udev does not tell: twenty looks in the two seconds within which a device
/// that is back is recorded again.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// After a device that was there but could not be started: it may be busy starting up, or be another one.
const LOOK_AFTER_FAILURE: Duration = Duration::from_millis(500);

/// How long the same obstacle must last before somebody is told: udev needs a moment to set permissions.
const TELL_AFTER: Duration = Duration::from_secs(1);

/// What is tried to bring a device back.
enum Attempt {
    Back,
    /// It is not there, or may not be opened.
    Absent(String),
    /// It is there, but does not do what is asked.
    Failed(String),
}

/// What keeps a device away, told once when it lasts.
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
    /// From now on a recording waits so long for the device when it goes away, before the take ends. Without this it
    /// does not wait.
    pub fn wait_for_replug(&mut self, patience: Duration) {
        self.patience = patience;
    }

    /// Waits for the device, and starts it. `false`: it did not come back before its time was over, or `is_over`.
    pub(super) fn reconnect(
        &mut self,
        reader: &mut Reader<'_>,
        options: &ReadOptions<'_>,
        is_over: &dyn Fn(&Reader<'_>) -> bool,
    ) -> bool {
        // Closed before anything else: a port that stays open keeps its name from the one that comes.
        self.transport = Box::new(Unplugged);
        if self.patience.is_zero() || is_over(reader) {
            return false;
        }
        let gone_ns = monotonic_ns();
        (options.say)(&format!(
            "{} is gone: plug it in again within {} s, and {} goes on{}",
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
                // Asked between any two tries: a handshake may take longer than the watchdog waits.
                reader.intake.alive();
                is_over(reader) || monotonic_ns() > give_up_ns
            };
            let wait = match self.attempt(reader, options, &give_up) {
                Attempt::Back => {
                    // How long it was away its first frame tells.
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
            // What was recorded before goes to disk meanwhile.
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

    /// Makes sure that it is the same device, as it was, and starts it.
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
            "another device answers, {} {}, and the take is of {} {}: plug that one in",
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

/// Nothing is attached.
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
