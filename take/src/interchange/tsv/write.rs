//! Trajectories -> a QTM text export.

use std::io::Write;

use super::HEADER;
use crate::interchange::text::{column_labels, kept_header, plain, value_of};
use crate::interchange::{InterchangeError, expect_frames, origin::beside_origin};
use crate::motion::{FrameSource, GAP, MotionInfo, is_gap};

/// Writes a whole file: millimetres, LF, missing samples as zeros, as many digits as bring back the f32. The numbers
/// of the frames and their times stand before the positions when they say more than the line's place.
pub(crate) fn write(
    frames: &mut dyn FrameSource,
    out: &mut dyn Write,
) -> Result<(), InterchangeError> {
    let info = frames.info().clone();
    let first_frame = info.source.first_frame;
    // A line without columns would be empty, and empty lines are no frames.
    let numbered = first_frame != 1 || info.markers.is_empty();
    let mut line = Vec::new();
    write_head(&mut line, &info, numbered)?;
    out.write_all(&line)?;
    let mut row = vec![GAP; info.markers.len()];
    let mut n_written = 0u64;
    while frames.next_frame(&mut row)? {
        line.clear();
        if numbered {
            let number = first_frame.saturating_add(n_written);
            write!(line, "{number}\t{}\t", n_written as f64 / info.rate_hz)?;
        }
        for (column, &position) in row.iter().enumerate() {
            if column > 0 {
                line.push(b'\t');
            }
            match position {
                gap if is_gap(gap) => line.extend(b"0.000\t0.000\t0.000"),
                position => {
                    let [x, y, z] = beside_origin(position);
                    write!(line, "{x}\t{y}\t{z}")?;
                }
            }
        }
        line.push(b'\n');
        out.write_all(&line)?;
        n_written += 1;
    }
    expect_frames(info.n_frames, n_written)?;
    out.flush()?;
    Ok(())
}

fn write_head(
    line: &mut Vec<u8>,
    info: &MotionInfo,
    numbered: bool,
) -> Result<(), InterchangeError> {
    let kept = &kept_header(info, HEADER)?[..];
    let original =
        |name: &str, else_: &str| value_of(kept, name).unwrap_or_else(|| else_.to_owned());
    writeln!(line, "NO_OF_FRAMES\t{}", info.n_frames)?;
    writeln!(line, "NO_OF_CAMERAS\t{}", original("NO_OF_CAMERAS", "0"))?;
    writeln!(line, "NO_OF_MARKERS\t{}", info.markers.len())?;
    writeln!(line, "FREQUENCY\t{}", info.rate_hz)?;
    writeln!(line, "NO_OF_ANALOG\t0\nANALOG_FREQUENCY\t0")?;
    writeln!(line, "DESCRIPTION\t{}", original("DESCRIPTION", "--"))?;
    writeln!(line, "TIME_STAMP\t{}\nDATA_INCLUDED\t3D", original("TIME_STAMP", "--"))?;
    for event in &info.events {
        let number = info.source.first_frame.saturating_add(event.frame);
        let time_s = event.frame as f64 / info.rate_hz;
        writeln!(line, "EVENT\t{}\t{number}\t{time_s}", plain(event.label()))?;
    }
    line.extend(b"MARKER_NAMES");
    let labels = column_labels(info);
    for label in &labels {
        write!(line, "\t{}", plain(label))?;
    }
    line.push(b'\n');
    if numbered {
        line.extend(b"Frame\tTime");
        for label in labels.iter().map(|label| plain(label)) {
            write!(line, "\t{label} X\t{label} Y\t{label} Z")?;
        }
        line.push(b'\n');
    }
    Ok(())
}
