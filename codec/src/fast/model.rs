//! The distributions of the residuals: fixed tables, chosen by how large a level's residuals were lately.

/// log2 of the states of every table.
pub(super) const STATE_BITS: u32 = 10;
/// States of every table; frequencies add up to it.
pub(super) const STATES: usize = 1 << STATE_BITS;

/// Classes of activity.
pub(super) const CLASSES: usize = 14;
/// Table of the zero rows of a quiet level.
pub(super) const QUIET: usize = CLASSES;
/// Table of the row that ends the quiet.
pub(super) const WAKE: usize = CLASSES + 1;
/// All tables.
pub(super) const TABLES: usize = CLASSES + 2;

/// Symbols of a row: four states (0, +1, -1, larger) of each axis, x highest.
pub(super) const SYMBOLS: usize = 64;
/// Zero rows that one quiet symbol stands for at most.
pub(super) const QUIET_ROWS: usize = 16;

/// Sequences with an activity of their own: strides 1, 2, 4, 8, 16, anchors (32), origins.
pub(super) const LEVELS: usize = 7;
/// Level of the anchors.
pub(super) const ANCHOR: usize = 5;
/// Level of the origins.
pub(super) const ORIGIN: usize = 6;

/// Sums of magnitudes are cut to this: one jump must not decide for long.
const MAX_MAGNITUDE: u32 = 255;

/// Order of the Exp-Golomb code of larger magnitudes, by table.
pub(super) const GOLOMB: [u32; TABLES] = [0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 2, 2, 0, 0];

/// Low bits of each axis that are left out of the symbol and stored as they are, by table.
pub(super) const LOW_BITS: [u32; TABLES] = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3, 6, 0, 0];

/// Frequency of each symbol that has so many axes of +-1 and larger, in the order of [`kind`].
/// Counted on recorded takes, each with the same weight.
const FREQUENCIES: [[u16; 10]; CLASSES] = [
    [937, 5, 1, 1, 1, 1, 1, 1, 1, 1],
    [925, 7, 1, 1, 1, 1, 1, 1, 1, 1],
    [907, 10, 1, 1, 1, 1, 1, 1, 1, 1],
    [868, 14, 2, 1, 2, 1, 1, 1, 1, 1],
    [799, 21, 4, 1, 3, 1, 1, 1, 1, 1],
    [684, 28, 7, 2, 7, 2, 1, 2, 1, 3],
    [495, 30, 11, 4, 12, 5, 3, 6, 4, 11],
    [281, 22, 12, 6, 20, 10, 6, 18, 12, 41],
    [147, 13, 7, 4, 19, 12, 8, 34, 25, 134],
    [73, 6, 4, 2, 14, 9, 6, 44, 33, 299],
    [51, 3, 2, 1, 8, 6, 4, 37, 32, 476],
    [42, 2, 1, 1, 5, 3, 3, 32, 28, 599],
    [102, 9, 3, 2, 12, 8, 4, 37, 29, 351],
    [132, 16, 4, 2, 17, 8, 4, 31, 21, 318],
];

/// Frequencies of 0 to 15 zero rows before the first that is not, and of none that is not.
const QUIET_FREQUENCIES: [u16; QUIET_ROWS + 1] =
    [17, 16, 15, 11, 13, 11, 10, 11, 10, 9, 9, 7, 6, 6, 6, 5, 862];

/// As [`FREQUENCIES`], for a row that is not zero after zero rows.
const WAKE_FREQUENCIES: [u16; 10] = [0, 120, 18, 2, 7, 2, 1, 1, 1, 6];

/// The code of an axis of a row symbol: 0, +1, -1, larger.
pub(super) fn axis_code(symbol: usize, axis: usize) -> usize {
    symbol >> (4 - 2 * axis) & 3
}

/// What the axes of a row symbol are.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axes {
    /// How many are +-1.
    pub(super) ones: u8,
    /// A bit for each that is larger, x lowest.
    pub(super) larger: u8,
}

pub(super) fn axes(symbol: usize) -> Axes {
    let mut axes = Axes { ones: 0, larger: 0 };
    for axis in 0..3 {
        match axis_code(symbol, axis) {
            0 => {}
            3 => axes.larger |= 1 << axis,
            _ => axes.ones += 1,
        }
    }
    axes
}

/// Kinds of symbols: by the number of axes that are larger, then by those of +-1.
fn kind(symbol: usize) -> usize {
    let Axes { ones, larger } = axes(symbol);
    [0, 4, 7, 9][larger.count_ones() as usize] + usize::from(ones)
}

/// Frequency of a symbol of a table.
pub(super) fn frequency(table: usize, symbol: usize) -> u16 {
    match table {
        QUIET => QUIET_FREQUENCIES.get(symbol).copied().unwrap_or(0),
        WAKE => WAKE_FREQUENCIES[kind(symbol)],
        _ => FREQUENCIES[table][kind(symbol)],
    }
}

/// How large the residuals of one level were lately: an average of the sum over the axes, in 1/256,
/// that forgets a quarter a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Activity(u32);

impl Activity {
    /// What a key block starts with: more at wider strides.
    pub(super) const NEW: [Self; LEVELS] = [
        Self(1 << 8),
        Self(2 << 8),
        Self(4 << 8),
        Self(8 << 8),
        Self(16 << 8),
        Self(64 << 8),
        Self(255 << 8),
    ];

    /// Nothing but zero for long.
    #[inline(always)]
    pub(super) fn is_quiet(self) -> bool {
        self.0 == 0
    }

    /// Table of the next row, below [`CLASSES`].
    #[inline(always)]
    pub(super) fn class(self) -> usize {
        // At most 255 * 256: 16 bits.
        (32 - (self.0 | 4).leading_zeros()) as usize - 3
    }

    #[inline(always)]
    pub(super) fn push(&mut self, magnitude: u32) {
        let new = magnitude.min(MAX_MAGNITUDE) << 8;
        self.0 = self.0.wrapping_add_signed((new as i32 - self.0 as i32) >> 2);
    }
}

// Where a decoder finds the table of the next row: what it waits for most.

/// Places of tables in a decoder's memory: by the leading zeros of four times an [`Activity`].
pub(super) const PLACES: usize = 32;
/// Place of [`QUIET`]: an activity of nothing has no table of its own, and its leading zeros are not looked up.
pub(super) const QUIET_PLACE: usize = 30;
/// Place of [`WAKE`].
pub(super) const WAKE_PLACE: usize = 31;

/// The table at a place. The lowest class is at several, no activity is so large that it comes to the first.
pub(super) fn table_at(place: usize) -> Option<usize> {
    match place {
        QUIET_PLACE => Some(QUIET),
        WAKE_PLACE => Some(WAKE),
        28.. => Some(0),
        14.. => Some(27 - place),
        _ => None,
    }
}

/// An activity as a decoder keeps it while it reads: four times as much, so that the table of the next row waits for
/// nothing but a sum and its leading zeros.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fourfold(u32);

impl Fourfold {
    #[inline(always)]
    pub(super) fn new(activity: Activity) -> Self {
        Self(activity.0 << 2)
    }

    #[inline(always)]
    pub(super) fn activity(self) -> Activity {
        Activity(self.0 >> 2)
    }

    #[inline(always)]
    pub(super) fn is_quiet(self) -> bool {
        self.0 < 4
    }

    /// Place of the table of the next row, where it is not quiet.
    #[inline(always)]
    pub(super) fn place(self) -> usize {
        self.0.leading_zeros() as usize
    }

    /// As [`Activity::push`], with the magnitude in 1/256, cut already.
    #[inline(always)]
    pub(super) fn push(&mut self, magnitude: u32) {
        self.0 = (self.0 >> 2) * 3 + magnitude;
    }
}

/// A sum of magnitudes as [`Fourfold::push`] takes it.
#[inline(always)]
pub(super) fn cut(magnitude: u32) -> u32 {
    magnitude.min(MAX_MAGNITUDE) << 8
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;

    #[test]
    fn every_table_fills_its_states() {
        for table in 0..TABLES {
            let sum: usize = (0..SYMBOLS).map(|s| usize::from(frequency(table, s))).sum();
            assert_eq!(sum, STATES, "table {table}");
        }
    }

    #[test]
    fn an_activity_stays_within_its_classes_and_comes_to_rest() {
        let mut activity = Activity::NEW[ORIGIN];
        for _ in 0..100 {
            activity.push(u32::MAX);
            assert_eq!(activity.class(), CLASSES - 1);
        }
        for _ in 0..60 {
            activity.push(0);
        }
        assert!(activity.is_quiet());
        assert_eq!(activity.class(), 0);
    }

    #[test]
    fn a_decoder_finds_the_table_that_the_encoder_took() {
        let mut activity = Activity::NEW[ORIGIN];
        let mut fourfold = Fourfold::new(activity);
        let mut random = Random::new(1);
        for row in 0..20_000_u32 {
            // Now large, now small, and nothing for long.
            let magnitude = random.next_u64() as u32;
            let magnitude = if row % 500 > 400 { 0 } else { magnitude >> (magnitude % 32) };
            activity.push(magnitude);
            fourfold.push(cut(magnitude));
            assert_eq!(activity, fourfold.activity(), "row {row}");
            assert_eq!(activity.is_quiet(), fourfold.is_quiet(), "row {row}");
            if !activity.is_quiet() {
                assert_eq!(Some(activity.class()), table_at(fourfold.place()), "row {row}");
            }
        }
    }

    #[test]
    fn every_class_has_a_place() {
        for activity in Activity::NEW.into_iter().take(LEVELS) {
            let place = Fourfold::new(activity).place();
            assert_eq!(table_at(place), Some(activity.class()));
        }
        let found: Vec<_> = (0..PLACES).filter_map(table_at).collect();
        assert!((0..CLASSES).all(|class| found.contains(&class)));
        assert_eq!((table_at(QUIET_PLACE), table_at(WAKE_PLACE)), (Some(QUIET), Some(WAKE)));
    }
}
