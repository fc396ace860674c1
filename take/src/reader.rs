//! Reads a take, sans-io: bytes are pushed in, events come out; damage is an event, not the end.

mod bytes;
mod chunks;
mod io;
mod mend;

pub use bytes::TakeBytes;

pub use io::{pull, read_events, read_events_at};
pub(crate) use mend::head as mend_head;

use self::chunks::is_one_other_chunk;
use crate::{
    TakeError, chunk,
    chunk::Front,
    index::{Footer, IndexEntry},
    motion::Foreign,
    record::{Channel, Clock, Event, Header, Ledger, Subject, SummaryRecord},
    stretch::{Chain, Stretch},
};

/// One thing found in a take.
#[derive(Debug)]
pub enum TakeEvent<'a> {
    /// The first chunk.
    Header(Box<Header>),
    /// More entries of the channel table.
    Channels(Vec<Channel>),
    /// A stretch, its blocks still coded.
    Stretch(Stretch<'a>),
    /// A stretch that goes on from one that is missing or damaged: nobody knows which rows it has, and
    /// its blocks cannot be decoded.
    Unplaced {
        /// At least one stretch before it is missing.
        missing_before: bool,
        /// How many rows it has.
        n_rows: u32,
        /// Rows that the take has at least, up to its end.
        rows_min: u64,
    },
    /// Who was captured.
    Subject(Box<Subject>),
    /// An event.
    Event(Event),
    /// What was seen of the clocks.
    Clock(Box<Clock>),
    /// The ledger so far; the last one counts.
    Ledger(Box<Ledger>),
    /// What an importer kept.
    Foreign(Foreign),
    /// What stands at the end of a take that was closed: how it ended.
    Summary(SummaryRecord),
    /// The key stretches.
    Index(Vec<IndexEntry>),
    /// The take was finished.
    Footer(Footer),
    /// A chunk of a type this build does not know, which it may skip.
    Skipped {
        /// Its type.
        kind: u8,
    },
    /// Bytes that are no chunk, or a chunk whose content is wrong: what it held is lost.
    Damaged {
        /// File offset.
        offset: u64,
        /// How many bytes.
        len: u64,
        /// The type of chunk that their first byte says, if it is one.
        kind: Option<u8>,
        /// What is wrong.
        message: String,
    },
    /// Type or length of the chunk that follows were damaged; where the next one begins and its CRC told what
    /// they were. Nothing of it is lost.
    Mended {
        /// File offset of the chunk.
        offset: u64,
    },
    /// The end of the bytes, said once after [`TakeReader::finish`].
    End {
        /// Whether the footer was there: a take without one was cut off.
        finished: bool,
        /// What the bytes were for.
        bytes: TakeBytes,
    },
}

/// What an ordinary reader says of a header that it cannot read.
pub(crate) const HEADER_DAMAGED: &str = "its header is damaged, and nothing can be read without it; try `mocapd recover`, which can put one byte of it right";

/// Turns bytes into [`TakeEvent`]s. Holds one chunk at a time (after damage, up to the rest of the file).
#[derive(Debug, Default)]
pub struct TakeReader {
    buffer: Vec<u8>,
    /// Bytes at the front of `buffer` that are done with.
    used: usize,
    /// File offset of the front of `buffer`.
    base: u64,
    /// Bytes that must be there before another look is worth it.
    wanted: u64,
    /// After the header.
    chain: Option<Chain>,
    bytes: TakeBytes,
    /// Up to which byte there was nothing but the beginning of a header.
    header_cut_until: u64,
    seen_magic: bool,
    seen_footer: bool,
    complete: bool,
    ended: bool,
}

impl TakeReader {
    /// At the start of a take.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// In the middle of the take whose header was read: the bytes to push are those from the key stretch `key` on.
    ///
    /// What lies before it is not missed. The bytes that [`TakeEvent::End`] counts are those that were pushed.
    ///
    /// # Errors
    /// `Unsupported` or `Codec` when the header cannot be used.
    pub fn from_key(header: &Header, key: IndexEntry) -> Result<Self, TakeError> {
        let mut chain = Chain::of(header)?;
        chain.go_to(key.first_row);
        Ok(Self { base: key.offset, chain: Some(chain), seen_magic: true, ..Self::default() })
    }

    /// Adds bytes of the file, in order, in pieces of any size.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.used);
        self.base += self.used as u64;
        self.used = 0;
        self.buffer.extend_from_slice(bytes);
    }

    /// No more bytes will come.
    pub fn finish(&mut self) {
        self.complete = true;
    }

    /// File offset of the next byte that will be looked at.
    #[must_use]
    pub fn offset(&self) -> u64 {
        self.base + self.used as u64
    }

    /// The next event; `None` when more bytes are needed.
    ///
    /// # Errors
    /// `NotATake`, and `Unsupported` or `Corrupt` when the header cannot be used: nothing can be read then.
    pub fn next_event(&mut self) -> Result<Option<TakeEvent<'_>>, TakeError> {
        if !self.seen_magic && !self.check_magic()? {
            return Ok(None);
        }
        if self.ended {
            return Ok(None);
        }
        let waiting = &self.buffer[self.used..];
        if waiting.is_empty() && self.complete {
            return self.end().map(Some);
        }
        if (waiting.len() as u64) < self.wanted && !self.complete {
            return Ok(None);
        }
        match chunk::front(waiting) {
            Front::Whole { kind, len, .. } => {
                let start = self.used;
                self.used += len;
                self.wanted = 1;
                self.interpret(kind, start, len).map(Some)
            }
            Front::Short(wanted) if !self.complete => {
                self.wanted = wanted;
                Ok(None)
            }
            Front::Short(_) => {
                let is_header = self.offset() == chunk::MAGIC.len() as u64;
                let damage = self.skip_damage("the file ends inside a chunk");
                if is_header {
                    self.header_cut_until = self.offset();
                }
                Ok(Some(damage))
            }
            Front::Damaged if !self.complete => {
                // The next whole chunk may be long and cut by the end of the buffer, and only its
                // CRC tells it from noise: look again when all is there.
                self.wanted = u64::MAX;
                Ok(None)
            }
            Front::Damaged => Ok(Some(self.skip_damage("checksum does not match"))),
        }
    }

    fn check_magic(&mut self) -> Result<bool, TakeError> {
        let have = self.buffer.len().min(chunk::MAGIC.len());
        if self.buffer[..have] != chunk::MAGIC[..have] {
            return Err(TakeError::NotATake(if self.buffer.starts_with(b"\x89TAK\n\x1a\n") {
                "its line ends were changed by a transfer in text mode; copy it again in binary mode"
            } else {
                "the file does not begin with a take's eight bytes"
            }));
        }
        if have < chunk::MAGIC.len() {
            return if self.complete {
                Err(TakeError::NotATake("the file is shorter than a take's eight bytes"))
            } else {
                Ok(false)
            };
        }
        self.used = have;
        self.header_cut_until = have as u64;
        self.seen_magic = true;
        self.bytes.header += have as u64;
        Ok(true)
    }

    fn end(&mut self) -> Result<TakeEvent<'static>, TakeError> {
        self.ended = true;
        if self.chain.is_none() {
            return Err(TakeError::NotATake(if self.offset() > self.header_cut_until {
                HEADER_DAMAGED
            } else {
                "the file ends inside its header, and nothing of it can be read"
            }));
        }
        Ok(TakeEvent::End { finished: self.seen_footer, bytes: self.bytes })
    }

    /// Steps over what is damaged, to the next whole chunk or the end; or makes it whole where that is proven.
    fn skip_damage(&mut self, message: &str) -> TakeEvent<'static> {
        let (offset, start) = (self.offset(), self.used);
        self.used = chunk::resync(&self.buffer, self.used + 1).unwrap_or(self.buffer.len());
        self.wanted = 1;
        if mend::head(&mut self.buffer[start..self.used]) {
            self.used = start;
            return TakeEvent::Mended { offset };
        }
        let (len, message) = (self.offset() - offset, message.to_owned());
        self.bytes.other += len;
        let kind = self.buffer.get(start).copied().filter(|kind| chunk::types::ALL.contains(kind));
        if !is_one_other_chunk(&self.buffer[start..self.used])
            && let Some(chain) = &mut self.chain
        {
            chain.break_off();
        }
        TakeEvent::Damaged { offset, len, kind, message }
    }
}
