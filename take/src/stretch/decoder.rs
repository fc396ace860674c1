//! Blocks to rows.

use std::iter;

use mocapd_codec::{
    BlockDecoder, CodecError, DecodedRows, GROUP_CHANNELS, Settings, stated_channels,
};

use super::{SAMPLES_MAX, Span, Stretch, rows_max};
use crate::TakeError;

/// Decodes the stretches of a take in order.
#[derive(Debug)]
pub struct StretchDecoder {
    settings: Settings,
    /// Those that are decoded; `None`: all.
    wanted: Option<Vec<usize>>,
    /// Made with the first block, so that an empty one costs nothing.
    groups: Vec<Option<Group>>,
    /// The stretch before was not decoded: what follows up to the next key stretch cannot be either.
    waits_for_key: bool,
}

/// One group of channels.
#[derive(Debug)]
struct Group {
    decoder: Box<dyn BlockDecoder>,
    /// Channels of its last block since the key.
    n_channels: usize,
    /// Its rows in the last stretch decoded.
    rows: Vec<DecodedRows>,
}

impl StretchDecoder {
    /// For a take coded with `settings`.
    #[must_use]
    pub fn new(settings: Settings) -> Self {
        Self { settings, wanted: None, groups: Vec::new(), waits_for_key: true }
    }

    /// The same for some groups only, by number: what is coded together is decoded together, and groups know
    /// nothing of each other. [`rows`](Self::rows) has nothing of the others.
    #[must_use]
    pub fn of_groups(settings: Settings, wanted: Vec<usize>) -> Self {
        Self { wanted: Some(wanted), ..Self::new(settings) }
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

    /// Decodes the stretch after the one before; [`rows`](Self::rows) then has what is in it.
    ///
    /// # Errors
    /// `InvalidArgument` when it [`depends_on_lost`](Self::depends_on_lost); `Codec`; what depends on the
    /// stretch is then lost, too.
    pub fn decode(&mut self, stretch: &Stretch<'_>) -> Result<(), TakeError> {
        let Span { key, n_rows, .. } = stretch.span;
        if self.depends_on_lost(stretch.span) {
            return Err(TakeError::InvalidArgument("depends on a damaged stretch".to_owned()));
        }
        self.waits_for_key = true;
        if u64::from(n_rows) > rows_max(self.settings.kind) {
            Err(CodecError::Corrupt("more rows than a stretch can hold"))?;
        }
        if self.groups.len() < stretch.blocks.len() {
            self.groups.resize_with(stretch.blocks.len(), || None);
        }
        // Every group that is there must see the stretch, if only as a gap.
        let is_wanted = |group: usize| self.wanted.as_ref().is_none_or(|all| all.contains(&group));
        let wanted = |(group, &block)| if is_wanted(group) { block } else { &[][..] };
        let blocks = stretch.blocks.iter().enumerate().map(wanted).chain(iter::repeat(&[][..]));
        let mut n_channels = 0;
        for (group, block) in self.groups.iter_mut().zip(blocks.clone()) {
            if let Some(group) = group
                && key
            {
                group.n_channels = 0;
            }
            if !block.is_empty() {
                let group = group.get_or_insert_with(|| Group::new(self.settings));
                group.n_channels = stated_channels(block).unwrap_or(group.n_channels);
                n_channels += group.n_channels;
            }
        }
        if n_channels as u64 * u64::from(n_rows) > SAMPLES_MAX {
            Err(CodecError::Corrupt("more samples than a stretch can hold"))?;
        }
        for (group, block) in self.groups.iter_mut().zip(blocks) {
            if let Some(Group { decoder, rows, .. }) = group {
                decoder.decode(block, stretch.shared, n_rows as usize, key, rows)?;
            }
        }
        self.waits_for_key = false;
        Ok(())
    }

    /// The rows of the last stretch decoded, by channel; `None` where it has nothing of a channel.
    pub fn rows(&self) -> impl Iterator<Item = Option<&DecodedRows>> {
        self.groups.iter().flat_map(|group| {
            let rows = group.as_ref().map_or(&[][..], |group| &group.rows);
            rows.iter().map(Some).chain(iter::repeat(None)).take(GROUP_CHANNELS)
        })
    }
}

impl Group {
    fn new(settings: Settings) -> Self {
        Self { decoder: settings.decoder(), n_channels: 0, rows: Vec::new() }
    }
}
