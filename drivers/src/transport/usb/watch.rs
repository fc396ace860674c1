//! Hotplug notification through udev, where it runs.

use std::{
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, Wake, Waker},
    thread::{self, Thread},
    time::{Duration, Instant},
};

use futures_core::Stream;
use nusb::hotplug::HotplugWatch;

/// Waits for USB devices to be plugged in or unplugged.
///
/// The events come from udev. In a container, or where udev does not run, none arrive, and there is no
/// error either: callers must also poll the list of devices occasionally.
pub struct UsbWatch {
    watch: Option<HotplugWatch>,
    waker: Waker,
}

impl std::fmt::Debug for UsbWatch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("UsbWatch").field("is_watching", &self.watch.is_some()).finish()
    }
}

/// Wakes the waiting thread.
struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}

impl Default for UsbWatch {
    fn default() -> Self {
        Self::new()
    }
}

impl UsbWatch {
    /// Starts to watch, for the calling thread. List the attached devices afterwards, not before, so that no
    /// device is missed in between.
    #[must_use]
    pub fn new() -> Self {
        Self {
            watch: nusb::watch_devices().ok(),
            waker: Waker::from(Arc::new(Unpark(thread::current()))),
        }
    }

    /// Waits for a hotplug event: `true` when there was one, `false` after `timeout`.
    pub fn wait(&mut self, timeout: Duration) -> bool {
        let until = Instant::now() + timeout;
        loop {
            if self.drain_events() {
                return true;
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            thread::park_timeout(left);
        }
    }

    /// Drains all pending events, and returns whether there were any.
    fn drain_events(&mut self) -> bool {
        let mut had_event = false;
        let mut context = Context::from_waker(&self.waker);
        while let Some(watch) = &mut self.watch {
            match Pin::new(watch).poll_next(&mut context) {
                Poll::Ready(Some(_)) => had_event = true,
                Poll::Ready(None) => self.watch = None,
                Poll::Pending => break,
            }
        }
        had_event
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wait_without_events_times_out() {
        let started = Instant::now();
        let wait = Duration::from_millis(30);
        let had_event = UsbWatch::new().wait(wait);
        assert!(had_event || started.elapsed() >= wait);
    }
}
