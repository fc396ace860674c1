//! Raw logs: every byte of a line, in both directions, with its time. `docs/raw-log.md` has the format.

use crate::bytes::{Cursor, WireValue, wire_struct};

/// Magic number at the start of a raw log.
///
/// The first byte is not ASCII, the line ends reveal a transfer in text mode, and 0x1a ends a listing.
pub const MAGIC: [u8; 8] = *b"\x89MRL\r\n\x1a\n";

/// Format version that this build writes and reads.
pub const VERSION: u8 = 1;

/// Bytes of the file header: magic number and version.
pub const HEADER_BYTES: usize = MAGIC.len() + 1;

/// Bytes around every payload: type, time, length and checksum.
pub const RECORD_OVERHEAD_BYTES: usize = 1 + 8 + 4 + 4;

/// Longest payload of a record, in bytes: 16 times the largest read of a host.
pub const PAYLOAD_BYTES_MAX: usize = 1 << 20;

/// Content of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry<'a> {
    /// Bytes received from the device.
    FromDevice(&'a [u8]),
    /// Bytes sent to the device.
    ToDevice(&'a [u8]),
    /// The host sent a break, which resets some devices.
    Break,
    /// The host changed the line's speed, in baud.
    Baud(u32),
    /// The line was opened. Holds the driver's name, a space, and the description of the line.
    Opened(&'a str),
    /// The device was disconnected, or the line closed.
    Closed,
    /// Number of bytes of both directions that are missing here, because the disk fell behind.
    Missing(u64),
    /// The log is complete: nothing went over the line afterwards.
    End,
}

impl Entry<'_> {
    fn kind(&self) -> u8 {
        match self {
            Self::FromDevice(_) => 0x01,
            Self::ToDevice(_) => 0x02,
            Self::Break => 0x03,
            Self::Baud(_) => 0x04,
            Self::Opened(_) => 0x10,
            Self::Closed => 0x11,
            Self::Missing(_) => 0x20,
            Self::End => 0x7f,
        }
    }
}

/// One record of a raw log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Record<'a> {
    /// Nanoseconds since the start of the log.
    pub time_ns: u64,
    /// The content.
    pub entry: Entry<'a>,
}

/// Appends the file header.
pub fn put_header(out: &mut Vec<u8>) {
    out.extend_from_slice(&MAGIC);
    out.push(VERSION);
}

/// Appends a record. A payload longer than [`PAYLOAD_BYTES_MAX`] is split over several records.
pub fn put_record(record: &Record<'_>, out: &mut Vec<u8>) {
    let Record { time_ns, entry } = record;
    let payload: &[u8] = match entry {
        Entry::FromDevice(bytes) | Entry::ToDevice(bytes) => bytes,
        Entry::Opened(text) => text.as_bytes(),
        Entry::Missing(bytes) => &bytes.to_le_bytes(),
        Entry::Baud(baud) => &baud.to_le_bytes(),
        Entry::Break | Entry::Closed | Entry::End => &[],
    };
    let mut rest = payload;
    loop {
        let (now, later) = rest.split_at(rest.len().min(PAYLOAD_BYTES_MAX));
        let start = out.len();
        out.push(entry.kind());
        time_ns.put(out);
        (now.len() as u32).put(out);
        out.extend_from_slice(now);
        crc32fast::hash(out.get(start..).unwrap_or_default()).put(out);
        if later.is_empty() {
            return;
        }
        rest = later;
    }
}

/// Reasons why reading a raw log stops.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RawLogError {
    /// The file does not start with [`MAGIC`].
    #[error("not a raw log: record one with `mocapd record --raw`")]
    NotALog,
    /// The log has another format version.
    #[error("raw log version {found}, but this build reads version {VERSION}: use a newer build")]
    Version {
        /// Version in the file.
        found: u8,
    },
    /// The checksum or layout of a record is wrong. The records before it are intact.
    #[error("raw log damaged at byte {offset}; the records before it were read")]
    Damaged {
        /// Where the record begins.
        offset: usize,
    },
    /// The last record is incomplete: the recorder was killed.
    #[error("raw log cut off at byte {offset}; the records before it were read")]
    CutOff {
        /// Where the record begins.
        offset: usize,
    },
}

/// Header of a record, before its payload.
struct RecordHeader {
    kind: u8,
    time_ns: u64,
    payload_bytes: u32,
}

wire_struct!(RecordHeader { kind, time_ns, payload_bytes });

/// Iterator over the records of a log. It yields an error where the log cannot be read, and allocates nothing.
#[derive(Debug, Clone)]
pub struct Records<'a> {
    log: &'a [u8],
    offset: usize,
    ended: bool,
}

/// Iterates over the records of a log in memory.
///
/// # Errors
/// `NotALog` and `Version`.
pub fn records(log: &[u8]) -> Result<Records<'_>, RawLogError> {
    let rest = log.strip_prefix(&MAGIC[..]).ok_or(RawLogError::NotALog)?;
    match rest.first() {
        Some(&VERSION) => Ok(Records { log, offset: HEADER_BYTES, ended: false }),
        Some(&found) => Err(RawLogError::Version { found }),
        None => Err(RawLogError::CutOff { offset: MAGIC.len() }),
    }
}

impl<'a> Records<'a> {
    fn read(&mut self) -> Result<Record<'a>, RawLogError> {
        let offset = self.offset;
        let (cut_off, damaged) = (RawLogError::CutOff { offset }, RawLogError::Damaged { offset });
        let rest = self.log.get(offset..).unwrap_or_default();
        let mut cursor = Cursor::new(rest);
        let header = cursor.get::<RecordHeader>().ok_or_else(|| cut_off.clone())?;
        let RecordHeader { kind, time_ns, payload_bytes } = header;
        let n = payload_bytes as usize;
        if n > PAYLOAD_BYTES_MAX {
            return Err(damaged);
        }
        let payload = cursor.bytes(n).ok_or_else(|| cut_off.clone())?;
        let crc: u32 = cursor.get().ok_or(cut_off)?;
        let bytes = RECORD_OVERHEAD_BYTES + n;
        if rest.get(..bytes - 4).map(crc32fast::hash) != Some(crc) {
            return Err(damaged);
        }
        let entry = match (kind, n) {
            (0x01, _) => Entry::FromDevice(payload),
            (0x02, _) => Entry::ToDevice(payload),
            (0x03, 0) => Entry::Break,
            (0x04, _) => Entry::Baud(WireValue::decode(payload).ok_or(damaged)?),
            (0x10, _) => Entry::Opened(str::from_utf8(payload).map_err(|_| damaged)?),
            (0x11, 0) => Entry::Closed,
            (0x20, _) => Entry::Missing(WireValue::decode(payload).ok_or(damaged)?),
            (0x7f, 0) => Entry::End,
            _ => return Err(damaged),
        };
        self.offset = offset + bytes;
        Ok(Record { time_ns, entry })
    }
}

impl<'a> Iterator for Records<'a> {
    type Item = Result<Record<'a>, RawLogError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let record = self.read();
        self.ended = !matches!(&record, Ok(record) if record.entry != Entry::End);
        Some(record)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample_log() -> (Vec<u8>, Vec<Record<'static>>) {
        let entries = [
            Entry::Opened("dvmc a line"),
            Entry::ToDevice(&[0, 1, 2]),
            Entry::FromDevice(&[]),
            Entry::Break,
            Entry::Baud(921_600),
            Entry::FromDevice(&[9; 300]),
            Entry::Missing(77),
            Entry::Closed,
            Entry::End,
        ];
        let mut log = Vec::new();
        put_header(&mut log);
        let records = (0..).zip(entries).map(|(i, entry)| Record { time_ns: i << 40, entry });
        let records: Vec<_> = records.collect();
        records.iter().for_each(|record| put_record(record, &mut log));
        (log, records)
    }

    #[test]
    fn records_round_trip() {
        let (log, expected) = sample_log();
        let found: Result<Vec<_>, _> = records(&log).unwrap().collect();
        assert_eq!(found.unwrap(), expected);
        assert_eq!(log.len(), HEADER_BYTES + 9 * RECORD_OVERHEAD_BYTES + 11 + 3 + 4 + 300 + 8);
    }

    #[test]
    fn a_long_payload_is_split_into_several_records() {
        let bytes = vec![5; 2 * PAYLOAD_BYTES_MAX + 1];
        let mut log = Vec::new();
        put_header(&mut log);
        put_record(&Record { time_ns: 3, entry: Entry::FromDevice(&bytes) }, &mut log);
        let lengths: Vec<usize> = records(&log)
            .unwrap()
            .filter_map(|record| match record {
                Ok(Record { time_ns: 3, entry: Entry::FromDevice(bytes) }) => Some(bytes.len()),
                _ => None,
            })
            .collect();
        assert_eq!(lengths, [PAYLOAD_BYTES_MAX, PAYLOAD_BYTES_MAX, 1]);
    }

    #[test]
    fn every_cut_and_every_changed_byte_is_found() {
        let (log, expected) = sample_log();
        for end in 0..log.len() {
            let found: Vec<_> = match records(&log[..end]) {
                Ok(records) => records.collect(),
                Err(error) => vec![Err(error)],
            };
            let (last, good) = found.split_last().unwrap();
            assert!(
                matches!(last, Err(RawLogError::CutOff { .. } | RawLogError::NotALog)),
                "{end}"
            );
            assert!(good.iter().zip(&expected).all(|(found, wanted)| found.as_ref() == Ok(wanted)));
        }
        for at in 0..log.len() {
            let mut log = log.clone();
            log[at] ^= 0x10;
            let found: Result<Vec<_>, _> = records(&log).and_then(Iterator::collect);
            assert!(found.is_err(), "byte {at}");
        }
    }

    #[test]
    fn other_files_and_later_versions_are_refused() {
        assert_eq!(records(b"").unwrap_err(), RawLogError::NotALog);
        assert_eq!(records(b"seq,ticks\n1,2\n").unwrap_err(), RawLogError::NotALog);
        let (mut log, _) = sample_log();
        log[MAGIC.len()] = 9;
        assert_eq!(records(&log).unwrap_err(), RawLogError::Version { found: 9 });
    }
}
