//! FOREIGN: what an importer found and the take does not model, kept for the way back.

use std::io::{Read, Write};

use flate2::{Compression, bufread::DeflateDecoder, write::DeflateEncoder};

use crate::{TakeError, motion::Foreign, varint};

/// Longest foreign part: a C3D file's analog section at the format's own limits stays below it.
const DATA_BYTES_MAX: u64 = 1 << 28;

/// The payload of a FOREIGN chunk.
///
/// # Errors
/// `InvalidArgument` when the part is too long; `Io` never happens in memory.
pub fn to_payload(foreign: &Foreign) -> Result<Vec<u8>, TakeError> {
    if foreign.data.len() as u64 > DATA_BYTES_MAX {
        return Err(TakeError::InvalidArgument(format!(
            "{} of {} bytes is longer than a take can hold; import with --drop-foreign",
            foreign.kind,
            foreign.data.len()
        )));
    }
    let mut out = Vec::new();
    varint::put(&mut out, foreign.kind.len() as u64);
    out.extend_from_slice(foreign.kind.as_bytes());
    varint::put(&mut out, foreign.data.len() as u64);
    let mut deflate = DeflateEncoder::new(out, Compression::best());
    deflate.write_all(&foreign.data)?;
    Ok(deflate.finish()?)
}

/// From the payload of a FOREIGN chunk at file offset `offset`.
///
/// # Errors
/// `Corrupt` when the bytes are not such a payload.
pub fn from_payload(payload: &[u8], offset: u64) -> Result<Foreign, TakeError> {
    let corrupt = |message: &str| TakeError::Corrupt {
        what: "foreign part",
        offset,
        message: message.to_owned(),
    };
    let mut cursor = varint::Cursor::new(payload);
    let kind = cursor
        .varint()
        .and_then(|n| cursor.take(n))
        .and_then(|bytes| std::str::from_utf8(bytes).ok())
        .ok_or_else(|| corrupt("no kind"))?;
    let len = cursor.varint().ok_or_else(|| corrupt("no length"))?;
    if len > DATA_BYTES_MAX {
        return Err(corrupt("longer than a take can hold"));
    }
    // Grows with what is really inflated: DEFLATE gives at most 1032 bytes a byte.
    let mut data = Vec::new();
    DeflateDecoder::new(cursor.rest())
        .take(len + 1)
        .read_to_end(&mut data)
        .map_err(|e| corrupt(&format!("not DEFLATE: {e}")))?;
    if data.len() as u64 != len {
        return Err(corrupt("another length than stated"));
    }
    Ok(Foreign { kind: kind.to_owned(), data })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comes_back_and_damage_is_an_error() {
        let part =
            Foreign { kind: "c3d/analog".into(), data: (0..4000).map(|i| i as u8).collect() };
        let payload = to_payload(&part).unwrap();
        assert!(payload.len() < 600);
        assert_eq!(from_payload(&payload, 8).unwrap(), part);
        for cut in 0..payload.len() {
            assert!(from_payload(&payload[..cut], 8).is_err(), "{cut}");
        }
    }
}
