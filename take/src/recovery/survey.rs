//! The first way through the file: what can be kept, and what is lost.

mod stretches;
mod surveyor;

use self::surveyor::Surveyor;
use super::{KindCount, Piece, kinds::Kinds};
use crate::{
    TakeError, TakeReader, chunk,
    loss::{Losses, LostRows, Why},
    reader::{HEADER_DAMAGED, TakeInput, pull},
    record::{Channel, Header, Ledger, TakeEnding},
    table::ChannelTable,
};

/// Most chunks that a recovery copies, each of which takes up to 64 bytes of memory until it is: four days of the shortest
/// stretches, 50 ms, and half a gigabyte. A file that has more was made so.
const PIECES_MAX: usize = 1 << 23;

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
    pub(super) ending: Option<TakeEnding>,
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
    /// Its ledger tells of other frames or samples than are there, and nothing is damaged.
    contradicted: bool,
}

impl Survey {
    /// Reads and decodes all that can be. Holds a chunk at a time, and some forty bytes of each.
    ///
    /// # Errors
    /// `NotATake` when there is no header, `Unsupported`, `Io`. Damage is no error.
    pub fn read(input: impl TakeInput) -> Result<Self, TakeError> {
        let mut input = input.input();
        let mut reader = TakeReader::new();
        let mut surveyor = Surveyor::default();
        let mut start = chunk::MAGIC.len() as u64;
        while !surveyor.ended {
            let Some(event) = reader.next_event().map_err(as_recovery)? else {
                pull(&mut input, &mut reader)?;
                continue;
            };
            let fate = surveyor.event(event)?;
            if surveyor.pieces.len() > PIECES_MAX {
                return Err(TakeError::InvalidArgument(format!(
                    "it has more than {PIECES_MAX} chunks, which is more than a recovery can hold"
                )));
            }
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

    /// How the new take says that it ended: as the old one says, or that it was cut off.
    #[must_use]
    pub fn ending(&self) -> Option<&TakeEnding> {
        self.ending.as_ref()
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
            || self.contradicted
            || self.rows_damaged() > 0
            || self.kinds.all().iter().any(lost)
    }
}

/// A recovery does not send people to a recovery.
fn as_recovery(error: TakeError) -> TakeError {
    match error {
        TakeError::NotATake(HEADER_DAMAGED) => TakeError::NotATake(
            "more than one byte of its header is damaged, and nothing can be read without it",
        ),
        other => other,
    }
}
