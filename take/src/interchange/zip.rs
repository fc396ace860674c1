//! A writer of ZIP archives with stored (uncompressed) members (APPNOTE.TXT 6.3.10, PKWARE).
//!
//! The local header in front of each member has its length and checksum, so that a reader can stream the archive. The
//! length is known in advance; the checksum of a streamed member is filled in afterwards. No library does this:
//! streaming writers put both after the member, and on a full disk the crate `zip` tries to finish the archive again
//! when it is dropped, and writes to stderr.

use std::io::{self, Seek, SeekFrom, Write};

use crc32fast::Hasher;

const LOCAL: [u8; 4] = *b"PK\x03\x04";
const CENTRAL: [u8; 4] = *b"PK\x01\x02";
const END_64: [u8; 4] = *b"PK\x06\x06";
const LOCATOR_64: [u8; 4] = *b"PK\x06\x07";
const END: [u8; 4] = *b"PK\x05\x06";

/// Version needed to extract: 4.5, for ZIP64.
const VERSION: u16 = 45;
/// 1 January 1980, the earliest date. A fixed date makes the archive reproducible.
const DATE: u16 = 0x21;
/// Offset of the checksum in a local header.
const CRC_OFFSET: u64 = 14;
/// Size of a ZIP64 end of central directory record after its size field.
const END_64_BYTES: u64 = 44;

/// An archive under construction.
pub(super) struct Archive<'a, W> {
    out: &'a mut W,
    /// Position of the next byte in `out`.
    offset: u64,
    n_members: u16,
    directory: Vec<u8>,
}

impl<'a, W: Write + Seek> Archive<'a, W> {
    /// Begins an archive at the current position of `out`.
    pub(super) fn new(out: &'a mut W) -> io::Result<Self> {
        let offset = out.stream_position()?;
        Ok(Self { out, offset, n_members: 0, directory: Vec::new() })
    }

    /// Writes a member from memory.
    pub(super) fn put(&mut self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let (crc, n_bytes) = (crc32fast::hash(bytes), bytes.len() as u64);
        let header_offset = self.offset;
        self.write_local_header(name, crc, n_bytes)?;
        self.write(bytes)?;
        self.add_entry(name, crc, n_bytes, header_offset);
        Ok(())
    }

    /// Writes a member of `n_bytes` bytes, which `fill` writes.
    ///
    /// # Errors
    /// Those of writing, and an error if `fill` writes another number of bytes than `n_bytes`.
    pub(super) fn stream(
        &mut self,
        name: &str,
        n_bytes: u64,
        fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> io::Result<()> {
        let header_offset = self.offset;
        self.write_local_header(name, 0, n_bytes)?;
        let mut member = MemberWriter { out: &mut *self.out, crc: Hasher::new(), n_bytes: 0 };
        fill(&mut member)?;
        let MemberWriter { crc, n_bytes: written, .. } = member;
        if written != n_bytes {
            let message = format!("{name}: expected {n_bytes} bytes, got {written}");
            return Err(io::Error::other(message));
        }
        let crc = crc.finalize();
        self.offset += written;
        self.out.seek(SeekFrom::Start(header_offset + CRC_OFFSET))?;
        self.out.write_all(&crc.to_le_bytes())?;
        self.out.seek(SeekFrom::Start(self.offset))?;
        self.add_entry(name, crc, n_bytes, header_offset);
        Ok(())
    }

    /// Writes the central directory and its end records.
    pub(super) fn finish(mut self) -> io::Result<()> {
        let directory = std::mem::take(&mut self.directory);
        let (start, n_bytes, n) = (self.offset, directory.len() as u64, self.n_members);
        self.write(&directory)?;
        let end = self.offset;
        let mut last = Vec::new();
        if saturated(start) == u32::MAX {
            last.extend(END_64);
            last.extend(END_64_BYTES.to_le_bytes());
            put_u16s(&mut last, &[VERSION, VERSION, 0, 0, 0, 0]);
            put_u64s(&mut last, &[n.into(), n.into(), n_bytes, start]);
            last.extend(LOCATOR_64);
            // Number of the disk with the end record, offset of that record, number of disks.
            put_u16s(&mut last, &[0, 0]);
            put_u64s(&mut last, &[end]);
            put_u16s(&mut last, &[1, 0]);
        }
        last.extend(END);
        put_u16s(&mut last, &[0, 0, n, n]);
        last.extend([n_bytes, start].map(saturated).map(u32::to_le_bytes).as_flattened());
        put_u16s(&mut last, &[0]);
        self.write(&last)?;
        self.out.flush()
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.offset += bytes.len() as u64;
        self.out.write_all(bytes)
    }

    /// Writes the local header of a member.
    fn write_local_header(&mut self, name: &str, crc: u32, n_bytes: u64) -> io::Result<()> {
        let mut header = LOCAL.to_vec();
        let extra = extra(&[n_bytes, n_bytes]);
        put_common(&mut header, name, crc, n_bytes, extra.len());
        header.extend(name.bytes());
        header.extend(extra);
        self.write(&header)
    }

    /// Adds a member to the central directory.
    fn add_entry(&mut self, name: &str, crc: u32, n_bytes: u64, header_offset: u64) {
        let out = &mut self.directory;
        out.extend(CENTRAL);
        put_u16s(out, &[VERSION]);
        let extra = extra(&[n_bytes, n_bytes, header_offset]);
        put_common(out, name, crc, n_bytes, extra.len());
        put_u16s(out, &[0; 5]);
        out.extend(saturated(header_offset).to_le_bytes());
        out.extend(name.bytes());
        out.extend(extra);
        self.n_members += 1;
    }
}

/// Passes the bytes of a member on, with their checksum and count.
struct MemberWriter<'a, W> {
    out: &'a mut W,
    crc: Hasher,
    n_bytes: u64,
}

impl<W: Write> Write for MemberWriter<'_, W> {
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

/// Appends the fields that local header and directory entry share: from the version to the length of the extra field.
fn put_common(out: &mut Vec<u8>, name: &str, crc: u32, n_bytes: u64, n_extra: usize) {
    put_u16s(out, &[VERSION, 0, 0, 0, DATE]);
    out.extend([crc, saturated(n_bytes), saturated(n_bytes)].map(u32::to_le_bytes).as_flattened());
    put_u16s(out, &[name.len() as u16, n_extra as u16]);
}

/// The ZIP64 extra field: the numbers that do not fit into 32 bits. Empty if all fit.
fn extra(numbers: &[u64]) -> Vec<u8> {
    let long: Vec<u64> = numbers.iter().copied().filter(|&n| saturated(n) == u32::MAX).collect();
    let mut extra = Vec::new();
    if !long.is_empty() {
        put_u16s(&mut extra, &[1, 8 * long.len() as u16]);
        put_u64s(&mut extra, &long);
    }
    extra
}

/// A number as 32 bits; all ones if it does not fit and is in the ZIP64 fields.
fn saturated(n: u64) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

fn put_u16s(out: &mut Vec<u8>, numbers: &[u16]) {
    out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}

fn put_u64s(out: &mut Vec<u8>, numbers: &[u64]) {
    out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes the headers of members beyond 4 GiB without their bytes.
    #[test]
    fn numbers_beyond_32_bits_are_in_the_zip64_fields() {
        let mut file = tempfile::tempfile().unwrap();
        let far = 5 << 30;
        file.seek(SeekFrom::Start(far)).unwrap();
        let mut archive = Archive::new(&mut file).unwrap();
        archive.write_local_header("a", 7, far).unwrap();
        archive.add_entry("a", 7, far, 0);
        archive.put("b", &[1, 2, 3]).unwrap();
        let b_at = far + 30 + 1 + 20;
        let start = archive.offset;
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
    fn a_member_of_an_unexpected_length_is_an_error() {
        let mut out = io::Cursor::new(Vec::new());
        let mut archive = Archive::new(&mut out).unwrap();
        let error = archive.stream("a", 4, |out| out.write_all(b"abc")).unwrap_err();
        assert_eq!(error.to_string(), "a: expected 4 bytes, got 3");
    }
}
