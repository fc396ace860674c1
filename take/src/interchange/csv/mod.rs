//! Comma separated values: what `export` writes, and the `time,head_x,head_y,head_z,...` dialect.

mod cells;
pub(super) mod long;
mod read;
mod write;

pub(super) use read::read;
pub(super) use write::write;

/// Kind of the lines above the column names that are kept, each followed by LF.
const HEADER: &str = "csv/header";

/// Bytes gathered before they are written.
const BUFFER_BYTES: usize = 1 << 16;
