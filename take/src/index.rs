//! INDEX and FOOTER: random access to a long take, and the proof that it was closed. [`TakeEnds`] reads what a take
//! states at its two ends without reading between them.

use std::io::{Read, Seek, SeekFrom};

use crate::{
    NotATake, TakeError,
    chunk::{self, ChunkParse, MAGIC, types},
    record::{
        Channel, Header, LIMIT_BYTES, Ledger, Record, SUMMARY_BYTES_MAX, SampleLedger,
        SummaryRecord, TakeEnding,
    },
    statistics::TakeStatistics,
    varint,
};

/// Size of the shortest STRETCH chunk: type, length, a head of two bytes, CRC. The magic and header before the first
/// one are longer.
const STRETCH_BYTES_MIN: u64 = 8;

/// Position of a key stretch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct IndexEntry {
    /// File offset of its chunk.
    pub offset: u64,
    /// Its first row.
    pub first_row: u64,
}

/// The payload of INDEX.
#[must_use]
pub fn index_payload(entries: &[IndexEntry]) -> Vec<u8> {
    let mut out = Vec::new();
    varint::put(&mut out, entries.len() as u64);
    let mut before = IndexEntry { offset: 0, first_row: 0 };
    for entry in entries {
        varint::put(&mut out, entry.offset.wrapping_sub(before.offset));
        varint::put(&mut out, entry.first_row.wrapping_sub(before.first_row));
        before = *entry;
    }
    out
}

/// Parses the payload of the INDEX chunk at file offset `offset`.
///
/// # Errors
/// `Corrupt`.
pub fn parse_index(payload: &[u8], offset: u64) -> Result<Vec<IndexEntry>, TakeError> {
    let message = "its entries are invalid or do not fill the payload";
    let corrupt = || TakeError::corrupt("index", offset, message);
    let mut cursor = varint::Cursor::new(payload);
    let count = cursor.varint().ok_or_else(corrupt)?;
    let mut entries = Vec::new();
    let mut before = IndexEntry { offset: 0, first_row: 0 };
    for _ in 0..count {
        // This bounds the memory of an index by twice the size of the stretches it lists.
        let by = cursor.varint().filter(|&by| by >= STRETCH_BYTES_MIN).ok_or_else(corrupt)?;
        let rows = cursor.varint().ok_or_else(corrupt)?;
        before.offset = before.offset.wrapping_add(by);
        before.first_row = before.first_row.wrapping_add(rows);
        entries.push(before);
    }
    if cursor.is_empty() { Ok(entries) } else { Err(corrupt()) }
}

/// The last chunk of a closed take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Footer {
    /// File offset of INDEX.
    pub index_offset: u64,
    /// File offset of the last LEDGER.
    pub ledger_offset: u64,
    /// Number of rows, including lost ones.
    pub n_rows: u64,
}

impl Footer {
    /// Size of its chunk, which ends a closed take: type, length, payload, CRC.
    pub const CHUNK_BYTES: usize = 30;

    /// Its payload.
    #[must_use]
    pub fn to_payload(self) -> Vec<u8> {
        [self.index_offset, self.ledger_offset, self.n_rows].map(u64::to_le_bytes).concat()
    }

    /// Parses the last bytes of a file. `None` unless they are a footer with a matching CRC, which shows that the take
    /// was closed.
    #[must_use]
    pub fn from_chunk(chunk: &[u8; Self::CHUNK_BYTES]) -> Option<Self> {
        let ChunkParse::Whole { kind: types::FOOTER, payload, .. } = chunk::parse(chunk) else {
            return None;
        };
        Self::from_payload(payload, 0).ok()
    }

    /// Parses the payload.
    ///
    /// # Errors
    /// `Corrupt` unless it has 24 bytes.
    pub fn from_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        if let (&[index, ledger, rows], []) = payload.as_chunks::<8>() {
            let [index_offset, ledger_offset, n_rows] =
                [index, ledger, rows].map(u64::from_le_bytes);
            return Ok(Self { index_offset, ledger_offset, n_rows });
        }
        let message = format!("expected 24 bytes, found {}", payload.len());
        Err(TakeError::corrupt("footer", offset, message))
    }

    /// Rejects a footer that claims more than `rows_max` rows.
    ///
    /// # Errors
    /// `Corrupt`.
    pub(crate) fn check(self, rows_max: u64, offset: u64) -> Result<Self, TakeError> {
        if self.n_rows <= rows_max {
            return Ok(self);
        }
        let message = format!("it states {} frames, more than any loss can explain", self.n_rows);
        Err(TakeError::corrupt("footer", offset, message))
    }
}

/// Size of one read at the start of a chunk: enough for the header of hundreds of markers, and for most ledgers with
/// the summary after them.
const READ_BYTES: u64 = 16 << 10;

/// Maximum number of bytes of a record's chunk besides its content: type, a length of at most five bytes, CRC-32, and
/// the version.
const OVERHEAD_BYTES: u64 = 1 + 5 + 4 + 2;

/// Longest chunk of a record.
const RECORD_BYTES_MAX: u64 = LIMIT_BYTES as u64 + OVERHEAD_BYTES;

/// Longest SUMMARY chunk.
const SUMMARY_CHUNK_BYTES_MAX: u64 = SUMMARY_BYTES_MAX as u64 + OVERHEAD_BYTES;

/// What a take states at its start and at its end.
#[derive(Debug, Clone, PartialEq)]
pub struct TakeEnds {
    /// The header.
    pub header: Header,
    /// `None` without a footer: the take is being written, or was cut off.
    pub end: Option<TakeEnd>,
}

/// The end of a closed take.
#[derive(Debug, Clone, PartialEq)]
pub struct TakeEnd {
    /// The last chunk.
    pub footer: Footer,
    /// The last ledger of sampled channels; `None` in a take without any.
    pub sample_ledger: Option<SampleLedger>,
    /// The last ledger; `None` if the chunk at the footer's offset is missing or damaged.
    pub ledger: Option<Ledger>,
    /// How the take ended, if it states that.
    pub ending: Option<TakeEnding>,
    /// The complete channel table, in column order, if the take repeats it at its end.
    pub channels: Option<Vec<Channel>>,
    /// The statistics of the take, if it states them.
    pub statistics: Option<TakeStatistics>,
}

impl TakeEnds {
    /// Reads both ends: some kilobytes of most takes, and at most the size limits of these records (16 MiB).
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`; `Corrupt` for a header that cannot be decoded.
    pub fn read(input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        let file_bytes = input.seek(SeekFrom::End(0))?;
        input.seek(SeekFrom::Start(0))?;
        let mut magic = Vec::with_capacity(MAGIC.len());
        input.by_ref().take(MAGIC.len() as u64).read_to_end(&mut magic)?;
        if magic != MAGIC {
            return Err(TakeError::NotATake(NotATake::OtherMagic));
        }
        let offset = MAGIC.len() as u64;
        let chunk = Chunk::read(input, offset, types::HEADER, RECORD_BYTES_MAX)?
            .ok_or(TakeError::NotATake(NotATake::NoHeader))?;
        let header = Header::from_payload(&chunk.payload, offset)?;
        header.check()?;
        Ok(Self { header, end: TakeEnd::read(input, file_bytes)? })
    }
}

impl TakeEnd {
    fn read(input: &mut (impl Read + Seek), file_bytes: u64) -> Result<Option<Self>, TakeError> {
        let Some(at) = file_bytes.checked_sub(Footer::CHUNK_BYTES as u64) else { return Ok(None) };
        input.seek(SeekFrom::Start(at))?;
        let mut bytes = [0; Footer::CHUNK_BYTES];
        input.read_exact(&mut bytes)?;
        let Some(footer) = Footer::from_chunk(&bytes) else { return Ok(None) };
        let mut end = Self {
            footer,
            sample_ledger: None,
            ledger: None,
            ending: None,
            channels: None,
            statistics: None,
        };
        let ledger_at = footer.ledger_offset;
        // No chunk follows a footer, and no file is long enough for every 64-bit offset.
        if ledger_at >= at {
            return Ok(Some(end));
        }
        let Some(chunk) = Chunk::read(input, ledger_at, types::LEDGER, RECORD_BYTES_MAX)? else {
            return Ok(Some(end));
        };
        end.ledger = Ledger::from_payload(&chunk.payload, ledger_at).ok();
        let summary_at = ledger_at + chunk.len;
        if summary_at < footer.index_offset {
            let limit = SUMMARY_CHUNK_BYTES_MAX;
            let chunk = Chunk::read(input, summary_at, types::SUMMARY, limit)?;
            let summary = |c: Chunk| SummaryRecord::from_payload(&c.payload, summary_at).ok();
            let summary = chunk.and_then(summary).unwrap_or_default();
            (end.ending, end.statistics) = (summary.ending, summary.statistics);
            end.sample_ledger = summary.sample_ledger;
            end.channels = summary.header.map(|header| header.channels);
            if let Some(order) = &summary.order {
                end.channels.iter_mut().for_each(|table| order.restore_table(table));
                end.statistics.iter_mut().for_each(|found| order.restore_statistics(found));
            }
        }
        Ok(Some(end))
    }
}

/// A chunk with a matching CRC.
struct Chunk {
    payload: Vec<u8>,
    len: u64,
}

impl Chunk {
    /// Reads the chunk at `offset`. `None` unless its CRC matches, its type is `kind` and it has at most `max` bytes.
    fn read(
        input: &mut (impl Read + Seek),
        offset: u64,
        kind: u8,
        max: u64,
    ) -> Result<Option<Self>, TakeError> {
        let mut bytes = Vec::new();
        let mut needed = READ_BYTES.min(max);
        input.seek(SeekFrom::Start(offset))?;
        loop {
            // Memory grows with the file's content, not with a length that it claims.
            input.by_ref().take(needed - bytes.len() as u64).read_to_end(&mut bytes)?;
            let has_kind = bytes.first() == Some(&kind);
            match chunk::parse(&bytes) {
                ChunkParse::Whole { payload, len, .. } if has_kind => {
                    return Ok(Some(Self { payload: payload.to_vec(), len: len as u64 }));
                }
                ChunkParse::Short(more) if has_kind && more <= max && more > needed => {
                    needed = more;
                }
                _ => return Ok(None),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::{
        TakeWriter,
        record::{CODEC_VERSION, Channel, EndingKind},
    };

    #[test]
    fn index_and_footer_round_trip() {
        let entries = [(100, 0), (9_000, 600), (20_000, 1_200)]
            .map(|(offset, first_row)| IndexEntry { offset, first_row });
        let payload = index_payload(&entries);
        assert_eq!(parse_index(&payload, 0).unwrap(), entries);
        assert!(parse_index(&payload[..payload.len() - 1], 0).is_err());

        let footer = Footer { index_offset: 5, ledger_offset: 6, n_rows: 7 };
        let mut out = Vec::new();
        chunk::put(&mut out, types::FOOTER, &footer.to_payload()).unwrap();
        assert_eq!(out.len(), Footer::CHUNK_BYTES);
        assert_eq!(Footer::from_payload(&footer.to_payload(), 0).unwrap(), footer);
    }

    fn header(n_channels: u16) -> Header {
        let channel =
            |marker_id| Channel { marker_id, label: format!("{marker_id:0>9}"), labelled: true };
        Header {
            software: "test".to_owned(),
            take_id: [7; 16],
            created_unix_ms: 0,
            resampler: "dense".to_owned(),
            codec_version: CODEC_VERSION,
            tolerance_mm: 1.0,
            rate_hz: 100.0,
            up_axis: crate::motion::UpAxis::Unknown,
            device: None,
            source: None,
            channels: (0..n_channels).map(channel).collect(),
            stretch_rows: 50,
            settings: Vec::new(),
        }
    }

    fn take(n_channels: u16, contradictions: usize, ending: Option<TakeEnding>) -> Vec<u8> {
        let mut take = TakeWriter::new(Vec::new(), &header(n_channels)).unwrap();
        let contradictions = vec!["x".repeat(1000); contradictions];
        let ledger = Ledger { finished: true, contradictions, ..Ledger::default() };
        take.close(&ledger, ending).unwrap();
        take.abandon()
    }

    #[test]
    fn ends_of_any_size_are_read() {
        let ending = TakeEnding::from(EndingKind::DeviceGone);
        for (n_channels, contradictions) in [(0, 0), (3, 1), (20_000, 100)] {
            for ending in [None, Some(ending.clone())] {
                let bytes = take(n_channels, contradictions, ending.clone());
                let ends = TakeEnds::read(&mut Cursor::new(&bytes)).unwrap();
                assert_eq!(ends.header.channels.len(), usize::from(n_channels));
                let end = ends.end.unwrap();
                assert_eq!(end.ledger.unwrap().contradictions.len(), contradictions);
                assert_eq!(end.ending, ending);
                assert_eq!(end.channels.unwrap(), ends.header.channels);
                assert_eq!(end.statistics.unwrap().channels.len(), ends.header.channels.len());
            }
        }
    }

    #[test]
    fn every_cut_and_every_wrong_byte_is_detected() {
        let bytes = take(2, 0, Some(EndingKind::DiskFull.into()));
        for cut in 0..bytes.len() {
            let read = TakeEnds::read(&mut Cursor::new(&bytes[..cut]));
            assert!(read.is_err() || read.unwrap().end.is_none(), "{cut}");
        }
        let whole = TakeEnds::read(&mut Cursor::new(&bytes)).unwrap();
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x21;
            let Ok(read) = TakeEnds::read(&mut Cursor::new(&damaged)) else { continue };
            let Some(end) = read.end else { continue };
            let expected = whole.end.clone().unwrap();
            assert!(end.ledger.is_none() || end.ledger == expected.ledger, "{at}");
            assert!(end.ending.is_none() || end.ending == expected.ending, "{at}");
            assert!(end.statistics.is_none() || end.statistics == expected.statistics, "{at}");
        }
    }

    /// Seeks like a file: offsets beyond `i64::MAX` are errors.
    struct SignedOffsetFile(Cursor<Vec<u8>>);

    impl Read for SignedOffsetFile {
        fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
            self.0.read(bytes)
        }
    }

    impl Seek for SignedOffsetFile {
        fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
            match to {
                SeekFrom::Start(at) if i64::try_from(at).is_err() => {
                    Err(std::io::ErrorKind::InvalidInput.into())
                }
                to => self.0.seek(to),
            }
        }
    }

    #[test]
    fn a_ledger_offset_after_the_footer_is_ignored() {
        let bytes = take(2, 0, Some(EndingKind::DiskFull.into()));
        let footer_at = bytes.len() - Footer::CHUNK_BYTES;
        for ledger_offset in [footer_at as u64, bytes.len() as u64, i64::MAX as u64 + 1, u64::MAX] {
            let mut changed = bytes[..footer_at].to_vec();
            let footer = Footer { index_offset: u64::MAX, ledger_offset, n_rows: 0 };
            chunk::put(&mut changed, types::FOOTER, &footer.to_payload()).unwrap();
            let ends = TakeEnds::read(&mut SignedOffsetFile(Cursor::new(changed))).unwrap();
            let end = ends.end.unwrap();
            assert_eq!((end.footer, end.ledger, end.ending), (footer, None, None));
            assert_eq!((end.channels, end.statistics), (None, None));
        }
    }
}
