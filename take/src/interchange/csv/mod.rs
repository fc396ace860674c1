//! Comma separated values: what `export` writes, the `time,head_x,head_y,head_z,...` dialect, and Motive's export.

mod cells;
mod dialect;
pub(super) mod long;
mod motive;
mod read;
mod write;

pub(super) use read::read;
pub(super) use write::write;

/// Kind of the lines that are kept, each followed by LF: those that begin with `#`; of Motive's export those above the data.
const HEADER: &str = "csv/header";

/// Bytes gathered before they are written.
const BUFFER_BYTES: usize = 1 << 16;
