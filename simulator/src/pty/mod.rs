//! A pseudo-terminal (pty) as the device's line: hosts open its path like a serial port.

use std::ffi::OsString;
use std::fs;
use std::io::{self, ErrorKind};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::OFlags;
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use crate::device::{LineDevice, SentLog};
use crate::line::Line;
pub use crate::line::ServeOptions;

/// Errors of a pty.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PtyError {
    /// The system could not open a pty.
    #[error("cannot open a pty ({action}): is /dev/pts mounted?")]
    Open {
        /// The call that failed.
        action: &'static str,
        /// The system's error.
        source: io::Error,
    },
    /// The link's path exists already.
    #[error("{} exists and is not a dead link: remove it or choose another name", path.display())]
    LinkExists {
        /// The link.
        path: PathBuf,
    },
    /// The link could not be created.
    #[error("cannot create the link {}: choose an existing, writable folder", path.display())]
    Link {
        /// The link.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Serving the line failed.
    #[error(transparent)]
    Line(#[from] crate::line::LineError),
}

/// An open pty: the device's end, and the path of the host's end. Dropping it hangs up, and removes the link.
#[derive(Debug)]
pub struct PtyLine {
    /// `None` while unplugged.
    pair: Option<Pair>,
    /// The path that a host opens without a link.
    slave_path: PathBuf,
    link: Option<PathBuf>,
}

#[derive(Debug)]
struct Pair {
    master: OwnedFd,
    /// Kept open so that hosts can come and go: without it, the master fails with EIO when no host has it open.
    slave: OwnedFd,
    slave_path: PathBuf,
}

impl Pair {
    /// Opens a raw, 8-bit clean pty.
    fn open() -> Result<Self, PtyError> {
        let failed = |action| move |e: Errno| PtyError::Open { action, source: e.into() };
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let master = openpt(flags).map_err(failed("openpt"))?;
        grantpt(&master).map_err(failed("grantpt"))?;
        unlockpt(&master).map_err(failed("unlockpt"))?;
        let name = ptsname(&master, Vec::new()).map_err(failed("ptsname"))?;
        let slave_path = PathBuf::from(OsString::from_vec(name.into_bytes()));
        let slave_flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let slave = rustix::fs::open(&slave_path, slave_flags, rustix::fs::Mode::empty())
            .map_err(failed("opening its other end"))?;
        let mut termios = tcgetattr(&slave).map_err(failed("tcgetattr"))?;
        termios.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &termios).map_err(failed("tcsetattr"))?;
        rustix::io::ioctl_fionbio(&master, true).map_err(failed("fionbio"))?;
        Ok(Self { master, slave, slave_path })
    }
}

impl PtyLine {
    /// Opens a raw, 8-bit clean pty. With `link`, creates a symbolic link to it there and replaces a dangling one.
    ///
    /// # Errors
    /// When the system cannot open a pty, or the link cannot be created.
    pub fn open(link: Option<&Path>) -> Result<Self, PtyError> {
        let pair = Pair::open()?;
        if let Some(link) = link {
            make_link(&pair.slave_path, link)?;
        }
        let slave_path = pair.slave_path.clone();
        Ok(Self { pair: Some(pair), slave_path, link: link.map(Path::to_owned) })
    }

    /// The path that a host opens: the link, if there is one.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.link.as_deref().unwrap_or(&self.slave_path)
    }

    fn remove_link(&self) {
        if let Some(link) = &self.link
            && fs::read_link(link).is_ok_and(|target| target == self.slave_path)
            && fs::remove_file(link).is_err()
        {
            // The link stays; the next simulator replaces dangling links.
        }
    }
}

impl Line for PtyLine {
    fn name(&self) -> &'static str {
        "pty"
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Some(Pair { master, .. }) = &self.pair else { return Ok(0) };
        or_nothing(rustix::io::write(master, bytes))
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let Some(Pair { master, .. }) = &self.pair else { return Ok(0) };
        or_nothing(rustix::io::read(master, buffer))
    }

    fn wait(&mut self, at_most: Duration) -> io::Result<bool> {
        match &self.pair {
            Some(Pair { master, .. }) => wait_readable(master.as_fd(), at_most),
            None => wait_for(&mut [], at_most),
        }
    }

    /// Bytes that the host could read now: 0 only if it has read all that was written.
    fn unread(&mut self) -> io::Result<u64> {
        let Some(Pair { slave, .. }) = &self.pair else { return Ok(0) };
        // FIONREAD leaves out what the kernel's worker has not moved to the host's end yet. A poll of that end waits for the
        // worker.
        wait_readable(slave.as_fd(), Duration::ZERO)?;
        Ok(rustix::io::ioctl_fionread(slave)?)
    }

    fn unplug(&mut self) -> io::Result<()> {
        self.remove_link();
        self.pair = None;
        Ok(())
    }

    /// Opens another pty; only a link makes it the same device to a host.
    fn plug_in(&mut self) -> io::Result<()> {
        let pair = Pair::open().map_err(io::Error::other)?;
        if let Some(link) = &self.link {
            make_link(&pair.slave_path, link).map_err(io::Error::other)?;
        }
        self.slave_path.clone_from(&pair.slave_path);
        self.pair = Some(pair);
        Ok(())
    }

    /// Clears exclusive mode, so that a new host can open the line after one was killed.
    ///
    /// Serial programs set TIOCEXCL. The kernel keeps it while the simulator's end is open, so a killed host would
    /// leave the line busy for ever. Their flock still keeps two hosts apart.
    fn maintain(&mut self) -> io::Result<()> {
        let Some(Pair { slave, .. }) = &self.pair else { return Ok(()) };
        Ok(rustix::termios::ioctl_tiocnxcl(slave)?)
    }
}

/// Turns a transfer that would block or was interrupted into one of 0 bytes.
pub(crate) fn or_nothing(outcome: Result<usize, Errno>) -> io::Result<usize> {
    match outcome {
        Err(Errno::AGAIN | Errno::INTR) => Ok(0),
        outcome => Ok(outcome?),
    }
}

/// Waits at most this long for something to read.
pub(crate) fn wait_readable(fd: BorrowedFd<'_>, at_most: Duration) -> io::Result<bool> {
    wait_for(&mut [PollFd::new(&fd, PollFlags::IN)], at_most)
}

fn wait_for(fds: &mut [PollFd<'_>], at_most: Duration) -> io::Result<bool> {
    let timeout =
        Timespec { tv_sec: at_most.as_secs() as i64, tv_nsec: i64::from(at_most.subsec_nanos()) };
    match poll(fds, Some(&timeout)) {
        Ok(n) => Ok(n > 0),
        Err(Errno::INTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

impl Drop for PtyLine {
    fn drop(&mut self) {
        self.remove_link();
    }
}

fn make_link(target: &Path, link: &Path) -> Result<(), PtyError> {
    let failed = |source| PtyError::Link { path: link.to_owned(), source };
    let is_link = fs::symlink_metadata(link).is_ok_and(|m| m.file_type().is_symlink());
    // A dangling link may look valid, because this pty can have the number of an earlier one.
    let is_ours = || fs::read_link(link).is_ok_and(|old| old == target);
    let is_dead = || matches!(fs::metadata(link), Err(e) if e.kind() == ErrorKind::NotFound);
    if is_link && (is_ours() || is_dead()) {
        fs::remove_file(link).map_err(failed)?;
    }
    std::os::unix::fs::symlink(target, link).map_err(|e| match e.kind() {
        ErrorKind::AlreadyExists => PtyError::LinkExists { path: link.to_owned() },
        _ => failed(e),
    })
}

#[cfg(test)]
mod tests;

/// Serves a device on an open pty; see [`line::serve`](crate::line::serve).
///
/// # Errors
/// When the line or the log fails.
pub fn serve(
    line: &mut PtyLine,
    device: &mut dyn LineDevice,
    options: ServeOptions,
    stop: &AtomicBool,
) -> Result<SentLog, PtyError> {
    Ok(crate::line::serve(line, device, options, stop)?)
}

/// Opens a pty and serves a device on it, on the caller's thread, until `stop` is set; with `options.once`, until the
/// host has read the end of stream. `on_open` receives the path that a host opens.
///
/// # Errors
/// When the pty or its link cannot be created, or when the line or the log fails.
pub fn serve_pty(
    device: &mut dyn LineDevice,
    link: Option<&Path>,
    options: ServeOptions,
    stop: &AtomicBool,
    on_open: impl FnOnce(&Path),
) -> Result<SentLog, PtyError> {
    let mut line = PtyLine::open(link)?;
    on_open(line.path());
    serve(&mut line, device, options, stop)
}
