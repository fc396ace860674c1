//! The place of a take in a recording that was divided into a series of takes: settings of its header.

use std::ops::Range;

use super::Header;
use crate::stretch::ROWS_PASSED_MAX;

/// Key of the setting that states the requested length of a take, as it was written.
pub const SPLIT_SETTING: &str = "split";

/// Key of the setting that states the id of the series' first take, in hexadecimal.
pub const SERIES_SETTING: &str = "series";

/// Key of the setting that states the number of the take in the series, from 1.
pub const PART_SETTING: &str = "part";

/// Key of the setting that states which row of the recording is row 0 of the take.
pub const FIRST_FRAME_SETTING: &str = "part_first_frame";

/// Which rows of a divided recording a take has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct SeriesPlace {
    series: String,
    rows: Range<u64>,
}

impl SeriesPlace {
    /// The place of a take of `n_rows` rows; `None` if its header states none.
    pub(crate) fn of(header: &Header, n_rows: u64) -> Option<Self> {
        let setting = |wanted: &str| {
            let found = header.settings.iter().find(|(key, _)| key == wanted);
            found.map(|(_, value)| value.as_str())
        };
        let first_row: u64 = setting(FIRST_FRAME_SETTING)?.parse().ok()?;
        let rows = first_row..first_row.checked_add(n_rows)?;
        Some(Self { series: setting(SERIES_SETTING)?.to_owned(), rows })
    }

    /// Rows of the recording between a take and a later one; `None` if they are not of one series, not in order, or
    /// farther apart than a take can hold.
    pub(crate) fn rows_between(before: Option<Self>, after: Option<Self>) -> Option<u64> {
        let (before, after) = before.zip(after)?;
        let rows = after.rows.start.checked_sub(before.rows.end)?;
        (before.series == after.series && rows < ROWS_PASSED_MAX).then_some(rows)
    }

    /// Sets the place of a take without its first `rows` rows.
    pub(crate) fn advance(header: &mut Header, rows: u64) {
        let first_row = header.settings.iter_mut().find(|(key, _)| key == FIRST_FRAME_SETTING);
        if let Some((_, value)) = first_row
            && let Ok(row) = value.parse::<u64>()
        {
            *value = row.saturating_add(rows).to_string();
        }
    }

    /// Turns the place of a take into that of a take in which others follow it. It remains if all are of `one_series`.
    pub(crate) fn join(header: &mut Header, one_series: bool) {
        let keys = [SPLIT_SETTING, PART_SETTING, SERIES_SETTING, FIRST_FRAME_SETTING];
        // The joined take is no longer one of the takes into which the recording was divided.
        let untrue = if one_series { &keys[..2] } else { &keys[..] };
        header.settings.retain(|(key, _)| !untrue.contains(&key.as_str()));
    }
}
