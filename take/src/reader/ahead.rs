//! The chunk that comes next, and the way ahead to know whether a long one is whole.

use super::{TakeReader, damage::Damage, passing::Passing};
use crate::{
    chunk::{self, CHUNK_HELD_MAX, Front, Head, LongChunks, Search, types},
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
        let is_header = self.offset() == chunk::MAGIC.len() as u64;
        let begin_damage = |message| {
            Some(Damage::new(self.offset(), waiting, message, is_header && message == CUT))
        };
        match chunk::head(waiting) {
            Head::Of { kind, len, .. } if len > have && len > CHUNK_HELD_MAX && !self.complete => {
                match self.long.is_whole(self.offset()) {
                    None => self.search = Some(Search::new(self.offset(), true)),
                    Some(false) if self.long.is_cut(self.offset() + len) => {
                        self.damage = begin_damage(CUT);
                    }
                    Some(false) => self.damage = begin_damage(WRONG),
                    Some(true) if kind == types::STRETCH && len <= stretch::BYTES_MAX => {
                        self.wanted = len;
                    }
                    Some(true) => self.passing = Some(Passing::new(kind, self.offset(), len)),
                }
                return Step::Again;
            }
            _ => {}
        }
        match chunk::front(waiting) {
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
        (self.base, self.used, self.wanted) = (from, 0, 1);
        self.goes_back_to = Some(from);
        true
    }
}
