//! Serial lines through the serialport crate: raw 8N1, opened exclusively, at any baud rate.

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
    READ_TIMEOUT, Transport, TransportError, WRITE_TIMEOUT, holder, permission_remedy, tty,
};

/// Baud rate when the URI gives none: the highest that the common USB adapters (FT232R,
/// CP2102N) reach according to their data sheets.
pub const BAUD_DEFAULT: u32 = 3_000_000;

/// Bits per byte on an 8N1 line: a start bit, eight data bits, a stop bit.
const BITS_PER_BYTE: u64 = 10;

/// Duration of a break. A device detects one after a few character times: 10 ms at 9600 baud, where a
/// character takes 1 ms. The rest allows for adapters that are slow to end one.
const BREAK_DURATION: Duration = Duration::from_millis(50);

/// Time-out of draining the output before a change of baud rate: a command of 64 bytes takes 67 ms at
/// 9600 baud.
const DRAIN_TIMEOUT: Duration = Duration::from_millis(200);

/// An open serial line.
#[derive(Debug)]
pub struct SerialTransport {
    port: TTYPort,
    path: PathBuf,
    baud: u32,
    is_limited: bool,
    is_low_latency_on: bool,
}

impl SerialTransport {
    /// Opens `path` exclusively, raises DTR and RTS, and asks the kernel for low latency.
    ///
    /// `baud` defaults to [`BAUD_DEFAULT`]; a line without a physical baud rate (a pty, a CDC-ACM device) then
    /// counts as unlimited.
    ///
    /// # Errors
    /// `NotFound`, `Busy`, `PermissionDenied`, `Unsupported` for anything but a serial port, `Io`.
    pub fn open(path: &Path, baud: Option<u32>) -> Result<Self, TransportError> {
        let has_physical_baud = has_physical_baud(path)?;
        let baud_rate = baud.unwrap_or(BAUD_DEFAULT);
        let builder = serialport::new(path.to_string_lossy(), baud_rate).timeout(READ_TIMEOUT);
        let mut port = TTYPort::open(&builder).map_err(|error| open_error(path, error))?;
        // Some devices send only while these are raised. A pty has neither, and returns ENOTTY.
        for raised in [port.write_data_terminal_ready(true), port.write_request_to_send(true)] {
            if raised.is_err() {
                break;
            }
        }
        let fd = tty::descriptor(&port);
        // serialport waits until the port is writable and then blocks: a device that accepts half of a command
        // would hang the reader.
        rustix::fs::fcntl_setfl(fd, OFlags::NONBLOCK).map_err(|error| TransportError::Io {
            device: path.display().to_string(),
            action: "setting the port to non-blocking mode",
            source: error.into(),
        })?;
        let is_low_latency_on = tty::set_low_latency(fd);
        let is_limited = has_physical_baud || baud.is_some();
        Ok(Self { port, path: path.to_owned(), baud: baud_rate, is_limited, is_low_latency_on })
    }

    fn device(&self) -> String {
        self.path.display().to_string()
    }

    /// Converts an I/O error. All but time-outs end the session.
    ///
    /// serialport maps EIO, ENXIO and ENODEV, which an unplugged adapter returns, to `Other`.
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
            // A tty that is readable but has no bytes was hung up.
            Ok(0) if !buf.is_empty() => Err(TransportError::Disconnected { device: self.device() }),
            Ok(n) => Ok(n),
            Err(error) if is_timeout(&error) => Ok(0),
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
                Err(error) if is_timeout(&error) => {
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
        // Ptys and some adapters have no break.
        if self.port.set_break().is_err() {
            return Ok(false);
        }
        thread::sleep(BREAK_DURATION);
        match self.port.clear_break() {
            Ok(()) => Ok(true),
            Err(error) => Err(self.session_error("ending a break", error.into())),
        }
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), TransportError> {
        // tcdrain would block for ever on a device that holds flow control.
        let give_up_at = Instant::now() + DRAIN_TIMEOUT;
        while self.port.bytes_to_write().is_ok_and(|left| left > 0) && Instant::now() < give_up_at {
            thread::sleep(Duration::from_millis(1));
        }
        match self.port.set_baud_rate(baud) {
            Ok(()) => {
                self.baud = baud;
                Ok(())
            }
            Err(_) if Path::new(&self.device()).exists() => Err(TransportError::Refused(format!(
                "{} does not support {baud} baud",
                self.device()
            ))),
            Err(error) => Err(self.session_error("changing its speed", error.into())),
        }
    }

    fn line_bytes_per_s(&self) -> Option<u64> {
        self.is_limited.then_some(u64::from(self.baud) / BITS_PER_BYTE)
    }

    fn is_low_latency(&self) -> bool {
        self.is_low_latency_on
    }

    fn describe(&self) -> String {
        let latency = if self.is_low_latency_on { ", low latency" } else { "" };
        format!("serial line {} at {} baud{latency}", self.device(), self.baud)
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// Whether the baud rate limits the port: not on ptys and CDC-ACM devices. An error for anything but a port.
///
/// Device numbers: Linux's Documentation/admin-guide/devices.txt.
fn has_physical_baud(path: &Path) -> Result<bool, TransportError> {
    const PTY_MAJORS: std::ops::RangeInclusive<u32> = 136..=143;
    const CDC_ACM_MAJOR: u32 = 166;
    let device = path.display().to_string();
    let metadata = path.metadata().map_err(|source| match source.kind() {
        ErrorKind::NotFound => TransportError::NotFound { device: device.clone() },
        _ => TransportError::Io { device: device.clone(), action: "looking it up", source },
    })?;
    if !metadata.file_type().is_char_device() {
        return Err(not_a_serial_port(&device));
    }
    let major = rustix::fs::major(metadata.rdev());
    Ok(!PTY_MAJORS.contains(&major) && major != CDC_ACM_MAJOR)
}

fn not_a_serial_port(device: &str) -> TransportError {
    TransportError::Unsupported(format!(
        "{device} is not a serial port: give a device such as /dev/ttyUSB0, or a link to one"
    ))
}

fn open_error(path: &Path, error: serialport::Error) -> TransportError {
    let device = path.display().to_string();
    match error.kind() {
        // EBUSY, or another program's lock.
        serialport::ErrorKind::NoDevice => TransportError::Busy { device, holder: holder(path) },
        serialport::ErrorKind::Io(ErrorKind::NotFound) => TransportError::NotFound { device },
        serialport::ErrorKind::Io(ErrorKind::PermissionDenied) => {
            TransportError::PermissionDenied { device, remedy: permission_remedy(path) }
        }
        // EPERM has no kind of its own: a control group denies the device.
        serialport::ErrorKind::Unknown if error.description == "Operation not permitted" => {
            let remedy = format!("add `DeviceAllow={device} rw` to the systemd unit");
            TransportError::PermissionDenied { device, remedy }
        }
        // ENOTTY.
        serialport::ErrorKind::Unknown if error.description == "Not a typewriter" => {
            not_a_serial_port(&device)
        }
        _ => TransportError::Io {
            device,
            action: "opening it as a serial port",
            source: error.into(),
        },
    }
}
