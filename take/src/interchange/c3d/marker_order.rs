//! The order of markers in the foreign parts that have something for each of them: residuals, and coordinates under
//! gaps. It follows the channel table of the take.

use std::io;

use super::{
    columns::{RESIDUALS, SampleHeader},
    gap_coordinates,
};
use crate::{
    ChannelOrder,
    foreign::content::{Content, ContentSlice},
    motion::Foreign,
};

/// Size of a marker's index in a part.
const INDEX_BYTES: u64 = 4;

/// A part with its markers in another order: at each place what is at its column in `order` now. `None` for a part that
/// does not belong to markers, or that is damaged.
///
/// # Errors
/// Those of the scratch file that the part may be in.
pub(crate) fn reordered(part: &Foreign, order: &ChannelOrder) -> io::Result<Option<Foreign>> {
    if order.is_identity() {
        return Ok(None);
    }
    let data = match part.kind.as_str() {
        RESIDUALS => residuals(&part.data, order)?,
        gap_coordinates::KIND => coordinates(&part.data, order)?,
        _ => None,
    };
    let Some(data) = data else { return Ok(None) };
    let mut bounds = part.bounds.clone();
    order.apply(&mut bounds);
    Ok(Some(Foreign { kind: part.kind.clone(), data, bounds }))
}

/// Whether a part has something for each marker.
pub(crate) fn is_by_marker(part: &Foreign) -> bool {
    [RESIDUALS, gap_coordinates::KIND].contains(&part.kind.as_str())
}

/// Columns of the same length.
fn residuals(data: &Content, order: &ChannelOrder) -> io::Result<Option<Content>> {
    let Some((header, columns)) = data.as_slice().split_array()? else { return Ok(None) };
    let Some(parsed) = SampleHeader::parse(&header) else { return Ok(None) };
    if parsed.columns(columns, 1, 0).is_none() || parsed.n_signals == 0 {
        return Ok(None);
    }
    let column_bytes = columns.len() / parsed.n_signals as u64;
    let column = |at: usize| {
        let (_, rest) = columns.split_at(at as u64 * column_bytes)?;
        Some(rest.split_at(column_bytes)?.0)
    };
    let moved: Option<Vec<_>> =
        (0..parsed.n_signals).map(|row| column(order.column_of(row))).collect();
    let Some(moved) = moved else { return Ok(None) };
    let written = data.converted(data.len(), |out| {
        out.write_all(&header)?;
        moved.iter().try_for_each(|column| copy(*column, out))
    })?;
    Ok(Some(written))
}

/// Markers of different lengths, each behind its index.
fn coordinates(data: &Content, order: &ChannelOrder) -> io::Result<Option<Content>> {
    let Some((front, mut markers)) = gap_coordinates::by_marker(data)? else { return Ok(None) };
    markers.iter_mut().for_each(|(index, _)| *index = order.row_of(*index));
    markers.sort_by_key(|(index, _)| *index);
    let written = data.converted(data.len(), |out| {
        copy(front, out)?;
        for &(index, marker) in &markers {
            out.write_all(&(index as u32).to_le_bytes())?;
            let rest = marker.split_at(INDEX_BYTES).ok_or(io::ErrorKind::UnexpectedEof)?.1;
            copy(rest, out)?;
        }
        Ok(())
    })?;
    Ok(Some(written))
}

fn copy(slice: ContentSlice<'_>, out: &mut dyn io::Write) -> io::Result<()> {
    io::copy(&mut slice.reader(), out).map(|_| ())
}
