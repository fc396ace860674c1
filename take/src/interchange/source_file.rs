//! A file that is read several times without being held: its bytes, at any place, or its lines, if it is a text file.
//!
//! It is read in pages, whose checksums are kept: if the content of a page differs when it is read again, another
//! program has changed the file, and earlier results are invalid.

use std::{
    collections::{HashMap, hash_map::Entry},
    fmt,
    io::{self, BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use super::{
    InterchangeError, Result,
    text::{self, Separator},
};
use crate::stretch::CHANNELS_MAX;

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

/// Maximum number of bytes of a line: of each coordinate of as many markers as a take can have, 42 bytes, twice the
/// digits of an f64. Without a bound, a file without line ends would be held as a whole.
const LINE_BYTES_MAX: usize = 1 << 23;

/// Maximum number of bytes of the lines above the data: two of the longest.
const HEADER_BYTES_MAX: usize = 2 * LINE_BYTES_MAX;

/// Bytes that are read at a time: a page of the source.
const BUFFER_BYTES: usize = 1 << 16;

/// Appends a line in the layout that the readers expect to the bytes.
pub(super) type Conversion = dyn Fn(&[u8], &mut Vec<u8>);

/// A text file.
pub(super) struct TextFile<'s, 'a> {
    format: &'static str,
    source: &'s mut SourceFile<'a>,
    conversion: Option<Box<Conversion>>,
}

/// A line, without the byte order mark and the line end (LF or CRLF).
#[derive(Debug, Clone, Copy)]
pub(super) struct Line<'l> {
    /// Its number, from 1.
    pub(super) number: usize,
    pub(super) bytes: &'l [u8],
    /// Whether the file ends before the line does.
    pub(super) is_open: bool,
}

impl<'s, 'a> TextFile<'s, 'a> {
    /// A file of a format, whose name is for messages.
    pub(super) fn new(format: &'static str, source: &'s mut SourceFile<'a>) -> Self {
        Self { format, source, conversion: None }
    }

    /// Converts each line.
    pub(super) fn convert(&mut self, conversion: Box<Conversion>) {
        self.conversion = Some(conversion);
    }

    /// Replaces decimal commas by points in lines that begin with a number or one of `names`, if cells are between tabs and
    /// no such line has a number with a point: then commas separate thousands.
    ///
    /// # Errors
    /// Those of [`Lines::next`].
    pub(super) fn use_decimal_points(&mut self, names: &'static [&'static [u8]]) -> Result<()> {
        let is_of_numbers = move |line: &[u8]| {
            let first = Separator::TAB.cells(line).next().unwrap_or_default().trim_ascii();
            text::number(first).is_some()
                || text::with_point(first).is_some()
                || names.contains(&first)
        };
        let mut has_commas = false;
        let mut lines = self.lines();
        while let Some(Line { bytes: line, .. }) = lines.next()? {
            let may_have = line.contains(&b'\t') && (line.contains(&b',') || line.contains(&b'.'));
            if !may_have || !is_of_numbers(line) {
                continue;
            }
            let has_point = |cell: &[u8]| cell.contains(&b'.') && text::number(cell).is_some();
            if Separator::TAB.cells(line).any(has_point) {
                return Ok(());
            }
            has_commas |= Separator::TAB.cells(line).any(|cell| text::with_point(cell).is_some());
        }
        if has_commas {
            self.convert(Box::new(move |line, out| {
                if !is_of_numbers(line) {
                    out.extend_from_slice(line);
                    return;
                }
                for (index, cell) in Separator::TAB.cells(line).enumerate() {
                    out.extend((index > 0).then_some(b'\t'));
                    match text::with_point(cell) {
                        Some(number) => out.extend_from_slice(&number),
                        None => out.extend_from_slice(cell),
                    }
                }
            }));
        }
        Ok(())
    }

    /// All lines. An empty file has one, which is empty.
    pub(super) fn lines(&mut self) -> Lines<'_, 'a> {
        Lines {
            input: BufReader::with_capacity(BUFFER_BYTES, self.source.reader()),
            format: self.format,
            conversion: self.conversion.as_deref(),
            raw: Vec::new(),
            converted: Vec::new(),
            number: 0,
            n_bytes: 0,
            is_open: false,
        }
    }

    /// The lines below the first `n`.
    ///
    /// # Errors
    /// Those of [`Lines::next`].
    pub(super) fn lines_below(&mut self, n: usize) -> Result<Lines<'_, 'a>> {
        let mut lines = self.lines();
        while lines.number < n && lines.next()?.is_some() {}
        Ok(lines)
    }

    /// Whether the last number of an [open](Lines::is_open) file is probably cut off: every other number of that column
    /// has more decimals. Compares the lines below the first `n_header`.
    ///
    /// # Errors
    /// Those of [`Lines::next`].
    pub(super) fn ends_mid_number(
        &mut self,
        n_header: usize,
        separator: Separator,
    ) -> Result<bool> {
        let (mut last, mut last_number) = (Vec::new(), 0);
        let mut lines = self.lines_below(n_header)?;
        while let Some(line) = lines.next()? {
            last_number = line.number;
            last.clear();
            last.extend_from_slice(line.bytes);
        }
        let Some((column, cut)) = separator.cells(&last).enumerate().last() else {
            return Ok(false);
        };
        if text::number(cut).is_none() {
            return Ok(false);
        }
        let mut fewest = None;
        let mut lines = self.lines_below(n_header)?;
        while let Some(line) = lines.next()?.filter(|line| line.number < last_number) {
            let cell = separator.cells(line.bytes).nth(column);
            let cell = cell.filter(|cell| text::number(cell).is_some());
            let decimals = cell.map(|cell| text::decimals(cell.trim_ascii()));
            fewest = fewest.into_iter().chain(decimals).min();
        }
        Ok(fewest.is_some_and(|fewest| text::decimals(cut.trim_ascii()) < fewest))
    }
}

/// The lines of a file, one after another.
pub(super) struct Lines<'l, 'a> {
    input: BufReader<SourceReader<'l, 'a>>,
    format: &'static str,
    conversion: Option<&'l Conversion>,
    raw: Vec<u8>,
    converted: Vec<u8>,
    /// Number of the last line.
    number: usize,
    n_bytes: u64,
    is_open: bool,
}

impl Lines<'_, '_> {
    /// The next line.
    ///
    /// # Errors
    /// `Malformed` if it has more than [`LINE_BYTES_MAX`]; `Io` if the file cannot be read or has changed.
    pub(super) fn next(&mut self) -> Result<Option<Line<'_>>> {
        self.raw.clear();
        let mut input = (&mut self.input).take(LINE_BYTES_MAX as u64 + 1);
        let n_read = input.read_until(b'\n', &mut self.raw)?;
        if n_read == 0 && self.number > 0 {
            return Ok(None);
        }
        self.number += 1;
        let is_ended = self.raw.ends_with(b"\n");
        if n_read > LINE_BYTES_MAX && !is_ended {
            return Err(self.too_long("the line", LINE_BYTES_MAX));
        }
        let is_first = self.number == 1;
        let mut bytes = without_ends(&self.raw, is_first);
        self.is_open = !is_ended;
        if let Some(convert) = self.conversion {
            self.converted.clear();
            convert(bytes, &mut self.converted);
            self.n_bytes += self.converted.len() as u64 + u64::from(is_ended);
            self.is_open &= !self.converted.is_empty();
            bytes = without_ends(&self.converted, is_first);
        } else {
            self.n_bytes += n_read as u64;
        }
        Ok(Some(Line { number: self.number, bytes, is_open: self.is_open }))
    }

    /// Checks that the lines of the header so far are not too long to be kept.
    ///
    /// # Errors
    /// `Malformed` if they have more than [`HEADER_BYTES_MAX`].
    pub(super) fn check_header(&self) -> Result<()> {
        if self.n_bytes <= HEADER_BYTES_MAX as u64 {
            return Ok(());
        }
        Err(self.too_long("the header", HEADER_BYTES_MAX))
    }

    /// Whether the file ends in the middle of a line; valid after the last line.
    pub(super) fn is_open(&self) -> bool {
        self.is_open
    }

    /// Bytes of the lines so far, with their ends, as converted.
    pub(super) fn n_bytes(&self) -> u64 {
        self.n_bytes
    }

    fn too_long(&self, what: &str, bytes_max: usize) -> InterchangeError {
        let mib = bytes_max >> 20;
        let message = format!(
            "{what} has more than {mib} MiB, more than {CHANNELS_MAX} markers need: not a table of trajectories, or \
             split its columns into several files"
        );
        InterchangeError::malformed(self.format, &format!("line {}", self.number), message)
    }
}

/// A line without its end, and the first one without the byte order mark.
fn without_ends(line: &[u8], is_first: bool) -> &[u8] {
    let line = line.strip_suffix(b"\n").unwrap_or(line);
    let line = line.strip_prefix(b"\xEF\xBB\xBF").filter(|_| is_first).unwrap_or(line);
    line.strip_suffix(b"\r").unwrap_or(line)
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
