//! The key times K of `sync`, which all channels of a stretch share.

use std::ops::Range;

use super::{
    greedy::{SplineVariant, resample_run},
    natural::RunFit,
};
use crate::{
    CodecError, Result, Rows, Tolerance,
    coding::bytes::{Bytes, write_varint},
    frame,
};

/// Computes and encodes K: the union of all channels' knots (Shi et al. 2012, section 2.1), extended until every
/// channel's spline through K keeps the tolerance.
///
/// Channels keep the ends of their runs anyway; these are in K only where another channel needs them.
pub(crate) fn plan(
    channels: &[Rows<'_>],
    tolerance: Tolerance,
    variant: SplineVariant,
) -> Result<Vec<u8>> {
    let n_rows = channels.first().map_or(0, Rows::len);
    let mut keys = vec![false; n_rows];
    let mut fit = RunFit::default();
    for rows in channels {
        if rows.len() != n_rows {
            return Err(CodecError::InvalidArgument(format!(
                "channels of {} and of {n_rows} rows: pass the same stretch of each",
                rows.len()
            )));
        }
        frame::count_finite(*rows)?;
        for run in rows.runs() {
            let samples = &rows.positions()[run.clone()];
            resample_run(samples, tolerance, variant, &mut fit)?;
            let last = samples.len() - 1;
            fit.rows().filter(|&row| row != 0 && row != last).for_each(|row| {
                keys[run.start + row] = true;
            });
        }
    }
    // A key time of one channel moves the splines of all others, so repeat until a pass adds none.
    let mut added = true;
    while std::mem::take(&mut added) {
        for rows in channels {
            for run in rows.runs() {
                added |= add_missing(*rows, run, tolerance, &mut keys, &mut fit);
            }
        }
    }
    Ok(write(&keys))
}

/// Adds rows of worst samples until the run's spline through K keeps the tolerance; returns whether any was added.
fn add_missing(
    rows: Rows<'_>,
    run: Range<usize>,
    tolerance: Tolerance,
    keys: &mut [bool],
    fit: &mut RunFit,
) -> bool {
    let keys = &mut keys[run.clone()];
    fit.start(kept_rows(keys));
    fit.prove(&rows.positions()[run], tolerance.mm());
    let last = keys.len() - 1;
    let mut added = false;
    for row in fit.rows().filter(|&row| row != 0 && row != last) {
        added |= !std::mem::replace(&mut keys[row], true);
    }
    added
}

/// The kept rows of a run: its key times and both ends.
pub(super) fn kept_rows(run_keys: &[bool]) -> impl Iterator<Item = usize> {
    let last = run_keys.len().wrapping_sub(1);
    run_keys
        .iter()
        .enumerate()
        .filter(move |&(row, &key)| key || row == 0 || row == last)
        .map(|(row, _)| row)
}

fn write(keys: &[bool]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut next = 0;
    for (row, _) in keys.iter().enumerate().filter(|(_, key)| **key) {
        write_varint((row - next) as u64, &mut out);
        next = row + 1;
    }
    out
}

/// Reads the next row of `rows`, coded as the number of rows before it; `None` where it lies beyond `rows`.
pub(super) fn read_row(
    input: &mut Bytes<'_>,
    what: &'static str,
    rows: Range<usize>,
) -> Result<Option<usize>> {
    let skipped = usize::try_from(input.varint(what)?).unwrap_or(usize::MAX);
    Ok(skipped.checked_add(rows.start).filter(|row| rows.contains(row)))
}

/// Decodes K into `keys`, one flag per row.
pub(super) fn read(shared: &[u8], n_rows: usize, keys: &mut Vec<bool>) -> Result<()> {
    keys.clear();
    keys.resize(n_rows, false);
    let mut input = Bytes::new(shared);
    let mut next = 0;
    while !input.is_empty() {
        let row = read_row(&mut input, "a key time", next..n_rows)?
            .ok_or(CodecError::Corrupt("a key time beyond the block's rows"))?;
        keys[row] = true;
        next = row + 1;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_times_round_trip() {
        for pattern in 0..1 << 9_u32 {
            let keys: Vec<bool> = (0..9).map(|i| pattern >> i & 1 == 1).collect();
            let mut back = Vec::new();
            read(&write(&keys), 9, &mut back).unwrap();
            assert_eq!(back, keys);
        }
        assert!(matches!(read(&[9], 9, &mut Vec::new()), Err(CodecError::Corrupt(_))));
        assert!(matches!(read(&[0x80], 9, &mut Vec::new()), Err(CodecError::Truncated(_))));
    }
}
