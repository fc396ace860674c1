//! STRETCH: all channels over the same rows, the unit that is checksummed, written and lost as one.

use mocapd_codec::{BlockDecoder, DecodedRows, Settings};

use crate::{TakeError, varint};

/// Most rows of one stretch: over an hour at 1000 Hz, for the resamplers that are not cut into blocks.
pub const ROWS_MAX: u64 = 1 << 22;

/// Most samples that one stretch may decode to: 400 MB of positions.
pub const SAMPLES_MAX: u64 = 1 << 25;

/// Where a stretch lies and whether a decoder can start at it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span {
    /// First row.
    pub first_row: u64,
    /// Rows, lost ones included.
    pub n_rows: u32,
    /// Coded without state from earlier stretches.
    pub key: bool,
    /// Counts the stretches of a take from 0, modulo 128: one that is missing shows.
    pub number: u8,
}

/// Stretches are counted modulo this.
pub const NUMBERS: u8 = 128;

/// Bytes of the smallest chunk that holds a stretch: type, length, four bytes of front, CRC.
const STRETCH_CHUNK_BYTES_MIN: u64 = 10;

/// Most channels: marker ids have 16 bits.
const CHANNELS_MAX: usize = 1 << 16;

/// Appends the front of a stretch's payload; [`put_block`] for every channel in table order follows.
pub fn put_front(span: Span, shared: &[u8], out: &mut Vec<u8>) {
    varint::put(out, span.first_row);
    varint::put(out, u64::from(span.n_rows));
    out.push(u8::from(span.key) | (span.number << 1));
    varint::put(out, shared.len() as u64);
    out.extend_from_slice(shared);
}

/// Appends one channel's block.
pub fn put_block(block: &[u8], out: &mut Vec<u8>) {
    varint::put(out, block.len() as u64);
    out.extend_from_slice(block);
}

/// A stretch as stored, its blocks still coded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stretch<'a> {
    /// Where it lies.
    pub span: Span,
    /// What its channels share.
    pub shared: &'a [u8],
    /// Its blocks, by channel; channels after the last have no samples.
    pub blocks: Vec<&'a [u8]>,
}

impl<'a> Stretch<'a> {
    /// From the payload of a chunk at file offset `offset`.
    ///
    /// # Errors
    /// `Corrupt` when the parts do not fill it or claim more than the limits.
    pub fn parse(payload: &'a [u8], offset: u64) -> Result<Self, TakeError> {
        let corrupt = |message: &str| TakeError::Corrupt {
            what: "stretch",
            offset,
            message: message.to_owned(),
        };
        let short = || corrupt("its parts do not fill it");
        let mut cursor = varint::Cursor::new(payload);
        let first_row = cursor.varint().ok_or_else(short)?;
        let n_rows = cursor.varint().ok_or_else(short)?;
        let flags = cursor.byte().ok_or_else(short)?;
        let shared = cursor.varint().and_then(|n| cursor.take(n)).ok_or_else(short)?;
        let mut blocks = Vec::new();
        while !cursor.is_empty() {
            if blocks.len() == CHANNELS_MAX {
                return Err(corrupt("it has more channels than there are marker ids"));
            }
            blocks.push(cursor.varint().and_then(|n| cursor.take(n)).ok_or_else(short)?);
        }
        let with_samples = blocks.iter().filter(|block| !block.is_empty()).count() as u64;
        if n_rows > ROWS_MAX || n_rows * with_samples > SAMPLES_MAX {
            return Err(corrupt("it claims more samples than a stretch can hold"));
        }
        first_row.checked_add(n_rows).ok_or_else(|| corrupt("its rows do not fit a counter"))?;
        let (key, number) = (flags & 1 == 1, flags >> 1);
        let span = Span { first_row, n_rows: n_rows as u32, key, number };
        Ok(Self { span, shared, blocks })
    }
}

/// What a stretch is to what came before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Met {
    /// At least one stretch before it is missing.
    pub missing: bool,
    /// It cannot be decoded: it needs a stretch that is missing or damaged.
    pub depends_on_lost: bool,
}

/// Decodes the stretches of a take in order.
#[derive(Debug)]
pub struct StretchDecoder {
    settings: Settings,
    /// By channel; made with its first block, so that an empty one costs nothing.
    channels: Vec<Option<Box<dyn BlockDecoder>>>,
    /// The number of the next stretch, as far as is known.
    next_number: Option<u8>,
    /// Set after damage: what follows up to the next key stretch cannot be decoded.
    waits_for_key: bool,
    /// The rows of the last stretch decoded, by channel; `None` where a channel has no samples in it.
    rows: Vec<Option<DecodedRows>>,
    spare: Vec<DecodedRows>,
}

impl StretchDecoder {
    /// For a take coded with `settings`.
    #[must_use]
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            channels: Vec::new(),
            next_number: Some(0),
            waits_for_key: true,
            rows: Vec::new(),
            spare: Vec::new(),
        }
    }

    /// So many bytes were damaged. A few hide no more stretches than their numbers tell apart.
    pub fn pass_damage(&mut self, len: u64) {
        self.waits_for_key |= len >= u64::from(NUMBERS) * STRETCH_CHUNK_BYTES_MIN;
    }

    /// Looks at the next stretch that was found: whether it can be decoded, and whether the one before it
    /// is missing.
    pub fn meet(&mut self, span: Span) -> Met {
        let missing = self.next_number.is_some_and(|number| number != span.number);
        self.next_number = Some((span.number + 1) % NUMBERS);
        self.waits_for_key |= missing;
        Met { missing, depends_on_lost: self.waits_for_key && !span.key }
    }

    /// Decodes one stretch, by channel; `None` where a channel has no samples in it.
    /// Not to be called when [`meet`](Self::meet) said that it depends on a lost one.
    ///
    /// # Errors
    /// `Codec`; what depends on the stretch is then lost, too.
    pub fn decode(&mut self, stretch: &Stretch<'_>) -> Result<&[Option<DecodedRows>], TakeError> {
        self.waits_for_key = true;
        if self.channels.len() < stretch.blocks.len() {
            self.channels.resize_with(stretch.blocks.len(), || None);
        }
        self.spare.extend(self.rows.drain(..).flatten());
        let n_rows = stretch.span.n_rows as usize;
        let blocks = stretch.blocks.iter().copied().chain(std::iter::repeat(&[][..]));
        for (channel, block) in self.channels.iter_mut().zip(blocks) {
            if block.is_empty() {
                // Its decoder's state must see the gap.
                if let Some(decoder) = channel {
                    decoder.skip(stretch.span.key);
                }
                self.rows.push(None);
                continue;
            }
            let decoder = channel.get_or_insert_with(|| self.settings.decoder());
            let mut rows = self.spare.pop().unwrap_or_default();
            decoder.decode(block, stretch.shared, n_rows, stretch.span.key, &mut rows)?;
            self.rows.push(Some(rows));
        }
        self.waits_for_key = false;
        Ok(&self.rows)
    }

    /// What [`decode`](Self::decode) gave last.
    #[must_use]
    pub fn rows(&self) -> &[Option<DecodedRows>] {
        &self.rows
    }
}
