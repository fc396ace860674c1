//! The first pass over the file: which chunks can be kept, and what is lost.

use super::{KINDS, Kind, KindCount, Piece, account::Account};
use crate::{
    NotATake, TakeError, TakeEvent,
    chunk::types,
    damage::{Counts, LostRows, Problem, Why},
    reader::TakeInput,
    record::{Channel, EndingKind, Header, Ledger, TakeEnding},
    stretch::{NUMBERS, Span, Stretch},
    traversal::{Decode, Found, Progress, Renamed, TakeTraversal},
};

/// Most chunks that a recovery copies; each takes up to 64 bytes of memory. The limit is four days of the shortest
/// stretches, 50 ms, and half a gigabyte. Only a crafted file has more.
const PIECES_MAX: usize = 1 << 23;

/// Counts of one channel, over the whole take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ChannelCount {
    /// Samples that are kept.
    pub samples: u64,
    /// Rows lost to damage since the channel was announced.
    pub rows_damaged: u64,
}

/// What a recovery keeps of a file and what is lost.
#[derive(Debug)]
pub struct Survey {
    /// The header, as the file has it.
    pub header: Header,
    /// The complete channel table.
    pub channels: Vec<Channel>,
    /// Counts by channel.
    pub per_channel: Vec<ChannelCount>,
    /// Chunk counts by kind.
    pub kinds: [KindCount; KINDS.len()],
    /// Everything missing or damaged.
    pub problems: Vec<Problem>,
    /// Rows lost to damage, in order, including those of an earlier recovery.
    pub damage: Vec<LostRows>,
    /// Rows of the new take, including lost ones.
    pub rows: u64,
    /// Recorded frames of the new take.
    pub recorded: u64,
    /// The ledger of the new take.
    pub ledger: Ledger,
    /// The ending that the new take states: the ending of the old take, or that it was cut off.
    pub ending: Option<TakeEnding>,
    /// Whether the old take was closed: its last ledger exists, if not its footer.
    pub finished: bool,
    /// Bytes that are damaged or depend on damaged ones.
    pub discarded_bytes: u64,
    pub(super) pieces: Vec<Piece>,
    names_lost: bool,
    /// A ledger is missing or contradicts the frames and samples found, although nothing is damaged.
    pub(super) contradicted: bool,
}

impl Survey {
    /// Reads and decodes everything that is valid. It holds one chunk at a time, and about forty bytes for each chunk.
    ///
    /// # Errors
    /// `NotATake` without a header, `Unsupported`, `Io`. Damage is not an error.
    pub fn read(input: impl TakeInput) -> Result<Self, TakeError> {
        let mut surveyor = Surveyor::default();
        let traversal = TakeTraversal::new(input, Decode::All);
        let progress = traversal.run(|found, progress| surveyor.found(found, progress));
        progress.map_err(as_recovery).map(|progress| surveyor.finish(progress))
    }

    /// Rows lost to damage in this file.
    #[must_use]
    pub fn rows_damaged(&self) -> u64 {
        let here = self.damage.iter().filter(|lost| lost.why == Why::Damaged);
        here.fold(0, |sum, lost| sum.saturating_add(lost.rows))
    }

    /// Whether the new take lacks anything that the file had, or may have had.
    #[must_use]
    pub fn lost_anything(&self) -> bool {
        let lost = |count: &KindCount| count.discarded > 0 && !count.kind.is_made_anew();
        !self.finished
            || self.names_lost
            || self.contradicted
            || self.rows_damaged() > 0
            || self.kinds.iter().any(lost)
    }
}

/// Replaces the advice to run a recovery.
fn as_recovery(error: TakeError) -> TakeError {
    match error {
        TakeError::NotATake(NotATake::HeaderDamaged) => TakeError::NotATake(NotATake::HeaderLost),
        other => other,
    }
}

/// What happens to a chunk.
#[derive(Debug, Clone, Copy)]
enum Fate {
    /// Copy it.
    Kept,
    /// Write a new one in its place.
    Anew,
    /// Discard it.
    Discarded,
}

/// The state of the first pass.
#[derive(Debug)]
struct Surveyor {
    kinds: [KindCount; KINDS.len()],
    pieces: Vec<Piece>,
    account: Account,
    samples: Vec<u64>,
    /// Position in `pieces` at which channel table entries may be missing.
    hole: Option<usize>,
    end_row: u64,
    next_number: u8,
    discarded_bytes: u64,
    names_lost: bool,
    closed: bool,
    /// A ledger before the last that contradicts the stretches before it.
    contradiction: Option<Problem>,
}

impl Default for Surveyor {
    fn default() -> Self {
        Self {
            kinds: KINDS.map(|(kind, ..)| KindCount { kind, recovered: 0, discarded: 0 }),
            pieces: Vec::new(),
            account: Account::default(),
            samples: Vec::new(),
            hole: None,
            end_row: 0,
            next_number: 0,
            discarded_bytes: 0,
            names_lost: false,
            closed: false,
            contradiction: None,
        }
    }
}

impl Surveyor {
    fn found(&mut self, found: &Found<'_>, progress: &Progress) -> Result<(), TakeError> {
        if let Some(renamed) = found.renamed {
            self.name_channels(renamed, progress.channels());
        }
        if let TakeEvent::Stretch(stretch) = &found.event
            && !found.is_refused
            && stretch.stated_channels() >= progress.channels().len()
        {
            // No channel table entry is missing.
            self.hole = None;
        }
        self.samples.resize(progress.channels().len(), 0);
        let mut span = None;
        let (kind, fate) = match &found.event {
            TakeEvent::Header(_) => (types::HEADER, Fate::Anew),
            TakeEvent::Channels(_) => (types::CHANNELS, Fate::Kept),
            TakeEvent::Stretch(_) if found.is_refused => (types::STRETCH, Fate::Discarded),
            TakeEvent::Stretch(stretch) => {
                self.stretch(stretch, progress);
                span = Some(stretch.span);
                (types::STRETCH, Fate::Kept)
            }
            TakeEvent::Unplaced { .. } => (types::STRETCH, Fate::Discarded),
            TakeEvent::Event(_) => (types::EVENT, Fate::Kept),
            TakeEvent::Clock(_) => (types::CLOCK, Fate::Kept),
            TakeEvent::Subject(_) => (types::SUBJECT, Fate::Kept),
            TakeEvent::Foreign(_) => (types::FOREIGN, Fate::Kept),
            TakeEvent::Ledger(ledger) => {
                self.closed |= ledger.finished;
                self.account.ledger();
                let (frames, samples) = (self.account.recorded(), self.samples.iter().sum());
                let (told, found) = (Counts::of(ledger), Counts { frames, samples });
                if told != found && !ledger.finished && !progress.take.damaged {
                    self.contradiction = Some(Problem::LedgerCounts { told, found });
                }
                // A ledger behind damage counts more than is kept; its counts go into the new last ledger.
                let is_superseded = ledger.finished || progress.take.damaged || told != found;
                (types::LEDGER, if is_superseded { Fate::Anew } else { Fate::Kept })
            }
            TakeEvent::Summary(_) => (types::SUMMARY, Fate::Anew),
            // An index that is too long to hold has the old offsets, too.
            TakeEvent::Index(_) | TakeEvent::Skipped { kind: types::INDEX } => {
                (types::INDEX, Fate::Anew)
            }
            TakeEvent::Footer(_) => {
                self.closed = true;
                (types::FOOTER, Fate::Anew)
            }
            TakeEvent::Skipped { kind } => (*kind, Fate::Kept),
            TakeEvent::Damaged { kind, .. } => {
                if self.kinds[Kind::Header as usize].recovered > 0 {
                    self.hole.get_or_insert(self.pieces.len());
                }
                // Only summary, index and footer follow the last ledger.
                let is_of_end = Kind::of(*kind).is_at_the_end();
                let kind = if self.closed && !is_of_end { Some(types::INDEX) } else { *kind };
                (kind.unwrap_or_default(), Fate::Discarded)
            }
            TakeEvent::Mended { .. } | TakeEvent::End { .. } => return Ok(()),
        };
        self.chunk(found, kind, span, fate)?;
        self.end_row = progress.end_row();
        Ok(())
    }

    fn chunk(
        &mut self,
        found: &Found<'_>,
        kind: u8,
        span: Option<Span>,
        fate: Fate,
    ) -> Result<(), TakeError> {
        let (offset, len) = (found.offset, found.len);
        let count = &mut self.kinds[Kind::of(Some(kind)) as usize];
        match fate {
            Fate::Discarded => {
                count.discarded += 1;
                self.discarded_bytes += len;
            }
            Fate::Anew => count.recovered += 1,
            Fate::Kept => {
                count.recovered += 1;
                self.pieces.push(Piece::Chunk { offset, len, kind, span });
            }
        }
        if self.pieces.len() > PIECES_MAX {
            return Err(TakeError::InvalidArgument(format!(
                "it has more than {PIECES_MAX} chunks, which is more than a recovery can hold"
            )));
        }
        Ok(())
    }

    /// Counts a stretch that is kept.
    fn stretch(&mut self, stretch: &Stretch<'_>, progress: &Progress) {
        let span = stretch.span;
        let from_row = stretch.from_row();
        let jumps = span.number != self.next_number && !stretch.stands_for_damaged();
        if span.key && (from_row > self.end_row || jumps) {
            let number = (span.number + NUMBERS - 1) % NUMBERS;
            let rows = from_row - self.end_row;
            self.pieces.push(Piece::Lost { first_row: self.end_row, rows, number });
        }
        self.next_number = (span.number + 1) % NUMBERS;
        let mut samples = 0;
        if span.n_rows > 0 {
            for (sum, rows) in self.samples.iter_mut().zip(progress.rows()) {
                let present = rows.map_or(0, |rows| rows.present.iter().filter(|&&p| p).count());
                *sum += present as u64;
                samples += present as u64;
            }
        }
        self.account.stretch(stretch, progress.channels().len(), samples);
    }

    /// Inserts entries for the lost ones at the same place in the new take.
    fn name_channels(&mut self, renamed: Renamed, channels: &[Channel]) {
        self.names_lost = true;
        let first = renamed.first.min(self.samples.len());
        self.samples.splice(first..first, std::iter::repeat_n(0, renamed.inserted));
        let at = self.hole.take().unwrap_or(self.pieces.len());
        if renamed.nameless > renamed.inserted {
            // Entries whose columns are unknown.
            let mut seen = 0;
            self.pieces.retain(|piece| {
                seen += 1;
                let doubtful = matches!(piece, Piece::Chunk { kind: types::CHANNELS, .. });
                !(doubtful && seen > at)
            });
        }
        let nameless = renamed.first..renamed.first + renamed.nameless;
        let nameless = channels.get(nameless).unwrap_or_default();
        self.pieces.insert(at.min(self.pieces.len()), Piece::Channels(nameless.to_vec()));
    }

    fn finish(mut self, progress: Progress) -> Survey {
        let Progress { take, rows_damaged, .. } = progress;
        let rows = take.n_rows - self.end_row;
        if rows > 0 {
            let (first_row, number) = (self.end_row, self.next_number);
            self.pieces.push(Piece::Lost { first_row, rows, number });
        }
        let mut problems = take.problems;
        let lacks_ledger = problems.contains(&Problem::NoLedger);
        // A file that was cut off states no ending; the recovered take states that it was cut off.
        let cut_off = || Some(TakeEnding::from(EndingKind::CutOff)).filter(|_| !self.closed);
        let ending = take.ending.or_else(cut_off);
        if self.closed {
            problems.pop_if(|last| *last == Problem::CutOff);
        }
        let here: Vec<_> =
            take.damage.iter().filter(|lost| lost.why == Why::Damaged).copied().collect();
        let counted = |(samples, rows_damaged)| ChannelCount { samples, rows_damaged };
        let mut survey = Survey {
            header: take.header,
            ledger: self.account.close(take.ledger.as_ref(), &here),
            ending,
            kinds: self.kinds,
            channels: take.channels,
            per_channel: self.samples.into_iter().zip(rows_damaged).map(counted).collect(),
            problems,
            damage: take.damage,
            rows: take.n_rows,
            recorded: self.account.recorded(),
            finished: self.closed,
            discarded_bytes: self.discarded_bytes,
            pieces: self.pieces,
            names_lost: self.names_lost,
            contradicted: self.contradiction.is_some() || lacks_ledger,
        };
        survey.problems.extend(self.contradiction);
        // Without loss, the original ledger stands.
        if let Some(ledger) = take.ledger.filter(|ledger| ledger.finished)
            && !survey.lost_anything()
        {
            let (told, found) = (Counts::of(&ledger), Counts::of(&survey.ledger));
            if told == found {
                survey.ledger = ledger;
            } else {
                survey.contradicted = true;
                survey.problems.push(Problem::LedgerCounts { told, found });
            }
        }
        survey
    }
}
