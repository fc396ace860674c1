//! A serial port as a USB gadget: the host sees `/dev/ttyACM0`, the simulator uses `/dev/ttyGS0`.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use usb_gadget::RegGadget;
use usb_gadget::function::serial::{Serial as Function, SerialClass};

use super::{GadgetError, GadgetSettings, MANUFACTURER, PRODUCT, SERIAL_PRODUCT_ID, plug_in};
use crate::line::Line;
use crate::pty::{or_nothing, wait_readable};

/// No call tells how much the host has not read yet. The kernel buffers 8 KiB, which full speed carries in 10 ms: after
/// this time the host either has it or does not read.
const UNREAD_TIMEOUT: Duration = Duration::from_millis(250);

/// The device's end of a CDC-ACM port.
#[derive(Debug)]
pub struct Serial {
    port: PathBuf,
    /// `None` after a hang-up, until it can be opened again.
    open: Option<OwnedFd>,
    serial: String,
    written: Instant,
    // After the port that it makes.
    _plugged: RegGadget,
}

impl Serial {
    /// Creates the gadget and plugs it in.
    ///
    /// # Errors
    /// When this machine has no free USB device controller, lacks kernel support, or the process lacks rights.
    pub fn plug_in(settings: &GadgetSettings) -> Result<Self, GadgetError> {
        let (function, handle) = Function::new(SerialClass::Acm);
        let plugged = plug_in(settings, SERIAL_PRODUCT_ID, handle)?;
        let port = function.tty().map_err(GadgetError::Make)?;
        let open = Some(open(&port).map_err(|error| GadgetError::Make(error.into()))?);
        Ok(Self {
            port,
            open,
            serial: settings.serial.clone(),
            written: Instant::now(),
            _plugged: plugged,
        })
    }

    /// The path under which a host with udev finds it.
    #[must_use]
    pub fn host_path(&self) -> PathBuf {
        format!("/dev/serial/by-id/usb-{MANUFACTURER}_{PRODUCT}_{}-if00", self.serial).into()
    }

    /// Closes a port that has hung up because the cable was pulled; it must be reopened.
    fn on_hang_up(&mut self, outcome: io::Result<usize>, may_be_empty: bool) -> io::Result<usize> {
        match outcome {
            Ok(0) if may_be_empty => Ok(0),
            Ok(0) | Err(_) => {
                self.open = None;
                Ok(0)
            }
            outcome => outcome,
        }
    }
}

fn open(port: &Path) -> Result<OwnedFd, Errno> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let fd = rustix::fs::open(port, flags, Mode::empty())?;
    let mut termios = tcgetattr(&fd)?;
    termios.make_raw();
    tcsetattr(&fd, OptionalActions::Now, &termios)?;
    Ok(fd)
}

impl Line for Serial {
    fn name(&self) -> &'static str {
        "USB serial gadget"
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Some(fd) = &self.open else { return Ok(0) };
        let outcome = or_nothing(rustix::io::write(fd, bytes));
        self.written = Instant::now();
        self.on_hang_up(outcome, true)
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let Some(fd) = &self.open else { return Ok(0) };
        match rustix::io::read(fd, buffer) {
            Err(Errno::AGAIN | Errno::INTR) => Ok(0),
            outcome => self.on_hang_up(outcome.map_err(Into::into), false),
        }
    }

    fn wait(&mut self, at_most: Duration) -> io::Result<bool> {
        match &self.open {
            Some(fd) => wait_readable(fd.as_fd(), at_most),
            None => {
                std::thread::sleep(at_most);
                Ok(false)
            }
        }
    }

    /// Just sleeps: waiting for input would return at once.
    fn wait_for_room(&mut self, at_most: Duration) -> io::Result<bool> {
        std::thread::sleep(at_most);
        Ok(true)
    }

    fn unread(&mut self) -> io::Result<u64> {
        // A port that has hung up holds no bytes.
        Ok(u64::from(self.open.is_some() && self.written.elapsed() < UNREAD_TIMEOUT))
    }

    fn maintain(&mut self) -> io::Result<()> {
        if self.open.is_none() {
            self.open = open(&self.port).ok();
        }
        Ok(())
    }
}
