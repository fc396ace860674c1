//! INDEX and FOOTER: the way to the middle of a long take, and the proof that it was finished.

use crate::{
    TakeError,
    chunk::{self, types},
    varint,
};

/// Bytes of the shortest chunk of a stretch: type, length, a head of two bytes, CRC. It is less than what stands in front of
/// the first one.
const STRETCH_BYTES_MIN: u64 = 8;

/// One key stretch.
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

/// From the payload of INDEX at file offset `offset`.
///
/// # Errors
/// `Corrupt`.
pub fn parse_index(payload: &[u8], offset: u64) -> Result<Vec<IndexEntry>, TakeError> {
    let corrupt = || TakeError::Corrupt {
        what: "index",
        offset,
        message: "its entries do not fill it, or make no sense".into(),
    };
    let mut cursor = varint::Cursor::new(payload);
    let count = cursor.varint().ok_or_else(corrupt)?;
    let mut entries = Vec::new();
    let mut before = IndexEntry { offset: 0, first_row: 0 };
    for _ in 0..count {
        let (Some(by), Some(rows)) = (cursor.varint(), cursor.varint()) else {
            return Err(corrupt());
        };
        // So that an index costs no more memory than twice the stretches that it tells of.
        if by < STRETCH_BYTES_MIN {
            return Err(corrupt());
        }
        before = IndexEntry {
            offset: before.offset.wrapping_add(by),
            first_row: before.first_row.wrapping_add(rows),
        };
        entries.push(before);
    }
    if cursor.is_empty() { Ok(entries) } else { Err(corrupt()) }
}

/// The last chunk of a finished take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Footer {
    /// File offset of INDEX.
    pub index_offset: u64,
    /// File offset of the last LEDGER.
    pub ledger_offset: u64,
    /// Rows in all, lost ones included.
    pub n_rows: u64,
}

impl Footer {
    /// Bytes of its chunk, the last ones of a finished take: type, length, payload, CRC.
    pub const CHUNK_BYTES: usize = 30;

    /// Its payload.
    #[must_use]
    pub fn to_payload(self) -> Vec<u8> {
        [self.index_offset, self.ledger_offset, self.n_rows]
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect()
    }

    /// From the last bytes of a file, when they are a footer whose CRC matches: so a take is known to be finished
    /// without reading it.
    #[must_use]
    pub fn from_chunk(chunk: &[u8; Self::CHUNK_BYTES]) -> Option<Self> {
        match chunk::front(chunk) {
            chunk::Front::Whole { kind: types::FOOTER, payload, .. } => {
                Self::from_payload(payload, 0).ok()
            }
            _ => None,
        }
    }

    /// From its payload.
    ///
    /// # Errors
    /// `Corrupt` when it is not 24 bytes.
    pub fn from_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        let word = |i: usize| payload[i * 8..].first_chunk().map(|b| u64::from_le_bytes(*b));
        match payload.len() {
            24 => word(0).zip(word(1)).zip(word(2)),
            _ => None,
        }
        .map(|((index_offset, ledger_offset), n_rows)| Self { index_offset, ledger_offset, n_rows })
        .ok_or_else(|| TakeError::Corrupt {
            what: "footer",
            offset,
            message: format!("{} bytes instead of 24", payload.len()),
        })
    }

    /// Itself, unless it claims more rows than what is known of the take leaves room for.
    ///
    /// # Errors
    /// `Corrupt`.
    pub(crate) fn check(self, rows_max: u64, offset: u64) -> Result<Self, TakeError> {
        if self.n_rows <= rows_max {
            return Ok(self);
        }
        let message = format!("it tells of {} frames, more than can have been lost", self.n_rows);
        Err(TakeError::Corrupt { what: "footer", offset, message })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunk;

    #[test]
    fn both_come_back() {
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
}
