//! A dataset of one recording after the Brain Imaging Data Structure, motion
//! (bids-specification.readthedocs.io, "Motion").
//!
//! ```text
//! dataset_description.json  README.md  participants.tsv  participants.json
//! sub-01/motion/sub-01_task-walk_tracksys-optical_motion.tsv    a column a coordinate, no head
//!                                                 _motion.json
//!                                                 _channels.tsv what each column is
//!                                                 _channels.json
//!                                                 _events.tsv   where there are events
//!                                                 _events.json
//! ```

mod json;
mod names;
mod sidecars;

use std::io::{self, Write};

pub use self::names::Names;
use super::text::{column_labels, plain};
use super::{InterchangeError, expect_frames};
use crate::motion::{FrameSource, GAP, MotionInfo, is_gap};

/// Bytes gathered before they are written.
const BUFFER_BYTES: usize = 1 << 16;
/// What stands in a table where nothing does.
const MISSING: &str = "n/a";

/// Where the files of a format that is a folder go.
pub trait Folder {
    /// Begins a file that is not there yet, `/` between the folders on the way to it.
    ///
    /// # Errors
    /// Whatever creating it meets.
    fn file(&mut self, path: &str) -> io::Result<Box<dyn Write + '_>>;
}

/// Writes a whole dataset. Positions are millimetres, a missing sample three times `n/a`; events count from the first
/// frame, in seconds.
///
/// # Errors
/// `Unsupported` for no markers at all; `Io`.
pub fn write(
    frames: &mut dyn FrameSource,
    names: &Names,
    folder: &mut dyn Folder,
) -> Result<(), InterchangeError> {
    let info = frames.info().clone();
    if info.markers.is_empty() {
        return Err(InterchangeError::Unsupported(
            "bids needs a channel at least: the take has no markers".to_owned(),
        ));
    }
    let mut put = |path: &str, text: &str| -> io::Result<()> {
        let mut file = folder.file(path)?;
        file.write_all(text.as_bytes())?;
        file.flush()
    };
    put("dataset_description.json", &sidecars::dataset(names))?;
    put("README.md", &sidecars::readme(names, &info))?;
    put("participants.tsv", &format!("participant_id\nsub-{}\n", names.subject()))?;
    put("participants.json", &sidecars::participants())?;
    put(&names.path("motion.json"), &sidecars::motion(names, &info))?;
    put(&names.path("channels.tsv"), &channels(&info))?;
    put(&names.path("channels.json"), &sidecars::channels(&info))?;
    if !info.events.is_empty() {
        put(&names.path("events.tsv"), &events(&info))?;
        put(&names.path("events.json"), &sidecars::events())?;
    }
    let mut out = folder.file(&names.path("motion.tsv"))?;
    write_motion(frames, &info, &mut *out)
}

/// One line a frame, without a line of names.
fn write_motion(
    frames: &mut dyn FrameSource,
    info: &MotionInfo,
    out: &mut dyn Write,
) -> Result<(), InterchangeError> {
    let mut row = vec![GAP; info.markers.len()];
    let mut buffer = Vec::new();
    let mut n_written = 0u64;
    while frames.next_frame(&mut row)? {
        for (column, &position) in row.iter().enumerate() {
            if column > 0 {
                buffer.push(b'\t');
            }
            if is_gap(position) {
                buffer.extend(b"n/a\tn/a\tn/a");
            } else {
                let [x, y, z] = position;
                write!(buffer, "{x}\t{y}\t{z}")?;
            }
        }
        buffer.push(b'\n');
        if buffer.len() >= BUFFER_BYTES {
            out.write_all(&buffer)?;
            buffer.clear();
        }
        n_written += 1;
    }
    expect_frames(info.n_frames, n_written)?;
    out.write_all(&buffer)?;
    out.flush()?;
    Ok(())
}

/// What each column of the motion is.
fn channels(info: &MotionInfo) -> String {
    let mut table = "name\tcomponent\ttype\ttracked_point\tunits\treference_frame\n".to_owned();
    for label in column_labels(info) {
        let label = cell(&label);
        for axis in ["x", "y", "z"] {
            table.push_str(&format!("{label}_{axis}\t{axis}\tPOS\t{label}\tmm\tglobal\n"));
        }
    }
    table
}

fn events(info: &MotionInfo) -> String {
    let mut table = "onset\tduration\ttrial_type\tkind\n".to_owned();
    for event in &info.events {
        let onset = event.frame as f64 / info.rate_hz;
        let (label, kind) = (cell(event.label()), event.kind.word());
        table.push_str(&format!("{onset}\t0\t{label}\t{kind}\n"));
    }
    table
}

/// A text as a cell of a table: never empty, and without spaces at its ends.
fn cell(text: &str) -> String {
    let text = plain(text);
    let text = text.trim();
    if text.is_empty() { MISSING.to_owned() } else { text.to_owned() }
}
