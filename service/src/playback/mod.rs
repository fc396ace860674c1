//! Finished takes for a player: an overview, windows of positions, and where samples are missing.
//!
//! Everything is read through the one reader of takes, from a key stretch on, so that a window in the middle of an hour
//! costs as much as one at its beginning. The amount of work of a call and the size of its result are bounded.

mod gaps;
mod overview;
mod window;

use std::io::{Read, Seek};

use mocapd_take::{TakeError, TakeMap, TakeTail};

pub use self::{
    gaps::{BINS, GapBins, lost_runs, read_gaps},
    overview::{PlaybackEvent, TakeOverview},
    window::{
        EVERY_MAX, FrameWindow, HEADER_BYTES, SECONDS_MAX, WINDOW_BYTES_MAX, WindowError,
        WindowRequest,
    },
};

/// Maximum number of samples that a call decodes, besides those between its first row and the key stretch before it:
/// about a second of work.
const SAMPLES_MAX: u64 = 1 << 22;

/// The key stretches, the channel table and the number of rows of a take. For a closed take its end is enough; any other
/// is read chunk by chunk, without decoding it.
fn open(input: &mut (impl Read + Seek)) -> Result<TakeMap, TakeError> {
    match TakeTail::read(input)? {
        Some(tail) => Ok(tail.map),
        None => TakeMap::open(input),
    }
}
