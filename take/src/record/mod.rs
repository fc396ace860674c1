//! Small records: a version, then bincode, bounded, and only ever decoded after the chunk's CRC matched.
//!
//! Structures are frozen per version; docs/take-format.md gives their bytes.

mod channel_table;
mod clock;
mod event;
mod header;
mod import_id;
mod ledger;
mod stored;
mod subject;
mod summary;

use bincode::{
    config::{Configuration, Limit, LittleEndian, Varint},
    error::DecodeError,
};

pub use clock::{
    CLOCK_ENTRIES_MAX, Clock, ClockBound, ClockJitter, ClockLine, ClockPoint, ClockProbe,
};
pub use event::{Event, EventKind};
pub(crate) use header::MoreChannels;
pub use header::{CODEC_VERSION, Channel, Device, Header, ImportSource};
pub use ledger::{ClockFit, Ledger};
pub use subject::{DOCUMENT_BYTES_MAX, DOCUMENTS_MAX, Document, Subject};
pub use summary::{DETAIL_BYTES_MAX, EndingKind, SUMMARY_BYTES_MAX, SummaryRecord, TakeEnding};

use crate::TakeError;

/// Most bytes that decoding may claim: 10 000 labels of 255 bytes fit.
pub(crate) const LIMIT_BYTES: usize = 4 << 20;

type Config = Configuration<LittleEndian, Varint, Limit<LIMIT_BYTES>>;
const CONFIG: Config = bincode::config::standard().with_little_endian().with_limit::<LIMIT_BYTES>();

/// A structure with a chunk type and a version of its own.
pub trait Record: bincode::Encode + bincode::Decode<()> {
    /// For messages.
    const NAME: &'static str;
    /// The chunk type it travels in.
    const KIND: u8;
    /// The newest version this build reads, and the one it writes.
    const VERSION: u16;

    /// The payload of its chunk.
    ///
    /// # Errors
    /// `InvalidArgument` when it is larger than a reader would accept.
    fn to_payload(&self) -> Result<Vec<u8>, TakeError> {
        let mut out = Self::VERSION.to_le_bytes().to_vec();
        let body = bincode::encode_to_vec(self, CONFIG).map_err(|e| {
            TakeError::InvalidArgument(format!("{} cannot be stored: {e}", Self::NAME))
        })?;
        if body.len() > LIMIT_BYTES {
            return Err(TakeError::InvalidArgument(format!(
                "{} of {} bytes is larger than a take can hold ({LIMIT_BYTES})",
                Self::NAME,
                body.len()
            )));
        }
        // The limit counts what decoding claims, which is more than the bytes: ask the decoder.
        bincode::decode_from_slice::<Self, _>(&body, CONFIG).map_err(|e| {
            let why = match e {
                DecodeError::Other(why) => why.to_owned(),
                e => e.to_string(),
            };
            TakeError::InvalidArgument(format!(
                "{} is larger than a take can hold: {why}",
                Self::NAME
            ))
        })?;
        out.extend_from_slice(&body);
        Ok(out)
    }

    /// From the payload of a chunk at file offset `offset`, whose CRC matched.
    ///
    /// # Errors
    /// `Unsupported` for a newer version, `Corrupt` when the bytes are not that structure and nothing more.
    fn from_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        let corrupt = |message: String| TakeError::Corrupt { what: Self::NAME, offset, message };
        let (version, body) = payload
            .split_first_chunk::<2>()
            .ok_or_else(|| corrupt("shorter than its version".into()))?;
        let found = u16::from_le_bytes(*version);
        if found != Self::VERSION {
            return Err(TakeError::Unsupported {
                what: Self::NAME,
                found,
                supported: Self::VERSION,
            });
        }
        let (record, used) = bincode::decode_from_slice(body, CONFIG)
            .map_err(|e| corrupt(format!("not decodable: {e}")))?;
        if used != body.len() {
            return Err(corrupt(format!("{} bytes follow the record", body.len() - used)));
        }
        Ok(record)
    }
}
