//! What is no whole chunk, and the way to the next one.

use super::{TakeEvent, TakeReader, mend};
use crate::chunk::{self, CHUNK_HELD_MAX, HEAD_BYTES_MAX, Head, Next, Search, WINDOW_BYTES, types};

/// Bytes that are no whole chunk, from `offset` to wherever the reader is.
#[derive(Debug)]
pub(super) struct Damage {
    pub(super) offset: u64,
    /// Its first bytes.
    head: Vec<u8>,
    message: &'static str,
    /// It goes on for so long that its beginning is not held any more.
    pub(super) is_far: bool,
    /// It is the header, and the file ends inside it.
    is_cut_header: bool,
}

impl Damage {
    /// Of the bytes at file offset `offset`.
    pub(super) fn new(
        offset: u64,
        bytes: &[u8],
        message: &'static str,
        is_cut_header: bool,
    ) -> Self {
        let head = bytes[..bytes.len().min(HEAD_BYTES_MAX)].to_vec();
        Self { offset, head, message, is_far: false, is_cut_header }
    }

    /// The type that its first byte says, if it is one.
    fn kind(&self) -> Option<u8> {
        self.head.first().copied().filter(|kind| types::ALL.contains(kind))
    }

    /// Whether it is one chunk by its own head, and no stretch: then none was among it. Bytes that are missing
    /// altogether leave pieces of two chunks, and no head fits these.
    fn is_one_other_chunk(&self, damaged_bytes: u64) -> bool {
        matches!(
            chunk::head(&self.head),
            Head::Of { kind, len, .. }
                if len == damaged_bytes && kind != types::STRETCH && types::ALL.contains(&kind)
        )
    }
}

impl TakeReader {
    /// Looks for the next whole chunk; `None` when more of the file has to be seen.
    pub(super) fn find_next(&mut self) -> Option<TakeEvent<'static>> {
        // What is known of its first byte is that no chunk begins there.
        let (offset, is_far) = self.damage.as_ref().map(|damage| (damage.offset, damage.is_far))?;
        if !self.complete && self.buffer.len() - self.used < WINDOW_BYTES {
            self.wanted = WINDOW_BYTES as u64;
            return None;
        }
        let from = self.used + usize::from(self.offset() == offset);
        let is_whole = |at: usize| self.long.is_whole(self.base + at as u64);
        match chunk::resync(&self.buffer, &mut self.marks, from, self.complete, is_whole) {
            Next::At(at) => return self.end_damage(at),
            Next::Until(at) if self.complete => return self.end_damage(at),
            Next::Until(at) => {
                self.used = at;
                if let Some(damage) = &mut self.damage {
                    damage.is_far = true;
                }
            }
            Next::Unknown(at) => {
                let begun = if is_far { self.base + at as u64 } else { offset };
                self.used = (begun - self.base) as usize;
                self.search = Some(Search::new(begun, false));
            }
        }
        None
    }

    /// The next chunk begins at `at` of the buffer, or the file ends there. Where what lies before it is a chunk whose
    /// head alone is damaged, that one is next.
    fn end_damage(&mut self, at: usize) -> Option<TakeEvent<'static>> {
        let damage = self.damage.take()?;
        let offset = damage.offset;
        self.used = at;
        self.wanted = 1;
        let len = self.offset() - offset;
        if !damage.is_far && len <= CHUNK_HELD_MAX {
            let start = (offset - self.base) as usize;
            if mend::head(&mut self.buffer[start..at]) {
                self.marks.forget(at);
                self.used = start;
                return Some(TakeEvent::Mended { offset });
            }
        }
        self.bytes.other += len;
        if damage.is_cut_header {
            self.header_cut_until = self.offset();
        }
        if !damage.is_one_other_chunk(len)
            && let Some(chain) = &mut self.chain
        {
            chain.break_off();
        }
        let (kind, message) = (damage.kind(), damage.message.to_owned());
        Some(TakeEvent::Damaged { offset, len, kind, message })
    }
}
