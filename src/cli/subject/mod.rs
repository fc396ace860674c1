//! `subject`: prepares a subject before a capture, and the options that store a subject in a take.

mod body;
mod face;

use std::path::PathBuf;

use clap::Subcommand;
use mocapd::outcome::{Outcome, UsageError};
use mocapd_service::subject::{NAME_BYTES_MAX, SubjectFiles};
use mocapd_take::record;

#[derive(Debug, Subcommand)]
pub(crate) enum SubjectCommand {
    /// Locate joint centres and measure bones in one or several body scans of a person, in any pose
    Body(body::Args),
    /// Fit a wireframe to each face in a photograph, and locate its 53 points
    Face(face::Args),
}

pub(crate) fn run(command: &SubjectCommand) -> anyhow::Result<Outcome> {
    match command {
        SubjectCommand::Body(args) => body::run(args),
        SubjectCommand::Face(args) => face::run(args),
    }
}

/// The method of `subject body` and `subject face`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum MethodArg {
    Default,
    Paper,
}

#[derive(Debug, Clone, clap::Args)]
pub(crate) struct SubjectArgs {
    /// Name of the subject, to store in the take
    #[arg(long, value_name = "NAME")]
    subject: Option<String>,
    /// Skeleton of the subject, to store in the take: a skeleton.json of `mocapd subject body`
    #[arg(long, value_name = "FILE")]
    skeleton: Option<PathBuf>,
    /// Face of the subject, to store in the take: a face.json of `mocapd subject face`
    #[arg(long, value_name = "FILE")]
    face: Option<PathBuf>,
    /// JSON file that maps marker labels to vertices of the wireframe (docs/subject-face-format.md)
    #[arg(long, value_name = "FILE", requires = "face")]
    face_markers: Option<PathBuf>,
}

impl SubjectArgs {
    /// Reads and checks the files; `None` if no option is given.
    ///
    /// # Errors
    /// The first file that is missing, too large or invalid; a usage error for a name that is too long.
    pub(crate) fn load(&self) -> anyhow::Result<Option<record::Subject>> {
        let Self { subject, skeleton, face, face_markers } = self.clone();
        if subject.as_ref().is_some_and(|name: &String| name.len() > NAME_BYTES_MAX) {
            anyhow::bail!(UsageError(format!("--subject is longer than {NAME_BYTES_MAX} bytes")));
        }
        SubjectFiles { name: subject, skeleton, face, face_markers }.load()
    }
}
