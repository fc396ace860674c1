//! Finished takes for a player: an overview, windows of positions, and where samples are missing.
//!
//! Everything is read through the one reader of takes. Frames are decoded from a key stretch on, so that a window in the
//! middle of an hour costs as much as one at its beginning. The number of samples that a call decodes and the size of its
//! result are bounded; a caller keeps the map of a take that was cut off, whose chunks have to be read for it.

mod compare;
mod forces;
mod gaps;
mod overview;
mod poses;
mod window;

use std::io::{Read, Seek};

use mocapd_take::{TakeError, TakeMap, TakeTail};

pub use self::{
    compare::{CompareError, LargestError, TakeDifference, read_difference},
    forces::{ForceWindow, PlateList, PlateOverview, TakeForces},
    gaps::{BINS, GapBins, lost_runs, read_gaps},
    overview::{PlaybackEvent, TakeOverview},
    poses::{BodyList, FaceWindow, PoseWindow, TakeBodies},
    window::{
        EVERY_MAX, FrameWindow, HEADER_BYTES, SECONDS_MAX, WINDOW_BYTES_MAX, WindowError,
        WindowRequest,
    },
};

/// Maximum number of samples that a window is made of, besides those between its first row and the key stretch before it:
/// about a second of work.
const WINDOW_SAMPLES_MAX: u64 = 1 << 22;

/// Samples after which a part of the gaps or of the differences ends: about a tenth of a second of work, since windows wait for it.
const GAPS_SAMPLES_MAX: u64 = 1 << 19;

/// What the end of a closed take states: the key stretches, the channel table and the number of rows. `None` for any other
/// take, which [`TakeMap::open`] reads chunk by chunk.
///
/// # Errors
/// Those of the reader.
pub fn map_of_end(input: &mut (impl Read + Seek)) -> Result<Option<TakeMap>, TakeError> {
    Ok(TakeTail::read(input)?.map(|tail| tail.map))
}

/// The same, and the subject that the beginning of the take states. Reading both ends takes as long for an hour as for a
/// second; the events, and damage between the ends, are known only to [`TakeMap::open`].
///
/// # Errors
/// Those of the reader.
pub fn map_of_ends(input: &mut (impl Read + Seek)) -> Result<Option<TakeMap>, TakeError> {
    let Some(tail) = TakeTail::read(input)? else { return Ok(None) };
    Ok(tail.with_subject(input)?.map(|tail| tail.map))
}
