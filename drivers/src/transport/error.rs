//! What can go wrong on a transport, by what helps.

use std::io;

/// Why a device cannot be opened, read or written. The message is one line that says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TransportError {
    /// Nothing is there.
    #[error(
        "{device} does not exist: plug the device in, or list what is attached with `mocapd devices`"
    )]
    NotFound {
        /// A path, or a USB identity.
        device: String,
    },
    /// Somebody else has it open.
    #[error("{device} is in use{}: close the other program", holder.as_ref().map_or_else(String::new, |holder| format!(" by {holder}")))]
    Busy {
        /// A path, or a USB identity.
        device: String,
        /// Who, as `name (process 1234)`, when that could be found out.
        holder: Option<String>,
    },
    /// The user may not open it.
    #[error("no permission for {device}: {remedy}")]
    PermissionDenied {
        /// A path, or a USB identity.
        device: String,
        /// What to type.
        remedy: String,
    },
    /// It was there, and is gone.
    #[error("{device} is gone: plug it in again")]
    Disconnected {
        /// A path, or a USB identity.
        device: String,
    },
    /// The device answers, and says that it cannot do what it was asked.
    #[error("{0}")]
    Refused(String),
    /// It is there, and takes no bytes.
    #[error(
        "{device} takes no commands: check that it is the right device, and switch it off and on again"
    )]
    Stuck {
        /// A path, or a USB identity.
        device: String,
    },
    /// This build cannot do that.
    #[error("{0}")]
    Unsupported(String),
    /// Anything else the system said.
    #[error("{device}: {action} failed")]
    Io {
        /// A path, or a USB identity.
        device: String,
        /// What was tried.
        action: &'static str,
        /// What the system said.
        source: io::Error,
    },
}
