//! Opens regular files only, so that reading to the end of input cannot block.

use std::{
    fs::{self, File, FileType},
    io,
    os::unix::fs::FileTypeExt,
    path::Path,
};

use rustix::fs::{Mode, OFlags};

/// Kinds of file that are not regular files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NotAFile {
    /// A directory.
    #[error("a folder, not a file")]
    Folder,
    /// A FIFO: opening it blocks until there is a writer, and it may never end.
    #[error("a pipe, not a file: write its content to a file first")]
    Pipe,
    /// A socket.
    #[error("a socket, not a file")]
    Socket,
    /// A character or block device: it may never end, and opening it can have side effects.
    #[error("a device, not a file")]
    Device,
}

impl NotAFile {
    fn of(kind: FileType) -> Option<Self> {
        match kind {
            _ if kind.is_dir() => Some(Self::Folder),
            _ if kind.is_fifo() => Some(Self::Pipe),
            _ if kind.is_socket() => Some(Self::Socket),
            _ if kind.is_char_device() || kind.is_block_device() => Some(Self::Device),
            _ => None,
        }
    }

    /// Returns the `NotAFile` inside an error of [`open`], if that was the reason.
    #[must_use]
    pub fn why(error: &io::Error) -> Option<Self> {
        error.get_ref().and_then(|source| source.downcast_ref()).copied()
    }
}

/// Opens a regular file, or a link to one, for reading. Never blocks.
///
/// # Errors
/// The operating system's error; [`NotAFile`] as its source for anything but a regular file.
pub fn open(path: &Path) -> io::Result<File> {
    // Before opening it, which has side effects on a device.
    require_regular(fs::metadata(path)?.file_type())?;
    // The path may have been replaced since: opening a pipe must not block then either.
    let flags = OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = File::from(rustix::fs::open(path, flags, Mode::empty())?);
    require_regular(file.metadata()?.file_type())?;
    Ok(file)
}

fn require_regular(kind: FileType) -> io::Result<()> {
    NotAFile::of(kind).map_or(Ok(()), |what| Err(io::Error::other(what)))
}

#[cfg(test)]
mod tests {
    use std::os::unix::{fs::symlink, net::UnixListener};

    use super::*;

    #[test]
    fn everything_but_a_regular_file_is_refused_without_blocking() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(path("plain"), b"it").unwrap();
        symlink("plain", path("link")).unwrap();
        symlink("/dev/zero", path("device")).unwrap();
        rustix::fs::mknodat(
            rustix::fs::CWD,
            path("pipe"),
            rustix::fs::FileType::Fifo,
            Mode::RUSR | Mode::WUSR,
            0,
        )
        .unwrap();
        let _listener = UnixListener::bind(path("socket")).unwrap();
        let why = |name: &str| open(&path(name)).err().and_then(|error| NotAFile::why(&error));
        assert_eq!(why("pipe"), Some(NotAFile::Pipe));
        assert_eq!(why("socket"), Some(NotAFile::Socket));
        assert_eq!(why("device"), Some(NotAFile::Device));
        assert_eq!(why("."), Some(NotAFile::Folder));
        assert_eq!(io::read_to_string(open(&path("link")).unwrap()).unwrap(), "it");
        assert_eq!(open(&path("none")).unwrap_err().kind(), io::ErrorKind::NotFound);
    }
}
