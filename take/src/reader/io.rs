//! From anything that can be read to events.

use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};

use super::{TakeEvent, TakeReader};
use crate::{TakeError, recovery::MendedStart};

/// How much is read at once.
pub(super) const READ_BYTES: usize = 1 << 16;

/// What a take can be read from, its bytes more than once: a file, or bytes in memory.
pub trait TakeInput {
    /// What reads it.
    type Input: Read + Seek;

    /// From its start.
    fn input(self) -> Self::Input;
}

impl<'a> TakeInput for &'a [u8] {
    type Input = Cursor<&'a [u8]>;

    fn input(self) -> Self::Input {
        Cursor::new(self)
    }
}

impl<'a> TakeInput for &'a Vec<u8> {
    type Input = Cursor<&'a [u8]>;

    fn input(self) -> Self::Input {
        Cursor::new(self)
    }
}

impl<R: Read + Seek> TakeInput for &mut R {
    type Input = Self;

    fn input(self) -> Self {
        self
    }
}

impl<R: Read + Seek> TakeInput for BufReader<R> {
    type Input = Self;

    fn input(self) -> Self {
        self
    }
}

impl<R: Read + Seek> TakeInput for MendedStart<R> {
    type Input = Self;

    fn input(self) -> Self {
        self
    }
}

impl<T: AsRef<[u8]>> TakeInput for Cursor<T> {
    type Input = Self;

    fn input(self) -> Self {
        self
    }
}

/// Pushes the next bytes of `input` into `reader`, from where it wants them, or tells it that there are no more.
///
/// # Errors
/// As [`TakeReader::next_event`], and `Io`.
pub fn pull(input: &mut (impl Read + Seek), reader: &mut TakeReader) -> Result<(), TakeError> {
    if let Some(offset) = reader.goes_back_to() {
        input.seek(SeekFrom::Start(offset))?;
    }
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
    input: impl TakeInput,
    mut on_event: impl FnMut(TakeEvent<'_>) -> Result<(), TakeError>,
) -> Result<(), TakeError> {
    read_events_at(input, |_, event| on_event(event))
}

/// The same, with the file offset at which each event's chunk begins (that of the header at 0).
///
/// # Errors
/// As [`read_events`].
pub fn read_events_at(
    input: impl TakeInput,
    mut on_event: impl FnMut(u64, TakeEvent<'_>) -> Result<(), TakeError>,
) -> Result<(), TakeError> {
    let mut input = input.input();
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
