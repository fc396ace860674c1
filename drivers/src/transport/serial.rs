//! Serial lines, over the serialport crate: raw 8N1, ours alone, at any speed.

use std::{
    io::{self, ErrorKind, Read, Write},
    os::unix::fs::{FileTypeExt, MetadataExt},
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use rustix::fs::OFlags;
use serialport::{SerialPort, TTYPort};

use super::{
    READ_TIMEOUT, Transport, TransportError, WRITE_TIMEOUT,
    access::{holder, permission_remedy},
    tty,
};

/// The speed of a line whose URI gives none: the highest that the common USB adapters (FT232R,
/// CP2102N) reach by their data sheets.
pub const BAUD_DEFAULT: u32 = 3_000_000;

/// Bits on an 8N1 line for every byte: a start bit, eight of data, a stop bit.
const BITS_PER_BYTE: u64 = 10;

/// How long a break is held. A device sees one after a few characters' time: 10 ms at 9600 baud,
/// where a character takes 1 ms; the rest is for adapters that are slow to end one.
const BREAK: Duration = Duration::from_millis(50);

/// How long the last bytes may take to leave before the speed changes: a command of 64 bytes takes
/// 67 ms at 9600 baud.
const LEAVE_WITHIN: Duration = Duration::from_millis(200);

/// A serial line, open.
#[derive(Debug)]
pub struct SerialTransport {
    port: TTYPort,
    path: PathBuf,
    baud: u32,
    limited: bool,
    low_latency: bool,
}

impl SerialTransport {
    /// Opens `path` for us alone, with DTR and RTS raised and the kernel's low latency asked for.
    ///
    /// Without a `baud` it is [`BAUD_DEFAULT`], and a line that has no speed of its own (a pty, a
    /// CDC-ACM device) counts as unlimited.
    ///
    /// # Errors
    /// `NotFound`, `Busy`, `PermissionDenied`, `Unsupported` for what is no serial port, `Io`.
    pub fn open(path: &Path, baud: Option<u32>) -> Result<Self, TransportError> {
        let has_own_speed = has_own_speed(path)?;
        let baud_rate = baud.unwrap_or(BAUD_DEFAULT);
        let builder = serialport::new(path.to_string_lossy(), baud_rate).timeout(READ_TIMEOUT);
        let mut port = TTYPort::open(&builder).map_err(|error| open_error(path, error))?;
        // Some devices send only while these are up. A pty has neither, and says ENOTTY.
        for raised in [port.write_data_terminal_ready(true), port.write_request_to_send(true)] {
            if raised.is_err() {
                break;
            }
        }
        let fd = tty::descriptor(&port);
        // serialport waits for room and then writes blocking: a device that takes half of a command
        // would hold us for ever.
        rustix::fs::fcntl_setfl(fd, OFlags::NONBLOCK).map_err(|error| TransportError::Io {
            device: path.display().to_string(),
            action: "setting it up",
            source: error.into(),
        })?;
        let low_latency = tty::set_low_latency(fd);
        let limited = has_own_speed || baud.is_some();
        Ok(Self { port, path: path.to_owned(), baud: baud_rate, limited, low_latency })
    }

    fn device(&self) -> String {
        self.path.display().to_string()
    }

    /// Every error but a timeout ends the session.
    ///
    /// serialport folds EIO, ENXIO and ENODEV, all of which a pulled plug gives, into `Other`.
    fn session_error(&self, action: &'static str, source: io::Error) -> TransportError {
        match source.kind() {
            ErrorKind::BrokenPipe | ErrorKind::Other | ErrorKind::NotFound => {
                TransportError::Disconnected { device: self.device() }
            }
            _ => TransportError::Io { device: self.device(), action, source },
        }
    }
}

impl Transport for SerialTransport {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        match self.port.read(buf) {
            // A tty gives no bytes after a wake-up only when it was hung up.
            Ok(0) if !buf.is_empty() => Err(TransportError::Disconnected { device: self.device() }),
            Ok(n) => Ok(n),
            Err(error) if is_not_yet(&error) => Ok(0),
            Err(error) => Err(self.session_error("reading", error)),
        }
    }

    fn write_all(&mut self, mut bytes: &[u8]) -> Result<(), TransportError> {
        let mut last_progress = Instant::now();
        while !bytes.is_empty() {
            match self.port.write(bytes) {
                Ok(n) => {
                    bytes = bytes.get(n..).unwrap_or_default();
                    last_progress = Instant::now();
                }
                Err(error) if is_not_yet(&error) => {
                    if last_progress.elapsed() >= WRITE_TIMEOUT {
                        return Err(TransportError::Stuck { device: self.device() });
                    }
                }
                Err(error) => return Err(self.session_error("writing", error)),
            }
        }
        Ok(())
    }

    fn send_break(&mut self) -> Result<bool, TransportError> {
        // A pty, and some adapters, know no break.
        if self.port.set_break().is_err() {
            return Ok(false);
        }
        thread::sleep(BREAK);
        match self.port.clear_break() {
            Ok(()) => Ok(true),
            Err(error) => Err(self.session_error("ending a break", error.into())),
        }
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), TransportError> {
        // tcdrain would wait without an end for a device that holds us off.
        let give_up_at = Instant::now() + LEAVE_WITHIN;
        while self.port.bytes_to_write().is_ok_and(|left| left > 0) && Instant::now() < give_up_at {
            thread::sleep(Duration::from_millis(1));
        }
        match self.port.set_baud_rate(baud) {
            Ok(()) => {
                self.baud = baud;
                Ok(())
            }
            Err(_) if Path::new(&self.device()).exists() => Err(TransportError::Refused(format!(
                "{} does not run at {baud} baud",
                self.device()
            ))),
            Err(error) => Err(self.session_error("changing its speed", error.into())),
        }
    }

    fn line_bytes_per_s(&self) -> Option<u64> {
        self.limited.then_some(u64::from(self.baud) / BITS_PER_BYTE)
    }

    fn is_low_latency(&self) -> bool {
        self.low_latency
    }

    fn describe(&self) -> String {
        let latency = if self.low_latency { ", low latency" } else { "" };
        format!("serial line {} at {} baud{latency}", self.device(), self.baud)
    }
}

fn is_not_yet(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// Whether the baud rate of a port is what limits it; an error when it is no port at all.
///
/// Device numbers: Linux's Documentation/admin-guide/devices.txt.
fn has_own_speed(path: &Path) -> Result<bool, TransportError> {
    const PTY_MAJORS: std::ops::RangeInclusive<u32> = 136..=143;
    const CDC_ACM_MAJOR: u32 = 166;
    let device = path.display().to_string();
    let metadata = path.metadata().map_err(|source| match source.kind() {
        ErrorKind::NotFound => TransportError::NotFound { device: device.clone() },
        _ => TransportError::Io { device: device.clone(), action: "looking it up", source },
    })?;
    if !metadata.file_type().is_char_device() {
        return Err(no_serial_port(&device));
    }
    let major = rustix::fs::major(metadata.rdev());
    Ok(!PTY_MAJORS.contains(&major) && major != CDC_ACM_MAJOR)
}

fn no_serial_port(device: &str) -> TransportError {
    TransportError::Unsupported(format!(
        "{device} is no serial port: give a device such as /dev/ttyUSB0, or a link to one"
    ))
}

fn open_error(path: &Path, error: serialport::Error) -> TransportError {
    let device = path.display().to_string();
    match error.kind() {
        // EBUSY, or a lock that somebody else holds.
        serialport::ErrorKind::NoDevice => TransportError::Busy { device, holder: holder(path) },
        serialport::ErrorKind::Io(ErrorKind::NotFound) => TransportError::NotFound { device },
        serialport::ErrorKind::Io(ErrorKind::PermissionDenied) => {
            TransportError::PermissionDenied { device, remedy: permission_remedy(path) }
        }
        // EPERM comes without a kind of its own: a control group keeps the device from us.
        serialport::ErrorKind::Unknown if error.description == "Operation not permitted" => {
            let remedy = format!("add `DeviceAllow={device} rw` to the systemd unit");
            TransportError::PermissionDenied { device, remedy }
        }
        // ENOTTY.
        serialport::ErrorKind::Unknown if error.description == "Not a typewriter" => {
            no_serial_port(&device)
        }
        _ => TransportError::Io {
            device,
            action: "opening it as a serial port",
            source: error.into(),
        },
    }
}
