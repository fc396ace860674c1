//! The bytes of a file that is read several times, at any place, without being held.
//!
//! It is read in pages, whose checksums are kept: if the content of a page differs when it is read again, another
//! program has changed the file, and earlier results are invalid.

use std::{
    collections::{HashMap, hash_map::Entry},
    fmt,
    io::{self, ErrorKind, Read, Seek, SeekFrom},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use super::InterchangeError;

/// Bytes of a page: large enough to make system calls cheap, and small enough for a file that is read in a few places
/// only.
const PAGE_BYTES: usize = 1 << 16;

/// An input that can be read at any place.
pub(super) trait SeekableRead: Read + Seek {}

impl<T: Read + Seek> SeekableRead for T {}

/// A file to import.
pub(super) struct SourceFile<'a> {
    input: Box<dyn SeekableRead + 'a>,
    len: u64,
    page: Vec<u8>,
    /// The number of the page that is held.
    held: Option<u64>,
    /// CRC-32 of each page that was read, by its number: 12 bytes for 64 KiB of the file.
    checksums: HashMap<u64, u32>,
    bytes_read: Arc<AtomicU64>,
}

impl<'a> SourceFile<'a> {
    /// Wraps an input, and adds the bytes that are read from it to `bytes_read`.
    ///
    /// # Errors
    /// Those of the input.
    pub(super) fn new(
        mut input: impl SeekableRead + 'a,
        bytes_read: Arc<AtomicU64>,
    ) -> io::Result<Self> {
        let len = input.seek(SeekFrom::End(0))?;
        let (page, held, checksums) = (Vec::new(), None, HashMap::new());
        Ok(Self { input: Box::new(input), len, page, held, checksums, bytes_read })
    }

    /// Length in bytes, when the file was opened.
    pub(super) fn len(&self) -> u64 {
        self.len
    }

    /// Fills `bytes` from byte `at` on.
    ///
    /// # Errors
    /// `UnexpectedEof` beyond the end; otherwise those of the input, or that the file has changed.
    pub(super) fn read_at(&mut self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        let n = self.read_some(at, bytes)?;
        if n == bytes.len() { Ok(()) } else { Err(ErrorKind::UnexpectedEof.into()) }
    }

    /// Reads as many bytes as there are from byte `at` on, at most all of `bytes`. Returns how many.
    ///
    /// # Errors
    /// Those of the input, or that the file has changed.
    pub(super) fn read_some(&mut self, mut at: u64, bytes: &mut [u8]) -> io::Result<usize> {
        let mut n_read = 0;
        while let Some(rest) = bytes.get_mut(n_read..).filter(|rest| !rest.is_empty())
            && at < self.len
        {
            let (number, skipped) = (at / PAGE_BYTES as u64, (at % PAGE_BYTES as u64) as usize);
            let n_page = self.page_len(number);
            let n = match rest.get_mut(..n_page).filter(|_| skipped == 0) {
                Some(page) => {
                    self.fetch(number, page)?;
                    n_page
                }
                None => {
                    self.hold(number)?;
                    let page = self.page.get(skipped..).unwrap_or_default();
                    let n = page.len().min(rest.len());
                    rest[..n].copy_from_slice(&page[..n]);
                    n
                }
            };
            n_read += n;
            at += n as u64;
        }
        Ok(n_read)
    }

    /// A reader of all bytes.
    pub(super) fn reader(&mut self) -> SourceReader<'_, 'a> {
        SourceReader { file: self, at: 0 }
    }

    /// The end of the last byte that is not zero.
    ///
    /// # Errors
    /// Those of the input, or that the file has changed.
    pub(super) fn filled(&mut self) -> io::Result<u64> {
        for number in (0..self.len.div_ceil(PAGE_BYTES as u64)).rev() {
            self.hold(number)?;
            if let Some(last) = self.page.iter().rposition(|&byte| byte != 0) {
                return Ok(number * PAGE_BYTES as u64 + last as u64 + 1);
            }
        }
        Ok(0)
    }

    /// Bytes of a page: fewer than usual for the last one.
    fn page_len(&self, number: u64) -> usize {
        let left = self.len.saturating_sub(number.saturating_mul(PAGE_BYTES as u64));
        left.min(PAGE_BYTES as u64) as usize
    }

    fn hold(&mut self, number: u64) -> io::Result<()> {
        if self.held == Some(number) {
            return Ok(());
        }
        self.held = None;
        let mut page = std::mem::take(&mut self.page);
        page.resize(self.page_len(number), 0);
        self.fetch(number, &mut page)?;
        (self.page, self.held) = (page, Some(number));
        Ok(())
    }

    /// Reads a page and compares its checksum with that of an earlier read.
    fn fetch(&mut self, number: u64, page: &mut [u8]) -> io::Result<()> {
        self.input.seek(SeekFrom::Start(number * PAGE_BYTES as u64))?;
        self.input.read_exact(page).map_err(|error| match error.kind() {
            ErrorKind::UnexpectedEof => changed(),
            _ => error,
        })?;
        self.bytes_read.fetch_add(page.len() as u64, Ordering::Relaxed);
        let checksum = crc32fast::hash(page);
        match self.checksums.entry(number) {
            Entry::Vacant(vacant) => {
                vacant.insert(checksum);
                Ok(())
            }
            Entry::Occupied(before) if *before.get() == checksum => Ok(()),
            Entry::Occupied(_) => Err(changed()),
        }
    }
}

fn changed() -> io::Error {
    io::Error::other(InterchangeError::Changed)
}

impl fmt::Debug for SourceFile<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SourceFile").field("len", &self.len).finish_non_exhaustive()
    }
}

/// Reads a file from its beginning to its end.
#[derive(Debug)]
pub(super) struct SourceReader<'s, 'a> {
    file: &'s mut SourceFile<'a>,
    at: u64,
}

impl Read for SourceReader<'_, '_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let n = self.file.read_some(self.at, bytes)?;
        self.at += n as u64;
        Ok(n)
    }
}

#[cfg(test)]
mod tests {
    use std::{cell::RefCell, io::Cursor, rc::Rc};

    use super::*;

    fn bytes(len: usize) -> Vec<u8> {
        (0..len).map(|i| (i * i / 7) as u8).collect()
    }

    fn open(bytes: &[u8]) -> (SourceFile<'_>, Arc<AtomicU64>) {
        let n_read = Arc::new(AtomicU64::new(0));
        (SourceFile::new(Cursor::new(bytes), Arc::clone(&n_read)).unwrap(), n_read)
    }

    #[test]
    fn every_offset_reads_the_same_bytes() {
        let all = bytes(2 * PAGE_BYTES + 100);
        let (mut file, n_read) = open(&all);
        assert_eq!(file.len(), all.len() as u64);
        for at in [0, 1, PAGE_BYTES - 1, PAGE_BYTES, 2 * PAGE_BYTES, all.len() - 1, all.len()] {
            for len in [0, 1, 3, 99, PAGE_BYTES, PAGE_BYTES + 1, 3 * PAGE_BYTES] {
                let mut read = vec![0; len];
                let n = file.read_some(at as u64, &mut read).unwrap();
                assert_eq!(n, len.min(all.len() - at));
                assert_eq!(read[..n], all[at..at + n], "{len} bytes from {at}");
                assert_eq!(file.read_at(at as u64, &mut read).is_ok(), n == len);
            }
        }
        n_read.store(0, Ordering::Relaxed);
        let mut read = Vec::new();
        file.reader().read_to_end(&mut read).unwrap();
        assert!(read == all);
        assert!(n_read.load(Ordering::Relaxed) >= all.len() as u64);
    }

    #[test]
    fn zeros_at_the_end_are_found() {
        for (n_filled, n_zeros) in [(0, 0), (0, 9), (1, PAGE_BYTES), (PAGE_BYTES, 5), (700, 1)] {
            let all = [vec![1; n_filled], vec![0; n_zeros]].concat();
            assert_eq!(open(&all).0.filled().unwrap(), n_filled as u64);
        }
    }

    /// A file that others write to.
    struct Shared(Rc<RefCell<Vec<u8>>>, u64);

    impl Read for Shared {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            let all = self.0.borrow();
            let n = (&all[(self.1 as usize).min(all.len())..]).read(bytes)?;
            self.1 += n as u64;
            Ok(n)
        }
    }

    impl Seek for Shared {
        fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
            self.1 = match to {
                SeekFrom::Start(at) => at,
                _ => self.0.borrow().len() as u64,
            };
            Ok(self.1)
        }
    }

    #[test]
    fn a_change_between_two_reads_is_an_error() {
        let read_all = |file: &mut SourceFile<'_>| io::copy(&mut file.reader(), &mut io::sink());
        let changes: [fn(&mut Vec<u8>); 3] =
            [|all| all[PAGE_BYTES + 5] ^= 1, |all| all.truncate(PAGE_BYTES), Vec::clear];
        for change in changes {
            let shared = Rc::new(RefCell::new(bytes(3 * PAGE_BYTES)));
            let mut file = SourceFile::new(Shared(Rc::clone(&shared), 0), Arc::default()).unwrap();
            assert_eq!(read_all(&mut file).unwrap(), 3 * PAGE_BYTES as u64);
            // What is appended is not read, and not missed.
            shared.borrow_mut().push(7);
            assert_eq!(read_all(&mut file).unwrap(), 3 * PAGE_BYTES as u64);
            change(&mut shared.borrow_mut());
            let error = read_all(&mut file).unwrap_err();
            assert_eq!(error.to_string(), "another program changed it while it was being read");
        }
    }
}
