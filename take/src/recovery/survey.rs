//! The first way through the file: what can be kept, and what is lost.

use std::io::Read;

use super::{KindCount, Piece, account::Account, kinds::Kind, kinds::Kinds};
use crate::{
    TakeError, TakeEvent, TakeReader, chunk, frames,
    loss::{Losses, LostRows, Why},
    reader::pull,
    record::{Channel, Header, Ledger},
    stretch::{NUMBERS, Span, Stretch, StretchDecoder},
    table::ChannelTable,
};

/// A channel, over the whole take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ChannelCount {
    /// Samples that are kept.
    pub samples: u64,
    /// Rows that are lost to damage since it was announced.
    pub rows_damaged: u64,
}

/// What a recovery would keep of a file, and what not.
#[derive(Debug)]
pub struct Survey {
    header: Header,
    pub(super) pieces: Vec<Piece>,
    pub(super) ledger: Ledger,
    kinds: Kinds,
    table: ChannelTable,
    losses: Losses,
    per_channel: Vec<ChannelCount>,
    problems: Vec<String>,
    recorded: u64,
    read_bytes: u64,
    discarded_bytes: u64,
    finished: bool,
    names_lost: bool,
}

impl Survey {
    /// Reads and decodes all that can be. Holds a chunk at a time, and some forty bytes of each.
    ///
    /// # Errors
    /// `NotATake` when there is no header, `Unsupported`, `Io`. Damage is no error.
    pub fn read(mut input: impl Read) -> Result<Self, TakeError> {
        let mut reader = TakeReader::new();
        let mut surveyor = Surveyor::default();
        let mut start = chunk::MAGIC.len() as u64;
        while !surveyor.ended {
            let Some(event) = reader.next_event()? else {
                pull(&mut input, &mut reader)?;
                continue;
            };
            let fate = surveyor.event(event)?;
            let end = reader.offset();
            surveyor.chunk(start, end - start, fate);
            start = end;
        }
        surveyor.finish(start)
    }

    /// Of the file, as it stands there.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The whole channel table.
    #[must_use]
    pub fn channels(&self) -> &[Channel] {
        self.table.channels()
    }

    /// By channel.
    #[must_use]
    pub fn per_channel(&self) -> &[ChannelCount] {
        &self.per_channel
    }

    /// Chunks by kind.
    #[must_use]
    pub fn kinds(&self) -> &[KindCount] {
        self.kinds.all()
    }

    /// What is missing or damaged, one sentence each.
    #[must_use]
    pub fn problems(&self) -> &[String] {
        &self.problems
    }

    /// The rows that are lost to damage, in order; those of an earlier recovery, too.
    #[must_use]
    pub fn damage(&self) -> &[LostRows] {
        self.losses.lost()
    }

    /// Rows of the new take, lost ones included.
    #[must_use]
    pub fn rows(&self) -> u64 {
        self.losses.end_row()
    }

    /// Rows that are lost to damage in this file.
    #[must_use]
    pub fn rows_damaged(&self) -> u64 {
        let here = self.losses.lost().iter().filter(|lost| lost.why == Why::Damaged);
        here.fold(0, |sum, lost| sum.saturating_add(lost.rows))
    }

    /// Frames of the new take.
    #[must_use]
    pub fn recorded(&self) -> u64 {
        self.recorded
    }

    /// The ledger of the new take.
    #[must_use]
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Whether it was closed in order: its last ledger is there, if not its footer.
    #[must_use]
    pub fn finished(&self) -> bool {
        self.finished
    }

    /// Bytes of the file.
    #[must_use]
    pub fn read_bytes(&self) -> u64 {
        self.read_bytes
    }

    /// Of these, bytes that are damaged or depend on what is.
    #[must_use]
    pub fn discarded_bytes(&self) -> u64 {
        self.discarded_bytes
    }

    /// Whether the file had anything, or may have had, that the new take has not.
    #[must_use]
    pub fn lost_anything(&self) -> bool {
        let lost = |count: &KindCount| count.discarded > 0 && !count.kind.is_made_anew();
        !self.finished
            || self.names_lost
            || self.rows_damaged() > 0
            || self.kinds.all().iter().any(lost)
    }
}

/// What becomes of a chunk.
#[derive(Debug, Clone, Copy)]
enum Fate {
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
struct Surveyor {
    header: Option<Header>,
    decoder: Option<StretchDecoder>,
    pieces: Vec<Piece>,
    account: Account,
    kinds: Kinds,
    table: ChannelTable,
    /// Where in `pieces` entries of the table may be missing.
    hole: Option<usize>,
    losses: Losses,
    per_channel: Vec<ChannelCount>,
    problems: Vec<String>,
    next_number: u8,
    damaged: bool,
    discarded_bytes: u64,
    names_lost: bool,
    closed: bool,
    ended: bool,
}

impl Surveyor {
    fn event(&mut self, event: TakeEvent<'_>) -> Result<Fate, TakeError> {
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
                let from = self.losses.end_row();
                self.problems.push(format!(
                    "a stretch of {n_rows} frames, from frame {from} or later: it depends on a damaged one"
                ));
                self.lose(Kind::Stretch);
                self.losses.at_least(rows_min);
                Fate::Discarded
            }
            TakeEvent::Event(_) => Fate::Kept(types::EVENT, None),
            TakeEvent::Clock(_) => Fate::Kept(types::CLOCK, None),
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
            TakeEvent::Index(_) => {
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
                self.problems.push(format!("{len} bytes at byte {offset}: {message}"));
                // Behind the last ledger there is nothing but index and footer.
                let kind = Kind::of(kind);
                self.lose(if self.closed && !kind.is_made_anew() { Kind::Index } else { kind });
                self.table.damaged();
                if self.header.is_some() {
                    self.hole.get_or_insert(self.pieces.len());
                }
                Fate::Discarded
            }
            TakeEvent::Mended { offset } => {
                self.problems.push(frames::mended(offset));
                Fate::None
            }
            TakeEvent::End { .. } => {
                self.ended = true;
                Fate::None
            }
        })
    }

    fn chunk(&mut self, offset: u64, len: u64, fate: Fate) {
        match fate {
            Fate::Kept(kind, span) => {
                self.kinds.recovered(Kind::of(Some(kind)));
                self.pieces.push(Piece::Chunk { offset, len, kind, span });
            }
            Fate::Discarded => self.discarded_bytes += len,
            Fate::Anew | Fate::None => {}
        }
    }

    fn stretch(&mut self, stretch: &Stretch<'_>) -> Fate {
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
            self.problems.push(format!("the stretch of {frames}: {reason}"));
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

    fn append(&mut self, more: &[Channel]) {
        self.table.append(more);
        self.per_channel.resize(self.table.channels().len(), ChannelCount::default());
    }

    /// The names of lost entries: the new take has them where they stood.
    fn name_channels(&mut self, n_channels: usize) {
        let renamed = self.table.stated(n_channels);
        let at = if n_channels >= self.table.channels().len() { self.hole.take() } else { None };
        let Some(renamed) = renamed else { return };
        self.problems.push(renamed.to_string());
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

    fn lose(&mut self, kind: Kind) {
        self.damaged = true;
        self.kinds.discarded(kind);
    }

    fn lose_rows(&mut self, rows: u64) {
        for channel in &mut self.per_channel {
            channel.rows_damaged += rows;
        }
    }

    fn finish(mut self, read_bytes: u64) -> Result<Survey, TakeError> {
        let header = self.header.take().ok_or(TakeError::NotATake("no intact header was found"))?;
        let end_row = self.losses.end_row();
        let rows = self.losses.finish();
        self.lose_rows(rows);
        if rows > 0 {
            self.pieces.push(Piece::Lost { first_row: end_row, rows, number: self.next_number });
        }
        if !self.closed {
            self.problems.push("the take was cut off: its end is missing".to_owned());
        }
        let here: Vec<_> =
            self.losses.lost().iter().filter(|lost| lost.why == Why::Damaged).copied().collect();
        let mut survey = Survey {
            header,
            pieces: self.pieces,
            ledger: self.account.close(&here),
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
        };
        // Where nothing is lost, nothing is counted again.
        if let Some(ledger) = self.account.last().filter(|ledger| ledger.finished)
            && !survey.lost_anything()
        {
            survey.ledger = ledger.clone();
        }
        Ok(survey)
    }
}
