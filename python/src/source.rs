//! The bytes of a take in a file or in memory, which several threads read at independent positions.

#[cfg(unix)]
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::{
    fs::{File, FileType, OpenOptions},
    io::{self, Read, Seek, SeekFrom},
    path::Path,
    sync::Arc,
};

use crate::{background::Cancel, errors::Failure};

/// The bytes of a take, read until cancelled.
#[derive(Debug, Clone)]
pub(crate) struct Source {
    bytes: Bytes,
    cancel: Cancel,
}

/// Where the bytes are.
#[derive(Debug, Clone)]
enum Bytes {
    File(Arc<File>),
    Memory(Arc<[u8]>),
}

/// The system's error numbers for a folder and for an invalid argument.
const EISDIR: i32 = 21;
#[cfg(unix)]
const EINVAL: i32 = 22;

impl Source {
    /// Opens a plain file. Never blocks, not even on a pipe or a device.
    pub(crate) fn open(path: &Path) -> Result<Self, Failure> {
        if path.as_os_str().as_encoded_bytes().contains(&0) {
            let shown = path.to_string_lossy().replace('\0', "\\0");
            return Err(Failure::Value(format!("{shown}: a path cannot contain a zero byte")));
        }
        // Checked before opening, which may have an effect on a device, and again after: it may have been replaced.
        check(std::fs::metadata(path)?.file_type())?;
        let mut options = OpenOptions::new();
        options.read(true);
        #[cfg(unix)]
        options.custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY);
        let file = options.open(path)?;
        check(file.metadata()?.file_type())?;
        Ok(Self { bytes: Bytes::File(Arc::new(file)), cancel: Cancel::default() })
    }

    pub(crate) fn from_bytes(bytes: &[u8]) -> Self {
        Self { bytes: Bytes::Memory(Arc::from(bytes)), cancel: Cancel::default() }
    }

    /// A source of the same bytes, readable until `cancel` is set.
    pub(crate) fn with_cancel(&self, cancel: &Cancel) -> Self {
        Self { bytes: self.bytes.clone(), cancel: cancel.clone() }
    }

    /// Fails with `TimedOut` once cancelled.
    pub(crate) fn check(&self) -> io::Result<()> {
        self.cancel.check()
    }

    /// A reader with a separate position, at the start.
    pub(crate) fn reader(&self) -> Reader {
        Reader { source: self.clone(), at: 0 }
    }

    fn len(&self) -> io::Result<u64> {
        match &self.bytes {
            Bytes::File(file) => Ok(file.metadata()?.len()),
            Bytes::Memory(bytes) => Ok(bytes.len() as u64),
        }
    }
}

/// Fails with the error number and a description of a file that is not a plain one.
#[cfg(unix)]
fn check(kind: FileType) -> Result<(), Failure> {
    let (code, what) = match kind {
        _ if kind.is_dir() => (EISDIR, "a folder, not a file"),
        _ if kind.is_fifo() => (EINVAL, "a pipe, not a file: write its content to a file first"),
        _ if kind.is_socket() => (EINVAL, "a socket, not a file"),
        _ if kind.is_char_device() || kind.is_block_device() => (EINVAL, "a device, not a file"),
        _ => return Ok(()),
    };
    Err(Failure::NotAFile(code, what))
}

#[cfg(not(unix))]
fn check(kind: FileType) -> Result<(), Failure> {
    if kind.is_dir() { Err(Failure::NotAFile(EISDIR, "a folder, not a file")) } else { Ok(()) }
}

/// A position in a [`Source`].
#[derive(Debug)]
pub(crate) struct Reader {
    source: Source,
    at: u64,
}

impl Read for Reader {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.source.check()?;
        let n = match &self.source.bytes {
            Bytes::File(file) => read_at(file, buffer, self.at)?,
            Bytes::Memory(bytes) => {
                let at = usize::try_from(self.at).unwrap_or(usize::MAX);
                bytes.get(at..).unwrap_or_default().read(buffer)?
            }
        };
        self.at += n as u64;
        Ok(n)
    }
}

impl Seek for Reader {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::End(by) => self.source.len()?.checked_add_signed(by),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        self.at = at.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}

/// Fills `bytes` from byte `at` of a file, or fails.
pub(crate) fn read_exact_at(file: &File, mut bytes: &mut [u8], mut at: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        match read_at(file, bytes, at) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(n) => {
                bytes = &mut bytes[n..];
                at += n as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Writes all of `bytes` at byte `at` of a file.
pub(crate) fn write_all_at(file: &File, mut bytes: &[u8], mut at: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        match write_at(file, bytes, at) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(n) => {
                bytes = &bytes[n..];
                at += n as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(unix)]
fn read_at(file: &File, buffer: &mut [u8], at: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, buffer, at)
}

#[cfg(unix)]
fn write_at(file: &File, bytes: &[u8], at: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::write_at(file, bytes, at)
}

#[cfg(windows)]
fn read_at(file: &File, buffer: &mut [u8], at: u64) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_read(file, buffer, at)
}

#[cfg(windows)]
fn write_at(file: &File, bytes: &[u8], at: u64) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_write(file, bytes, at)
}
