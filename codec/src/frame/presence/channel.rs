//! One channel's presence over one stretch: what is known of it, what it is expected from, and its bits.

use crate::coding::range::{BinaryCoder, Bit};

/// Classes of how long a state has lasted.
const AGES: usize = 7;

/// Rows that count as for ever.
const LONG: u8 = 61;

/// What was seen of a channel up to a stretch.
#[derive(Debug, Clone, Copy)]
pub(super) struct State {
    /// Its last four rows, the newest lowest.
    pub(super) last: u8,
    /// How many rows it has been as in the newest, up to [`LONG`].
    pub(super) age: u8,
    /// Whether it changed in the block before: 0 there was none, 1 no, 2 yes.
    pub(super) changed: u8,
}

impl State {
    /// Behind a key.
    pub(super) const PRESENT: Self = Self { last: 0b1111, age: LONG, changed: 0 };
    /// Behind rows without a sample.
    pub(super) const ABSENT: Self = Self { last: 0, age: LONG, changed: 0 };

    pub(super) fn is_present(self) -> bool {
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
    pub(super) fn pass(&mut self, present: bool, n_rows: usize) {
        (0..n_rows.min(LONG.into())).for_each(|_| self.push(present));
    }

    fn push(&mut self, present: bool) {
        self.age = if present == self.is_present() { (self.age + 1).min(LONG) } else { 1 };
        self.last = self.last << 1 & 0b1111 | u8::from(present);
    }
}

/// The channel before one, over the same rows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beside<'a> {
    pub(super) present: &'a [bool],
    /// In the row before.
    pub(super) before: bool,
}

/// The adaptive bits.
#[derive(Debug)]
pub(super) struct Models {
    /// By what the channel did in the block before.
    changes: [Bit; 3],
    /// By the newest row, how long that has lasted, and the row and change of the channel beside.
    by_age: [Bit; 2 * AGES * 4],
    /// By the last four rows and the channel beside.
    by_rows: [Bit; 16 * 4],
}

impl Models {
    pub(super) const NEW: Self =
        Self { changes: [Bit::NEW; 3], by_age: [Bit::NEW; 2 * AGES * 4], by_rows: [Bit::NEW; 64] };

    /// One channel over one stretch, the same for both sides.
    pub(super) fn channel<C: BinaryCoder>(
        &mut self,
        coder: &mut C,
        state: &mut State,
        beside: Option<Beside<'_>>,
        rows: &mut impl Flags,
    ) {
        let was = state.is_present();
        let changes = (0..rows.len()).any(|row| rows.get(row) != was);
        let changes = coder.bit(&mut self.changes[usize::from(state.changed)], changes);
        state.changed = 1 + u8::from(changes);
        if !changes {
            (0..rows.len()).for_each(|row| rows.set(row, was));
            state.pass(was, rows.len());
            return;
        }
        let mut beside_before = beside.is_none_or(|beside| beside.before);
        for row in 0..rows.len() {
            let near = beside.is_none_or(|beside| beside.present[row]);
            let neighbour = usize::from(near) << 1 | usize::from(near != beside_before);
            beside_before = near;
            let was = state.is_present();
            let by_age = usize::from(was) * AGES + state.age_class();
            let flips = coder.mixed(
                &mut self.by_age[by_age << 2 | neighbour],
                &mut self.by_rows[usize::from(state.last) << 2 | neighbour],
                rows.get(row) != was,
            );
            rows.set(row, was != flips);
            state.push(was != flips);
        }
    }
}

/// The rows of a channel: what an encoder has, or what a decoder will have.
pub(super) trait Flags {
    fn len(&self) -> usize;
    fn get(&self, row: usize) -> bool;
    fn set(&mut self, row: usize, present: bool);
}

impl Flags for &[bool] {
    fn len(&self) -> usize {
        <[bool]>::len(self)
    }

    fn get(&self, row: usize) -> bool {
        self[row]
    }

    fn set(&mut self, _row: usize, _present: bool) {}
}

impl Flags for &mut [bool] {
    fn len(&self) -> usize {
        <[bool]>::len(self)
    }

    fn get(&self, row: usize) -> bool {
        self[row]
    }

    fn set(&mut self, row: usize, present: bool) {
        self[row] = present;
    }
}
