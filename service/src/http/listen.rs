//! Sockets to listen on.

use std::{
    fs,
    io::ErrorKind,
    net::SocketAddr,
    os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt},
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use tokio::net::{TcpListener, TcpSocket, UnixListener, UnixSocket};

/// Connections that the kernel holds until they are accepted, which is at once.
const BACKLOG: u32 = 128;

/// Who may open the socket: its owner and its group, who may then do everything.
const SOCKET_MODE: u32 = 0o660;

/// A listening Unix socket. Its file goes with it.
#[derive(Debug)]
pub(super) struct UnixDoor {
    listener: UnixListener,
    file: SocketFile,
}

/// The file of a socket; it is removed when this is dropped.
#[derive(Debug)]
pub(super) struct SocketFile {
    path: PathBuf,
    inode: u64,
}

/// Listens on `path`. A socket that a killed service left there makes way; one that answers does not.
pub(super) fn unix(path: &Path) -> anyhow::Result<UnixDoor> {
    make_way(path)?;
    let context = || format!("cannot listen on {}", path.display());
    let socket = UnixSocket::new_stream().with_context(context)?;
    socket.bind(path).with_context(context)?;
    // Before it listens nobody can connect, so nobody comes in with another mode.
    fs::set_permissions(path, fs::Permissions::from_mode(SOCKET_MODE)).with_context(context)?;
    let inode = fs::symlink_metadata(path).with_context(context)?.ino();
    let file = SocketFile { path: path.to_owned(), inode };
    let listener = socket.listen(BACKLOG).with_context(context)?;
    Ok(UnixDoor { listener, file })
}

fn make_way(path: &Path) -> anyhow::Result<()> {
    let found = match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        found => found.with_context(|| format!("cannot look at {}", path.display()))?,
    };
    if !found.file_type().is_socket() {
        bail!("{} exists and is no socket: name another path, or move it away", path.display());
    }
    match std::os::unix::net::UnixStream::connect(path) {
        Ok(_) => bail!("another service answers on {}: stop it first", path.display()),
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => fs::remove_file(path)
            .with_context(|| format!("cannot remove {}, which nobody answers on", path.display())),
        // Full, or not ours: somebody may be behind it.
        Err(error) => Err(error).with_context(|| {
            format!("cannot tell whether a service answers on {}", path.display())
        }),
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        // Another service's by now, where this one's was taken away.
        if fs::symlink_metadata(&self.path).is_ok_and(|found| found.ino() == self.inode) {
            // One that stays is removed by the next start.
            fs::remove_file(&self.path).ok();
        }
    }
}

impl UnixDoor {
    /// What is listened with, and what stands for the file: dropped, it is removed.
    pub(super) fn into_parts(self) -> (UnixListener, SocketFile) {
        (self.listener, self.file)
    }
}

/// Listens on an address.
pub(super) fn tcp(address: SocketAddr) -> anyhow::Result<TcpListener> {
    let context =
        || format!("cannot listen on {address}: choose another port, or stop what listens there");
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() };
    let socket = socket.with_context(context)?;
    // A port that was left a moment ago can be used again.
    socket.set_reuseaddr(true).with_context(context)?;
    socket.bind(address).with_context(context)?;
    socket.listen(BACKLOG).with_context(context)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stale_socket_makes_way_and_nothing_else_does() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build().unwrap();
        let _inside = runtime.enter();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.sock");
        // Left behind: closed without its file.
        drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
        let door = unix(&path).unwrap();
        let mode = fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o660);
        let second = unix(&path).unwrap_err().to_string();
        assert!(second.contains("another service answers"), "{second}");
        drop(door);
        assert!(!path.exists(), "the file goes with the listener");
        fs::write(&path, "mine").unwrap();
        assert!(unix(&path).unwrap_err().to_string().contains("no socket"));
        assert_eq!(fs::read(&path).unwrap(), b"mine");
        assert!(unix(&folder.path().join("no/s.sock")).is_err());
    }

    #[test]
    fn the_file_of_another_service_stays() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build().unwrap();
        let _inside = runtime.enter();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.sock");
        let door = unix(&path).unwrap();
        fs::rename(&path, folder.path().join("kept.sock")).unwrap();
        let other = unix(&path).unwrap();
        drop(door);
        assert!(path.exists());
        drop(other);
        assert!(!path.exists());
    }
}
