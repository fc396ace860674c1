//! A coded stretch at another place: what was coded before it was known which take it would stand in.

use super::{
    NUMBERS,
    front::{KEY, NUMBER_SHIFT, PLAIN},
};
use crate::{TakeError, varint};

/// Appends `payload`, a stretch as [`FrontWriter`](super::FrontWriter) made it, as the one with this `number` of a
/// take whose row 0 is row `rows_before` of the recording that it was coded in. Nothing of it is decoded: only the
/// number and a key stretch's row stand in it as such.
///
/// # Errors
/// `InvalidArgument` for a payload that is none, or that begins before the take does.
pub fn put_moved(
    payload: &[u8],
    rows_before: u64,
    number: u8,
    out: &mut Vec<u8>,
) -> Result<(), TakeError> {
    let wrong = |what: &str| TakeError::InvalidArgument(format!("a stretch that {what}"));
    let mut cursor = varint::Cursor::new(payload);
    let short = || wrong("has no whole front");
    let head = cursor.byte().ok_or_else(short)?;
    out.push((head & ((1 << NUMBER_SHIFT) - 1)) | ((number % NUMBERS) << NUMBER_SHIFT));
    if head & PLAIN == 0 {
        out.push(cursor.byte().ok_or_else(short)?);
    }
    if head & KEY != 0 {
        let from_row = cursor.varint().ok_or_else(short)?;
        let from_row = from_row.checked_sub(rows_before);
        varint::put(out, from_row.ok_or_else(|| wrong("begins before its take"))?);
    }
    out.extend_from_slice(cursor.rest());
    Ok(())
}
