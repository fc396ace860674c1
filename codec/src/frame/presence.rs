//! Which samples of a group are present.
//!
//! Most channels of most stretches go on as they were: one cheap bit each. Those that do not get a bit
//! a page of rows, then a part of a page, and a row only where something changes; expected from the channel's
//! own last rows and from the channel before it, because markers of one body are hidden together, and an
//! unlabelled one that is lost here goes on as another there.

use std::ops::Range;

use crate::{
    DecodedRows, GROUP_CHANNELS, Result, Rows,
    coding::{
        bytes::{Bytes, MAX_VARINT_BYTES, write_varint},
        range::{BinaryCoder, Bit, RangeDecoder, RangeEncoder},
    },
    ensure,
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
            self.models.channel(&mut coder, state, beside, &mut Flags::Known(rows.present()));
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
    ) -> Result<()> {
        let len = input.varint("the length of the presence section")?;
        let len = usize::try_from(len).unwrap_or(usize::MAX);
        let mut coder = RangeDecoder::new(input.take(len, "the presence section")?);
        let mut before = true;
        for (i, state) in self.states.iter_mut().enumerate().take(channels.len()) {
            let (done, rest) = channels.split_at_mut(i);
            let beside = done.last().map(|rows| Beside { present: &rows.present, before });
            before = state.is_present();
            self.models.channel(
                &mut coder,
                state,
                beside,
                &mut Flags::Wanted(&mut rest[0].present),
            );
        }
        coder.finish()?;
        self.leave_out_from(channels.len());
        ensure(
            channels.iter().any(|rows| rows.present.contains(&false)),
            "a presence section of a block that needs none",
        )?;
        Ok(())
    }
}

/// Most bytes of a section.
pub(super) fn max_bytes(n_channels: usize, n_rows: usize) -> usize {
    let pieces = n_rows.div_ceil(PAGE) + n_rows.div_ceil(PART);
    // No bit costs more than 11: its odds are at least 2^-11. Twelve leave room for their rounding.
    MAX_VARINT_BYTES + 5 + n_channels * (1 + pieces + n_rows) * 12 / 8
}

/// Classes of how long a state has lasted.
const AGES: usize = 7;

/// Rows that count as for ever.
const LONG: u8 = 61;

/// What was seen of a channel up to a stretch.
#[derive(Debug, Clone, Copy)]
struct State {
    /// Its last four rows, the newest lowest.
    last: u8,
    /// How many rows it has been as in the newest, up to [`LONG`].
    age: u8,
    /// Whether it changed in the block before: 0 there was none, 1 no, 2 yes.
    changed: u8,
}

impl State {
    /// Behind a key.
    const PRESENT: Self = Self { last: 0b1111, age: LONG, changed: 0 };
    /// Behind rows without a sample.
    const ABSENT: Self = Self { last: 0, age: LONG, changed: 0 };

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
            21..LONG => 5,
            _ => 6,
        }
    }

    /// So many rows alike.
    fn pass(&mut self, present: bool, n_rows: usize) {
        let Some(more) = n_rows.checked_sub(1) else { return };
        self.push(present);
        self.age = more.saturating_add(self.age.into()).min(LONG.into()) as u8;
        let alike = if present { (1 << more.min(4)) - 1 } else { 0 };
        self.last = (self.last << more.min(4) | alike) & 0b1111;
    }

    fn push(&mut self, present: bool) {
        self.age = if present == self.is_present() { (self.age + 1).min(LONG) } else { 1 };
        self.last = self.last << 1 & 0b1111 | u8::from(present);
    }
}

/// The channel before one, over the same rows.
#[derive(Debug, Clone, Copy)]
struct Beside<'a> {
    present: &'a [bool],
    /// In the row before.
    before: bool,
}

impl Beside<'_> {
    /// A row and the one before it.
    fn at(&self, row: usize) -> (bool, bool) {
        (self.present[row], if row == 0 { self.before } else { self.present[row - 1] })
    }

    /// 0 it changes in these rows, 1 it is absent, 2 present.
    fn class(&self, rows: Range<usize>) -> usize {
        let (_, before) = self.at(rows.start);
        if self.present[rows].iter().any(|&present| present != before) {
            return 0;
        }
        1 + usize::from(before)
    }
}

/// Rows of a page, and of its parts. Most of a channel that comes and goes is still long runs of the same:
/// a page without a change is one bit, and a part of another page one.
const PAGE: usize = 64;
const PART: usize = 8;

/// By the newest row, how long that has lasted, and the class of the channel beside.
type ByPlace = [Bit; 2 * AGES * 3];

/// The adaptive bits.
#[derive(Debug)]
struct Models {
    /// By what the channel did in the block before.
    changes: [Bit; 3],
    pages: ByPlace,
    parts: ByPlace,
    /// By the newest row, how long that has lasted, and the row and change of the channel beside.
    by_age: [Bit; 2 * AGES * 4],
    /// By the last four rows and the channel beside.
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

    /// One channel over one stretch, the same for both sides.
    fn channel<C: BinaryCoder>(
        &mut self,
        coder: &mut C,
        state: &mut State,
        beside: Option<Beside<'_>>,
        rows: &mut Flags<'_>,
    ) {
        let all = 0..rows.len();
        let change = &mut self.changes[usize::from(state.changed)];
        let changes = any(coder, Some(change), state, all.clone(), rows);
        state.changed = 1 + u8::from(changes);
        if !changes {
            return;
        }
        // The last piece must have a change where those before it had none, and is not asked.
        let mut found = false;
        for page in split(all.clone(), PAGE) {
            let asked = found || page.end != all.end;
            let change = &mut self.pages[place(state, beside, &page)];
            if !any(coder, asked.then_some(change), state, page.clone(), rows) {
                continue;
            }
            found = true;
            let mut found = false;
            for part in split(page.clone(), PART) {
                let asked = found || part.end != page.end;
                let change = &mut self.parts[place(state, beside, &part)];
                if any(coder, asked.then_some(change), state, part.clone(), rows) {
                    found = true;
                    self.rows(coder, state, beside, part, rows);
                }
            }
        }
    }

    /// Rows of which at least one is other than the one before it.
    fn rows<C: BinaryCoder>(
        &mut self,
        coder: &mut C,
        state: &mut State,
        beside: Option<Beside<'_>>,
        part: Range<usize>,
        rows: &mut Flags<'_>,
    ) {
        let (mut found, end) = (false, part.end);
        for row in part {
            let (near, before) = beside.map_or((true, true), |beside| beside.at(row));
            let neighbour = usize::from(near) << 1 | usize::from(near != before);
            let was = state.is_present();
            let by_age = usize::from(was) * AGES + state.age_class();
            let asked = found || row + 1 != end;
            let flips = !asked
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

/// Says whether any of some rows is other than the newest, which is so where there is no model; if none is they
/// are passed.
#[inline(always)]
fn any<C: BinaryCoder>(
    coder: &mut C,
    model: Option<&mut Bit>,
    state: &mut State,
    range: Range<usize>,
    rows: &mut Flags<'_>,
) -> bool {
    let was = state.is_present();
    let any = model.is_none_or(|model| coder.bit(model, rows.any_other(range.clone(), was)));
    if !any {
        state.pass(was, range.len());
        rows.fill(range, was);
    }
    any
}

/// The context of a page or part.
fn place(state: &State, beside: Option<Beside<'_>>, rows: &Range<usize>) -> usize {
    let beside = beside.map_or(2, |beside| beside.class(rows.clone()));
    (usize::from(state.is_present()) * AGES + state.age_class()) * 3 + beside
}

/// Pieces of some rows, the last one shorter.
fn split(rows: Range<usize>, piece: usize) -> impl Iterator<Item = Range<usize>> {
    rows.clone().step_by(piece).map(move |first| first..rows.end.min(first + piece))
}

/// The rows of a channel: what an encoder has, or what a decoder will have.
enum Flags<'a> {
    Known(&'a [bool]),
    Wanted(&'a mut [bool]),
}

impl Flags<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Known(rows) => rows.len(),
            Self::Wanted(rows) => rows.len(),
        }
    }

    /// Nothing that a decoder relies on.
    fn any_other(&self, rows: Range<usize>, than: bool) -> bool {
        matches!(self, Self::Known(known) if known[rows].iter().any(|&present| present != than))
    }

    fn fill(&mut self, rows: Range<usize>, present: bool) {
        if let Self::Wanted(wanted) = self {
            wanted[rows].fill(present);
        }
    }
}
