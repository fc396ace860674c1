//! The raw log: every byte that went over a line, either way, with its time. `docs/raw-log.md` has the format.

use crate::bytes::{Cursor, Wire, record};

/// What a raw log begins with.
///
/// The first byte is no text, the line ends show a transfer that changed them, and 0x1a ends a listing.
pub const MAGIC: [u8; 8] = *b"\x89MRL\r\n\x1a\n";

/// The version that this build writes and reads.
pub const VERSION: u8 = 1;

/// Bytes before the first record.
pub const HEAD_BYTES: usize = MAGIC.len() + 1;

/// Type, time, length and checksum around every payload.
pub const RECORD_OVERHEAD_BYTES: usize = 1 + 8 + 4 + 4;

/// The longest payload: 16 times what a host reads at once.
pub const PAYLOAD_BYTES_MAX: usize = 1 << 20;

/// What a record tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry<'a> {
    /// The device said these bytes.
    FromDevice(&'a [u8]),
    /// The host said these bytes.
    ToDevice(&'a [u8]),
    /// The host held the line in the break state, as a reset.
    Break,
    /// The host changed the line's speed, in baud.
    Baud(u32),
    /// The line was opened. The driver's name and the line in words, with a space in between.
    Opened(&'a str),
    /// The device was gone, or the line was closed.
    Closed,
    /// So many bytes of both directions are not in the log: the disk did not take them in time.
    Missing(u64),
    /// The log is whole: nothing went over the line after it.
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

/// One record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Record<'a> {
    /// Nanoseconds since the log was begun.
    pub time_ns: u64,
    /// What it tells.
    pub entry: Entry<'a>,
}

/// Appends what a log begins with.
pub fn put_head(out: &mut Vec<u8>) {
    out.extend_from_slice(&MAGIC);
    out.push(VERSION);
}

/// Appends a record. A payload that is longer than [`PAYLOAD_BYTES_MAX`] goes as several.
pub fn put_record(record: &Record<'_>, out: &mut Vec<u8>) {
    let Record { time_ns, entry } = record;
    let payload: &[u8] = match entry {
        Entry::FromDevice(bytes) | Entry::ToDevice(bytes) => bytes,
        Entry::Opened(words) => words.as_bytes(),
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

/// Why a raw log cannot be read on.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RawLogError {
    /// It does not begin like one.
    #[error("not a raw log: `mocapd record --raw` writes them")]
    NotALog,
    /// A later version.
    #[error("raw log version {found}, and this build reads {VERSION}: use a newer one")]
    Version {
        /// As it says.
        found: u8,
    },
    /// A record is not as it was written. What stands before it is good.
    #[error("the raw log is damaged at byte {offset}, and is read up to there")]
    Damaged {
        /// Where the record begins.
        offset: usize,
    },
    /// The last record is not whole: the recorder was killed.
    #[error("the raw log is cut off at byte {offset}, and is read up to there")]
    CutOff {
        /// Where the record begins.
        offset: usize,
    },
}

/// What stands in front of every payload.
struct Head {
    kind: u8,
    time_ns: u64,
    payload_bytes: u32,
}

record!(Head { kind, time_ns, payload_bytes });

/// The records of a log, one after another, and an error where it cannot be read on. Nothing is allocated.
#[derive(Debug, Clone)]
pub struct Records<'a> {
    log: &'a [u8],
    offset: usize,
    ended: bool,
}

/// Reads a log that is in memory.
///
/// # Errors
/// `NotALog` and `Version`.
pub fn records(log: &[u8]) -> Result<Records<'_>, RawLogError> {
    let rest = log.strip_prefix(&MAGIC[..]).ok_or(RawLogError::NotALog)?;
    match rest.first() {
        Some(&VERSION) => Ok(Records { log, offset: HEAD_BYTES, ended: false }),
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
        let head = cursor.get::<Head>().ok_or_else(|| cut_off.clone())?;
        let Head { kind, time_ns, payload_bytes } = head;
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
            (0x04, _) => Entry::Baud(Wire::whole(payload).ok_or(damaged)?),
            (0x10, _) => Entry::Opened(str::from_utf8(payload).map_err(|_| damaged)?),
            (0x11, 0) => Entry::Closed,
            (0x20, _) => Entry::Missing(Wire::whole(payload).ok_or(damaged)?),
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

    fn written() -> (Vec<u8>, Vec<Record<'static>>) {
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
        put_head(&mut log);
        let records = (0..).zip(entries).map(|(i, entry)| Record { time_ns: i << 40, entry });
        let records: Vec<_> = records.collect();
        records.iter().for_each(|record| put_record(record, &mut log));
        (log, records)
    }

    #[test]
    fn records_come_back_as_they_were() {
        let (log, expected) = written();
        let found: Result<Vec<_>, _> = records(&log).unwrap().collect();
        assert_eq!(found.unwrap(), expected);
        assert_eq!(log.len(), HEAD_BYTES + 9 * RECORD_OVERHEAD_BYTES + 11 + 3 + 4 + 300 + 8);
    }

    #[test]
    fn a_long_payload_goes_as_several_records() {
        let bytes = vec![5; 2 * PAYLOAD_BYTES_MAX + 1];
        let mut log = Vec::new();
        put_head(&mut log);
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
        let (log, expected) = written();
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
        let (mut log, _) = written();
        log[MAGIC.len()] = 9;
        assert_eq!(records(&log).unwrap_err(), RawLogError::Version { found: 9 });
    }
}
