//! SUMMARY: what stands at the end of a take, so that a reader need not read all of it: tagged sections of which a
//! reader skips those that it does not know.

use std::fmt;

use bincode::{
    Decode, Encode,
    de::Decoder,
    enc::Encoder,
    error::{DecodeError, EncodeError},
};

use super::Record;
use crate::{
    TakeError,
    chunk::types,
    varint::{self, Cursor},
};

/// Longest payload: two records at their limit of 4 MiB, so that there is room for a copy of the header and one of the
/// channel table.
pub const SUMMARY_BYTES_MAX: usize = 8 << 20;

/// Longest detail of an ending, in bytes: a sentence.
pub const DETAIL_BYTES_MAX: usize = 256;

/// The only version of the sequence of sections. A section has a version of its own.
const VERSION: u16 = 1;

/// The section that holds a [`TakeEnding`].
const ENDING_TAG: u64 = 1;

/// Why a take ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EndingKind {
    /// Somebody asked for it.
    #[default]
    Stopped,
    /// It was as long as it should be.
    Length,
    /// The device had no more frames: a replay's end.
    DeviceEnded,
    /// The device went away and did not come back, or could not be read.
    DeviceGone,
    /// So little was left of the disk that the take was closed.
    DiskFull,
    /// The service was stopped.
    ServiceStopped,
    /// It was saved from the pre-roll.
    Saved,
    /// The recorder was killed or the disk failed: the take was cut off, and recovered.
    CutOff,
    /// Another program cut the file short while it was written.
    Truncated,
    /// Its file system was unmounted, or covered by another one.
    Unmounted,
    /// What a later version calls by this code.
    Other(u16),
}

impl EndingKind {
    /// Every kind with a name, in the order of its codes, which begin with 1.
    pub const ALL: [Self; 10] = [
        Self::Stopped,
        Self::Length,
        Self::DeviceEnded,
        Self::DeviceGone,
        Self::DiskFull,
        Self::ServiceStopped,
        Self::Saved,
        Self::CutOff,
        Self::Truncated,
        Self::Unmounted,
    ];

    /// As a take stores it.
    #[must_use]
    pub fn code(self) -> u16 {
        match self {
            Self::Other(code) => code,
            named => Self::ALL
                .iter()
                .zip(1..)
                .find(|(kind, _)| **kind == named)
                .map_or(0, |(_, code)| code),
        }
    }

    /// From what a take stores.
    #[must_use]
    pub fn from_code(code: u16) -> Self {
        let index = usize::from(code).checked_sub(1);
        index.and_then(|index| Self::ALL.get(index)).copied().unwrap_or(Self::Other(code))
    }

    /// For people and documents.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Stopped => "stopped",
            Self::Length => "length",
            Self::DeviceEnded => "device ended",
            Self::DeviceGone => "device gone",
            Self::DiskFull => "disk full",
            Self::ServiceStopped => "service stopped",
            Self::Saved => "saved",
            Self::CutOff => "cut off",
            Self::Truncated => "truncated",
            Self::Unmounted => "unmounted",
            Self::Other(_) => "other",
        }
    }

    /// The kind that has this word; of one that nobody knows here, `Other(0)`.
    #[must_use]
    pub fn from_word(word: &str) -> Self {
        Self::ALL.into_iter().find(|kind| kind.word() == word).unwrap_or(Self::Other(0))
    }
}

impl fmt::Display for EndingKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// How a take ended.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TakeEnding {
    /// Why.
    pub kind: EndingKind,
    /// More about it; empty where there is nothing to say. At most [`DETAIL_BYTES_MAX`].
    pub detail: String,
}

impl TakeEnding {
    /// With a detail, which is cut where it is too long.
    #[must_use]
    pub fn new(kind: EndingKind, mut detail: String) -> Self {
        detail.truncate(detail.floor_char_boundary(DETAIL_BYTES_MAX));
        Self { kind, detail }
    }
}

impl From<EndingKind> for TakeEnding {
    fn from(kind: EndingKind) -> Self {
        Self { kind, detail: String::new() }
    }
}

impl Record for TakeEnding {
    const NAME: &'static str = "ending";
    const KIND: u8 = types::SUMMARY;
    const VERSION: u16 = 1;
}

const LONG_DETAIL: &str = "a detail of more than 256 bytes";

impl Encode for TakeEnding {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        if self.detail.len() > DETAIL_BYTES_MAX {
            return Err(EncodeError::Other(LONG_DETAIL));
        }
        self.kind.code().encode(encoder)?;
        self.detail.encode(encoder)
    }
}

impl Decode<()> for TakeEnding {
    fn decode<D: Decoder<Context = ()>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let kind = EndingKind::from_code(u16::decode(decoder)?);
        let detail = String::decode(decoder)?;
        if detail.len() > DETAIL_BYTES_MAX {
            return Err(DecodeError::Other(LONG_DETAIL));
        }
        Ok(Self { kind, detail })
    }
}

/// The sections that this build knows.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SummaryRecord {
    /// How the take ended; `None` where it does not say.
    pub ending: Option<TakeEnding>,
}

impl SummaryRecord {
    /// The payload of its chunk.
    ///
    /// # Errors
    /// `InvalidArgument` when it is larger than a reader would accept.
    pub fn to_payload(&self) -> Result<Vec<u8>, TakeError> {
        let mut out = VERSION.to_le_bytes().to_vec();
        if let Some(ending) = &self.ending {
            put_section(&mut out, ENDING_TAG, &ending.to_payload()?);
        }
        if out.len() > SUMMARY_BYTES_MAX {
            return Err(TakeError::InvalidArgument(format!(
                "a summary of {} bytes is larger than a take can hold ({SUMMARY_BYTES_MAX})",
                out.len()
            )));
        }
        Ok(out)
    }

    /// From the payload of a chunk at file offset `offset`, whose CRC matched.
    ///
    /// # Errors
    /// `Unsupported` for a newer version; `Corrupt` when the sections do not fill the bytes, one that is known comes
    /// twice, or its content is wrong.
    pub fn from_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        let corrupt = |message: &str| TakeError::Corrupt {
            what: "summary",
            offset,
            message: message.to_owned(),
        };
        if payload.len() > SUMMARY_BYTES_MAX {
            return Err(corrupt("larger than a take can hold"));
        }
        let (version, sections) =
            payload.split_first_chunk::<2>().ok_or_else(|| corrupt("shorter than its version"))?;
        let found = u16::from_le_bytes(*version);
        if found != VERSION {
            return Err(TakeError::Unsupported { what: "summary", found, supported: VERSION });
        }
        let mut summary = Self::default();
        let mut cursor = Cursor::new(sections);
        while !cursor.is_empty() {
            let (tag, section) =
                next_section(&mut cursor).ok_or_else(|| corrupt("its sections do not fill it"))?;
            if tag != ENDING_TAG {
                continue;
            }
            if summary.ending.is_some() {
                return Err(corrupt("it tells twice how the take ended"));
            }
            match TakeEnding::from_payload(section, offset) {
                // Of a newer version: as good as unknown.
                Err(TakeError::Unsupported { .. }) => {}
                read => summary.ending = Some(read?),
            }
        }
        Ok(summary)
    }
}

fn put_section(out: &mut Vec<u8>, tag: u64, section: &[u8]) {
    varint::put(out, tag);
    varint::put(out, section.len() as u64);
    out.extend_from_slice(section);
}

fn next_section<'a>(cursor: &mut Cursor<'a>) -> Option<(u64, &'a [u8])> {
    let tag = cursor.varint()?;
    let len = cursor.varint()?;
    Some((tag, cursor.take(len)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(kind: EndingKind, detail: &str) -> SummaryRecord {
        SummaryRecord { ending: Some(TakeEnding::new(kind, detail.to_owned())) }
    }

    #[test]
    fn every_ending_comes_back_and_the_bytes_are_those_of_the_document() {
        for kind in EndingKind::ALL.into_iter().chain([EndingKind::Other(777)]) {
            for detail in ["", "the folder was renamed"] {
                let summary = of(kind, detail);
                let payload = summary.to_payload().unwrap();
                assert_eq!(SummaryRecord::from_payload(&payload, 0).unwrap(), summary);
            }
        }
        let document = include_str!("../../../docs/take-format.md");
        let (_, example) = document.split_once("A SUMMARY of a take whose disk was full").unwrap();
        let bytes = example.lines().skip(2).map_while(|line| line.strip_prefix("    "));
        let hex = bytes.flat_map(|line| line.split("   ").next().unwrap_or("").split_whitespace());
        let bytes: Vec<u8> = hex.map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
        assert_eq!(of(EndingKind::DiskFull, "ok").to_payload().unwrap(), bytes);
    }

    #[test]
    fn unknown_sections_are_skipped_and_known_ones_are_checked() {
        let mut payload = VERSION.to_le_bytes().to_vec();
        put_section(&mut payload, 900, b"from a later version");
        put_section(&mut payload, ENDING_TAG, &[1, 0, 5, 0]);
        put_section(&mut payload, 2, b"");
        assert_eq!(SummaryRecord::from_payload(&payload, 0).unwrap(), of(EndingKind::DiskFull, ""));
        // Cut anywhere, it is wrong or has fewer sections; it never says anything else.
        for cut in 0..payload.len() {
            let read = SummaryRecord::from_payload(&payload[..cut], 0);
            let ending = read.ok().and_then(|summary| summary.ending);
            assert!(ending.is_none_or(|ending| ending.kind == EndingKind::DiskFull), "{cut}");
        }
        let mut twice = payload.clone();
        put_section(&mut twice, ENDING_TAG, &[1, 0, 5, 0]);
        let mut wrong = VERSION.to_le_bytes().to_vec();
        put_section(&mut wrong, ENDING_TAG, &[1, 0, 5]);
        let mut long = VERSION.to_le_bytes().to_vec();
        let detail = [&[1, 0, 5, 251, 1, 1][..], &[b'x'; DETAIL_BYTES_MAX + 1]].concat();
        put_section(&mut long, ENDING_TAG, &detail);
        for payload in [twice, wrong, long] {
            let error = SummaryRecord::from_payload(&payload, 0).unwrap_err();
            assert!(matches!(error, TakeError::Corrupt { .. }), "{error}");
        }
        let newer = SummaryRecord::from_payload(&[2, 0], 0).unwrap_err();
        assert!(matches!(newer, TakeError::Unsupported { .. }), "{newer}");
        let mut ending_of_later = VERSION.to_le_bytes().to_vec();
        put_section(&mut ending_of_later, ENDING_TAG, &[2, 0, 9, 9, 9]);
        let read = SummaryRecord::from_payload(&ending_of_later, 0).unwrap();
        assert_eq!(read, SummaryRecord::default());
    }

    #[test]
    fn a_long_detail_is_cut_between_characters() {
        let ending = TakeEnding::new(EndingKind::DeviceGone, "é".repeat(DETAIL_BYTES_MAX));
        assert_eq!(ending.detail.len(), DETAIL_BYTES_MAX);
        let ending =
            TakeEnding::new(EndingKind::DeviceGone, format!("x{}", "é".repeat(DETAIL_BYTES_MAX)));
        assert_eq!(ending.detail.len(), DETAIL_BYTES_MAX - 1);
    }
}
