//! A cache of the rows decoded last, for programs that read marker after marker.
//!
//! Markers of one group are encoded together, so decoding a minute of one of them decodes that minute of all. The cache
//! keeps all of them, and reading the next marker of the same minute is only a copy.

use std::{ops::Range, sync::Mutex};

use mocapd_codec::GROUP_CHANNELS;
use mocapd_take::TakeMap;

use crate::{
    decode::{DecodeRequest, groups},
    errors::Failure,
    read::read,
};

/// Maximum number of bytes to cache: two minutes of 64 markers at 240 Hz. A longer read bypasses the cache.
const BYTES_MAX: u64 = 24 << 20;

/// Bytes of a position: three float32.
const POSITION_BYTES: u64 = 12;

/// Cached rows of all markers of some groups.
struct CachedRows {
    rows: Range<u64>,
    columns: Vec<usize>,
    /// Three values for each row and column; NaN for a missing sample.
    values: Vec<f32>,
}

/// The rows of a take that were decoded last.
#[derive(Default)]
pub(crate) struct DecodeCache(Mutex<Option<CachedRows>>);

impl DecodeCache {
    /// Frees the rows, unless another thread is reading them.
    pub(crate) fn clear(&self) {
        if let Ok(mut kept) = self.0.try_lock() {
            *kept = None;
        }
    }

    /// Reads like [`read`], from the cache if it has the rows and columns.
    pub(crate) fn read(
        &self,
        request: DecodeRequest<'_>,
        rows: &Range<u64>,
        out: &mut [f32],
    ) -> Result<Vec<String>, Failure> {
        let columns = request.columns;
        let group_columns = group_columns(request.map, columns);
        let bytes = (rows.end - rows.start) * group_columns.len() as u64 * POSITION_BYTES;
        // Reads most of the group, or more than fits: nothing is gained.
        if columns.is_empty() || 2 * columns.len() > group_columns.len() || bytes > BYTES_MAX {
            return read(request, rows, out);
        }
        // Another thread reads: neither waits for the other.
        let Ok(mut kept) = self.0.try_lock() else { return read(request, rows, out) };
        if let Some(cached) = kept.as_ref().filter(|cached| cached.contains(rows, columns)) {
            cached.copy(rows, columns, out);
            return Ok(Vec::new());
        }
        // Reuses the memory of the old rows.
        let mut values = kept.take().map_or_else(Vec::new, |cached| cached.values);
        values.clear();
        values.resize((bytes / 4) as usize, f32::NAN);
        let request = DecodeRequest { columns: &group_columns, ..request };
        let problems = read(request, rows, &mut values)?;
        let cached = CachedRows { rows: rows.clone(), columns: group_columns, values };
        cached.copy(rows, columns, out);
        // Damaged rows are not cached, so that the next read reports its problems again.
        if problems.is_empty() {
            *kept = Some(cached);
        }
        Ok(problems)
    }
}

/// All columns of the groups of `columns`, in ascending order.
fn group_columns(map: &TakeMap, columns: &[usize]) -> Vec<usize> {
    let all = map.channels.len();
    let group = |group: usize| group * GROUP_CHANNELS..((group + 1) * GROUP_CHANNELS).min(all);
    groups(columns).into_iter().flat_map(group).collect()
}

impl CachedRows {
    /// Whether the cache has all of these rows and columns.
    fn contains(&self, rows: &Range<u64>, columns: &[usize]) -> bool {
        self.rows.start <= rows.start
            && rows.end <= self.rows.end
            && columns.iter().all(|column| self.columns.binary_search(column).is_ok())
    }

    /// Copies rows and columns, which the cache must contain, to `out`.
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
