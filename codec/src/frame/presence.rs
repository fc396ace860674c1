//! The presence section: which samples of a group are present.
//!
//! Most channels of most stretches do not change and take one cheap bit each. The others take a bit per page of 64
//! rows, per part of 8 rows of a page with a change, and per row of a part with a change. The contexts are the
//! channel's own last rows and the channel before it: markers of one body are hidden together, and an unlabelled marker
//! that is lost in one channel often continues in another. Contexts gain 1.8 % of the ratio of `dense` over 9 bits per
//! change; pages and parts cost nothing, and `fast` takes with gaps decode 2.9 to 3.7 times as fast with them.

use std::ops::Range;

use crate::{
    DecodedRows, GROUP_CHANNELS, Result, Rows,
    coding::{
        Bytes, MAX_VARINT_BYTES,
        range::{BinaryCoder, Bit, RangeDecoder, RangeEncoder},
        write_varint,
    },
    ensure,
};

/// The presence coder of a group, encoder and decoder alike. Initially in the state after an empty key block.
#[derive(Debug)]
pub(super) struct Presence {
    models: Models,
    states: [PresenceHistory; GROUP_CHANNELS],
}

impl Presence {
    pub(super) const NEW: Self =
        Self { models: Models::NEW, states: [PresenceHistory::ABSENT; GROUP_CHANNELS] };

    /// Resets everything before a key block.
    pub(super) fn reset(&mut self) {
        *self = Self { models: Models::NEW, states: [PresenceHistory::PRESENT; GROUP_CHANNELS] };
    }

    /// Accounts for an empty block: no channel has a sample.
    pub(super) fn skip(&mut self) {
        for state in &mut self.states {
            *state = PresenceHistory { changed: state.changed, ..PresenceHistory::ABSENT };
        }
    }

    /// Accounts for a block in which every sample is present.
    pub(super) fn all_present(&mut self, n_channels: usize, n_rows: usize) {
        for state in &mut self.states[..n_channels] {
            state.changed = 1 + u8::from(!state.is_present());
            state.push_many(true, n_rows);
        }
        self.mark_absent_from(n_channels);
    }

    /// Marks the channels beyond a block's own as absent.
    fn mark_absent_from(&mut self, n_channels: usize) {
        self.states[n_channels..].fill(PresenceHistory::ABSENT);
    }

    /// Appends the presence section of a block.
    pub(super) fn write(&mut self, channels: &[Rows<'_>], out: &mut Vec<u8>) {
        let start = out.len();
        let mut coder = RangeEncoder::new(out, usize::MAX);
        let mut previous = None;
        for (state, rows) in self.states.iter_mut().zip(channels) {
            let before = state.is_present();
            self.models.channel(&mut coder, state, previous, &mut Flags::Encode(rows.present()));
            previous = Some(PreviousChannel { present: rows.present(), before });
        }
        let fits = coder.finish();
        debug_assert!(fits);
        self.mark_absent_from(channels.len());
        let coded = out.len();
        write_varint((coded - start) as u64, out);
        // The length is known last, but read first.
        out[start..].rotate_left(coded - start);
    }

    /// Reads the presence section of a block into `present` of its channels, which have the same number of rows.
    pub(super) fn read(
        &mut self,
        input: &mut Bytes<'_>,
        channels: &mut [DecodedRows],
    ) -> Result<()> {
        let len = input.varint("the length of the presence section")?;
        let len = usize::try_from(len).unwrap_or(usize::MAX);
        let mut coder = RangeDecoder::new(input.take(len, "the presence section")?);
        let mut before = true;
        for (i, state) in self.states.iter_mut().enumerate().take(channels.len()) {
            let (done, rest) = channels.split_at_mut(i);
            let previous = done.last().map(|c| PreviousChannel { present: &c.present, before });
            before = state.is_present();
            self.models.channel(
                &mut coder,
                state,
                previous,
                &mut Flags::Decode(&mut rest[0].present),
            );
        }
        coder.finish()?;
        self.mark_absent_from(channels.len());
        ensure(
            channels.iter().any(|rows| rows.present.contains(&false)),
            "a presence section without a gap",
        )?;
        Ok(())
    }
}

/// Maximum number of bytes of a presence section.
pub(super) fn max_bytes(n_channels: usize, n_rows: usize) -> usize {
    let pieces = n_rows.div_ceil(PAGE) + n_rows.div_ceil(PART);
    // A decision costs at most 11 bits, as probabilities are at least 2^-11. Twelve allow for rounding.
    MAX_VARINT_BYTES + 5 + n_channels * (1 + pieces + n_rows) * 12 / 8
}

/// Number of classes of age.
const AGES: usize = 7;

/// The age, in rows, at which counting stops.
const MAX_AGE: u8 = 61;

/// The recent presence of a channel.
#[derive(Debug, Clone, Copy)]
struct PresenceHistory {
    /// Presence of the last four rows, the newest in the lowest bit.
    last: u8,
    /// For how many rows presence has not changed, up to [`MAX_AGE`].
    age: u8,
    /// Whether presence changed in the block before: 0 no such block, 1 no, 2 yes.
    changed: u8,
}

impl PresenceHistory {
    /// The state after a key.
    const PRESENT: Self = Self { last: 0b1111, age: MAX_AGE, changed: 0 };
    /// The state after rows without a sample.
    const ABSENT: Self = Self { last: 0, age: MAX_AGE, changed: 0 };

    fn is_present(self) -> bool {
        self.last & 1 == 1
    }

    fn age_class(self) -> usize {
        match self.age {
            0..=1 => 0,
            2 => 1,
            3..=4 => 2,
            5..=8 => 3,
            9..=20 => 4,
            21..MAX_AGE => 5,
            _ => 6,
        }
    }

    /// Appends `n_rows` rows with the same presence.
    fn push_many(&mut self, present: bool, n_rows: usize) {
        let Some(more) = n_rows.checked_sub(1) else { return };
        self.push(present);
        self.age = more.saturating_add(self.age.into()).min(MAX_AGE.into()) as u8;
        let alike = if present { (1 << more.min(4)) - 1 } else { 0 };
        self.last = (self.last << more.min(4) | alike) & 0b1111;
    }

    /// Appends a row.
    fn push(&mut self, present: bool) {
        self.age = if present == self.is_present() { (self.age + 1).min(MAX_AGE) } else { 1 };
        self.last = self.last << 1 & 0b1111 | u8::from(present);
    }
}

/// The presence of the channel with the next lower number, over the same rows.
#[derive(Debug, Clone, Copy)]
struct PreviousChannel<'a> {
    present: &'a [bool],
    /// Presence in the row before the stretch.
    before: bool,
}

impl PreviousChannel<'_> {
    /// Presence of a row and of the row before it.
    fn at(&self, row: usize) -> (bool, bool) {
        (self.present[row], if row == 0 { self.before } else { self.present[row - 1] })
    }

    /// 0 where presence changes in these rows, 1 where all are absent, 2 where all are present.
    fn class(&self, rows: Range<usize>) -> usize {
        let (_, before) = self.at(rows.start);
        if self.present[rows].iter().any(|&present| present != before) {
            return 0;
        }
        1 + usize::from(before)
    }
}

/// Rows of a page, and of its parts. Most of them, even in a channel with gaps, have no change and take one bit.
const PAGE: usize = 64;
const PART: usize = 8;

/// Contexts by presence in the newest row, class of age, and class of the previous channel.
type ByPiece = [Bit; 2 * AGES * 3];

/// The adaptive contexts.
#[derive(Debug)]
struct Models {
    /// By whether the channel changed in the block before.
    changes: [Bit; 3],
    pages: ByPiece,
    parts: ByPiece,
    /// By presence in the newest row, class of age, and presence and change of the previous channel.
    by_age: [Bit; 2 * AGES * 4],
    /// By the last four rows, and presence and change of the previous channel.
    by_rows: [Bit; 16 * 4],
}

impl Models {
    const NEW: Self = Self {
        changes: [Bit::NEW; 3],
        pages: [Bit::NEW; 2 * AGES * 3],
        parts: [Bit::NEW; 2 * AGES * 3],
        by_age: [Bit::NEW; 2 * AGES * 4],
        by_rows: [Bit::NEW; 64],
    };

    /// Codes one channel over one stretch.
    fn channel<C: BinaryCoder>(
        &mut self,
        coder: &mut C,
        state: &mut PresenceHistory,
        previous: Option<PreviousChannel<'_>>,
        rows: &mut Flags<'_>,
    ) {
        let all = 0..rows.len();
        let change = &mut self.changes[usize::from(state.changed)];
        let changes = code_any_change(coder, Some(change), state, all.clone(), rows);
        state.changed = 1 + u8::from(changes);
        if !changes {
            return;
        }
        // If no piece before the last one has a change, the last one must have it, which is not coded.
        let mut found = false;
        for page in split(all.clone(), PAGE) {
            let is_coded = found || page.end != all.end;
            let change = &mut self.pages[place(state, previous, &page)];
            if !code_any_change(coder, is_coded.then_some(change), state, page.clone(), rows) {
                continue;
            }
            found = true;
            let mut found = false;
            for part in split(page.clone(), PART) {
                let is_coded = found || part.end != page.end;
                let change = &mut self.parts[place(state, previous, &part)];
                if code_any_change(coder, is_coded.then_some(change), state, part.clone(), rows) {
                    found = true;
                    self.rows(coder, state, previous, part, rows);
                }
            }
        }
    }

    /// Codes rows; at least one of them differs from the row before it.
    fn rows<C: BinaryCoder>(
        &mut self,
        coder: &mut C,
        state: &mut PresenceHistory,
        previous: Option<PreviousChannel<'_>>,
        part: Range<usize>,
        rows: &mut Flags<'_>,
    ) {
        let (mut found, end) = (false, part.end);
        for row in part {
            let (near, before) = previous.map_or((true, true), |previous| previous.at(row));
            let neighbour = usize::from(near) << 1 | usize::from(near != before);
            let was = state.is_present();
            let by_age = usize::from(was) * AGES + state.age_class();
            let is_coded = found || row + 1 != end;
            let flips = !is_coded
                || coder.mixed(
                    &mut self.by_age[by_age << 2 | neighbour],
                    &mut self.by_rows[usize::from(state.last) << 2 | neighbour],
                    rows.any_other(row..row + 1, was),
                );
            found |= flips;
            rows.fill(row..row + 1, was != flips);
            state.push(was != flips);
        }
    }
}

/// Codes whether any row of a range differs from the newest one; without a `model` this is certain and not coded. If
/// none differs, appends all of them.
#[inline(always)]
fn code_any_change<C: BinaryCoder>(
    coder: &mut C,
    model: Option<&mut Bit>,
    state: &mut PresenceHistory,
    range: Range<usize>,
    rows: &mut Flags<'_>,
) -> bool {
    let was = state.is_present();
    let any = model.is_none_or(|model| coder.bit(model, rows.any_other(range.clone(), was)));
    if !any {
        state.push_many(was, range.len());
        rows.fill(range, was);
    }
    any
}

/// The context index of a page or part.
fn place(
    state: &PresenceHistory,
    previous: Option<PreviousChannel<'_>>,
    rows: &Range<usize>,
) -> usize {
    let previous = previous.map_or(2, |previous| previous.class(rows.clone()));
    (usize::from(state.is_present()) * AGES + state.age_class()) * 3 + previous
}

/// Splits rows into pieces, the last one shorter.
fn split(rows: Range<usize>, piece: usize) -> impl Iterator<Item = Range<usize>> {
    rows.clone().step_by(piece).map(move |first| first..rows.end.min(first + piece))
}

/// The presence of a channel's rows: the input of an encoder, or the output of a decoder.
enum Flags<'a> {
    Encode(&'a [bool]),
    Decode(&'a mut [bool]),
}

impl Flags<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Encode(rows) => rows.len(),
            Self::Decode(rows) => rows.len(),
        }
    }

    /// Whether presence in any row differs from `than`; meaningless in a decoder, which ignores it.
    fn any_other(&self, rows: Range<usize>, than: bool) -> bool {
        matches!(self, Self::Encode(known) if known[rows].iter().any(|&present| present != than))
    }

    fn fill(&mut self, rows: Range<usize>, present: bool) {
        if let Self::Decode(decoded) = self {
            decoded[rows].fill(present);
        }
    }
}
