//! Trajectories -> CSV in the long layout.

use std::io::Write;

use super::super::{BUFFER_BYTES, cells::quote};
use super::COLUMNS;
use crate::interchange::InterchangeError;
use crate::interchange::text::column_labels;
use crate::motion::{FrameSource, GAP, is_gap};

/// Writes a line of names, then one line a sample that is present: the frame's number, its time from the first frame
/// in seconds, the marker's label (told apart by `#2`, `#3`... where it is not the only one), and the position in
/// millimetres with as many digits as bring back the f32.
pub(in crate::interchange) fn write(
    frames: &mut dyn FrameSource,
    out: &mut dyn Write,
) -> Result<(), InterchangeError> {
    let info = frames.info().clone();
    let labels: Vec<String> =
        column_labels(&info).iter().map(|label| quote(label).into_owned()).collect();
    let mut buffer = COLUMNS.join(",").into_bytes();
    buffer.push(b'\n');
    let mut row = vec![GAP; info.markers.len()];
    let mut index = 0u64;
    while frames.next_frame(&mut row)? {
        let number = info.source.first_frame.saturating_add(index);
        let time_s = index as f64 / info.rate_hz;
        for (label, &position) in labels.iter().zip(&row) {
            if !is_gap(position) {
                let [x, y, z] = position;
                writeln!(buffer, "{number},{time_s},{label},{x},{y},{z}")?;
            }
        }
        if buffer.len() >= BUFFER_BYTES {
            out.write_all(&buffer)?;
            buffer.clear();
        }
        index += 1;
    }
    out.write_all(&buffer)?;
    out.flush()?;
    Ok(())
}
