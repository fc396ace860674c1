//! Comma separated values: what `export` writes, the `time,head_x,head_y,head_z,...` dialect, and Motive's export.

mod dialect;
pub(super) mod long;
mod motive;
pub(super) mod wide;

use super::{InterchangeError, ReadOptions, text};
use crate::motion::Motion;

/// Kind of the lines that are kept, each followed by LF: those that begin with `#`; of Motive's export those above the data.
const HEADER: &str = "csv/header";

/// Reads a whole file of whichever of them.
pub(super) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Motion, InterchangeError> {
    let bytes = &*dialect::with_commas(bytes);
    let mut lines = text::lines(bytes);
    match lines
        .find(|(_, line)| !line.trim_ascii().is_empty() && !line.trim_ascii().starts_with(b"#"))
    {
        Some((number, line)) if long::is_long(line) => long::read(bytes, number, options),
        Some((_, line)) if motive::is_motive(line) => motive::read(bytes, options),
        _ => wide::read(bytes, options),
    }
}

fn malformed(line: usize, message: &str) -> InterchangeError {
    InterchangeError::malformed("csv", format!("line {line}"), message)
}
