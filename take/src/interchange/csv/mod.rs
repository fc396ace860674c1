//! CSV: the wide and long layouts that `export` writes, the `time,head_x,head_y,head_z,...` dialect, and Motive's
//! export.

mod dialect;
pub(super) mod long;
mod motive;
mod rectangle;
pub(super) mod wide;

pub use dialect::quote;

use super::{
    InterchangeError, ReadOptions, Result,
    text_file::{Line, TextFile},
    text_frames::TextFrames,
};
use crate::{foreign::content::NewScratch, motion::MotionInfo};

/// Kind of the foreign part with the header lines, each followed by LF: those that begin with `#`, or in Motive's
/// export all lines above the data.
const HEADER: &str = "csv/header";

/// How the frames of a file are read.
#[derive(Debug, Clone, Copy)]
enum CsvLayout {
    Wide,
    /// The line of column names.
    Long(usize),
    Motive,
}

/// Detects the layout of a file, reads everything but the frames, and prepares to deliver those.
pub(super) fn open(
    file: &mut TextFile<'_, '_>,
    options: &ReadOptions,
    new_scratch: NewScratch<'_>,
) -> Result<(MotionInfo, TextFrames)> {
    if let Some(conversion) = dialect::to_commas(file)? {
        file.convert(conversion);
    }
    match layout(file)? {
        CsvLayout::Wide => wide::open(file, options, new_scratch),
        CsvLayout::Long(header_line) => long::open(file, header_line, options, new_scratch),
        CsvLayout::Motive => motive::open(file, options, new_scratch),
    }
}

/// The layout, from the first line with content.
fn layout(file: &mut TextFile<'_, '_>) -> Result<CsvLayout> {
    let mut lines = file.lines();
    while let Some(Line { number, bytes: line, .. }) = lines.next()? {
        let content = line.trim_ascii();
        if !content.is_empty() && !content.starts_with(b"#") {
            return Ok(match line {
                _ if long::is_long(line) => CsvLayout::Long(number),
                _ if motive::is_motive(line) => CsvLayout::Motive,
                _ => CsvLayout::Wide,
            });
        }
    }
    Ok(CsvLayout::Wide)
}

fn malformed(line: usize, message: &str) -> InterchangeError {
    InterchangeError::malformed("csv", &format!("line {line}"), message)
}
