//! A pty as the device's line: a path that any program opens like a serial port.

mod batch;
mod drain;
mod error;
mod line;
mod pace;
mod serve;

#[cfg(test)]
mod tests;

pub use error::PtyError;
pub use line::PtyLine;
pub use serve::{ServeOptions, serve};

use std::path::Path;
use std::sync::atomic::AtomicBool;

use crate::device::{LineDevice, SentLog};

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
    let line = PtyLine::open(link)?;
    on_open(line.path());
    serve(&line, device, options, stop)
}
