//! `subject`: what is made of a subject before a capture.

mod body;
mod face;

use std::path::PathBuf;

use clap::Subcommand;
use mocapd::outcome::{Outcome, UsageError};
use mocapd_service::subject::{NAME_BYTES_MAX, SubjectFiles};
use mocapd_take::record;

#[derive(Debug, Subcommand)]
pub(crate) enum Subject {
    /// Joint centres and limb lengths out of a body scan, or several of one person, in any pose
    Body(body::Args),
    /// A wireframe fitted to each face of a photograph, and where its 53 points are
    Face(face::Args),
}

pub(crate) fn run(subject: &Subject) -> anyhow::Result<Outcome> {
    match subject {
        Subject::Body(args) => body::run(args),
        Subject::Face(args) => face::run(args),
    }
}

/// Whose method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Chosen {
    Default,
    Paper,
}

#[derive(Debug, Clone, clap::Args)]
pub(crate) struct SubjectArgs {
    /// What the subject is called; it stands in the take
    #[arg(long, value_name = "NAME")]
    subject: Option<String>,
    /// The subject's skeleton, which the take carries: a skeleton.json of `mocapd subject body`
    #[arg(long, value_name = "FILE")]
    skeleton: Option<PathBuf>,
    /// The subject's face, which the take carries: a face.json of `mocapd subject face`
    #[arg(long, value_name = "FILE")]
    face: Option<PathBuf>,
    /// Which marker sits where on the face: a mapping of labels to vertices
    #[arg(long, value_name = "FILE", requires = "face")]
    face_markers: Option<PathBuf>,
}

impl SubjectArgs {
    /// Reads and checks them.
    ///
    /// # Errors
    /// Which file is missing, too large, or is not what it should be; a usage error for a name that is too long.
    pub(crate) fn load(&self) -> anyhow::Result<Option<record::Subject>> {
        let Self { subject, skeleton, face, face_markers } = self.clone();
        if subject.as_ref().is_some_and(|name: &String| name.len() > NAME_BYTES_MAX) {
            let message = format!("--subject has more than {NAME_BYTES_MAX} bytes");
            return Err(UsageError(message).into());
        }
        SubjectFiles { name: subject, skeleton, face, face_markers }.load()
    }
}
