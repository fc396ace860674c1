//! What was decoded last, for whoever goes from marker to marker.
//!
//! Markers that were coded together are decoded together: a minute of one of them is as much work as a minute of all.
//! So all are kept, and the next marker of the same minute is only copied.

use std::{ops::Range, sync::Mutex};

use mocapd_codec::GROUP_CHANNELS;
use mocapd_take::TakeMap;

use crate::{
    errors::Failure,
    pieces::{Wanted, groups},
    read::read,
};

/// Most bytes that are kept: two minutes of 64 markers at 240 Hz. More is decoded for the markers asked for alone.
const BYTES_MAX: u64 = 24 << 20;

/// Bytes of a position.
const POSITION_BYTES: u64 = 12;

/// Some rows of whole groups of markers.
struct Window {
    rows: Range<u64>,
    columns: Vec<usize>,
    /// Three values a column and row; NaN where there is no sample.
    values: Vec<f32>,
}

/// The last rows that were decoded of a take.
#[derive(Default)]
pub(crate) struct Last(Mutex<Option<Window>>);

impl Last {
    /// As [`read`], out of what was decoded last where it is there.
    pub(crate) fn read(
        &self,
        wanted: Wanted<'_>,
        rows: &Range<u64>,
        out: &mut [f32],
    ) -> Result<Vec<String>, Failure> {
        let columns = wanted.columns;
        let together = together(wanted.map, columns);
        let bytes = (rows.end - rows.start) * together.len() as u64 * POSITION_BYTES;
        // Most of what was decoded is asked for, or it is more than is kept.
        if columns.is_empty() || 2 * columns.len() > together.len() || bytes > BYTES_MAX {
            return read(wanted, rows, out);
        }
        // Another thread of the program reads: neither waits for the other.
        let Ok(mut kept) = self.0.try_lock() else {
            return read(wanted, rows, out);
        };
        if !kept.as_ref().is_some_and(|window| window.has(rows, columns)) {
            // Its memory is used again.
            let mut values = kept.take().map_or_else(Vec::new, |window| window.values);
            values.clear();
            values.resize((bytes / 4) as usize, f32::NAN);
            let problems = read(Wanted { columns: &together, ..wanted }, rows, &mut values)?;
            let window = Window { rows: rows.clone(), columns: together, values };
            window.copy(rows, columns, out);
            // What could not be decoded is told of the rows that were asked for, and so looked for anew.
            if problems.is_empty() {
                *kept = Some(window);
            }
            return Ok(problems);
        }
        if let Some(window) = &*kept {
            window.copy(rows, columns, out);
        }
        Ok(Vec::new())
    }
}

/// All columns that are coded together with one of these, in order.
fn together(map: &TakeMap, columns: &[usize]) -> Vec<usize> {
    let all = map.channels.len();
    let group = |group: usize| group * GROUP_CHANNELS..((group + 1) * GROUP_CHANNELS).min(all);
    groups(columns).into_iter().flat_map(group).collect()
}

impl Window {
    fn has(&self, rows: &Range<u64>, columns: &[usize]) -> bool {
        self.rows.start <= rows.start
            && rows.end <= self.rows.end
            && columns.iter().all(|column| self.columns.binary_search(column).is_ok())
    }

    /// Rows and columns that it has.
    fn copy(&self, rows: &Range<u64>, columns: &[usize], out: &mut [f32]) {
        let first = (rows.start - self.rows.start) as usize;
        let from = self.values.chunks_exact(3 * self.columns.len()).skip(first);
        let places: Vec<usize> =
            columns.iter().filter_map(|column| self.columns.binary_search(column).ok()).collect();
        for (out, row) in out.chunks_exact_mut(3 * columns.len()).zip(from) {
            for (out, place) in out.as_chunks_mut::<3>().0.iter_mut().zip(&places) {
                out.copy_from_slice(&row[3 * place..][..3]);
            }
        }
    }
}
