//! Takes on the way from the disk: holes of a sparse file are not read.

use std::{
    fs::File,
    io::{self, Read, Seek, SeekFrom},
    ops::Range,
    os::unix::fs::FileExt,
    path::Path,
};

use rustix::{fs::seek, io::Errno};

/// A file to read whose holes are zeros without a read: a file system fills memory with them, for as long as a file
/// claims to be, in ten times the time.
#[derive(Debug)]
pub struct SparseFile {
    file: File,
    at: u64,
    hole: Range<u64>,
    data: Range<u64>,
}

impl SparseFile {
    /// Opens a file.
    ///
    /// # Errors
    /// As [`open`](super::open).
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        super::open(path).map(Self::of)
    }

    /// A file that is open, from its beginning.
    #[must_use]
    pub fn of(file: File) -> Self {
        Self { file, at: 0, hole: 0..0, data: 0..0 }
    }

    /// How long it is, holes included.
    ///
    /// # Errors
    /// The system's.
    pub fn len_bytes(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    /// What there is here: data or a hole, and up to where.
    fn look(&mut self) -> io::Result<()> {
        let at = self.at;
        (self.hole, self.data) = match seek(&self.file, rustix::fs::SeekFrom::Data(at)) {
            Ok(data) if data > at => (at..data, 0..0),
            Ok(_) => {
                let end = seek(&self.file, rustix::fs::SeekFrom::Hole(at)).unwrap_or(u64::MAX);
                (0..0, at..end)
            }
            // Nothing but a hole up to the end, or the end.
            Err(Errno::NXIO) => (at..self.len_bytes()?, 0..0),
            // A file system that knows of no holes.
            Err(_) => (0..0, at..u64::MAX),
        };
        Ok(())
    }
}

impl Read for SparseFile {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if !self.hole.contains(&self.at) && !self.data.contains(&self.at) {
            self.look()?;
        }
        let up_to = |end: u64| {
            let left = usize::try_from(end - self.at).unwrap_or(usize::MAX);
            bytes.len().min(left)
        };
        let n = if self.hole.contains(&self.at) {
            let n = up_to(self.hole.end);
            bytes[..n].fill(0);
            n
        } else if self.data.contains(&self.at) {
            let n = up_to(self.data.end);
            self.file.read_at(&mut bytes[..n], self.at)?
        } else {
            0
        };
        self.at += n as u64;
        Ok(n)
    }
}

impl Seek for SparseFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let beyond = || io::Error::from(io::ErrorKind::InvalidInput);
        self.at = match to {
            SeekFrom::Start(at) => at,
            SeekFrom::Current(by) => self.at.checked_add_signed(by).ok_or_else(beyond)?,
            SeekFrom::End(by) => self.len_bytes()?.checked_add_signed(by).ok_or_else(beyond)?,
        };
        Ok(self.at)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn holes_are_zeros_and_data_is_where_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("holes");
        let mut file = File::create(&path).unwrap();
        file.write_all(b"first").unwrap();
        file.seek(SeekFrom::Start(300_000)).unwrap();
        file.write_all(b"second").unwrap();
        file.set_len(700_000).unwrap();
        let mut wanted = Vec::new();
        File::open(&path).unwrap().read_to_end(&mut wanted).unwrap();
        let mut holes = SparseFile::open(&path).unwrap();
        assert_eq!(holes.len_bytes().unwrap(), 700_000);
        for from in [0, 3, 299_999, 300_003, 699_999, 700_000, 800_000] {
            assert_eq!(holes.seek(SeekFrom::Start(from as u64)).unwrap(), from as u64);
            let mut read = Vec::new();
            holes.read_to_end(&mut read).unwrap();
            assert!(read == wanted.get(from..).unwrap_or_default(), "from byte {from}");
        }
        assert_eq!(holes.seek(SeekFrom::End(-400_000)).unwrap(), 300_000);
        assert_eq!(holes.seek(SeekFrom::Current(2)).unwrap(), 300_002);
        let mut read = [0; 4];
        holes.read_exact(&mut read).unwrap();
        assert_eq!(&read, b"cond");
        // What is appended meanwhile is found.
        file.seek(SeekFrom::End(0)).unwrap();
        holes.seek(SeekFrom::End(0)).unwrap();
        assert_eq!(holes.read(&mut read).unwrap(), 0);
        file.write_all(b"more").unwrap();
        holes.read_exact(&mut read).unwrap();
        assert_eq!(&read, b"more");
    }
}
