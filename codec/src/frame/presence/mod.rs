//! Which samples of a group are present.
//!
//! Most channels of most stretches go on as they were: one cheap bit each. Those that do not get a bit
//! a page of rows, then a part of a page, and a row only where something changes; expected from the channel's
//! own last rows and from the channel before it, because markers of one body are hidden together, and an
//! unlabelled one that is lost here goes on as another there.

mod channel;

use self::channel::{Beside, Models, State};
use crate::{
    CodecError, DecodedRows, GROUP_CHANNELS, Rows,
    coding::{
        bytes::{Bytes, MAX_VARINT_BYTES, write_varint},
        range::{RangeDecoder, RangeEncoder},
    },
};

/// Follows a group from block to block. A new one is as behind a key stretch without samples.
#[derive(Debug)]
pub(super) struct Presence {
    models: Models,
    states: [State; GROUP_CHANNELS],
}

impl Presence {
    pub(super) const NEW: Self =
        Self { models: Models::NEW, states: [State::ABSENT; GROUP_CHANNELS] };

    /// Before a key block.
    pub(super) fn reset(&mut self) {
        *self = Self { models: Models::NEW, states: [State::PRESENT; GROUP_CHANNELS] };
    }

    /// An empty block: no channel has a sample, for however many rows.
    pub(super) fn skip(&mut self) {
        for state in &mut self.states {
            *state = State { changed: state.changed, ..State::ABSENT };
        }
    }

    /// A block of which every sample is present.
    pub(super) fn all_present(&mut self, n_channels: usize, n_rows: usize) {
        for state in &mut self.states[..n_channels] {
            state.changed = 1 + u8::from(!state.is_present());
            state.pass(true, n_rows);
        }
        self.leave_out_from(n_channels);
    }

    /// Channels that a block does not have have no sample in it.
    fn leave_out_from(&mut self, n_channels: usize) {
        self.states[n_channels..].fill(State::ABSENT);
    }

    /// Appends the section of a block.
    pub(super) fn write(&mut self, channels: &[Rows<'_>], out: &mut Vec<u8>) {
        let start = out.len();
        let mut coder = RangeEncoder::new(out, usize::MAX);
        let mut beside = None;
        for (state, rows) in self.states.iter_mut().zip(channels) {
            let before = state.is_present();
            self.models.channel(&mut coder, state, beside, &mut rows.present());
            beside = Some(Beside { present: rows.present(), before });
        }
        let fits = coder.finish();
        debug_assert!(fits);
        self.leave_out_from(channels.len());
        let coded = out.len();
        write_varint((coded - start) as u64, out);
        // Known last, read first.
        out[start..].rotate_left(coded - start);
    }

    /// Fills `present` of the channels of a block, each with the same number of rows.
    pub(super) fn read(
        &mut self,
        input: &mut Bytes<'_>,
        channels: &mut [DecodedRows],
    ) -> Result<(), CodecError> {
        let len = input.varint("the length of the presence section")?;
        let len = usize::try_from(len).unwrap_or(usize::MAX);
        let mut coder = RangeDecoder::new(input.take(len, "the presence section")?);
        let mut before = true;
        for (i, state) in self.states.iter_mut().enumerate().take(channels.len()) {
            let (done, rest) = channels.split_at_mut(i);
            let beside = done.last().map(|rows| Beside { present: &rows.present, before });
            before = state.is_present();
            self.models.channel(&mut coder, state, beside, &mut &mut rest[0].present[..]);
        }
        coder.finish()?;
        self.leave_out_from(channels.len());
        if channels.iter().all(|rows| !rows.present.contains(&false)) {
            return Err(CodecError::Corrupt("a presence section of a block that needs none"));
        }
        Ok(())
    }
}

/// Most bytes of a section.
pub(super) fn max_bytes(n_channels: usize, n_rows: usize) -> usize {
    let pieces = n_rows.div_ceil(channel::PAGE) + n_rows.div_ceil(channel::PART);
    // No bit costs more than 11: its odds are at least 2^-11. Twelve leave room for their rounding.
    MAX_VARINT_BYTES + 5 + n_channels * (1 + pieces + n_rows) * 12 / 8
}
