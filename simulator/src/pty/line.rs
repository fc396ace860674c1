//! The pty pair and the link to it.

use std::ffi::OsString;
use std::fs;
use std::io::{self, ErrorKind};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use super::PtyError;

/// An open pty: the device's end, and the path of the host's end. Dropping it hangs up and removes the link.
#[derive(Debug)]
pub struct PtyLine {
    master: OwnedFd,
    /// Kept open so that hosts may come and go: without it the master fails with EIO between two of them.
    slave: OwnedFd,
    slave_path: PathBuf,
    link: Option<PathBuf>,
}

impl PtyLine {
    /// A raw, 8-bit clean pty. With a `link`, a symbolic link to it is made there, in place of a dead one.
    ///
    /// # Errors
    /// When the kernel gives no pty, or the link cannot be made.
    pub fn open(link: Option<&Path>) -> Result<Self, PtyError> {
        let failed =
            |action| move |e: rustix::io::Errno| PtyError::Open { action, source: e.into() };
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
        if let Some(link) = link {
            make_link(&slave_path, link)?;
        }
        Ok(Self { master, slave, slave_path, link: link.map(Path::to_owned) })
    }

    /// The path that a host opens: the link when there is one.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.link.as_deref().unwrap_or(&self.slave_path)
    }

    pub(super) fn master(&self) -> BorrowedFd<'_> {
        self.master.as_fd()
    }

    /// Bytes that the host could read now and has not.
    pub(super) fn unread(&self) -> io::Result<u64> {
        Ok(rustix::io::ioctl_fionread(&self.slave)?)
    }

    /// Lets a new host in after one that was killed.
    ///
    /// Serial programs open with TIOCEXCL. The kernel keeps that mark as long as our end is open, so that a host
    /// that could not take it back would leave the line busy for ever. Their flock still keeps two hosts apart.
    pub(super) fn clear_exclusive(&self) -> io::Result<()> {
        Ok(rustix::termios::ioctl_tiocnxcl(&self.slave)?)
    }
}

impl Drop for PtyLine {
    fn drop(&mut self) {
        if let Some(link) = &self.link
            && fs::read_link(link).is_ok_and(|target| target == self.slave_path)
            && fs::remove_file(link).is_err()
        {
            // A dead link stays, which the next simulator replaces.
        }
    }
}

fn make_link(target: &Path, link: &Path) -> Result<(), PtyError> {
    let failed = |source| PtyError::Link { path: link.to_owned(), source };
    let is_link = fs::symlink_metadata(link).is_ok_and(|m| m.file_type().is_symlink());
    if is_link && matches!(fs::metadata(link), Err(e) if e.kind() == ErrorKind::NotFound) {
        fs::remove_file(link).map_err(failed)?;
    }
    std::os::unix::fs::symlink(target, link).map_err(|e| match e.kind() {
        ErrorKind::AlreadyExists => PtyError::LinkExists { path: link.to_owned() },
        _ => failed(e),
    })
}
