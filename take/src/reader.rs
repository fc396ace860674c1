//! Reads a take, sans-io: bytes are pushed in, events come out; damage is an event, not the end.

mod ahead;
mod bytes;
mod chunks;
mod damage;
mod io;
mod mend;
mod passing;

pub use bytes::TakeBytes;

pub use io::{TakeInput, pull, read_events, read_events_at};
pub(crate) use mend::head as mend_head;

use self::{ahead::Step, damage::Damage, passing::Passing};
use crate::{
    TakeError, chunk,
    chunk::{LongChunks, Marks, Search, WINDOW_BYTES},
    foreign::ForeignPart,
    index::{Footer, IndexEntry},
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
    Foreign(ForeignPart),
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

/// A window, and a piece that was pushed when a byte of it was still missing.
const PUSHED_MAX: usize = WINDOW_BYTES + io::READ_BYTES;

/// Turns bytes into [`TakeEvent`]s. Holds one chunk at a time, after damage at most [`WINDOW_BYTES`], whatever the file
/// claims. Of chunks longer than [`CHUNK_HELD_MAX`](chunk::CHUNK_HELD_MAX) it holds a stretch, once it is known to be whole.
///
/// To know that it reads ahead, and [goes back](Self::goes_back_to): no chunk is read more than twice.
#[derive(Debug, Default)]
pub struct TakeReader {
    buffer: Vec<u8>,
    /// CRCs of what is in `buffer`.
    marks: Marks,
    /// Bytes at the front of `buffer` that are done with.
    used: usize,
    /// File offset of the front of `buffer`.
    base: u64,
    /// Bytes that must be there before another look is worth it.
    wanted: u64,
    /// After the header.
    chain: Option<Chain>,
    /// Entries of the channel table so far.
    n_channels: usize,
    bytes: TakeBytes,
    /// What is not a whole chunk, and behind which the next one is looked for.
    damage: Option<Damage>,
    /// A whole chunk that is too long to be held, on its way through.
    passing: Option<Passing>,
    /// Which long chunks are whole, as far as is known.
    long: LongChunks,
    /// The way ahead to know more of them.
    search: Option<Search>,
    goes_back_to: Option<u64>,
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
        let done = self.done_with();
        // So that each byte is moved a few times at most.
        if done >= self.buffer.len() / 4 {
            self.buffer.drain(..done);
            self.marks.drain(done);
            self.base += done as u64;
            self.used -= done;
        }
        let (held, wanted) = (self.buffer.capacity(), self.buffer.len() + bytes.len());
        if wanted > held {
            // A vector doubles: near the window it need not.
            let grown = if held < WINDOW_BYTES { 2 * held } else { held / 4 * 5 };
            let grown = if wanted > PUSHED_MAX { grown } else { grown.min(PUSHED_MAX) };
            self.buffer.reserve_exact(grown.max(wanted) - self.buffer.len());
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// Where the bytes to push next begin, when it is not where the last ones ended: said once.
    pub fn goes_back_to(&mut self) -> Option<u64> {
        let offset = self.goes_back_to.take()?;
        self.complete = false;
        Some(offset)
    }

    /// Bytes at the front of the buffer that are not looked at again.
    fn done_with(&self) -> usize {
        match &self.damage {
            // All of it is wanted, if it turns out to be one chunk whose head alone is damaged.
            Some(damage) if !damage.is_far && self.search.is_none() => {
                damage.offset.checked_sub(self.base).map_or(self.used, |at| at as usize)
            }
            _ => self.used,
        }
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
        loop {
            if self.goes_back_to.is_some() {
                return Ok(None);
            }
            if self.search.is_some() {
                if !self.look_ahead() {
                    return Ok(None);
                }
            } else if self.passing.is_some() {
                return if self.pass() { self.passed().map(Some) } else { Ok(None) };
            } else if !self.complete && ((self.buffer.len() - self.used) as u64) < self.wanted {
                return Ok(None);
            } else if self.damage.is_some() {
                if let Some(event) = self.find_next() {
                    return Ok(Some(event));
                }
            } else if self.used == self.buffer.len() {
                return if self.complete { self.end().map(Some) } else { Ok(None) };
            } else {
                match self.next_chunk() {
                    Step::Chunk { kind, start, len } => {
                        return self.interpret(kind, start, len).map(Some);
                    }
                    Step::Again => {}
                }
            }
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
}
