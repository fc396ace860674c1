//! The long layout: one row a sample that is present, `frame,time_s,label,x_mm,y_mm,z_mm`, as statistics programs
//! like it. Lost frames, and markers that were never seen, have no row.

mod read;
mod write;

pub(in crate::interchange) use read::{is_long, read};
pub(in crate::interchange) use write::write;

/// The names of the columns.
const COLUMNS: [&str; 6] = ["frame", "time_s", "label", "x_mm", "y_mm", "z_mm"];
