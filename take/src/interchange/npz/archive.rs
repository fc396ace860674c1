//! A ZIP file of stored members, written front to back (APPNOTE.TXT 6.3.10, PKWARE).
//!
//! The length of a member is known before it comes; its checksum is, too, for those that can be made twice. The one
//! that comes as a stream has its checksum behind it. What does not fit into 32 bits goes into ZIP64 fields.
//! A library would draw in a dozen crates for compression, encryption and times, none of which is needed here.

use std::io::{self, Write};

const LOCAL: u32 = 0x0403_4b50;
const DESCRIPTOR: u32 = 0x0807_4b50;
const CENTRAL: u32 = 0x0201_4b50;
const END_64: u32 = 0x0606_4b50;
const LOCATOR_64: u32 = 0x0706_4b50;
const END: u32 = 0x0605_4b50;
/// The version that a reader must know: 4.5 has ZIP64.
const VERSION: u16 = 45;
/// The checksum stands behind the member.
const CRC_BEHIND: u16 = 8;
/// 1 January 1980, the first day there is: the same take gives the same bytes.
const DATE: u16 = 0x21;
/// The id of ZIP64's extra field.
const ZIP_64: u16 = 1;

/// A member, as the directory at the end tells of it.
struct Entry {
    name: &'static str,
    flags: u16,
    crc: u32,
    bytes: u64,
    offset: u64,
}

/// The archive under way.
pub(super) struct Archive<'a> {
    out: &'a mut dyn Write,
    at: u64,
    entries: Vec<Entry>,
    /// The checksum and the length so far of the member that comes as a stream.
    streamed: Option<(crc32fast::Hasher, u64)>,
}

impl<'a> Archive<'a> {
    pub(super) fn new(out: &'a mut dyn Write) -> Self {
        Self { out, at: 0, entries: Vec::new(), streamed: None }
    }

    /// Writes a member that is in memory.
    pub(super) fn small(&mut self, name: &'static str, bytes: &[u8]) -> io::Result<()> {
        self.open(name, 0, crc32fast::hash(bytes), bytes.len() as u64)?;
        self.raw(bytes)
    }

    /// Writes a member of a head and `n_bytes` bytes that can be made twice: once for the checksum.
    pub(super) fn repeatable<I: Iterator<Item = [u8; 8]>>(
        &mut self,
        name: &'static str,
        head: &[u8],
        n_bytes: u64,
        words: impl Fn() -> I,
    ) -> io::Result<()> {
        let mut crc = crc32fast::Hasher::new();
        crc.update(head);
        words().for_each(|word| crc.update(&word));
        self.open(name, 0, crc.finalize(), head.len() as u64 + n_bytes)?;
        self.raw(head)?;
        words().try_for_each(|word| self.raw(&word))
    }

    /// Begins a member of `bytes` bytes, which [`put`](Self::put) gives and [`end`](Self::end) ends.
    pub(super) fn begin(&mut self, name: &'static str, bytes: u64) -> io::Result<()> {
        self.open(name, CRC_BEHIND, 0, bytes)?;
        self.streamed = Some((crc32fast::Hasher::new(), 0));
        Ok(())
    }

    pub(super) fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        if let Some((crc, n_bytes)) = &mut self.streamed {
            crc.update(bytes);
            *n_bytes += bytes.len() as u64;
        }
        self.raw(bytes)
    }

    /// Ends the member, and says its checksum.
    pub(super) fn end(&mut self) -> io::Result<()> {
        let (Some((crc, n_bytes)), Some(entry)) = (self.streamed.take(), self.entries.last_mut())
        else {
            return Ok(());
        };
        if n_bytes != entry.bytes {
            return Err(io::Error::other(format!(
                "{}: {} bytes were announced, {n_bytes} came",
                entry.name, entry.bytes
            )));
        }
        entry.crc = crc.finalize();
        let mut behind = DESCRIPTOR.to_le_bytes().to_vec();
        behind.extend(entry.crc.to_le_bytes());
        match u32::try_from(n_bytes) {
            Ok(n) => behind.extend([n, n].iter().flat_map(|n| n.to_le_bytes())),
            Err(_) => behind.extend([n_bytes; 2].iter().flat_map(|n| n.to_le_bytes())),
        }
        self.raw(&behind)
    }

    fn raw(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.at += bytes.len() as u64;
        self.out.write_all(bytes)
    }

    /// Writes a member's head. Its length stands there whether or not the checksum does: it is known.
    fn open(&mut self, name: &'static str, flags: u16, crc: u32, bytes: u64) -> io::Result<()> {
        self.entries.push(Entry { name, flags, crc, bytes, offset: self.at });
        let mut head = LOCAL.to_le_bytes().to_vec();
        words(&mut head, &[VERSION, flags, 0, 0, DATE]);
        head.extend(crc.to_le_bytes());
        let extra = extra(&[bytes, bytes], bytes);
        let short = u32::try_from(bytes).unwrap_or(u32::MAX);
        head.extend([short, short].iter().flat_map(|n| n.to_le_bytes()));
        words(&mut head, &[name.len() as u16, extra.len() as u16]);
        head.extend(name.bytes());
        head.extend(extra);
        self.raw(&head)
    }

    /// Writes the directory.
    pub(super) fn finish(mut self) -> io::Result<()> {
        let start = self.at;
        let mut directory = Vec::new();
        for entry in &self.entries {
            directory.extend(CENTRAL.to_le_bytes());
            words(&mut directory, &[VERSION, VERSION, entry.flags, 0, 0, DATE]);
            directory.extend(entry.crc.to_le_bytes());
            let largest = entry.bytes.max(entry.offset);
            let extra = extra(&[entry.bytes, entry.bytes, entry.offset], largest);
            let short = |n: u64| if extra.is_empty() { n as u32 } else { u32::MAX };
            directory.extend([short(entry.bytes); 2].iter().flat_map(|n| n.to_le_bytes()));
            words(&mut directory, &[entry.name.len() as u16, extra.len() as u16, 0, 0, 0, 0, 0]);
            directory.extend(short(entry.offset).to_le_bytes());
            directory.extend(entry.name.bytes());
            directory.extend(extra);
        }
        let n_bytes = directory.len() as u64;
        self.raw(&directory)?;
        let end = self.at;
        let n = self.entries.len() as u64;
        let mut tail = Vec::new();
        if end > u64::from(u32::MAX) {
            tail.extend(END_64.to_le_bytes());
            tail.extend(44_u64.to_le_bytes());
            words(&mut tail, &[VERSION, VERSION, 0, 0, 0, 0]);
            tail.extend([n, n, n_bytes, start].iter().flat_map(|n| n.to_le_bytes()));
            tail.extend(LOCATOR_64.to_le_bytes());
            tail.extend(0_u32.to_le_bytes());
            tail.extend(end.to_le_bytes());
            tail.extend(1_u32.to_le_bytes());
        }
        tail.extend(END.to_le_bytes());
        words(&mut tail, &[0, 0, n as u16, n as u16]);
        let short = |n: u64| u32::try_from(n).unwrap_or(u32::MAX);
        tail.extend([short(n_bytes), short(start)].iter().flat_map(|n| n.to_le_bytes()));
        words(&mut tail, &[0]);
        self.raw(&tail)?;
        self.out.flush()
    }
}

fn words(out: &mut Vec<u8>, words: &[u16]) {
    out.extend(words.iter().flat_map(|word| word.to_le_bytes()));
}

/// ZIP64's extra field, where the largest of the numbers needs it.
fn extra(numbers: &[u64], largest: u64) -> Vec<u8> {
    let mut extra = Vec::new();
    if largest >= u64::from(u32::MAX) {
        words(&mut extra, &[ZIP_64, 8 * numbers.len() as u16]);
        extra.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
    }
    extra
}
