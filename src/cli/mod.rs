//! The command line: one file or folder per subcommand, and what several of them share. Data goes to standard output,
//! messages go to standard error.

mod batch;
mod bench;
mod clock;
mod concat;
mod config;
mod ctl;
mod cut;
mod damage;
mod demo;
mod devices;
mod diff;
mod doctor;
mod edited;
mod export;
mod gaps;
mod import;
mod info;
mod ledger;
mod manual;
mod motion_file_reports;
mod motion_files;
mod original;
mod output;
mod paths;
mod plot;
mod record;
mod recover;
mod run;
mod study;
mod subject;
mod values;
mod verify;

use clap::{Parser, Subcommand};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::files;
use mocapd_cli::{
    manual::{CompletionsArgs, ManArgs},
    stop,
    usage::{self, ParseError, Parsed},
};

pub(crate) use output::notify;

/// Record optical motion capture: error-bounded takes, and a ledger that accounts for every frame
#[derive(Debug, Parser)]
#[command(
    version,
    propagate_version = true,
    after_help = "Exit codes: 0 done, 1 failed, 2 usage or refused input value, 3 done but data was lost"
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Record a simulated device, verify the take and export it; needs no hardware
    Demo(demo::Args),
    /// List attached devices: the driver of each, or why it cannot be opened
    Devices(devices::Args),
    /// Record a device to a take
    Record(record::Args),
    /// Run as a service that is controlled over HTTP: arm, start, stop, mark
    Run(run::Args),
    /// Convert a C3D, TRC, QTM TSV or CSV file to a take
    Import(import::Args),
    /// Convert a take to a format of other tools: C3D, TRC, CSV, XDF, BIDS and more
    Export(export::Args),
    /// Show what is in a take: header, sizes and ledger; samples, gaps, kept samples and error of each marker
    Info(info::Args),
    /// Show the gaps of each marker, and write each gap with its cause to a CSV file
    Gaps(gaps::Args),
    /// Check a take: every checksum and block, the ledger, and with --against every sample
    Verify(verify::Args),
    /// Write a new take from what can be read of a truncated or damaged one
    Recover(recover::Args),
    /// Write a part of a take as a new take; no sample changes
    Cut(cut::Args),
    /// Join takes with the same markers one after another; no sample changes
    Concat(concat::Args),
    /// Show how two takes differ: markers, frames, gaps, samples, times, events, ledger, header and settings
    Diff(diff::Args),
    /// Plot takes as SVG or PNG: a trajectory, poses, file sizes, marker quality
    #[command(subcommand)]
    Plot(plot::Plot),
    /// Repeat the study of Shi et al. 2012 on your takes: its tables and figures, and file sizes
    Study(study::Args),
    /// Prepare a subject: a skeleton from body scans, a wireframe fitted to a photograph of the face
    #[command(subcommand)]
    Subject(subject::SubjectCommand),
    /// Control a running service: status, arm, start, stop, mark, takes, events
    Ctl(ctl::Args),
    /// Check whether this machine can record, and show how to fix what is in the way
    Doctor(doctor::Args),
    /// Check a configuration of the service, or print an example with every key
    #[command(subcommand)]
    Config(config::ConfigCommand),
    /// Benchmark the resamplers and the recording pipeline on this machine
    #[command(subcommand)]
    Bench(bench::Bench),
    /// Print the script that completes commands and options in a shell
    #[command(after_help = manual::COMPLETIONS_EXAMPLES)]
    Completions(CompletionsArgs),
    /// Print the manual page of a command, or write all pages into a folder
    #[command(after_help = manual::MAN_EXAMPLES)]
    Man(ManArgs),
}

impl Command {
    /// Whether Ctrl-C finishes what the command does, a recording or a service, rather than ends it at once.
    fn stops_in_order(&self) -> bool {
        matches!(
            self,
            Self::Demo(_) | Self::Record(_) | Self::Run(_) | Self::Ctl(_) | Self::Bench(_)
        )
    }
}

/// Parses the arguments; prints help and version if asked to.
pub(crate) fn parse() -> anyhow::Result<Parsed<Cli>> {
    usage::parse().map_err(|error| match error {
        ParseError::Usage(message) => UsageError(message).into(),
        failed @ ParseError::Output(_) => failed.into(),
    })
}

/// Runs the command that was given.
pub(crate) fn run(cli: Cli) -> anyhow::Result<Outcome> {
    if !cli.command.stops_in_order() {
        stop::end_on_signal(files::remove_incomplete_outputs)?;
    }
    match cli.command {
        Command::Demo(args) => demo::run(&args),
        Command::Devices(args) => devices::run(&args),
        Command::Record(args) => record::run(&args),
        Command::Run(args) => run::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Gaps(args) => gaps::run(&args),
        Command::Verify(args) => verify::run(&args),
        Command::Recover(args) => recover::run(&args),
        Command::Cut(args) => cut::run(&args),
        Command::Concat(args) => concat::run(&args),
        Command::Diff(args) => diff::run(&args),
        Command::Plot(plot) => plot::run(&plot),
        Command::Study(args) => study::run(&args),
        Command::Subject(command) => subject::run(&command),
        Command::Ctl(args) => ctl::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Config(command) => config::run(&command),
        Command::Bench(bench) => bench::run(&bench),
        Command::Completions(args) => manual::completions(&args),
        Command::Man(args) => manual::pages(&args),
    }
}
