//! Positions of some rows and columns into an array of rows.

use std::ops::Range;

use mocapd_take::TakeTraversal;

use crate::{
    errors::Failure,
    pieces::{PIECES_A_THREAD, Wanted},
    source::Reader,
};

/// Rows that are written column by column before the next ones: what they fill of the array stays in a cache.
const TILE_ROWS: usize = 32;

/// Values of a position.
const AXES: usize = 3;

/// Fills `out`, which has three values a column and row, with millimetres; NaN where there is no sample.
pub(crate) fn read(
    wanted: Wanted<'_>,
    rows: &Range<u64>,
    mut out: &mut [f32],
) -> Result<Vec<String>, Failure> {
    let Wanted { source, map, columns, threads } = wanted;
    let width = columns.len() * AXES;
    let mut pieces = Vec::new();
    for piece in map.pieces(rows, threads.max(1) * PIECES_A_THREAD) {
        let values = (piece.end - piece.start) as usize * width;
        let Some((head, rest)) = out.split_at_mut_checked(values) else {
            return Err(Failure::Value("the array is smaller than what is read into it".into()));
        };
        pieces.push((piece, head));
        out = rest;
    }
    if width == 0 {
        return Ok(Vec::new());
    }
    let (_, problems) = wanted.decode(pieces, |take, (rows, out)| {
        let mut at = rows.start;
        take.read_rows(&rows, |take, held, offset| {
            source.check()?;
            // Between stretches is what was lost.
            let from = (held.start.max(at) - rows.start) as usize;
            out[(at - rows.start) as usize * width..from * width].fill(f32::NAN);
            let to = (held.end - rows.start) as usize;
            fill(take, offset, columns, &mut out[from * width..to * width]);
            at = held.end;
            Ok(())
        })?;
        out[(at - rows.start) as usize * width..].fill(f32::NAN);
        Ok(())
    })?;
    Ok(problems)
}

/// The rows of a stretch from `offset` on, as many as `out` has.
fn fill(take: &TakeTraversal<Reader>, offset: usize, columns: &[usize], out: &mut [f32]) {
    let all: Vec<_> = take.rows().collect();
    let rows: Vec<_> = columns.iter().map(|&column| all.get(column).copied().flatten()).collect();
    let width = columns.len() * AXES;
    for (tile, out) in out.chunks_mut(TILE_ROWS * width).enumerate() {
        let first = offset + tile * TILE_ROWS;
        for (column, rows) in rows.iter().enumerate() {
            let cells = out.chunks_exact_mut(width).map(|row| &mut row[column * AXES..][..AXES]);
            let Some(rows) = rows else {
                cells.for_each(|cell| cell.fill(f32::NAN));
                continue;
            };
            let found = rows.positions[first..].iter().zip(&rows.present[first..]);
            for (cell, (position, present)) in cells.zip(found) {
                cell.copy_from_slice(if *present { position } else { &[f32::NAN; AXES] });
            }
        }
    }
}
