//! Why there is no pty, or no longer one.

use std::io;
use std::path::PathBuf;

/// What can go wrong with a pty.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PtyError {
    /// The kernel gave none.
    #[error("cannot open a pty ({action}): is /dev/pts mounted?")]
    Open {
        /// What was tried.
        action: &'static str,
        /// What the system said.
        source: io::Error,
    },
    /// Something stands where the link should.
    #[error("{} exists and is no dead link: remove it, or choose another name", path.display())]
    LinkExists {
        /// The link.
        path: PathBuf,
    },
    /// The link could not be made.
    #[error("cannot make the link {}: choose a folder that exists and may be written", path.display())]
    Link {
        /// The link.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// It failed while it was served.
    #[error(transparent)]
    Line(#[from] crate::line::LineError),
}
