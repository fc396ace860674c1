//! `subject`: what is made of a subject before a capture.

mod body;
mod face;
mod picture;

use clap::Subcommand;
use mocapd::outcome::Outcome;

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
