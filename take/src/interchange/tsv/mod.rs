//! Qualisys Track Manager's text export of 3D data.
//!
//! Lines of a name, a tab and a value, the last of them `MARKER_NAMES` (QTM manual, "Motion data (.tsv)",
//! docs.qualisys.com); perhaps a line with trajectory types and a line with column names (`Frame`, `Time`,
//! `Head_FL X` or `Head_FL_X`); then one line a frame, in millimetres.
//! The export has no mark for a missing sample: it writes zeros. Three zeros, empty cells and cells that are no
//! finite numbers are therefore gaps.

mod read;
mod write;

pub(super) use read::read;
pub(super) use write::write;

/// Kind of the header lines that are kept: all lines above the data, each followed by LF.
const HEADER: &str = "tsv/header";
