//! Trajectories -> a TRC file as `OpenSim` reads it.

use std::io::Write;

use super::HEADER;
use crate::interchange::text::{self, column_labels, plain};
use crate::interchange::{InterchangeError, expect_frames, origin::beside_origin};
use crate::motion::{FrameSource, GAP, MotionInfo, is_gap};

/// Writes a whole file: millimetres, LF, missing samples as empty cells, as many digits as bring back the f32.
///
/// Lines end in a tab, as `OpenSim` writes them: its reader takes what stands behind the last tab for a cell only when
/// it is not empty, so that a row whose last sample is missing would have a cell too few.
pub(crate) fn write(
    frames: &mut dyn FrameSource,
    out: &mut dyn Write,
) -> Result<(), InterchangeError> {
    let info = frames.info().clone();
    let first_frame = info.source.first_frame.max(1);
    let mut line = Vec::new();
    write_head(&mut line, &info, first_frame)?;
    out.write_all(&line)?;
    let mut row = vec![GAP; info.markers.len()];
    let mut n_written = 0u64;
    while frames.next_frame(&mut row)? {
        line.clear();
        write!(line, "{}\t{}\t", first_frame + n_written, n_written as f64 / info.rate_hz)?;
        for &position in &row {
            if is_gap(position) {
                line.extend(b"\t\t\t");
            } else {
                let [x, y, z] = beside_origin(position);
                write!(line, "{x}\t{y}\t{z}\t")?;
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
    first_frame: u64,
) -> Result<(), InterchangeError> {
    let n_markers = info.markers.len();
    let kept = &text::kept_header(info, HEADER)?[..];
    let name =
        text::lines(kept).map(|(_, line)| line).find(|line| line.starts_with(b"PathFileType"));
    line.extend(name.unwrap_or(b"PathFileType\t4\t(X/Y/Z)\tmocapd.trc"));
    let original = |name: &str| original_value(kept, name);
    let camera_rate = original("CameraRate").unwrap_or_else(|| info.rate_hz.to_string());
    let original_rate = original("OrigDataRate").unwrap_or_else(|| info.rate_hz.to_string());
    let original_first = original("OrigDataStartFrame").unwrap_or_else(|| first_frame.to_string());
    let original_frames = original("OrigNumFrames").unwrap_or_else(|| info.n_frames.to_string());
    write!(
        line,
        "\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n\
         {}\t{camera_rate}\t{}\t{n_markers}\tmm\t{original_rate}\t{original_first}\t{original_frames}\nFrame#\tTime\t",
        info.rate_hz, info.n_frames
    )?;
    // A label is never empty and none comes twice: OpenSim's tables need that.
    for label in column_labels(info) {
        write!(line, "{}\t\t\t", plain(&label))?;
    }
    line.extend(b"\n\t\t");
    for column in 1..=n_markers {
        write!(line, "X{column}\tY{column}\tZ{column}\t")?;
    }
    line.extend(b"\n\n");
    Ok(())
}

/// A value of the file that was read, where its header stands in two lines of names and values.
fn original_value(kept: &[u8], name: &str) -> Option<String> {
    let mut lines = text::lines(kept).map(|(_, line)| line);
    let names = lines.find(|line| line.starts_with(b"DataRate"))?;
    let values = lines.next()?;
    let column =
        names.split(|&b| b == b'\t').position(|cell| cell.trim_ascii() == name.as_bytes())?;
    let value = text::decode(values.split(|&b| b == b'\t').nth(column)?.trim_ascii());
    (!value.is_empty()).then_some(value)
}
