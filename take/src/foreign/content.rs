//! The content of a foreign part: in memory, or in a scratch file if it is large.

use std::{
    borrow::Borrow,
    fmt::Debug,
    io::{self, BufRead, BufReader, BufWriter, IntoInnerError, Read, Write},
    sync::{Arc, Mutex, PoisonError, atomic::AtomicU64, atomic::Ordering},
};

use super::DATA_BYTES_MAX;

/// Maximum number of bytes of all foreign parts of a take or file in memory; further parts go into a scratch file.
/// Parameters and header lines, which every imported C3D or TRC file has, take a few kB; the analog data of a short
/// trial takes a few hundred.
const MEMORY_BYTES_MAX: u64 = 8 << 20;

/// A temporary file. The caller provides it, because this crate opens no files.
pub trait ScratchFile: Debug + Send + Sync {
    /// Fills `bytes` from byte `at` of the file.
    ///
    /// # Errors
    /// Those of the file.
    fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()>;

    /// Writes `bytes` at byte `at`; the file grows as needed.
    ///
    /// # Errors
    /// Those of the file, such as a full disk.
    fn write_at(&self, at: u64, bytes: &[u8]) -> io::Result<()>;
}

/// Size of one comparison or copy.
const BLOCK_BYTES: usize = 1 << 16;

/// The bytes of a foreign part.
#[derive(Debug, Clone)]
pub struct Content(Storage);

#[derive(Debug, Clone)]
enum Storage {
    Memory(Vec<u8>),
    /// `len` bytes of a file, from byte `from` on.
    Scratch {
        scratch: Arc<Scratch>,
        from: u64,
        len: u64,
    },
    /// `len` bytes that were not kept.
    Omitted {
        len: u64,
    },
}

impl Content {
    /// The content of a part that was not requested, or that is too long to be kept: only its length is known.
    pub(crate) fn omitted(len: u64) -> Self {
        Self(Storage::Omitted { len })
    }

    /// Whether only the length is known.
    pub(crate) fn is_omitted(&self) -> bool {
        matches!(self.0, Storage::Omitted { .. })
    }

    /// Number of bytes.
    #[must_use]
    pub fn len(&self) -> u64 {
        match &self.0 {
            Storage::Memory(bytes) => bytes.len() as u64,
            Storage::Scratch { len, .. } | Storage::Omitted { len } => *len,
        }
    }

    /// Whether there are no bytes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All bytes; `None` if there are more than `max`.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub fn to_vec(&self, max: u64) -> io::Result<Option<Vec<u8>>> {
        if self.len() > max {
            return Ok(None);
        }
        let mut bytes = vec![0; self.len() as usize];
        self.read_at(0, &mut bytes)?;
        Ok(Some(bytes))
    }

    /// Fills `bytes` from byte `at` on.
    ///
    /// # Errors
    /// `UnexpectedEof` beyond the end; `Unsupported` if the bytes were not kept; those of the scratch file.
    pub fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        let end = at.checked_add(bytes.len() as u64).filter(|&end| end <= self.len());
        let end = end.ok_or(io::ErrorKind::UnexpectedEof)?;
        match &self.0 {
            Storage::Memory(held) => {
                bytes.copy_from_slice(&held[at as usize..end as usize]);
                Ok(())
            }
            Storage::Scratch { scratch, from, .. } => scratch.file.read_at(from + at, bytes),
            Storage::Omitted { .. } => Err(io::ErrorKind::Unsupported.into()),
        }
    }

    /// A reader of all bytes.
    pub(crate) fn reader(&self) -> impl BufRead {
        BufReader::with_capacity(BLOCK_BYTES, ContentReader { content: self, at: 0 })
    }

    /// A slice of all bytes.
    pub(crate) fn as_slice(&self) -> ContentSlice<'_> {
        ContentSlice { content: self, from: 0, len: self.len() }
    }

    /// A copy that can be [overwritten](Self::write_at); a clone shares the bytes of a scratch file.
    pub(crate) fn copy(&self) -> io::Result<Self> {
        match &self.0 {
            Storage::Memory(_) | Storage::Omitted { .. } => Ok(self.clone()),
            Storage::Scratch { scratch, len, .. } => scratch.put(&mut self.reader(), *len),
        }
    }

    /// Overwrites the bytes from `at` on.
    pub(crate) fn write_at(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        let end = at.checked_add(bytes.len() as u64).filter(|&end| end <= self.len());
        let end = end.ok_or(io::ErrorKind::UnexpectedEof)?;
        match &mut self.0 {
            Storage::Memory(held) => {
                held[at as usize..end as usize].copy_from_slice(bytes);
                Ok(())
            }
            Storage::Scratch { scratch, from, .. } => scratch.file.write_at(*from + at, bytes),
            Storage::Omitted { .. } => Ok(()),
        }
    }

    /// Writes what `write` produces, at most `len_max` bytes, where these bytes are: into memory, or into the same
    /// scratch file.
    ///
    /// # Errors
    /// `Unsupported` if the bytes were not kept; those of `write` and of the scratch file.
    pub(crate) fn converted(
        &self,
        len_max: u64,
        write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> io::Result<Self> {
        match &self.0 {
            Storage::Memory(_) => {
                let mut bytes = Vec::new();
                write(&mut bytes)?;
                Ok(bytes.into())
            }
            Storage::Scratch { scratch, .. } => {
                let from = scratch.end.fetch_add(len_max, Ordering::Relaxed);
                let end = from.saturating_add(len_max);
                let region = ScratchRegion { scratch, at: from, end };
                let mut buffered = BufWriter::with_capacity(BLOCK_BYTES, region);
                write(&mut buffered)?;
                let len = buffered.into_inner().map_err(IntoInnerError::into_error)?.at - from;
                Ok(Self(Storage::Scratch { scratch: Arc::clone(scratch), from, len }))
            }
            Storage::Omitted { .. } => Err(io::ErrorKind::Unsupported.into()),
        }
    }
}

impl Default for Content {
    fn default() -> Self {
        Vec::new().into()
    }
}

impl From<Vec<u8>> for Content {
    fn from(bytes: Vec<u8>) -> Self {
        Self(Storage::Memory(bytes))
    }
}

/// Compares the bytes, in memory or in a scratch file. Bytes that cannot be read equal nothing.
impl PartialEq for Content {
    fn eq(&self, other: &Self) -> bool {
        if let (Storage::Memory(a), Storage::Memory(b)) = (&self.0, &other.0) {
            return a == b;
        }
        let [mut a, mut b] = [[0; BLOCK_BYTES]; 2];
        self.len() == other.len()
            && (0..self.len()).step_by(BLOCK_BYTES).all(|at| {
                let n = (self.len() - at).min(BLOCK_BYTES as u64) as usize;
                let (a, b) = (&mut a[..n], &mut b[..n]);
                self.read_at(at, a).is_ok() && other.read_at(at, b).is_ok() && a == b
            })
    }
}

/// Writes a region of a scratch file from its beginning.
struct ScratchRegion<'a> {
    scratch: &'a Scratch,
    at: u64,
    end: u64,
}

impl Write for ScratchRegion<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = (self.end - self.at).min(bytes.len() as u64) as usize;
        self.scratch.file.write_at(self.at, &bytes[..n])?;
        self.at += n as u64;
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[derive(Debug)]
struct ContentReader<C> {
    content: C,
    at: u64,
}

impl<C: Borrow<Content>> Read for ContentReader<C> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let content = self.content.borrow();
        let n = (content.len() - self.at).min(bytes.len() as u64);
        content.read_at(self.at, &mut bytes[..n as usize])?;
        self.at += n;
        Ok(n as usize)
    }
}

/// Reads a content, as often as needed.
#[derive(Debug)]
pub(crate) struct ContentCursor(BufReader<ContentReader<Content>>);

impl ContentCursor {
    /// Begins with the first byte.
    pub(crate) fn new(content: Content) -> Self {
        Self(BufReader::with_capacity(BLOCK_BYTES, ContentReader { content, at: 0 }))
    }

    /// Returns to the first byte.
    pub(crate) fn rewind(&mut self) {
        self.0.consume(self.0.buffer().len());
        self.0.get_mut().at = 0;
    }
}

impl Read for ContentCursor {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.0.read(bytes)
    }
}

/// A range of a content, like a `&[u8]` of bytes in memory.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ContentSlice<'a> {
    content: &'a Content,
    from: u64,
    len: u64,
}

impl<'a> ContentSlice<'a> {
    /// Number of bytes.
    pub(crate) fn len(&self) -> u64 {
        self.len
    }

    /// Its first byte's position in the content.
    pub(crate) fn from(&self) -> u64 {
        self.from
    }

    /// Splits off the first `at` bytes; `None` if there are fewer.
    pub(crate) fn split_at(self, at: u64) -> Option<(Self, Self)> {
        let rest = self.len.checked_sub(at)?;
        Some((Self { len: at, ..self }, Self { from: self.from + at, len: rest, ..self }))
    }

    /// Reads the first `N` bytes and returns them with the rest; `None` if there are fewer.
    pub(crate) fn split_array<const N: usize>(self) -> io::Result<Option<([u8; N], Self)>> {
        let Some((_, rest)) = self.split_at(N as u64) else { return Ok(None) };
        let mut bytes = [0; N];
        self.read_at(0, &mut bytes)?;
        Ok(Some((bytes, rest)))
    }

    /// Fills `bytes` from its byte `at` on.
    pub(crate) fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        self.content.read_at(self.from.saturating_add(at), bytes)
    }

    /// A reader of its bytes.
    pub(crate) fn reader(self) -> impl BufRead + use<'a> {
        let reader = ContentReader { content: self.content, at: self.from };
        BufReader::with_capacity(BLOCK_BYTES, reader.take(self.len))
    }
}

/// A scratch file to which contents are appended.
#[derive(Debug)]
struct Scratch {
    file: Arc<dyn ScratchFile>,
    /// Where the next content begins.
    end: AtomicU64,
}

impl Scratch {
    fn new(file: Arc<dyn ScratchFile>) -> Arc<Self> {
        Arc::new(Self { file, end: AtomicU64::new(0) })
    }

    /// Appends the bytes of `input`, at most `len + 1`.
    fn put(self: &Arc<Self>, input: &mut impl Read, len: u64) -> io::Result<Content> {
        let from = self.end.fetch_add(len.saturating_add(1), Ordering::Relaxed);
        let mut input = input.take(len.saturating_add(1));
        let mut block = vec![0; BLOCK_BYTES];
        let mut written = 0;
        loop {
            let n = match input.read(&mut block) {
                Ok(0) => break,
                Ok(n) => n,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
            self.file.write_at(from + written, &block[..n])?;
            written += n as u64;
        }
        Ok(Content(Storage::Scratch { scratch: Arc::clone(self), from, len: written }))
    }

    /// Reserves `len` zeros.
    fn zeros(self: &Arc<Self>, len: u64) -> io::Result<Content> {
        let from = self.end.fetch_add(len, Ordering::Relaxed);
        if let Some(last) = len.checked_sub(1) {
            // The file ends after them; the bytes before are a hole, which reads as zeros.
            self.file.write_at(from + last, &[0])?;
        }
        Ok(Content(Storage::Scratch { scratch: Arc::clone(self), from, len }))
    }
}

/// Writes a content of unknown length: to memory, and into a scratch file when it becomes large.
pub(crate) struct ContentWriter<'a> {
    new_scratch: NewScratch<'a>,
    /// What is not in the scratch file yet.
    held: Vec<u8>,
    scratch: Option<Arc<Scratch>>,
    written: u64,
}

impl<'a> ContentWriter<'a> {
    pub(crate) fn new(new_scratch: NewScratch<'a>) -> Self {
        Self { new_scratch, held: Vec::new(), scratch: None, written: 0 }
    }

    /// Appends bytes.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(crate) fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let held_max = if self.scratch.is_some() { BLOCK_BYTES } else { MEMORY_BYTES_MAX as usize };
        if self.held.len() + bytes.len() > held_max {
            self.flush()?;
        }
        let len = self.held.len() + bytes.len();
        if len > self.held.capacity() {
            // Doubled, but never beyond what will be held.
            let capacity = (2 * len).min(held_max).max(len);
            self.held.reserve_exact(capacity - self.held.len());
        }
        self.held.extend_from_slice(bytes);
        Ok(())
    }

    /// The content.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(crate) fn finish(mut self) -> io::Result<Content> {
        if self.scratch.is_none() {
            return Ok(self.held.into());
        }
        let scratch = Arc::clone(self.flush()?);
        Ok(Content(Storage::Scratch { scratch, from: 0, len: self.written }))
    }

    fn flush(&mut self) -> io::Result<&Arc<Scratch>> {
        let scratch = match &mut self.scratch {
            Some(scratch) => scratch,
            none => none.insert(Scratch::new((self.new_scratch)()?)),
        };
        scratch.file.write_at(self.written, &self.held)?;
        self.written += self.held.len() as u64;
        scratch.end.store(self.written, Ordering::Relaxed);
        self.held.clear();
        self.held.shrink_to(BLOCK_BYTES);
        Ok(scratch)
    }
}

/// A scratch file in memory, for callers that have the whole source in memory anyway.
#[derive(Debug, Default)]
pub struct MemoryScratch(Mutex<Vec<u8>>);

impl ScratchFile for MemoryScratch {
    fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        let file = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let held = file.get(at as usize..).and_then(|held| held.get(..bytes.len()));
        bytes.copy_from_slice(held.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    fn write_at(&self, at: u64, bytes: &[u8]) -> io::Result<()> {
        let mut file = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let end = at as usize + bytes.len();
        let len = file.len().max(end);
        file.resize(len, 0);
        file[at as usize..end].copy_from_slice(bytes);
        Ok(())
    }
}

/// Stores the foreign parts of a take or file: the first ones in memory, the rest in a scratch file.
#[derive(Debug)]
pub(crate) struct Spool<F> {
    new_scratch: F,
    memory_bytes: u64,
    scratch: Option<Arc<Scratch>>,
}

impl<F: Fn() -> io::Result<Arc<dyn ScratchFile>>> Spool<F> {
    /// Creates a spool; `new_scratch` is called when the scratch file is first needed.
    pub(crate) fn new(new_scratch: F) -> Self {
        Self { new_scratch, memory_bytes: 0, scratch: None }
    }

    /// Stores the bytes of `input`, at most `len + 1`, so that a longer input shows.
    pub(crate) fn put(&mut self, input: &mut impl Read, len: u64) -> io::Result<Content> {
        let memory_bytes = self.memory_bytes.saturating_add(len);
        if memory_bytes > MEMORY_BYTES_MAX {
            return self.scratch()?.put(input, len);
        }
        // Memory grows with the actual input; a few damaged bytes can claim any length.
        let mut bytes = Vec::new();
        input.take(len + 1).read_to_end(&mut bytes)?;
        self.memory_bytes = memory_bytes;
        Ok(bytes.into())
    }

    /// Reserves `len` zeros to [overwrite](Content::write_at). The caller has read about as many bytes.
    pub(crate) fn zeros(&mut self, len: u64) -> io::Result<Content> {
        let memory_bytes = self.memory_bytes.saturating_add(len);
        if memory_bytes > MEMORY_BYTES_MAX {
            return self.scratch()?.zeros(len);
        }
        self.memory_bytes = memory_bytes;
        Ok(vec![0; len as usize].into())
    }

    fn scratch(&mut self) -> io::Result<&Arc<Scratch>> {
        match &mut self.scratch {
            Some(scratch) => Ok(scratch),
            none => Ok(none.insert(Scratch::new((self.new_scratch)()?))),
        }
    }
}

/// Creates a scratch file.
pub(crate) type NewScratch<'a> = &'a dyn Fn() -> io::Result<Arc<dyn ScratchFile>>;

/// Stores the foreign parts of a file that is imported.
pub(crate) struct PartStore<'a> {
    /// `None` if only the kinds and lengths are wanted.
    spool: Option<Spool<NewScratch<'a>>>,
}

impl<'a> PartStore<'a> {
    /// Keeps the content, or only kinds and lengths.
    pub(crate) fn new(keeps: bool, new_scratch: NewScratch<'a>) -> Self {
        Self { spool: keeps.then(|| Spool::new(new_scratch)) }
    }

    /// Reserves `len` zeros for a part, to [overwrite](Content::write_at). They are not kept if the part is not wanted,
    /// or longer than a take can hold.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(crate) fn zeros(&mut self, len: u64) -> io::Result<Content> {
        match &mut self.spool {
            Some(spool) if len <= DATA_BYTES_MAX => spool.zeros(len),
            _ => Ok(Content::omitted(len)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn memory_scratch() -> io::Result<Arc<dyn ScratchFile>> {
        Ok(Arc::new(MemoryScratch::default()))
    }

    fn bytes(len: u64) -> Vec<u8> {
        (0..len).map(|i| (i * i / 7) as u8).collect()
    }

    #[test]
    fn content_is_the_same_in_memory_and_in_a_file() {
        let mut spool = Spool::new(memory_scratch);
        let lengths = [0, 5, 70_000, MEMORY_BYTES_MAX, 0, MEMORY_BYTES_MAX + 3];
        for len in lengths {
            let content = spool.put(&mut &bytes(len)[..], len).unwrap();
            let is_in_file = matches!(content.0, Storage::Scratch { .. });
            assert_eq!(is_in_file, len >= MEMORY_BYTES_MAX, "{len}");
            assert_eq!(content, bytes(len).into());
            assert_eq!(content.to_vec(len).unwrap().unwrap(), bytes(len));
            let mut read = Vec::new();
            content.reader().read_to_end(&mut read).unwrap();
            assert_eq!(read, bytes(len));
            assert!(content.read_at(len, &mut [0]).is_err());
            assert!(len == 0 || content.to_vec(len - 1).unwrap().is_none());
        }
    }

    #[test]
    fn writing_a_copy_leaves_the_original() {
        let mut spool = Spool { memory_bytes: MEMORY_BYTES_MAX, ..Spool::new(memory_scratch) };
        for content in [spool.put(&mut &bytes(300)[..], 300).unwrap(), bytes(300).into()] {
            let mut copy = content.copy().unwrap();
            copy.write_at(298, &[1, 2]).unwrap();
            assert!(copy.write_at(299, &[1, 2]).is_err());
            assert_eq!(content, bytes(300).into());
            assert_eq!(copy.to_vec(300).unwrap().unwrap()[298..], [1, 2]);
        }
    }

    #[test]
    fn reserved_zeros_are_overwritten_and_converted_where_they_are() {
        for memory_bytes in [0, MEMORY_BYTES_MAX] {
            let mut spool = Spool { memory_bytes, ..Spool::new(memory_scratch) };
            let mut first = spool.zeros(200_000).unwrap();
            let second = spool.zeros(3).unwrap();
            assert_eq!(first, vec![0; 200_000].into());
            first.write_at(70_000, b"abc").unwrap();
            assert!(first.write_at(199_998, b"abc").is_err());
            assert_eq!(second, vec![0; 3].into());
            let twice = |out: &mut dyn Write| {
                (0..2).try_for_each(|_| io::copy(&mut first.reader(), out).map(|_| ()))
            };
            let converted = first.converted(400_000, twice).unwrap();
            let bytes = converted.to_vec(400_000).unwrap().unwrap();
            assert_eq!((bytes.len(), &bytes[270_000..270_004]), (400_000, &b"abc\0"[..]));
            assert_eq!(bytes[..200_000], bytes[200_000..]);
            if memory_bytes > 0 {
                assert!(first.converted(399_999, twice).is_err());
            }
            assert_eq!(second, vec![0; 3].into());
        }
    }

    #[test]
    fn omitted_content_has_a_length_only() {
        let mut omitted = Content::omitted(1 << 40);
        assert_eq!(omitted.len(), 1 << 40);
        assert!(omitted.read_at(7, &mut [0]).is_err() && omitted.clone() != omitted);
        omitted.write_at(7, b"nowhere").unwrap();
    }

    #[test]
    fn one_byte_more_than_announced_is_noticed() {
        for memory_bytes in [0, MEMORY_BYTES_MAX] {
            let mut spool = Spool { memory_bytes, ..Spool::new(memory_scratch) };
            assert_eq!(spool.put(&mut &[7; 100][..], 10).unwrap().len(), 11);
        }
    }
}
