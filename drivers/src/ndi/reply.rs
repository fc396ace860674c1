//! Answers: text with a checksum in hexadecimal, or a binary block with two.

use std::ops::Range;

use super::crc::crc16;

/// The longest answer that is waited for: what a 16-bit length can say, with header and checksum.
/// 41 markers on tools and 255 strays need 5 kB.
pub(super) const REPLY_BYTES_MAX: usize = 6 + 0xFFFF + 2;

/// First two bytes of a binary answer, as they come, and of one whose length has 32 bits.
const BINARY: [u8; 2] = [0xC4, 0xA5];
const BINARY_LONG: [u8; 2] = [0xC8, 0xA5];

/// What has come of an answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Look {
    /// More must come.
    NotYet,
    /// The text, without its checksum.
    Text(Range<usize>),
    /// The block, without its header and checksum.
    Binary(Range<usize>),
    /// It is none: a checksum is wrong, or it is too long.
    Damaged,
}

/// The bytes since the request.
#[derive(Debug)]
pub(super) struct ReplyBuffer {
    bytes: Vec<u8>,
}

impl ReplyBuffer {
    pub(super) fn new() -> Self {
        Self { bytes: Vec::with_capacity(REPLY_BYTES_MAX) }
    }

    pub(super) fn clear(&mut self) {
        self.bytes.clear();
    }

    pub(super) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Takes what fits; `false` when more came than any answer has.
    pub(super) fn extend(&mut self, bytes: &[u8]) -> bool {
        let room = REPLY_BYTES_MAX - self.bytes.len();
        self.bytes.extend_from_slice(bytes.get(..room).unwrap_or(bytes));
        bytes.len() <= room
    }

    pub(super) fn get(&self, range: Range<usize>) -> &[u8] {
        self.bytes.get(range).unwrap_or_default()
    }

    pub(super) fn look(&self) -> Look {
        match self.bytes.get(..2) {
            Some(start) if start == BINARY => self.look_binary(2),
            Some(start) if start == BINARY_LONG => self.look_binary(4),
            // One byte may be the first of either.
            None if matches!(self.bytes.first(), None | Some(0xC4 | 0xC8)) => Look::NotYet,
            _ => self.look_text(),
        }
    }

    fn look_binary(&self, length_bytes: usize) -> Look {
        let header = 2 + length_bytes;
        let Some(head) = self.bytes.get(..header + 2) else { return Look::NotYet };
        let Some((said, length)) = split_crc(head) else { return Look::NotYet };
        if !said {
            return Look::Damaged;
        }
        let length = length.iter().skip(2).rev().fold(0, |n, byte| n << 8 | usize::from(*byte));
        let end = (header + 2).saturating_add(length);
        if end.saturating_add(2) > REPLY_BYTES_MAX {
            return Look::Damaged;
        }
        let Some(block) = self.bytes.get(header + 2..end + 2) else { return Look::NotYet };
        match split_crc(block) {
            Some((true, _)) if self.bytes.len() == end + 2 => Look::Binary(header + 2..end),
            _ => Look::Damaged,
        }
    }

    fn look_text(&self) -> Look {
        let Some(end) = self.bytes.iter().position(|byte| *byte == b'\r') else {
            return Look::NotYet;
        };
        let line = self.bytes.get(..end).unwrap_or_default();
        let Some((text, digits)) = line.split_last_chunk::<4>() else { return Look::Damaged };
        let said = std::str::from_utf8(digits).ok().filter(|_| digits.is_ascii());
        let said = said.and_then(|digits| u16::from_str_radix(digits, 16).ok());
        if said == Some(crc16(text)) && self.bytes.len() == end + 1 {
            Look::Text(0..text.len())
        } else {
            Look::Damaged
        }
    }
}

/// Whether the last two bytes are the checksum of those before them, and these.
fn split_crc(bytes: &[u8]) -> Option<(bool, &[u8])> {
    let (covered, crc) = bytes.split_last_chunk::<2>()?;
    Some((u16::from_le_bytes(*crc) == crc16(covered), covered))
}
