//! Bytes into records.

use super::{Entry, HEAD_BYTES, MAGIC, PAYLOAD_AT, PAYLOAD_BYTES_MAX, Record, VERSION};

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
        let head = rest.first_chunk::<PAYLOAD_AT>().ok_or_else(|| cut_off.clone())?;
        let [kind, t0, t1, t2, t3, t4, t5, t6, t7, n0, n1, n2, n3] = *head;
        let n = u32::from_le_bytes([n0, n1, n2, n3]) as usize;
        if n > PAYLOAD_BYTES_MAX {
            return Err(damaged);
        }
        let end = PAYLOAD_AT + n;
        let (body, rest) = rest.split_at_checked(end).ok_or_else(|| cut_off.clone())?;
        let crc = rest.first_chunk::<4>().ok_or(cut_off)?;
        if crc32fast::hash(body) != u32::from_le_bytes(*crc) {
            return Err(damaged);
        }
        let payload = body.get(PAYLOAD_AT..).unwrap_or_default();
        let entry = match (kind, n) {
            (0x01, _) => Entry::FromDevice(payload),
            (0x02, _) => Entry::ToDevice(payload),
            (0x03, 0) => Entry::Break,
            (0x04, 4) => {
                Entry::Baud(u32::from_le_bytes(payload.first_chunk().copied().unwrap_or_default()))
            }
            (0x10, _) => Entry::Opened(str::from_utf8(payload).map_err(|_| damaged)?),
            (0x11, 0) => Entry::Closed,
            (0x20, 8) => Entry::Missing(u64::from_le_bytes(
                payload.first_chunk().copied().unwrap_or_default(),
            )),
            (0x7f, 0) => Entry::End,
            _ => return Err(damaged),
        };
        self.offset = offset + end + 4;
        let time_ns = u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]);
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
