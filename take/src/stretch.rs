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
}

/// Appends the front of a stretch's payload; [`put_block`] for every channel in table order follows.
pub fn put_front(span: Span, shared: &[u8], out: &mut Vec<u8>) {
    varint::put(out, span.first_row);
    varint::put(out, u64::from(span.n_rows));
    out.push(u8::from(span.key));
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
            blocks.push(cursor.varint().and_then(|n| cursor.take(n)).ok_or_else(short)?);
        }
        let with_samples = blocks.iter().filter(|block| !block.is_empty()).count() as u64;
        if n_rows > ROWS_MAX || n_rows * with_samples > SAMPLES_MAX {
            return Err(corrupt("it claims more samples than a stretch can hold"));
        }
        first_row.checked_add(n_rows).ok_or_else(|| corrupt("its rows do not fit a counter"))?;
        let span = Span { first_row, n_rows: n_rows as u32, key: flags & 1 == 1 };
        Ok(Self { span, shared, blocks })
    }
}

/// Decodes the stretches of a take in order.
#[derive(Debug)]
pub struct StretchDecoder {
    settings: Settings,
    channels: Vec<Box<dyn BlockDecoder>>,
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
            waits_for_key: true,
            rows: Vec::new(),
            spare: Vec::new(),
        }
    }

    /// A stretch was lost: those that depend on it are too.
    pub fn lost(&mut self) {
        self.waits_for_key = true;
    }

    /// Whether `span` cannot be decoded because a stretch it depends on is missing.
    #[must_use]
    pub fn must_skip(&self, span: Span) -> bool {
        self.waits_for_key && !span.key
    }

    /// Decodes one stretch, by channel; `None` where a channel has no samples in it.
    /// Not to be called when [`must_skip`](Self::must_skip).
    ///
    /// # Errors
    /// `Codec`; what depends on the stretch is then lost, too.
    pub fn decode(&mut self, stretch: &Stretch<'_>) -> Result<&[Option<DecodedRows>], TakeError> {
        self.waits_for_key = true;
        while self.channels.len() < stretch.blocks.len() {
            self.channels.push(self.settings.decoder());
        }
        self.spare.extend(self.rows.drain(..).flatten());
        let n_rows = stretch.span.n_rows as usize;
        let blocks = stretch.blocks.iter().copied().chain(std::iter::repeat(&[][..]));
        for (decoder, block) in self.channels.iter_mut().zip(blocks) {
            let mut rows = self.spare.pop().unwrap_or_default();
            // Also for an empty block: the decoder's state must see the gap.
            decoder.decode(block, stretch.shared, n_rows, stretch.span.key, &mut rows)?;
            self.rows.push(if block.is_empty() {
                self.spare.push(rows);
                None
            } else {
                Some(rows)
            });
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
