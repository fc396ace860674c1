//! Where a decoder finds the table of the next row: what it waits for most.

use super::model::{Activity, MAX_MAGNITUDE, QUIET, WAKE};

/// Places of tables in a decoder's memory: by the leading zeros of four times an [`Activity`].
pub(super) const PLACES: usize = 32;
/// Place of [`QUIET`]: an activity of nothing has no table of its own, and its leading zeros are not looked up.
pub(super) const QUIET_PLACE: usize = 30;
/// Place of [`WAKE`].
pub(super) const WAKE_PLACE: usize = 31;

/// The table at a place. The lowest class is at several, no activity is so large that it comes to the first.
pub(super) const fn table_at(place: usize) -> Option<usize> {
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

impl From<Activity> for Fourfold {
    fn from(activity: Activity) -> Self {
        Self(activity.0 << 2)
    }
}

impl From<Fourfold> for Activity {
    fn from(fourfold: Fourfold) -> Self {
        Self(fourfold.0 >> 2)
    }
}

/// A sum of magnitudes as [`Fourfold::push`] takes it.
#[inline(always)]
pub(super) fn cut(magnitude: u32) -> u32 {
    magnitude.min(MAX_MAGNITUDE) << 8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fast::model::{CLASSES, LEVELS, ORIGIN};

    #[test]
    fn a_decoder_finds_the_table_that_the_encoder_took() {
        let mut activity = Activity::NEW[ORIGIN];
        let mut fourfold = Fourfold::from(activity);
        let mut magnitude = 1_u32;
        for row in 0..20_000_u32 {
            // Now large, now small, and nothing for long.
            magnitude = magnitude.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let magnitude = if row % 500 > 400 { 0 } else { magnitude >> (magnitude % 32) };
            activity.push(magnitude);
            fourfold.push(cut(magnitude));
            assert_eq!(activity, Activity::from(fourfold), "row {row}");
            assert_eq!(activity.is_quiet(), fourfold.is_quiet(), "row {row}");
            if !activity.is_quiet() {
                assert_eq!(Some(activity.class()), table_at(fourfold.place()), "row {row}");
            }
        }
    }

    #[test]
    fn every_class_has_a_place() {
        for activity in Activity::NEW.into_iter().take(LEVELS) {
            let place = Fourfold::from(activity).place();
            assert_eq!(table_at(place), Some(activity.class()));
        }
        let found: Vec<_> = (0..PLACES).filter_map(table_at).collect();
        assert!((0..CLASSES).all(|class| found.contains(&class)));
        assert_eq!((table_at(QUIET_PLACE), table_at(WAKE_PLACE)), (Some(QUIET), Some(WAKE)));
    }
}
