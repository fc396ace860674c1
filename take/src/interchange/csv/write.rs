//! Trajectories -> CSV.

use std::io::Write;

use super::{BUFFER_BYTES, cells::quote};
use crate::interchange::InterchangeError;
use crate::interchange::text::column_labels;
use crate::motion::{FrameSource, GAP, is_gap};

/// Writes a line of names, then one line a frame: its number, its time from the first frame in seconds, and three
/// cells a marker in millimetres, empty where the sample is missing. Numbers have the fewest digits that bring
/// back the value, and no exponent.
pub(crate) fn write(
    frames: &mut dyn FrameSource,
    out: &mut dyn Write,
) -> Result<(), InterchangeError> {
    let info = frames.info().clone();
    let mut buffer = b"frame,time_s".to_vec();
    for label in column_labels(&info) {
        let [x, y, z] = ["x", "y", "z"].map(|axis| format!("{label}.{axis}"));
        write!(buffer, ",{},{},{}", quote(&x), quote(&y), quote(&z))?;
    }
    buffer.push(b'\n');
    let mut row = vec![GAP; info.markers.len()];
    let mut index = 0u64;
    while frames.next_frame(&mut row)? {
        write!(
            buffer,
            "{},{}",
            info.source.first_frame.saturating_add(index),
            index as f64 / info.rate_hz
        )?;
        for &position in &row {
            if is_gap(position) {
                buffer.extend(b",,,");
            } else {
                let [x, y, z] = position;
                write!(buffer, ",{x},{y},{z}")?;
            }
        }
        buffer.push(b'\n');
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
