//! CSV: the wide and long layouts that `export` writes, the `time,head_x,head_y,head_z,...` dialect, and Motive's
//! export.

mod dialect;
pub(super) mod long;
mod motive;
pub(super) mod wide;

pub use dialect::quote;

use super::{InterchangeError, ReadOptions, Result, text};
use crate::motion::Motion;

/// Kind of the foreign part with the header lines, each followed by LF: those that begin with `#`, or in Motive's
/// export all lines above the data.
const HEADER: &str = "csv/header";

/// Detects the layout of a file and reads it.
pub(super) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Motion> {
    let bytes = &*dialect::with_commas(bytes);
    let is_content = |line: &[u8]| !line.is_empty() && !line.starts_with(b"#");
    match text::lines(bytes).find(|(_, line)| is_content(line.trim_ascii())) {
        Some((number, line)) if long::is_long(line) => long::read(bytes, number, options),
        Some((_, line)) if motive::is_motive(line) => motive::read(bytes, options),
        _ => wide::read(bytes, options),
    }
}

fn malformed(line: usize, message: &str) -> InterchangeError {
    InterchangeError::malformed("csv", &format!("line {line}"), message)
}
