//! The command line.

mod files;
mod generate;
mod manual;
mod output;
mod serve;

use clap::{Parser, Subcommand};
use mocapd_cli::{
    manual::{CompletionsArgs, ManArgs},
    usage::{self, ParseError, Parsed},
};

pub(crate) use output::notify;

/// Simulate motion-capture devices that play recorded or generated motion
#[derive(Debug, Parser)]
#[command(
    name = "mocapd-sim",
    version,
    propagate_version = true,
    after_help = "Exit codes: 0 done, 1 failed, 2 usage or refused input value"
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve a motion, or the log of a recording, as a device until Ctrl-C
    ///
    /// Prints one line on stdout: the path or URI for a host to open. The device sends frames once the host sends
    /// Start.
    #[command(after_help = serve::EXAMPLES)]
    Serve(Box<serve::ServeArgs>),
    /// Generate a data set of jumps: one C3D file per jump, and the phases of all
    ///
    /// The default has the size of the data set of Shi et al. 2012: 326 standing long jumps by 10 subjects at 60 Hz.
    /// The folder appears when it is complete.
    Generate(generate::GenerateArgs),
    /// Print the script that completes commands and options in a shell
    #[command(after_help = manual::COMPLETIONS_EXAMPLES)]
    Completions(CompletionsArgs),
    /// Print the manual page of a command, or write all pages into a folder
    #[command(after_help = manual::MAN_EXAMPLES)]
    Man(ManArgs),
}

/// The error that ended the program, and its exit code.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) code: u8,
    pub(crate) error: anyhow::Error,
}

impl Failure {
    /// A usage error, or a value that is refused.
    fn usage(error: impl Into<anyhow::Error>) -> Self {
        Self { code: 2, error: error.into() }
    }

    /// A usage error with this message.
    fn usage_message(message: impl Into<String>) -> Self {
        Self::usage(anyhow::Error::msg(message.into()))
    }
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self { code: 1, error: error.into() }
    }
}

/// Parses the arguments; prints help and version if asked to.
pub(crate) fn parse() -> Result<Parsed<Cli>, Failure> {
    usage::parse().map_err(|error| match error {
        ParseError::Usage(message) => Failure::usage_message(message),
        failed @ ParseError::Output(_) => failed.into(),
    })
}

/// Runs the command that was given.
pub(crate) fn run(cli: Cli) -> Result<(), Failure> {
    match cli.command {
        Command::Serve(args) => serve::run(*args),
        Command::Generate(args) => generate::run(&args),
        Command::Completions(args) => manual::completions(&args),
        Command::Man(args) => manual::pages(&args),
    }
}
