//! A pty as the device's line: a path that any program opens like a serial port.

mod error;
mod line;

#[cfg(test)]
mod tests;

pub use error::PtyError;
pub use line::PtyLine;
pub(crate) use line::{or_nothing, wait_readable};

use std::path::Path;
use std::sync::atomic::AtomicBool;

use crate::device::{LineDevice, SentLog};
pub use crate::line::ServeOptions;

/// Is the device on an open pty; see [`line::serve`](crate::line::serve).
///
/// # Errors
/// When the line or the log fails.
pub fn serve(
    line: &mut PtyLine,
    device: &mut dyn LineDevice,
    options: ServeOptions,
    stop: &AtomicBool,
) -> Result<SentLog, PtyError> {
    Ok(crate::line::serve(line, device, options, stop)?)
}

/// Opens a pty, and is the device on it until `stop`, or until the host has read the end of stream when
/// `options.once` is set. `on_open` gets the path that a host opens.
///
/// It works on the caller's thread.
///
/// # Errors
/// When the pty or its link cannot be made, and when the line or the log fails.
pub fn serve_pty(
    device: &mut dyn LineDevice,
    link: Option<&Path>,
    options: ServeOptions,
    stop: &AtomicBool,
    on_open: impl FnOnce(&Path),
) -> Result<SentLog, PtyError> {
    let mut line = PtyLine::open(link)?;
    on_open(line.path());
    serve(&mut line, device, options, stop)
}
