//! Word of devices that are plugged in and pulled, where udev says it.

use std::{
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, Wake, Waker},
    thread::{self, Thread},
    time::{Duration, Instant},
};

use futures_core::Stream;
use nusb::hotplug::HotplugWatch;

/// Waits for USB devices to come and go.
///
/// The kernel's word reaches programs through udev: in a container, or where udev does not run, none
/// ever comes, and no error either. Whoever waits must look for itself now and then.
pub struct UsbWatch {
    watch: Option<HotplugWatch>,
    waker: Waker,
}

impl std::fmt::Debug for UsbWatch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("UsbWatch").field("hears", &self.watch.is_some()).finish()
    }
}

/// Wakes the thread that waits.
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
    /// Listens from now on, for the thread that calls. Look at what is attached after this, not before:
    /// what comes in between is then seen by one or the other.
    #[must_use]
    pub fn new() -> Self {
        Self {
            watch: nusb::watch_devices().ok(),
            waker: Waker::from(Arc::new(Unpark(thread::current()))),
        }
    }

    /// Waits until a device came or went: `true` then, `false` when `at_most` is over.
    pub fn wait(&mut self, at_most: Duration) -> bool {
        let until = Instant::now() + at_most;
        loop {
            if self.heard() {
                return true;
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            thread::park_timeout(left);
        }
    }

    /// Takes what was heard so far, all of it: one look serves many events.
    fn heard(&mut self) -> bool {
        let mut heard = false;
        let mut context = Context::from_waker(&self.waker);
        while let Some(watch) = &mut self.watch {
            match Pin::new(watch).poll_next(&mut context) {
                Poll::Ready(Some(_)) => heard = true,
                Poll::Ready(None) => self.watch = None,
                Poll::Pending => break,
            }
        }
        heard
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wait_without_news_ends() {
        let started = Instant::now();
        let wait = Duration::from_millis(30);
        let heard = UsbWatch::new().wait(wait);
        assert!(heard || started.elapsed() >= wait);
    }
}
