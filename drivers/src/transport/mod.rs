//! Transports: byte streams to devices over serial lines, USB bulk endpoints and the network.

mod access;
pub mod lsl;
pub mod network;
pub mod polled;
pub mod serial;
mod tty;
pub mod usb;

use std::{
    fmt::{self, Debug},
    io,
    net::{Ipv4Addr, SocketAddrV4},
    time::Duration,
};

pub use access::{Access, access};

/// Time-out of a read that waits for its first byte.
///
/// Short enough for a reader thread to notice a stop request within about one frame at 60 Hz.
pub const READ_TIMEOUT: Duration = Duration::from_millis(20);

/// Time-out of a write to a device that accepts no bytes. Commands have 16 bytes: a device that cannot
/// accept one for a whole second does not read.
pub const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// A bidirectional byte stream to a device.
pub trait Transport: Send + Debug {
    /// Reads the available bytes, at most `buf.len()`, and waits up to [`READ_TIMEOUT`] for the first.
    /// `Ok(0)` means that none arrived in that time.
    ///
    /// # Errors
    /// `Disconnected` or `ConnectionLost` when the device is gone; `Io`.
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError>;

    /// Writes all of `bytes`.
    ///
    /// # Errors
    /// `Disconnected` or `ConnectionLost` when the device is gone; `Stuck` when it accepted no bytes for [`WRITE_TIMEOUT`]; `Io`.
    fn write_all(&mut self, bytes: &[u8]) -> Result<(), TransportError>;

    /// Sends a break, which resets some devices. Returns `false`, and does nothing, on a line without break
    /// (a pty, USB).
    ///
    /// # Errors
    /// `Disconnected` when the device is gone; `Io`.
    fn send_break(&mut self) -> Result<bool, TransportError> {
        Ok(false)
    }

    /// Changes the baud rate after pending output has left. Lines without a baud rate accept any.
    ///
    /// # Errors
    /// `Disconnected` when the device is gone; `Refused` when the port does not support the baud rate; `Io`.
    fn set_baud(&mut self, _baud: u32) -> Result<(), TransportError> {
        Ok(())
    }

    /// The wrapped transport, if any. The methods below delegate to it by default.
    fn inner(&self) -> Option<&dyn Transport> {
        None
    }

    /// Bandwidth of the line in each direction, in bytes per second; `None` when it is not limited.
    fn line_bytes_per_s(&self) -> Option<u64> {
        self.inner()?.line_bytes_per_s()
    }

    /// How the bytes of the last read arrived.
    fn arrival(&self) -> Arrival {
        self.inner().map_or_else(Arrival::default, Transport::arrival)
    }

    /// The local UDP port at which the device's datagrams arrive, on a line that receives datagrams.
    fn datagram_port(&self) -> Option<u16> {
        self.inner()?.datagram_port()
    }

    /// Receives datagrams of frames from another source as well, in place of the one before.
    ///
    /// # Errors
    /// `Unreachable` with a remedy when the system refuses; `Unsupported` on a line without datagrams.
    fn listen(&mut self, source: DatagramSource) -> Result<(), TransportError> {
        let line = self.describe();
        Err(TransportError::Unsupported(format!("{line} cannot receive {source}: use the network")))
    }

    /// Stops receiving from that source.
    fn stop_listening(&mut self) {}

    /// The last sender of datagrams that are not the device's, and are left out.
    fn stranger(&self) -> Option<SocketAddrV4> {
        self.inner()?.stranger()
    }

    /// What the system grants this line less than was wanted, in one line that says what to do.
    fn remark(&self) -> Option<String> {
        self.inner()?.remark()
    }

    /// Describes the device and the line's settings in one phrase for users.
    fn describe(&self) -> String {
        self.inner().map_or_else(|| "nothing".to_owned(), Transport::describe)
    }

    /// Whether the kernel's low-latency mode is on for this line: it then forwards bytes without delay.
    fn is_low_latency(&self) -> bool {
        self.inner().is_some_and(Transport::is_low_latency)
    }

    /// Number of USB stalls that were cleared. Bytes in flight at a stall may be lost.
    fn stalls_cleared(&self) -> u64 {
        self.inner().map_or(0, Transport::stalls_cleared)
    }
}

/// Where datagrams of frames arrive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DatagramSource {
    /// The multicast group; `None` for datagrams to this machine.
    pub group: Option<Ipv4Addr>,
    /// The UDP port.
    pub port: u16,
}

impl fmt::Display for DatagramSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.group {
            Some(group) => write!(f, "multicast group {group}:{}", self.port),
            None => write!(f, "UDP port {}", self.port),
        }
    }
}

/// How the bytes of a read arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Arrival {
    /// Whether they are one datagram, whole, and no part of the stream.
    pub is_datagram: bool,
    /// The host's monotonic time in nanoseconds at which the kernel received them, where the kernel states it.
    pub host_ns: Option<u64>,
}

/// Errors of opening, reading and writing a device. Each message is one line that says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TransportError {
    /// No such device.
    #[error(
        "{device} does not exist: plug the device in, or list what is attached with `mocapd devices`"
    )]
    NotFound {
        /// Path, or USB ids and serial number.
        device: String,
    },
    /// Another program has the device open.
    #[error("{device} is in use{}: close the other program", holder.as_ref().map_or_else(String::new, |holder| format!(" by {holder}")))]
    Busy {
        /// Path, or USB ids and serial number.
        device: String,
        /// That program, as `name (process 1234)`, when it could be determined.
        holder: Option<String>,
    },
    /// The user lacks permission to open the device.
    #[error("no permission to open {device}: {remedy}")]
    PermissionDenied {
        /// Path, or USB ids and serial number.
        device: String,
        /// What the user can do, with the command to type.
        remedy: String,
    },
    /// The device was disconnected.
    #[error("{device} is gone: plug it in again")]
    Disconnected {
        /// Path, or USB ids and serial number.
        device: String,
    },
    /// No connection to a device on the network could be made.
    #[error("cannot connect to {device}: {remedy}")]
    Unreachable {
        /// Host and port.
        device: String,
        /// What was found, and what the user can do.
        remedy: String,
    },
    /// An open connection to a device on the network ended.
    #[error("lost the connection to {device}: {cause}; it is used again as soon as it is back")]
    ConnectionLost {
        /// Host and port.
        device: String,
        /// How it ended.
        cause: String,
    },
    /// The device answered that it cannot do what the host requested.
    #[error("{0}")]
    Refused(String),
    /// The device is present but accepts no bytes.
    #[error(
        "{device} does not accept commands: check that it is the right device, and switch it off and on again"
    )]
    Stuck {
        /// Path, or USB ids and serial number.
        device: String,
    },
    /// The device, or the system, lacks something that mocapd needs.
    #[error("{0}")]
    Unsupported(String),
    /// Any other error of the operating system.
    #[error("{device}: {action} failed")]
    Io {
        /// Path, or USB ids and serial number.
        device: String,
        /// The action that failed.
        action: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
}

impl TransportError {
    /// Whether the device was there and is gone, and may come back.
    #[must_use]
    pub fn is_gone(&self) -> bool {
        matches!(self, Self::Disconnected { .. } | Self::ConnectionLost { .. })
    }
}
