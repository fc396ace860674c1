//! Counts of each marker over a whole take: samples, gaps, knots, and the largest stated error.

use crate::{
    decode::{DecodeRequest, PIECES_PER_THREAD},
    errors::Failure,
};

/// The counts of one marker.
#[derive(Debug, Clone, Default)]
pub(crate) struct MarkerScan {
    /// Samples present.
    pub(crate) samples: u64,
    /// Runs of rows without a sample, including those at start and end.
    pub(crate) gaps: u64,
    /// Samples kept as knots.
    pub(crate) n_knots: u64,
    /// The largest error stated by a block with samples of this marker.
    pub(crate) max_error_mm: f64,
    /// Rows of the knots, if requested.
    pub(crate) knots: Vec<i64>,
    begins_in_gap: bool,
    in_gap: bool,
}

impl MarkerScan {
    /// Counts absent rows; `at_start`: the first of the piece.
    fn absent(&mut self, at_start: bool) {
        self.gaps += u64::from(at_start || !self.in_gap);
        self.begins_in_gap |= at_start;
        self.in_gap = true;
    }

    /// Appends the counts of the next piece.
    fn append(&mut self, next: Self) {
        self.samples += next.samples;
        self.gaps += next.gaps - u64::from(self.in_gap && next.begins_in_gap);
        self.n_knots += next.n_knots;
        self.max_error_mm = self.max_error_mm.max(next.max_error_mm);
        self.knots.extend_from_slice(&next.knots);
        self.in_gap = next.in_gap;
    }
}

/// Scans the requested columns; collects the rows of their knots if `with_knots`. Returns the counts in order of
/// columns, and the problems of decoding as text.
pub(crate) fn scan(
    request: DecodeRequest<'_>,
    with_knots: bool,
) -> Result<(Vec<MarkerScan>, Vec<String>), Failure> {
    let DecodeRequest { source, map, columns, threads } = request;
    let pieces = map.pieces(&(0..map.n_rows), threads.max(1) * PIECES_PER_THREAD);
    let (pieces, problems) = request.decode(pieces, |take, rows| {
        let mut found = vec![MarkerScan::default(); columns.len()];
        let mut at = rows.start;
        take.read_rows(&rows, |take, part, offset| {
            source.check()?;
            let n = (part.end - part.start) as usize;
            for (column, &place) in found.iter_mut().zip(columns) {
                if part.start > at {
                    column.absent(at == rows.start);
                }
                let first = part.start == rows.start;
                let decoded = take.rows().nth(place).flatten().filter(|rows| rows.has_samples());
                let Some(decoded) = decoded else {
                    column.absent(first);
                    continue;
                };
                column.max_error_mm = column.max_error_mm.max(decoded.max_error_mm);
                for i in 0..n {
                    if !decoded.present[offset + i] {
                        column.absent(first && i == 0);
                        continue;
                    }
                    column.in_gap = false;
                    column.samples += 1;
                    if decoded.kept[offset + i] {
                        column.n_knots += 1;
                        if with_knots {
                            column.knots.push((part.start + i as u64).cast_signed());
                        }
                    }
                }
            }
            at = part.end;
            Ok(())
        })?;
        if rows.end > at {
            found.iter_mut().for_each(|column| column.absent(at == rows.start));
        }
        Ok(found)
    })?;
    let whole = pieces.into_iter().reduce(|mut whole, piece| {
        whole.iter_mut().zip(piece).for_each(|(one, next)| one.append(next));
        whole
    });
    Ok((whole.unwrap_or_else(|| vec![MarkerScan::default(); columns.len()]), problems))
}
