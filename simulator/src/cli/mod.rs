//! The command line.

mod generate;
mod manual;
mod serve;
mod values;

use clap::{Parser, Subcommand};

/// A simulated motion-capture device: replays recorded or generated motion.
#[derive(Debug, Parser)]
#[command(name = "mocapd-sim", version, propagate_version = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Be the device, until Ctrl-C.
    ///
    /// Prints one line on stdout: the path for a host to open. It sends when the host says Start.
    /// Exit codes: 0 done, 1 failed, 2 a value was refused.
    Serve(Box<serve::ServeArgs>),
    /// Write a data set of generated jumps: a C3D file each, and the phases of all.
    ///
    /// The default is of the size of the one of Shi et al. 2012: 326 standing long jumps by 10 subjects at 60 Hz.
    Generate(generate::GenerateArgs),
    /// Print what a shell needs to complete this command line
    #[command(hide = true)]
    Completions(manual::Completions),
    /// Write the pages of the manual, replacing those that are there
    #[command(hide = true)]
    Man(manual::Pages),
}

/// What ended the program, and the exit code that says so.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) code: u8,
    pub(crate) error: anyhow::Error,
}

impl Failure {
    /// A value that was refused.
    fn usage(error: impl Into<anyhow::Error>) -> Self {
        Self { code: 2, error: error.into() }
    }
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self { code: 1, error: error.into() }
    }
}

pub(crate) fn run(cli: &Cli) -> Result<(), Failure> {
    match &cli.command {
        Command::Serve(args) => serve::run(args),
        Command::Generate(args) => generate::run(args),
        Command::Completions(args) => manual::completions(args),
        Command::Man(args) => manual::pages(args),
    }
}
