//! A ZIP file of stored members (APPNOTE.TXT 6.3.10, PKWARE).
//!
//! Each member's length and checksum stand in front of it, where readers that go from front to back need them. The length is
//! known before the member comes; a checksum that is not is written over a place that was kept for it. No library does
//! that well enough: those that only write forwards put both behind the member, and the crate `zip` closes a file whose disk
//! is full once more when it is dropped, and writes to stderr.

use std::io::{self, Seek, SeekFrom, Write};

use crc32fast::Hasher;

const LOCAL: [u8; 4] = *b"PK\x03\x04";
const CENTRAL: [u8; 4] = *b"PK\x01\x02";
const END_64: [u8; 4] = *b"PK\x06\x06";
const LOCATOR_64: [u8; 4] = *b"PK\x06\x07";
const END: [u8; 4] = *b"PK\x05\x06";

/// The version that a reader must know: 4.5 has ZIP64.
const VERSION: u16 = 45;
/// 1 January 1980, the first day there is: the same take gives the same bytes.
const DATE: u16 = 0x21;
/// From its start to the checksum in a member's head.
const CRC_AT: u64 = 14;
/// Bytes of the rest of a ZIP64 end record behind its length.
const END_64_BYTES: u64 = 44;

/// An archive under way.
pub(super) struct Archive<'a, W> {
    out: &'a mut W,
    /// Where the next byte goes.
    at: u64,
    n_members: u16,
    directory: Vec<u8>,
}

impl<'a, W: Write + Seek> Archive<'a, W> {
    /// Begins where `out` stands.
    pub(super) fn new(out: &'a mut W) -> io::Result<Self> {
        let at = out.stream_position()?;
        Ok(Self { out, at, n_members: 0, directory: Vec::new() })
    }

    /// Writes a member that is in memory.
    pub(super) fn put(&mut self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let (crc, n_bytes) = (crc32fast::hash(bytes), bytes.len() as u64);
        let head_at = self.at;
        self.begin(name, crc, n_bytes)?;
        self.write(bytes)?;
        self.list(name, crc, n_bytes, head_at);
        Ok(())
    }

    /// Writes a member of the `n_bytes` bytes that `fill` writes.
    pub(super) fn stream(
        &mut self,
        name: &str,
        n_bytes: u64,
        fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> io::Result<()> {
        let head_at = self.at;
        self.begin(name, 0, n_bytes)?;
        let mut member = Member { out: &mut *self.out, crc: Hasher::new(), n_bytes: 0 };
        fill(&mut member)?;
        let Member { crc, n_bytes: written, .. } = member;
        if written != n_bytes {
            let what = format!("{name}: {n_bytes} bytes were announced, {written} came");
            return Err(io::Error::other(what));
        }
        let crc = crc.finalize();
        self.at += written;
        self.out.seek(SeekFrom::Start(head_at + CRC_AT))?;
        self.out.write_all(&crc.to_le_bytes())?;
        self.out.seek(SeekFrom::Start(self.at))?;
        self.list(name, crc, n_bytes, head_at);
        Ok(())
    }

    /// Writes the directory.
    pub(super) fn finish(mut self) -> io::Result<()> {
        let directory = std::mem::take(&mut self.directory);
        let (start, n_bytes, n) = (self.at, directory.len() as u64, self.n_members);
        self.write(&directory)?;
        let end = self.at;
        let mut last = Vec::new();
        if short(start) == u32::MAX {
            last.extend(END_64);
            last.extend(END_64_BYTES.to_le_bytes());
            put_words(&mut last, &[VERSION, VERSION, 0, 0, 0, 0]);
            put_longs(&mut last, &[n.into(), n.into(), n_bytes, start]);
            last.extend(LOCATOR_64);
            // The disk that has the end record, its place, and how many disks there are.
            put_words(&mut last, &[0, 0]);
            put_longs(&mut last, &[end]);
            put_words(&mut last, &[1, 0]);
        }
        last.extend(END);
        put_words(&mut last, &[0, 0, n, n]);
        last.extend([n_bytes, start].map(short).map(u32::to_le_bytes).as_flattened());
        put_words(&mut last, &[0]);
        self.write(&last)?;
        self.out.flush()
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.at += bytes.len() as u64;
        self.out.write_all(bytes)
    }

    /// Writes a member's head.
    fn begin(&mut self, name: &str, crc: u32, n_bytes: u64) -> io::Result<()> {
        let mut head = LOCAL.to_vec();
        let extra = extra(&[n_bytes, n_bytes]);
        put_common(&mut head, name, crc, n_bytes, extra.len());
        head.extend(name.bytes());
        head.extend(extra);
        self.write(&head)
    }

    /// Adds a member to the directory.
    fn list(&mut self, name: &str, crc: u32, n_bytes: u64, head_at: u64) {
        let out = &mut self.directory;
        out.extend(CENTRAL);
        put_words(out, &[VERSION]);
        let extra = extra(&[n_bytes, n_bytes, head_at]);
        put_common(out, name, crc, n_bytes, extra.len());
        put_words(out, &[0; 5]);
        out.extend(short(head_at).to_le_bytes());
        out.extend(name.bytes());
        out.extend(extra);
        self.n_members += 1;
    }
}

/// A member's bytes on their way.
struct Member<'a, W> {
    out: &'a mut W,
    crc: Hasher,
    n_bytes: u64,
}

impl<W: Write> Write for Member<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.out.write(bytes)?;
        self.crc.update(&bytes[..n]);
        self.n_bytes += n as u64;
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// What stands in a member's head and in the directory alike: stored, at that date, so long, with so many bytes of extra.
fn put_common(out: &mut Vec<u8>, name: &str, crc: u32, n_bytes: u64, n_extra: usize) {
    put_words(out, &[VERSION, 0, 0, 0, DATE]);
    out.extend([crc, short(n_bytes), short(n_bytes)].map(u32::to_le_bytes).as_flattened());
    put_words(out, &[name.len() as u16, n_extra as u16]);
}

/// ZIP64's extra field: those of the numbers that 32 bits do not hold.
fn extra(numbers: &[u64]) -> Vec<u8> {
    let long: Vec<u64> = numbers.iter().copied().filter(|&n| short(n) == u32::MAX).collect();
    let mut extra = Vec::new();
    if !long.is_empty() {
        put_words(&mut extra, &[1, 8 * long.len() as u16]);
        put_longs(&mut extra, &long);
    }
    extra
}

/// A number in 32 bits; all ones where ZIP64's fields have it.
fn short(n: u64) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

fn put_words(out: &mut Vec<u8>, words: &[u16]) {
    out.extend(words.iter().flat_map(|word| word.to_le_bytes()));
}

fn put_longs(out: &mut Vec<u8>, longs: &[u64]) {
    out.extend(longs.iter().flat_map(|long| long.to_le_bytes()));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that 32 bits do not hold, without the bytes that they count.
    #[test]
    fn what_is_long_stands_in_the_fields_of_zip64() {
        let mut file = tempfile::tempfile().unwrap();
        let far = 5 << 30;
        file.seek(SeekFrom::Start(far)).unwrap();
        let mut archive = Archive::new(&mut file).unwrap();
        archive.begin("a", 7, far).unwrap();
        archive.list("a", 7, far, 0);
        archive.put("b", &[1, 2, 3]).unwrap();
        let b_at = far + 30 + 1 + 20;
        let start = archive.at;
        let directory = archive.directory.clone();
        archive.finish().unwrap();

        let mut written = Vec::new();
        file.seek(SeekFrom::Start(far)).unwrap();
        io::Read::read_to_end(&mut file, &mut written).unwrap();
        let longs = |longs: &[u64]| longs.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>();
        let (head, rest) = written.split_at(51);
        assert_eq!(head[18..26], [0xff; 8]);
        assert_eq!(head[26..31], [1, 0, 20, 0, b'a']);
        assert_eq!(head[31..], [&[1, 0, 16, 0][..], &longs(&[far, far])].concat());
        assert_eq!(
            rest[14..30],
            [crc32fast::hash(&[1, 2, 3]), 3, 3, 1].map(u32::to_le_bytes).concat()
        );

        let (of_a, of_b) = directory.split_at(46 + 1 + 20);
        assert_eq!((&of_a[20..28], &of_a[42..46]), (&[0xff; 8][..], &[0; 4][..]));
        assert_eq!(of_a[47..], [&[1, 0, 16, 0][..], &longs(&[far, far])].concat());
        assert_eq!((&of_b[20..28], &of_b[42..46]), (&[3, 0, 0, 0, 3, 0, 0, 0][..], &[0xff; 4][..]));
        assert_eq!(of_b[47..], [&[1, 0, 8, 0][..], &longs(&[b_at])].concat());

        let last = &written[(start - far) as usize + directory.len()..];
        assert_eq!(last.len(), 56 + 20 + 22);
        assert_eq!(last[24..56], longs(&[2, 2, directory.len() as u64, start]));
        assert_eq!(last[64..72], longs(&[start + directory.len() as u64]));
        assert_eq!(last[76 + 16..76 + 20], [0xff; 4]);
    }

    #[test]
    fn a_member_of_another_length_than_was_announced_is_an_error() {
        let mut out = io::Cursor::new(Vec::new());
        let mut archive = Archive::new(&mut out).unwrap();
        let error = archive.stream("a", 4, |out| out.write_all(b"abc")).unwrap_err();
        assert_eq!(error.to_string(), "a: 4 bytes were announced, 3 came");
    }
}
