//! What is found on the way through the file, event by event.

use super::{ChannelCount, Survey};
use crate::{
    TakeError, TakeEvent, chunk, frames,
    loss::{Losses, Why},
    problems::Problems,
    record::{Channel, EndingKind, Header, Ledger, TakeEnding},
    recovery::{Piece, account::Account, kinds::Kind, kinds::Kinds},
    stretch::{Span, StretchDecoder},
    table::ChannelTable,
};

/// What becomes of a chunk.
#[derive(Debug, Clone, Copy)]
pub(super) enum Fate {
    /// It is copied: its type, and what a stretch spans.
    Kept(u8, Option<Span>),
    /// It is written anew.
    Anew,
    /// It is lost.
    Discarded,
    /// There is none.
    None,
}

/// What is known on the way.
#[derive(Debug, Default)]
pub(super) struct Surveyor {
    pub(super) header: Option<Header>,
    pub(super) decoder: Option<StretchDecoder>,
    pub(super) pieces: Vec<Piece>,
    pub(super) account: Account,
    pub(super) kinds: Kinds,
    pub(super) table: ChannelTable,
    /// Where in `pieces` entries of the table may be missing.
    pub(super) hole: Option<usize>,
    pub(super) losses: Losses,
    pub(super) per_channel: Vec<ChannelCount>,
    pub(super) problems: Vec<String>,
    pub(super) next_number: u8,
    pub(super) damaged: bool,
    pub(super) discarded_bytes: u64,
    pub(super) names_lost: bool,
    pub(super) ending: Option<TakeEnding>,
    pub(super) closed: bool,
    pub(super) ended: bool,
}

impl Surveyor {
    pub(super) fn event(&mut self, event: TakeEvent<'_>) -> Result<Fate, TakeError> {
        use chunk::types;
        Ok(match event {
            TakeEvent::Header(header) => {
                self.decoder = Some(StretchDecoder::new(header.codec()?));
                self.append(&header.channels);
                self.header = Some(*header);
                self.kinds.recovered(Kind::Header);
                Fate::Anew
            }
            TakeEvent::Channels(more) => {
                self.append(&more);
                Fate::Kept(types::CHANNELS, None)
            }
            TakeEvent::Stretch(stretch) => self.stretch(&stretch),
            TakeEvent::Unplaced { n_rows, rows_min, .. } => {
                let from = self.losses.rows_min();
                self.problems.note(format!(
                    "a stretch of {n_rows} frames, from frame {from} or later: it depends on a damaged one"
                ));
                self.lose(Kind::Stretch);
                self.losses.at_least(rows_min);
                Fate::Discarded
            }
            TakeEvent::Event(_) => Fate::Kept(types::EVENT, None),
            TakeEvent::Clock(_) => Fate::Kept(types::CLOCK, None),
            TakeEvent::Subject(_) => Fate::Kept(types::SUBJECT, None),
            TakeEvent::Foreign(_) => Fate::Kept(types::FOREIGN, None),
            TakeEvent::Ledger(ledger) => {
                // One behind damage tells of more than is kept: the new one has what it said.
                let superseded = ledger.finished || self.damaged;
                self.closed |= ledger.finished;
                self.account.ledger(*ledger);
                if superseded {
                    self.kinds.recovered(Kind::Ledger);
                    Fate::Anew
                } else {
                    Fate::Kept(types::LEDGER, None)
                }
            }
            TakeEvent::Summary(summary) => {
                self.kinds.recovered(Kind::Summary);
                self.ending = summary.ending;
                Fate::Anew
            }
            // One that is too long to be held tells the old offsets as well.
            TakeEvent::Index(_) | TakeEvent::Skipped { kind: types::INDEX } => {
                self.kinds.recovered(Kind::Index);
                Fate::Anew
            }
            TakeEvent::Footer(footer) => {
                self.kinds.recovered(Kind::Footer);
                self.closed = true;
                if self.damaged {
                    self.losses.at_least(footer.n_rows);
                }
                Fate::Anew
            }
            TakeEvent::Skipped { kind } => Fate::Kept(kind, None),
            TakeEvent::Damaged { offset, len, kind, message } => {
                self.problems.note(format!("{len} bytes at byte {offset}: {message}"));
                // Behind the last ledger there is nothing but summary, index and footer.
                let kind = Kind::of(kind);
                self.lose(if self.closed && !kind.is_at_the_end() { Kind::Index } else { kind });
                self.table.damaged();
                if self.header.is_some() {
                    self.hole.get_or_insert(self.pieces.len());
                }
                Fate::Discarded
            }
            TakeEvent::Mended { offset } => {
                self.problems.note(frames::mended(offset));
                Fate::None
            }
            TakeEvent::End { .. } => {
                self.ended = true;
                Fate::None
            }
        })
    }

    pub(super) fn chunk(&mut self, offset: u64, len: u64, fate: Fate) {
        match fate {
            Fate::Kept(kind, span) => {
                self.kinds.recovered(Kind::of(Some(kind)));
                self.pieces.push(Piece::Chunk { offset, len, kind, span });
            }
            Fate::Discarded => self.discarded_bytes += len,
            Fate::Anew | Fate::None => {}
        }
    }

    fn append(&mut self, more: &[Channel]) {
        self.table.append(more);
        self.per_channel.resize(self.table.channels().len(), ChannelCount::default());
    }

    pub(super) fn lose(&mut self, kind: Kind) {
        self.damaged = true;
        self.kinds.discarded(kind);
    }

    pub(super) fn finish(mut self, read_bytes: u64) -> Result<Survey, TakeError> {
        let header = self.header.take().ok_or(TakeError::NotATake("no intact header was found"))?;
        let end_row = self.losses.end_row();
        let rows = self.losses.finish();
        self.lose_rows(rows);
        if rows > 0 {
            self.pieces.push(Piece::Lost { first_row: end_row, rows, number: self.next_number });
        }
        if !self.closed {
            // Always, and last, however many there are before it.
            self.problems.push("the take was cut off: its end is missing".to_owned());
        }
        // A take that was cut off says nothing of its end; the recovered one says that.
        let cut_off = || Some(TakeEnding::from(EndingKind::CutOff)).filter(|_| !self.closed);
        let ending = self.ending.take().or_else(cut_off);
        let here: Vec<_> =
            self.losses.lost().iter().filter(|lost| lost.why == Why::Damaged).copied().collect();
        let mut survey = Survey {
            header,
            pieces: self.pieces,
            ledger: self.account.close(&here),
            ending,
            kinds: self.kinds,
            table: self.table,
            losses: self.losses,
            per_channel: self.per_channel,
            problems: self.problems,
            recorded: self.account.recorded(),
            read_bytes,
            discarded_bytes: self.discarded_bytes,
            finished: self.closed,
            names_lost: self.names_lost,
            contradicted: false,
        };
        // Where nothing is lost, nothing is counted again.
        if let Some(ledger) = self.account.last().filter(|ledger| ledger.finished)
            && !survey.lost_anything()
        {
            let counted = |ledger: &Ledger| (ledger.recorded, ledger.samples_present);
            let (told, found) = (counted(ledger), counted(&survey.ledger));
            if told == found {
                survey.ledger = ledger.clone();
            } else {
                survey.contradicted = true;
                survey.problems.push(format!(
                    "its ledger tells of {} frames and {} samples, in the file are {} and {}: it is counted again",
                    told.0, told.1, found.0, found.1
                ));
            }
        }
        Ok(survey)
    }
}
