//! The distributions of the residuals: fixed tables, selected by the recent magnitude of a level's residuals.

/// log2 of the number of states of every table.
pub(super) const STATE_BITS: u32 = 10;
/// Number of states of every table, and the sum of its frequencies.
pub(super) const STATES: usize = 1 << STATE_BITS;

/// Number of activity classes, each with a table.
pub(super) const CLASSES: usize = 14;
/// Table of the number of zero rows in a quiet level.
pub(super) const QUIET: usize = CLASSES;
/// Table of the nonzero row that follows zero rows.
pub(super) const WAKE: usize = CLASSES + 1;
/// Number of tables.
pub(super) const TABLES: usize = CLASSES + 2;

/// Number of row symbols: each axis, x highest, is 0, +1, -1 or larger.
pub(super) const SYMBOLS: usize = 64;
/// Maximum number of zero rows that one symbol represents.
pub(super) const QUIET_ROWS: usize = 16;

/// Levels with an activity of their own: strides 1, 2, 4, 8, 16, anchors (32), origins.
pub(super) const LEVELS: usize = 7;
/// Level of the anchors.
pub(super) const ANCHOR: usize = 5;
/// Level of the origins.
pub(super) const ORIGIN: usize = 6;

/// Sums of magnitudes are clamped to this, so that one jump does not dominate the activity for long.
const MAX_MAGNITUDE: u32 = 255;

/// Order of the Exp-Golomb code of larger magnitudes, by table.
pub(super) const GOLOMB: [u32; TABLES] = [0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 2, 2, 0, 0];

/// Number of low bits of each axis that are stored plainly, not in the symbol, by table.
pub(super) const LOW_BITS: [u32; TABLES] = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3, 6, 0, 0];

/// Frequency of each symbol by its [`kind`], for the tables of the activity classes. Counted on recorded takes, each
/// with the same weight.
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

/// Frequencies of 0 to 15 zero rows before a nonzero one, and of 16 zero rows.
const QUIET_FREQUENCIES: [u16; QUIET_ROWS + 1] =
    [17, 16, 15, 11, 13, 11, 10, 11, 10, 9, 9, 7, 6, 6, 6, 5, 862];

/// Frequency of each symbol by its [`kind`], for a nonzero row after zero rows.
const WAKE_FREQUENCIES: [u16; 10] = [0, 120, 18, 2, 7, 2, 1, 1, 1, 6];

/// The code of an axis of a row symbol: 0, +1, -1, larger.
pub(super) fn axis_code(symbol: usize, axis: usize) -> usize {
    symbol >> (4 - 2 * axis) & 3
}

/// The kinds of the axes of a row symbol.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axes {
    /// Number of axes that are +-1.
    pub(super) ones: u8,
    /// One bit per axis that is larger, x lowest.
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

/// The kind of a symbol: by the number of larger axes, then by the number of axes that are +-1.
fn kind(symbol: usize) -> usize {
    let Axes { ones, larger } = axes(symbol);
    [0, 4, 7, 9][larger.count_ones() as usize] + usize::from(ones)
}

/// Frequency of a symbol in a table.
pub(super) fn frequency(table: usize, symbol: usize) -> u16 {
    match table {
        QUIET => QUIET_FREQUENCIES.get(symbol).copied().unwrap_or(0),
        WAKE => WAKE_FREQUENCIES[kind(symbol)],
        _ => FREQUENCIES[table][kind(symbol)],
    }
}

/// The recent magnitude of a level's residuals, summed over the axes: an average in 1/256 of a step that forgets a
/// quarter per row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Activity(u32);

impl Activity {
    /// The activities at a key block: larger at wider strides.
    pub(super) const NEW: [Self; LEVELS] = [
        Self(1 << 8),
        Self(2 << 8),
        Self(4 << 8),
        Self(8 << 8),
        Self(16 << 8),
        Self(64 << 8),
        Self(255 << 8),
    ];

    /// Whether the last rows were all zero, long enough for the average to reach 0.
    #[inline(always)]
    pub(super) fn is_quiet(self) -> bool {
        self.0 == 0
    }

    /// Table of the next row, below [`CLASSES`].
    #[inline(always)]
    pub(super) fn class(self) -> usize {
        // At most 255 * 256, which is 16 bits.
        (32 - (self.0 | 4).leading_zeros()) as usize - 3
    }

    /// Adds the summed magnitude of a row.
    #[inline(always)]
    pub(super) fn push(&mut self, magnitude: u32) {
        let new = magnitude.min(MAX_MAGNITUDE) << 8;
        self.0 = self.0.wrapping_add_signed((new as i32 - self.0 as i32) >> 2);
    }
}

// How a decoder finds the table of the next row: its critical path.

/// Number of places of tables in a decoder's memory. The place of a class is the number of leading zeros of four times
/// an [`Activity`].
pub(super) const PLACES: usize = 32;
/// Place of [`QUIET`]: an activity of 0 selects no class, so that its number of leading zeros is free.
pub(super) const QUIET_PLACE: usize = 30;
/// Place of [`WAKE`].
pub(super) const WAKE_PLACE: usize = 31;

/// The table at a place, if any. The lowest class has several places; activities are too small for the first ones.
pub(super) fn table_at(place: usize) -> Option<usize> {
    match place {
        QUIET_PLACE => Some(QUIET),
        WAKE_PLACE => Some(WAKE),
        28.. => Some(0),
        14.. => Some(27 - place),
        _ => None,
    }
}

/// An activity times four, as a decoder keeps it while it reads: the table of the next row then takes only a sum and a
/// count of leading zeros.
#[derive(Debug, Clone, Copy)]
pub(super) struct ScaledActivity(u32);

impl ScaledActivity {
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

    /// Place of the table of the next row, unless the level is quiet.
    #[inline(always)]
    pub(super) fn place(self) -> usize {
        self.0.leading_zeros() as usize
    }

    /// Adds the summed magnitude of a row, a result of [`clamp_magnitude`], with the effect of [`Activity::push`].
    #[inline(always)]
    pub(super) fn push(&mut self, magnitude: u32) {
        self.0 = (self.0 >> 2) * 3 + magnitude;
    }
}

/// A clamped sum of magnitudes in 1/256, for [`ScaledActivity::push`].
#[inline(always)]
pub(super) fn clamp_magnitude(magnitude: u32) -> u32 {
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
    fn activities_stay_within_their_classes_and_decay_to_zero() {
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
    fn encoder_and_decoder_select_the_same_table() {
        let mut activity = Activity::NEW[ORIGIN];
        let mut scaled = ScaledActivity::new(activity);
        let mut random = Random::new(1);
        for row in 0..20_000_u32 {
            // Large and small magnitudes, and long runs of zeros.
            let magnitude = random.next_u64() as u32;
            let magnitude = if row % 500 > 400 { 0 } else { magnitude >> (magnitude % 32) };
            activity.push(magnitude);
            scaled.push(clamp_magnitude(magnitude));
            assert_eq!(activity, scaled.activity(), "row {row}");
            assert_eq!(activity.is_quiet(), scaled.is_quiet(), "row {row}");
            if !activity.is_quiet() {
                assert_eq!(Some(activity.class()), table_at(scaled.place()), "row {row}");
            }
        }
    }

    #[test]
    fn every_class_has_a_place() {
        for activity in Activity::NEW.into_iter().take(LEVELS) {
            let place = ScaledActivity::new(activity).place();
            assert_eq!(table_at(place), Some(activity.class()));
        }
        let found: Vec<_> = (0..PLACES).filter_map(table_at).collect();
        assert!((0..CLASSES).all(|class| found.contains(&class)));
        assert_eq!((table_at(QUIET_PLACE), table_at(WAKE_PLACE)), (Some(QUIET), Some(WAKE)));
    }
}
