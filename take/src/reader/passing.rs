//! Whole chunks that are too long to be held: they are looked at piece by piece as they come, and their content is
//! read by those who want it.

use super::{TakeEvent, TakeReader, chunks::damaged};
use crate::{
    TakeError,
    chunk::{self, CRC_BYTES, HEAD_BYTES_MAX, Head, MAY_SKIP, types},
    foreign::{self, ForeignPart, Inflation},
};

/// Whether one may be so long and is not read: what this version does not know, and an index, which repeats what the
/// stretches themselves say. No other record is so long.
fn may_be_skipped(kind: u8) -> bool {
    let is_read = types::ALL.contains(&kind) && ![types::MODEL, types::INDEX].contains(&kind);
    kind & MAY_SKIP != 0 && !is_read
}

/// One of them.
#[derive(Debug)]
pub(super) struct Passing {
    kind: u8,
    offset: u64,
    len: u64,
    /// Of a FOREIGN, once its front was there: it, and what became of it up to here.
    part: Option<Result<(ForeignPart, Inflation), TakeError>>,
}

impl Passing {
    pub(super) fn new(kind: u8, offset: u64, len: u64) -> Self {
        Self { kind, offset, len, part: None }
    }

    fn end(&self) -> u64 {
        self.offset + self.len
    }

    /// Looks at what comes next of a FOREIGN, from file offset `at` on.
    fn look_at(&mut self, at: u64, bytes: &[u8]) {
        if self.kind != types::FOREIGN {
            return;
        }
        let part = self.part.get_or_insert_with(|| {
            let Head::Of { head_bytes, .. } = chunk::head(bytes) else {
                return Err(TakeError::NotATake("a chunk vanished while it was read"));
            };
            let payload_at = self.offset + head_bytes as u64;
            let payload_bytes = self.len - head_bytes as u64 - CRC_BYTES as u64;
            let front = &bytes[head_bytes..];
            ForeignPart::of_payload(front, (payload_at, payload_bytes), self.offset)
                .map(|part| (Inflation::new(part.data_bytes), part))
                .map(|(inflation, part)| (part, inflation))
        });
        if let Ok((part, inflation)) = part {
            let from = part.deflated_at().saturating_sub(at) as usize;
            let end = (self.offset + self.len - CRC_BYTES as u64).saturating_sub(at);
            let end = bytes.len().min(usize::try_from(end).unwrap_or(usize::MAX));
            inflation.push(bytes.get(from..end).unwrap_or_default());
        }
    }
}

impl TakeReader {
    /// Passes over what is there of it; says whether that was all.
    pub(super) fn pass(&mut self) -> bool {
        let at = self.offset();
        let Some(passing) = &mut self.passing else { return true };
        let waiting = &self.buffer[self.used..];
        let front_bytes = HEAD_BYTES_MAX + foreign::FRONT_BYTES;
        if at == passing.offset && waiting.len() < front_bytes && !self.complete {
            return false;
        }
        let left = usize::try_from(passing.end() - at).unwrap_or(usize::MAX);
        let next = &waiting[..waiting.len().min(left)];
        passing.look_at(at, next);
        self.used += next.len();
        self.wanted = 1;
        next.len() == left || self.complete
    }

    /// All of it was passed over.
    pub(super) fn passed(&mut self) -> Result<TakeEvent<'static>, TakeError> {
        let end = self.offset();
        let Some(passing) = self.passing.take().filter(|passing| passing.end() == end) else {
            return Err(TakeError::NotATake("it became shorter while it was read"));
        };
        let Passing { kind, offset, len, part } = passing;
        let Some(chain) = self.chain.as_mut() else {
            self.bytes.other += len;
            let message = format!("a chunk of type {kind:02x} before the header");
            return Ok(damaged(offset, len, kind, message));
        };
        let event = match part {
            Some(part) => part.and_then(|(part, inflation)| {
                inflation.finish(offset).map(|()| TakeEvent::Foreign(part))
            }),
            None if may_be_skipped(kind) => Ok(TakeEvent::Skipped { kind }),
            None => {
                if kind == types::STRETCH {
                    chain.break_off();
                }
                let message = "longer than a take can hold".to_owned();
                Err(TakeError::Corrupt { what: "chunk", offset, message })
            }
        };
        let event = event.unwrap_or_else(|error| damaged(offset, len, kind, error.to_string()));
        self.bytes.add(&event, len);
        Ok(event)
    }
}
