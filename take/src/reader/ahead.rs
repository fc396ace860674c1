//! The chunk that comes next, and the way ahead to know whether a long one is whole.

use super::{TakeReader, damage::Damage, passing::Passing};
use crate::{
    chunk::{self, CHUNK_HELD_MAX, Front, Head, LongChunks, Marks, Search, types},
    stretch,
};

/// What to do next.
pub(super) enum Step {
    /// There is a whole chunk in the buffer.
    Chunk { kind: u8, start: usize, len: usize },
    /// Look again.
    Again,
}

/// What is wrong with a chunk that the file ends inside of.
const CUT: &str = "the file ends inside a chunk";

/// And with any other that is not whole.
const WRONG: &str = "checksum does not match";

impl TakeReader {
    /// What stands at the front of the bytes that are there. Behind a whole chunk, or behind the magic.
    pub(super) fn next_chunk(&mut self) -> Step {
        let waiting = &self.buffer[self.used..];
        let have = waiting.len() as u64;
        let offset = self.offset();
        let is_header = offset == chunk::MAGIC.len() as u64;
        let begin_damage =
            |message| Some(Damage::new(offset, waiting, message, is_header && message == CUT));
        match chunk::head(waiting) {
            Head::Of { kind, len, .. } if len > have && len > CHUNK_HELD_MAX && !self.complete => {
                match self.long.is_whole(offset) {
                    None => self.search = Some(Search::new(offset, true)),
                    Some(false) if self.long.is_cut(offset + len) => {
                        self.damage = begin_damage(CUT);
                    }
                    Some(false) => self.damage = begin_damage(WRONG),
                    Some(true) if kind == types::STRETCH && len <= stretch::BYTES_MAX => {
                        self.wanted = len;
                    }
                    Some(true) => self.passing = Some(Passing::new(kind, offset, len)),
                }
                return Step::Again;
            }
            _ => {}
        }
        match chunk::front_by_marks(&self.buffer, self.used, &mut self.marks) {
            Front::Whole { kind, len, .. } => {
                let start = self.used;
                self.used += len;
                self.wanted = 1;
                return Step::Chunk { kind, start, len };
            }
            Front::Short(wanted) if !self.complete => self.wanted = wanted,
            Front::Short(_) => self.damage = begin_damage(CUT),
            Front::Damaged => self.damage = begin_damage(WRONG),
        }
        Step::Again
    }

    /// Follows the file ahead; says whether all is known that was asked for, and the reader goes back.
    pub(super) fn look_ahead(&mut self) -> bool {
        let Some(search) = &mut self.search else { return true };
        self.used += search.push(&self.buffer[self.used..], self.complete);
        if !search.is_answered() && !self.complete {
            return false;
        }
        let from = search.from();
        self.long = self.search.take().map_or_else(LongChunks::default, Search::finish);
        self.buffer.clear();
        self.marks = Marks::default();
        (self.base, self.used, self.wanted) = (from, 0, 1);
        self.goes_back_to = Some(from);
        true
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        TakeEvent, TakeWriter,
        chunk::{self, HASHED_BYTES, types},
        reader::read_events,
        record::{CODEC_VERSION, Header},
        varint,
    };

    fn empty_take() -> Vec<u8> {
        let header = Header {
            software: "test".to_owned(),
            take_id: [7; 16],
            created_unix_ms: 0,
            resampler: "dense".to_owned(),
            codec_version: CODEC_VERSION,
            tolerance_mm: 1.0,
            rate_hz: 100.0,
            up_axis: 0,
            device: None,
            source: None,
            channels: Vec::new(),
            stretch_rows: 50,
            settings: Vec::new(),
        };
        let mut bytes = Vec::new();
        TakeWriter::new(&mut bytes, &header).unwrap();
        bytes
    }

    /// Behind each small chunk stands a head of a long one: all of it may be one, or damaged, and the next small
    /// chunk is found within it.
    #[test]
    fn no_byte_is_hashed_for_every_head_before_it() {
        for claimed in [3_000, 100_000, 1 << 20] {
            let mut bytes = empty_take();
            let (start, end) = (bytes.len(), bytes.len() + claimed + (256 << 10));
            while bytes.len() < end {
                bytes.push(types::STRETCH);
                varint::put(&mut bytes, claimed as u64);
                chunk::put(&mut bytes, types::EVENT, &[]).unwrap();
            }
            let before = HASHED_BYTES.get();
            let mut n_damaged = 0;
            read_events(&bytes, |event| {
                n_damaged += usize::from(matches!(event, TakeEvent::Damaged { .. }));
                Ok(())
            })
            .unwrap();
            let hashed = HASHED_BYTES.get() - before;
            // The heads, and the events, which have no version.
            assert!(n_damaged > (end - start) / 11, "{n_damaged} of {} bytes", bytes.len());
            let ratio = hashed / bytes.len() as u64;
            assert!(ratio <= 100, "{ratio} bytes hashed a byte, of {claimed} claimed");
        }
    }
}
