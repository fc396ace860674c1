//! A sans-io reader of takes: the caller pushes bytes in and takes events out. Damage is an event; reading continues
//! after it.

mod chunks;

use std::{
    io::{BufReader, Cursor, Read, Seek, SeekFrom},
    ops::{Deref, DerefMut},
};

use serde::Serialize;

use self::chunks::{Damage, LongChunk};
use crate::{
    ChannelOrder, NotATake, TakeError,
    chunk::{self, LongChunkScan, LongChunks, PrefixCrcs, WINDOW_BYTES, types},
    foreign::ForeignPart,
    index::{Footer, IndexEntry},
    record::{
        Channel, Clock, Event, Header, Ledger, SampleLedger, SampledGroup, Subject, SummaryRecord,
    },
    sampled::{SampleTimes, SamplesChunk},
    stretch::{Stretch, StretchChain},
};

pub(crate) use self::chunks::{order, record, repair_head};

/// One element of a take.
#[derive(Debug)]
pub enum TakeEvent<'a> {
    /// The header, always the first chunk.
    Header(Box<Header>),
    /// Further entries of the channel table.
    Channels(Vec<Channel>),
    /// The order of the markers of the header in the source.
    Order(ChannelOrder),
    /// A stretch, with its blocks still encoded.
    Stretch(Stretch<'a>),
    /// A stretch that continues a missing or damaged one: its rows are unknown, and its blocks cannot be decoded.
    Unplaced {
        /// Whether at least one stretch before it is missing.
        missing_before: bool,
        /// Number of its rows.
        n_rows: u32,
        /// The least number of rows that the take has up to the end of this stretch.
        rows_min: u64,
    },
    /// The captured subject.
    Subject(Box<Subject>),
    /// A mark, a trigger, or a notice of the device or host.
    Event(Event),
    /// Observations of the device's and the host's clock.
    Clock(Box<Clock>),
    /// The ledger up to here; the last one is final.
    Ledger(Box<Ledger>),
    /// A part that an importer kept.
    Foreign(ForeignPart),
    /// A group of sampled channels.
    SampledGroup(Box<SampledGroup>),
    /// Samples of such a group, with the block still encoded.
    Samples(SamplesChunk),
    /// When samples of such a group were taken.
    SampleTimes(SampleTimes),
    /// The ledger of the samples up to here; the last one is final.
    SampleLedger(Box<SampleLedger>),
    /// The summary of a closed take: how the take ended.
    Summary(SummaryRecord),
    /// Positions of the key stretches.
    Index(Vec<IndexEntry>),
    /// The footer: the take was closed.
    Footer(Footer),
    /// A chunk of an unknown type that a reader may skip.
    Skipped {
        /// Its type.
        kind: u8,
    },
    /// Bytes that are not a chunk, or a chunk with invalid content. Their content is lost.
    Damaged {
        /// File offset.
        offset: u64,
        /// Number of bytes.
        len: u64,
        /// The chunk type in their first byte, if it is a valid one.
        kind: Option<u8>,
        /// The reason.
        message: String,
    },
    /// The type or length of the next chunk was damaged and has been restored from the position of the chunk after it
    /// and from its CRC. No content is lost.
    Repaired {
        /// File offset of the chunk.
        offset: u64,
    },
    /// The end of the take, reported once after [`TakeReader::finish`].
    End {
        /// Whether the footer was found; a take without one was cut off.
        finished: bool,
        /// The bytes read, by purpose.
        bytes: TakeBytes,
    },
}

/// Turns bytes into [`TakeEvent`]s. It holds one chunk at a time, and at most [`WINDOW_BYTES`] after
/// damage, for any lengths that the file claims. A chunk longer than [`CHUNK_HELD_MAX`](chunk::CHUNK_HELD_MAX) is held
/// only if it is a stretch, and only once its CRC is known to match.
///
/// To check that, the reader scans ahead and then [asks for earlier bytes again](Self::seek_request); no chunk is read
/// more than twice.
#[derive(Debug, Default)]
pub struct TakeReader {
    buffer: ReadBuffer,
    /// Prefix CRCs of `buffer`.
    prefixes: PrefixCrcs,
    /// Bytes at the front of `buffer` that were processed.
    used: usize,
    /// File offset of the front of `buffer`.
    base: u64,
    /// Number of unprocessed bytes needed before the next attempt to parse.
    needed: u64,
    /// `None` before the header.
    chain: Option<StretchChain>,
    /// Entries of the channel table so far.
    n_channels: usize,
    /// The header's channels, while an order of them may follow: in an import, before the first order and stretch.
    orderable: Option<usize>,
    bytes: TakeBytes,
    /// A damaged region whose end is being searched for.
    damage: Option<Damage>,
    /// A chunk with a matching CRC that is too long to hold and is read piece by piece.
    long_chunk: Option<LongChunk>,
    /// Which long chunks have matching CRCs, within the range that was scanned.
    long_chunks: LongChunks,
    /// The scan ahead that finds the long chunks.
    scan: Option<LongChunkScan>,
    seek_request: Option<u64>,
    /// End of the region that held only an incomplete header.
    header_cut_until: u64,
    has_magic: bool,
    has_footer: bool,
    complete: bool,
    ended: bool,
    /// Whether a damaged region was met.
    had_damage: bool,
    /// Whether neither times nor foreign parts are decoded.
    skips_content: bool,
}

impl TakeReader {
    /// Creates a reader for a take from its first byte.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates a reader for a take from its first byte that checks every CRC and reads every record, but decodes neither
    /// the times of rows nor foreign parts. Their content can be invalid only where a writer made it so.
    #[must_use]
    pub fn skipping_content() -> Self {
        Self { skips_content: true, ..Self::default() }
    }

    /// Creates a reader for the middle of a take whose header is known. The caller pushes the bytes from the key
    /// stretch `key` on.
    ///
    /// Earlier stretches do not count as missing. [`TakeEvent::End`] counts only the pushed bytes.
    ///
    /// # Errors
    /// `Unsupported` or `Codec` when this build cannot use the header.
    pub fn from_key(header: &Header, key: IndexEntry) -> Result<Self, TakeError> {
        let mut chain = StretchChain::from_header(header)?;
        chain.seek(key.first_row);
        Ok(Self { base: key.offset, chain: Some(chain), has_magic: true, ..Self::default() })
    }

    /// Appends bytes of the file, in order, in pieces of any size.
    pub fn push(&mut self, bytes: &[u8]) {
        self.space(bytes.len()).copy_from_slice(bytes);
        self.buffer.fill(bytes.len());
    }

    /// Space for the next `n` bytes of the file. The bytes that are no longer needed make room for it.
    fn space(&mut self, n: usize) -> &mut [u8] {
        let done = self.consumed();
        // Waiting for a quarter of the buffer moves each byte only a few times.
        if done >= self.buffer.len() / 4 {
            self.buffer.remove_front(done);
            self.prefixes.drain(done);
            self.base += done as u64;
            self.used -= done;
        }
        self.buffer.space(n)
    }

    /// The file offset from which the caller must push next, if it is not where the last bytes ended. Each request is
    /// returned once.
    pub fn seek_request(&mut self) -> Option<u64> {
        let offset = self.seek_request.take()?;
        self.complete = false;
        Some(offset)
    }

    /// Bytes at the front of the buffer that are no longer needed.
    fn consumed(&self) -> usize {
        match &self.damage {
            // A region that turns out to be one chunk with a damaged head is needed as a whole.
            Some(damage) if !damage.start_dropped && self.scan.is_none() => {
                damage.offset.checked_sub(self.base).map_or(self.used, |at| at as usize)
            }
            _ => self.used,
        }
    }

    /// Declares the end of the file: no more bytes follow.
    pub fn finish(&mut self) {
        self.complete = true;
    }

    /// File offset of the next byte to process.
    #[must_use]
    pub fn offset(&self) -> u64 {
        self.base + self.used as u64
    }

    /// The next event; `None` when more bytes are needed.
    ///
    /// # Errors
    /// `NotATake`; `Unsupported` or `Corrupt` when this build cannot use the header. Reading cannot continue after an
    /// error.
    pub fn next_event(&mut self) -> Result<Option<TakeEvent<'_>>, TakeError> {
        Ok(self.next_located()?.map(|(_, event)| event))
    }

    /// The next event with the file offset of its end.
    pub(crate) fn next_located(&mut self) -> Result<Option<(u64, TakeEvent<'_>)>, TakeError> {
        if self.ended || !self.has_magic && !self.check_magic()? {
            return Ok(None);
        }
        while self.seek_request.is_none() {
            if self.scan.is_some() {
                self.scan_ahead();
                return Ok(None);
            } else if self.long_chunk.is_some() {
                if !self.read_long_chunk() {
                    return Ok(None);
                }
                return self.finish_long_chunk().map(|event| self.located(event));
            } else if !self.complete && ((self.buffer.len() - self.used) as u64) < self.needed {
                return Ok(None);
            } else if self.damage.is_some() {
                if let Some(event) = self.find_next() {
                    return Ok(self.located(event));
                }
            } else if self.used == self.buffer.len() {
                if !self.complete {
                    return Ok(None);
                }
                return self.end().map(|event| self.located(event));
            } else if let Some(len) = self.next_chunk() {
                let end = self.offset();
                return self.interpret(len).map(|event| Some((end, event)));
            }
        }
        Ok(None)
    }

    fn located(&self, event: TakeEvent<'static>) -> Option<(u64, TakeEvent<'static>)> {
        Some((self.offset(), event))
    }

    fn check_magic(&mut self) -> Result<bool, TakeError> {
        let have = self.buffer.len().min(chunk::MAGIC.len());
        if self.buffer[..have] != chunk::MAGIC[..have] {
            let as_text = self.buffer.starts_with(b"\x89TAK\n\x1a\n");
            let why = if as_text { NotATake::SentAsText } else { NotATake::OtherMagic };
            return Err(TakeError::NotATake(why));
        }
        if have < chunk::MAGIC.len() {
            let short = Err(TakeError::NotATake(NotATake::Short));
            return if self.complete { short } else { Ok(false) };
        }
        self.used = have;
        self.header_cut_until = have as u64;
        self.has_magic = true;
        self.bytes.header += have as u64;
        Ok(true)
    }

    fn end(&mut self) -> Result<TakeEvent<'static>, TakeError> {
        self.ended = true;
        if self.chain.is_none() {
            let is_damaged = self.offset() > self.header_cut_until;
            let why = if is_damaged { NotATake::HeaderDamaged } else { NotATake::HeaderCut };
            return Err(TakeError::NotATake(why));
        }
        Ok(TakeEvent::End { finished: self.has_footer, bytes: self.bytes })
    }
}

/// Bytes by purpose. Their sum is the number of bytes read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct TakeBytes {
    /// Magic, HEADER, CHANNELS and ORDER.
    pub header: u64,
    /// Blocks of stretches, and the bytes that these share.
    pub blocks: u64,
    /// Length prefixes of blocks; JSON counts them with the framing.
    #[serde(skip)]
    pub lengths: u64,
    /// Time lines of stretches: runs and times.
    pub time_line: u64,
    /// Everything else in STRETCH chunks: type, length, CRC, number, rows.
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
    /// `SAMPLED_GROUP` and SAMPLES.
    pub sampled: u64,
    /// Chunks that are damaged, unknown, or depend on damaged ones.
    pub other: u64,
}

impl TakeBytes {
    /// Adds a chunk of `len` bytes.
    fn add(&mut self, event: &TakeEvent<'_>, len: u64) {
        let counter = match event {
            TakeEvent::Header(_) | TakeEvent::Channels(_) | TakeEvent::Order(_) => &mut self.header,
            TakeEvent::Stretch(stretch) => {
                let sizes = stretch.sizes;
                self.time_line += sizes.time_line;
                self.lengths += sizes.lengths;
                self.blocks += sizes.blocks;
                self.framing += len - sizes.time_line - sizes.lengths - sizes.blocks;
                return;
            }
            TakeEvent::Ledger(_) | TakeEvent::SampleLedger(_) => &mut self.ledgers,
            TakeEvent::Clock(_) => &mut self.clock,
            TakeEvent::Event(_) => &mut self.events,
            TakeEvent::Subject(_) => &mut self.subject,
            TakeEvent::Foreign(_) => &mut self.foreign,
            TakeEvent::SampledGroup(_) | TakeEvent::Samples(_) | TakeEvent::SampleTimes(_) => {
                &mut self.sampled
            }
            TakeEvent::Summary(_)
            | TakeEvent::Index(_)
            | TakeEvent::Skipped { kind: types::INDEX }
            | TakeEvent::Footer(_) => &mut self.index,
            TakeEvent::Unplaced { .. }
            | TakeEvent::Skipped { .. }
            | TakeEvent::Damaged { .. }
            | TakeEvent::Repaired { .. }
            | TakeEvent::End { .. } => &mut self.other,
        };
        *counter += len;
    }

    /// The total.
    #[must_use]
    pub fn sum(&self) -> u64 {
        let Self { header, blocks, lengths, time_line, framing, .. } = self;
        let stretches = header + blocks + lengths + time_line + framing;
        let records = self.events + self.subject + self.foreign + self.sampled + self.other;
        stretches + self.ledgers + self.clock + self.index + records
    }
}

/// Size of one read.
const READ_BYTES: usize = 1 << 16;

/// A seekable source of a take: a file or bytes in memory.
pub trait TakeInput {
    /// The reader it becomes.
    type Input: Read + Seek;

    /// The reader.
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

/// Reads the next piece of `input` and pushes it into `reader`, seeking first if the reader asks for it. At the end of
/// the input it calls [`TakeReader::finish`].
///
/// # Errors
/// `Io`.
pub fn feed(input: &mut (impl Read + Seek), reader: &mut TakeReader) -> Result<(), TakeError> {
    if let Some(offset) = reader.seek_request() {
        input.seek(SeekFrom::Start(offset))?;
    }
    let space = reader.space(READ_BYTES);
    let n = loop {
        match input.read(space) {
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            other => break other?,
        }
    };
    if n == 0 {
        reader.finish();
    } else {
        reader.buffer.fill(n);
    }
    Ok(())
}

/// Calls `on_event` for every event of a take, including the end.
///
/// # Errors
/// Those of [`TakeReader::next_event`], `Io`, and any error of `on_event`.
pub fn read_events(
    input: impl TakeInput,
    mut on_event: impl FnMut(TakeEvent<'_>) -> Result<(), TakeError>,
) -> Result<(), TakeError> {
    let mut input = input.input();
    let mut reader = TakeReader::new();
    let mut ended = false;
    while !ended {
        match reader.next_event()? {
            Some(event) => {
                ended = matches!(event, TakeEvent::End { .. });
                on_event(event)?;
            }
            None => feed(&mut input, &mut reader)?,
        }
    }
    Ok(())
}

/// Largest buffer in ordinary use: a search window, and a read that arrives while the window lacks a byte.
const ORDINARY_BYTES_MAX: usize = WINDOW_BYTES + READ_BYTES;

/// Bytes with initialised space after them, into which files are read without another copy.
#[derive(Debug, Default)]
struct ReadBuffer {
    /// The bytes and the space.
    storage: Vec<u8>,
    /// Number of bytes.
    len: usize,
}

impl ReadBuffer {
    /// Space for the next `n` bytes.
    fn space(&mut self, n: usize) -> &mut [u8] {
        let (capacity, needed) = (self.storage.len(), self.len + n);
        if needed > capacity {
            // Twice the bytes that are held, as a vector would; near the window size less is enough.
            let grown = if self.len < WINDOW_BYTES { 2 * self.len } else { self.len / 4 * 5 };
            let is_ordinary = needed <= ORDINARY_BYTES_MAX;
            let grown = if is_ordinary { grown.min(ORDINARY_BYTES_MAX) } else { grown }.max(needed);
            self.storage.reserve_exact(grown - capacity);
            self.storage.resize(grown, 0);
        }
        &mut self.storage[self.len..needed]
    }

    /// Adds the first `n` bytes of the last [`space`](Self::space), which were written.
    fn fill(&mut self, n: usize) {
        self.len = (self.len + n).min(self.storage.len());
    }

    /// Removes the first `n` bytes.
    fn remove_front(&mut self, n: usize) {
        self.storage.copy_within(n..self.len, 0);
        self.len -= n;
    }

    fn clear(&mut self) {
        self.len = 0;
    }
}

impl Deref for ReadBuffer {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.storage[..self.len]
    }
}

impl DerefMut for ReadBuffer {
    fn deref_mut(&mut self) -> &mut [u8] {
        &mut self.storage[..self.len]
    }
}
