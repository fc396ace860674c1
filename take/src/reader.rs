//! Reads a take, sans-io: bytes are pushed in, events come out; damage is an event, not the end.

mod chunks;
mod damage;

use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};

use serde::Serialize;

pub(crate) use self::{chunks::record, damage::mend_head};

use self::{
    chunks::{Passing, Step},
    damage::Damage,
};
use crate::{
    NotATake, TakeError,
    chunk::{self, LongChunks, Marks, Search, WINDOW_BYTES, types},
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

/// A window, and a piece that was pushed when a byte of it was still missing.
const PUSHED_MAX: usize = WINDOW_BYTES + READ_BYTES;

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
        Ok(self.next_located()?.map(|(_, event)| event))
    }

    /// The same, with the file offset behind it.
    pub(crate) fn next_located(&mut self) -> Result<Option<(u64, TakeEvent<'_>)>, TakeError> {
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
                return if self.pass() {
                    self.passed().map(|event| self.at(event))
                } else {
                    Ok(None)
                };
            } else if !self.complete && ((self.buffer.len() - self.used) as u64) < self.wanted {
                return Ok(None);
            } else if self.damage.is_some() {
                if let Some(event) = self.find_next() {
                    return Ok(self.at(event));
                }
            } else if self.used == self.buffer.len() {
                return if self.complete {
                    self.end().map(|event| self.at(event))
                } else {
                    Ok(None)
                };
            } else {
                match self.next_chunk() {
                    Step::Chunk { kind, start, len } => {
                        let end = self.offset();
                        return self.interpret(kind, start, len).map(|event| Some((end, event)));
                    }
                    Step::Again => {}
                }
            }
        }
    }

    fn at(&self, event: TakeEvent<'static>) -> Option<(u64, TakeEvent<'static>)> {
        Some((self.offset(), event))
    }

    fn check_magic(&mut self) -> Result<bool, TakeError> {
        let have = self.buffer.len().min(chunk::MAGIC.len());
        if self.buffer[..have] != chunk::MAGIC[..have] {
            return Err(TakeError::NotATake(if self.buffer.starts_with(b"\x89TAK\n\x1a\n") {
                NotATake::SentAsText
            } else {
                NotATake::OtherMagic
            }));
        }
        if have < chunk::MAGIC.len() {
            return if self.complete {
                Err(TakeError::NotATake(NotATake::Short))
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
                NotATake::HeaderDamaged
            } else {
                NotATake::HeaderCut
            }));
        }
        Ok(TakeEvent::End { finished: self.seen_footer, bytes: self.bytes })
    }
}

/// Bytes by purpose: together all that were read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct TakeBytes {
    /// The magic, HEADER and CHANNELS.
    pub header: u64,
    /// The blocks of the stretches, and what they share.
    pub blocks: u64,
    /// The lengths of the blocks; JSON counts them with the framing.
    #[serde(skip)]
    pub lengths: u64,
    /// When the rows were: runs and times.
    pub time_line: u64,
    /// What else a stretch needs: type, length, CRC, number, rows.
    pub framing: u64,
    /// LEDGER.
    pub ledgers: u64,
    /// CLOCK.
    pub clock: u64,
    /// EVENT.
    pub events: u64,
    /// SUMMARY, INDEX and FOOTER.
    pub index: u64,
    /// SUBJECT.
    pub subject: u64,
    /// FOREIGN.
    pub foreign: u64,
    /// What is damaged, unknown, or depends on what is damaged.
    pub other: u64,
}

impl TakeBytes {
    /// Counts a chunk of `len` bytes.
    fn add(&mut self, event: &TakeEvent<'_>, len: u64) {
        let counter = match event {
            TakeEvent::Header(_) | TakeEvent::Channels(_) => &mut self.header,
            TakeEvent::Stretch(stretch) => {
                let sizes = stretch.sizes;
                self.time_line += sizes.time_line;
                self.lengths += sizes.lengths;
                self.blocks += sizes.blocks;
                self.framing += len - sizes.time_line - sizes.lengths - sizes.blocks;
                return;
            }
            TakeEvent::Ledger(_) => &mut self.ledgers,
            TakeEvent::Clock(_) => &mut self.clock,
            TakeEvent::Event(_) => &mut self.events,
            TakeEvent::Subject(_) => &mut self.subject,
            TakeEvent::Foreign(_) => &mut self.foreign,
            TakeEvent::Summary(_)
            | TakeEvent::Index(_)
            | TakeEvent::Skipped { kind: types::INDEX }
            | TakeEvent::Footer(_) => &mut self.index,
            TakeEvent::Unplaced { .. }
            | TakeEvent::Skipped { .. }
            | TakeEvent::Damaged { .. }
            | TakeEvent::Mended { .. }
            | TakeEvent::End { .. } => &mut self.other,
        };
        *counter += len;
    }

    /// All of them.
    #[must_use]
    pub fn sum(&self) -> u64 {
        let Self { header, blocks, lengths, time_line, framing, .. } = self;
        let stretches = header + blocks + lengths + time_line + framing;
        let beside = self.events + self.subject + self.foreign + self.other;
        stretches + self.ledgers + self.clock + self.index + beside
    }
}

/// How much is read at once.
const READ_BYTES: usize = 1 << 16;

/// What a take can be read from, its bytes more than once: a file, or bytes in memory.
pub trait TakeInput {
    /// What reads it.
    type Input: Read + Seek;

    /// From its start.
    fn input(self) -> Self::Input;
}

impl<'a> TakeInput for &'a [u8] {
    type Input = Cursor<&'a [u8]>;

    fn input(self) -> Self::Input {
        Cursor::new(self)
    }
}

impl<'a> TakeInput for &'a Vec<u8> {
    type Input = Cursor<&'a [u8]>;

    fn input(self) -> Self::Input {
        Cursor::new(self)
    }
}

impl<R: Read + Seek> TakeInput for &mut R {
    type Input = Self;

    fn input(self) -> Self {
        self
    }
}

impl<R: Read + Seek> TakeInput for BufReader<R> {
    type Input = Self;

    fn input(self) -> Self {
        self
    }
}

impl<T: AsRef<[u8]>> TakeInput for Cursor<T> {
    type Input = Self;

    fn input(self) -> Self {
        self
    }
}

/// Pushes the next bytes of `input` into `reader`, from where it wants them, or tells it that there are no more.
///
/// # Errors
/// As [`TakeReader::next_event`], and `Io`.
pub fn pull(input: &mut (impl Read + Seek), reader: &mut TakeReader) -> Result<(), TakeError> {
    if let Some(offset) = reader.goes_back_to() {
        input.seek(SeekFrom::Start(offset))?;
    }
    let mut buffer = [0; READ_BYTES];
    let n = loop {
        match input.read(&mut buffer) {
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            other => break other?,
        }
    };
    if n == 0 {
        reader.finish();
    } else {
        reader.push(&buffer[..n]);
    }
    Ok(())
}

/// Gives every event of a take to `on_event`, the end included.
///
/// # Errors
/// As [`TakeReader::next_event`], `Io`, and whatever `on_event` returns.
pub fn read_events(
    input: impl TakeInput,
    mut on_event: impl FnMut(TakeEvent<'_>) -> Result<(), TakeError>,
) -> Result<(), TakeError> {
    let mut input = input.input();
    let mut reader = TakeReader::new();
    loop {
        match reader.next_event()? {
            Some(event) => {
                let end = matches!(event, TakeEvent::End { .. });
                on_event(event)?;
                if end {
                    return Ok(());
                }
            }
            None => pull(&mut input, &mut reader)?,
        }
    }
}
