//! Stretches on the way through the file: kept, or lost with what depends on them.

use super::{ChannelCount, surveyor::Fate, surveyor::Surveyor};
use crate::{
    chunk,
    problems::Problems,
    recovery::{Piece, kinds::Kind},
    stretch::{NUMBERS, Stretch},
};

impl Surveyor {
    pub(super) fn stretch(&mut self, stretch: &Stretch<'_>) -> Fate {
        let Some(decoder) = &mut self.decoder else { return Fate::None };
        let span = stretch.span;
        let (from_row, end_row) = (stretch.from_row(), self.losses.end_row());
        let refused = if from_row < end_row {
            decoder.pass();
            Some("it comes twice".to_owned())
        } else if decoder.depends_on_lost(span) {
            Some("it depends on a damaged one".to_owned())
        } else if span.n_rows == 0 {
            None
        } else {
            decoder.decode(stretch).err().map(|error| error.to_string())
        };
        if let Some(reason) = refused {
            let last = span.end_row().saturating_sub(1);
            let frames = format!("frames {} to {last}", span.first_row);
            self.problems.note(format!("the stretch of {frames}: {reason}"));
            self.lose(Kind::Stretch);
            self.losses.at_least(span.end_row());
            return Fate::Discarded;
        }
        self.name_channels(stretch.stated_channels());
        let jumps = span.number != self.next_number && !stretch.stands_for_damaged();
        if span.key && (from_row > end_row || jumps) {
            let number = (span.number + NUMBERS - 1) % NUMBERS;
            let rows = from_row - end_row;
            self.pieces.push(Piece::Lost { first_row: end_row, rows, number });
        }
        self.next_number = (span.number + 1) % NUMBERS;
        let lost = self.losses.stretch(stretch);
        self.lose_rows(lost);
        let mut samples = 0;
        if span.n_rows > 0
            && let Some(decoder) = &self.decoder
        {
            for (channel, rows) in self.per_channel.iter_mut().zip(decoder.rows()) {
                let present = rows.map_or(0, |rows| rows.present.iter().filter(|&&p| p).count());
                channel.samples += present as u64;
                samples += present as u64;
            }
        }
        self.account.stretch(stretch, self.table.channels().len(), samples);
        Fate::Kept(chunk::types::STRETCH, Some(span))
    }

    /// The names of lost entries: the new take has them where they stood.
    fn name_channels(&mut self, n_channels: usize) {
        let renamed = self.table.stated(n_channels);
        let at = if n_channels >= self.table.channels().len() { self.hole.take() } else { None };
        let Some(renamed) = renamed else { return };
        self.problems.note(renamed.to_string());
        self.names_lost = true;
        let first = renamed.first.min(self.per_channel.len());
        let new = std::iter::repeat_n(ChannelCount::default(), renamed.inserted);
        self.per_channel.splice(first..first, new);
        let at = at.unwrap_or(self.pieces.len());
        if renamed.nameless > renamed.inserted {
            // Entries whose columns nobody knows.
            let mut seen = 0;
            self.pieces.retain(|piece| {
                seen += 1;
                let doubtful = matches!(piece, Piece::Chunk { kind: chunk::types::CHANNELS, .. });
                !(doubtful && seen > at)
            });
        }
        let nameless = renamed.first..renamed.first + renamed.nameless;
        let nameless = self.table.channels().get(nameless).unwrap_or_default();
        self.pieces.insert(at.min(self.pieces.len()), Piece::Channels(nameless.to_vec()));
    }

    pub(super) fn lose_rows(&mut self, rows: u64) {
        for channel in &mut self.per_channel {
            channel.rows_damaged += rows;
        }
    }
}
