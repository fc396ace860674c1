//! Transports: byte streams to devices over serial lines, USB bulk endpoints and the network.

pub mod lsl;
pub mod network;
pub mod polled;
pub mod serial;
mod tty;
pub mod usb;

use std::{
    fmt::{self, Debug},
    fs, io,
    net::{Ipv4Addr, SocketAddrV4},
    os::unix::fs::MetadataExt,
    path::Path,
    time::Duration,
};

use rustix::fs::{Access as Want, major, minor};

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

/// Result of checking access to a device.
#[derive(Debug)]
pub enum Access {
    /// Nothing visible from outside prevents opening.
    Accessible,
    /// The error that opening would return.
    Refused(TransportError),
}

/// Checks existence, permission and lock of a device file.
#[must_use]
pub fn access(path: &Path) -> Access {
    let device = path.display().to_string();
    if !path.exists() {
        return Access::Refused(TransportError::NotFound { device });
    }
    if rustix::fs::access(path, Want::READ_OK | Want::WRITE_OK).is_err() {
        let remedy = permission_remedy(path);
        return Access::Refused(TransportError::PermissionDenied { device, remedy });
    }
    match holder(path) {
        Some(holder) => Access::Refused(TransportError::Busy { device, holder: Some(holder) }),
        None => Access::Accessible,
    }
}

/// The command that gives the user permission to open `path`.
fn permission_remedy(path: &Path) -> String {
    let by_rule = || "install mocapd's udev rules, or ask your administrator".to_owned();
    group_remedy(path).unwrap_or_else(by_rule)
}

/// The command to join the group that may open `path`; `None` if only root's group may.
fn group_remedy(path: &Path) -> Option<String> {
    const GROUP_READ_WRITE: u32 = 0o060;
    let metadata = fs::metadata(path).ok()?;
    if metadata.gid() == 0 || metadata.mode() & GROUP_READ_WRITE != GROUP_READ_WRITE {
        return None;
    }
    let groups = fs::read_to_string("/etc/group").unwrap_or_default();
    let group = group_name(&groups, metadata.gid())?;
    Some(format!("`sudo usermod -aG {group} $USER`, then log in again"))
}

/// Finds the name of a group in the text of /etc/group (`name:password:gid:members`).
fn group_name(groups: &str, gid: u32) -> Option<&str> {
    groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(gid)).then_some(name)
    })
}

/// The program that holds a file lock on `path`. Programs that use the serialport crate, picocom and tio
/// lock the ports that they open.
fn holder(path: &Path) -> Option<String> {
    let metadata = fs::metadata(path).ok()?;
    let locks = fs::read_to_string("/proc/locks").ok()?;
    let file =
        format!("{:02x}:{:02x}:{}", major(metadata.dev()), minor(metadata.dev()), metadata.ino());
    let process = lock_owner(&locks, &file)?;
    let name = fs::read_to_string(format!("/proc/{process}/comm")).unwrap_or_default();
    Some(match name.trim() {
        "" => format!("process {process}"),
        name => format!("{name} (process {process})"),
    })
}

/// Finds the process that holds a lock in the text of /proc/locks
/// (`1: FLOCK  ADVISORY  WRITE 1234 00:05:678 0 EOF`, `proc_locks(5)`).
fn lock_owner(locks: &str, file: &str) -> Option<u32> {
    locks.lines().find_map(|line| {
        let mut fields = line.split_ascii_whitespace().skip(1);
        if fields.next() != Some("FLOCK") {
            return None;
        }
        let process = fields.nth(2)?.parse().ok()?;
        (fields.next() == Some(file)).then_some(process)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_group_is_found_by_its_number() {
        let groups = "root:x:0:\ndialout:x:20:anna\nbroken\n:x:\nplugdev:x:46:\n";
        assert_eq!(group_name(groups, 20), Some("dialout"));
        assert_eq!(group_name(groups, 46), Some("plugdev"));
        assert_eq!(group_name(groups, 5), None);
    }

    #[test]
    fn the_owner_of_a_lock_is_found() {
        let locks = "1: POSIX  ADVISORY  WRITE 11 00:05:678 0 EOF\n\
                     2: FLOCK  ADVISORY  WRITE 1234 00:05:678 0 EOF\n\
                     3: -> FLOCK  ADVISORY  WRITE 9 00:05:679 0 EOF\ngarbage\n";
        assert_eq!(lock_owner(locks, "00:05:678"), Some(1234));
        assert_eq!(lock_owner(locks, "00:05:679"), None, "a waiter holds nothing");
        assert_eq!(lock_owner(locks, "00:05:1"), None);
    }

    #[test]
    fn access_to_a_locked_file_names_the_holder() {
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(matches!(access(file.path()), Access::Accessible));
        file.as_file().lock().unwrap();
        let Access::Refused(TransportError::Busy { holder: Some(holder), .. }) =
            access(file.path())
        else {
            panic!("{:?}", access(file.path()));
        };
        assert!(holder.contains(&format!("process {}", std::process::id())), "{holder}");
    }

    #[test]
    fn the_remedy_names_the_group_to_join() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let remedy = permission_remedy(file.path());
        assert!(remedy.contains("udev"), "{remedy}");
        assert!(!remedy.contains("usermod"), "0600 helps no group: {remedy}");
        let groups = fs::read_to_string("/etc/group").unwrap();
        let Some((gid, name)) =
            [20, 5, 46].iter().find_map(|&gid| Some((gid, group_name(&groups, gid)?)))
        else {
            eprintln!("skipped: none of the usual groups here");
            return;
        };
        if std::os::unix::fs::chown(file.path(), None, Some(gid)).is_err() {
            eprintln!("skipped: only root may give a file away");
            return;
        }
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o660);
        fs::set_permissions(file.path(), mode).unwrap();
        let remedy = permission_remedy(file.path());
        assert!(remedy.contains(&format!("sudo usermod -aG {name} $USER")), "{remedy}");
    }

    #[test]
    fn a_missing_file_is_not_found() {
        let missing = Path::new("/dev/mocapd-no-such-port");
        assert!(matches!(access(missing), Access::Refused(TransportError::NotFound { .. })));
    }
}
