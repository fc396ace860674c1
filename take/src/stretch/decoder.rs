//! Blocks to rows.

use mocapd_codec::{BlockDecoder, DecodedRows, Settings};

use super::{Span, Stretch};
use crate::TakeError;

/// Decodes the stretches of a take in order.
#[derive(Debug)]
pub struct StretchDecoder {
    settings: Settings,
    /// By channel; made with its first block, so that an empty one costs nothing.
    channels: Vec<Option<Box<dyn BlockDecoder>>>,
    /// The stretch before was not decoded: what follows up to the next key stretch cannot be either.
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

    /// A stretch that the reader gave is not decoded: what depends on it is lost, too.
    pub fn pass(&mut self) {
        self.waits_for_key = true;
    }

    /// It needs a stretch that was not decoded.
    #[must_use]
    pub fn depends_on_lost(&self, span: Span) -> bool {
        self.waits_for_key && !span.key
    }

    /// Decodes the stretch after the one before, by channel; `None` where a channel has no samples in it.
    ///
    /// # Errors
    /// `InvalidArgument` when it [`depends_on_lost`](Self::depends_on_lost); `Codec`; what depends on the
    /// stretch is then lost, too.
    pub fn decode(&mut self, stretch: &Stretch<'_>) -> Result<&[Option<DecodedRows>], TakeError> {
        if self.depends_on_lost(stretch.span) {
            return Err(TakeError::InvalidArgument("depends on a damaged stretch".to_owned()));
        }
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
