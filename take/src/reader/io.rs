//! From anything that can be read to events.

use std::io::Read;

use super::{TakeEvent, TakeReader};
use crate::TakeError;

/// How much is read at once.
const READ_BYTES: usize = 1 << 16;

/// Pushes the next bytes of `input` into `reader`, or tells it that there are no more.
///
/// # Errors
/// As [`TakeReader::next_event`], and `Io`.
pub fn pull(input: &mut impl Read, reader: &mut TakeReader) -> Result<(), TakeError> {
    let mut buffer = [0; READ_BYTES];
    let n = loop {
        match input.read(&mut buffer) {
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            other => break other?,
        }
    };
    if n == 0 {
        reader.finish();
    } else {
        reader.push(&buffer[..n]);
    }
    Ok(())
}

/// Gives every event of a take to `on_event`, the end included.
///
/// # Errors
/// As [`TakeReader::next_event`], `Io`, and whatever `on_event` returns.
pub fn read_events(
    input: impl Read,
    mut on_event: impl FnMut(TakeEvent<'_>) -> Result<(), TakeError>,
) -> Result<(), TakeError> {
    read_events_at(input, |_, event| on_event(event))
}

/// The same, with the file offset at which each event's chunk begins (that of the header at 0).
///
/// # Errors
/// As [`read_events`].
pub fn read_events_at(
    mut input: impl Read,
    mut on_event: impl FnMut(u64, TakeEvent<'_>) -> Result<(), TakeError>,
) -> Result<(), TakeError> {
    let mut reader = TakeReader::new();
    loop {
        // Events lie behind each other: one begins where the one before ends.
        let offset = reader.offset();
        match reader.next_event()? {
            Some(event) => {
                let end = matches!(event, TakeEvent::End { .. });
                on_event(offset, event)?;
                if end {
                    return Ok(());
                }
            }
            None => pull(&mut input, &mut reader)?,
        }
    }
}
