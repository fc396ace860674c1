//! Decodes the positions of some rows and columns into an array.

use std::{
    io::{Read, Seek},
    ops::Range,
};

use mocapd_take::TakeTraversal;

use crate::{
    decode::{DecodeRequest, PIECES_PER_THREAD},
    errors::Failure,
};

/// Rows of a tile, which is filled column by column and fits into the processor's cache.
const TILE_ROWS: usize = 32;

/// Coordinates of a position.
const AXES: usize = 3;

/// Fills `out`, which has three values for each row and column, with millimetres, NaN for a missing sample. Returns the
/// problems of decoding as text.
pub(crate) fn read(
    request: DecodeRequest<'_>,
    rows: &Range<u64>,
    mut out: &mut [f32],
) -> Result<Vec<String>, Failure> {
    let DecodeRequest { source, map, columns, threads } = request;
    let width = columns.len() * AXES;
    let mut pieces = Vec::new();
    for piece in map.pieces(rows, threads.max(1) * PIECES_PER_THREAD) {
        let values = (piece.end - piece.start) as usize * width;
        let Some((head, rest)) = out.split_at_mut_checked(values) else {
            return Err(Failure::Value("the array is too small for these rows".into()));
        };
        pieces.push((piece, head));
        out = rest;
    }
    if width == 0 {
        return Ok(Vec::new());
    }
    let (_, problems) = request.decode(pieces, |take, (rows, out)| {
        let mut filler = PositionFiller::new(rows.start, columns, out);
        take.read_rows(&rows, |take, held, offset| {
            source.check()?;
            filler.fill(take, held, offset);
            Ok(())
        })?;
        filler.finish();
        Ok(())
    })?;
    Ok(problems)
}

/// Fills an array of some rows and columns, stretch by stretch.
pub(crate) struct PositionFiller<'a> {
    first: u64,
    /// The row after the last one that is filled.
    at: u64,
    columns: &'a [usize],
    out: &'a mut [f32],
}

impl<'a> PositionFiller<'a> {
    /// `out` has three values for each row, from `first` on, and column.
    pub(crate) fn new(first: u64, columns: &'a [usize], out: &'a mut [f32]) -> Self {
        Self { first, at: first, columns, out }
    }

    /// Fills the rows `held` of the last stretch, which begin at row `offset` of it. Rows between stretches are lost.
    pub(crate) fn fill<R: Read + Seek>(
        &mut self,
        take: &TakeTraversal<R>,
        held: Range<u64>,
        offset: usize,
    ) {
        let width = self.columns.len() * AXES;
        let from = (held.start.max(self.at) - self.first) as usize;
        self.out[(self.at - self.first) as usize * width..from * width].fill(f32::NAN);
        let to = (held.end - self.first) as usize;
        fill(take, offset, self.columns, &mut self.out[from * width..to * width]);
        self.at = held.end;
    }

    /// The rows after the last stretch are lost.
    pub(crate) fn finish(self) {
        let width = self.columns.len() * AXES;
        self.out[(self.at - self.first) as usize * width..].fill(f32::NAN);
    }
}

/// Fills `out` with the rows of a stretch from `offset` on.
fn fill<R: Read + Seek>(
    take: &TakeTraversal<R>,
    offset: usize,
    columns: &[usize],
    out: &mut [f32],
) {
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
