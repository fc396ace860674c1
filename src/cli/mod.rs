//! The command line: a file or folder for each subcommand, and what several share. stdout is data, stderr is words.

mod bench;
mod clock;
mod config;
mod ctl;
mod damage;
mod demo;
mod devices;
mod doctor;
mod export;
mod import;
mod info;
mod ledger;
mod limbs;
mod manual;
mod original;
mod output;
mod paths;
mod plot;
mod record;
mod recover;
mod run;
mod stop;
mod study;
mod subject;
mod usage;
mod values;
mod verify;
mod whole;

use clap::{Parser, Subcommand, error::ErrorKind};
use mocapd::outcome::{Outcome, UsageError};

pub(crate) use output::say;

/// Records optical motion capture: error-bounded takes, and a ledger that closes to zero.
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
    /// Record a simulated device and look at the take: no hardware needed
    Demo(demo::Args),
    /// List what is attached, which driver claims it, or why it cannot be opened
    Devices(devices::Args),
    /// Record a device into a take
    Record(record::Args),
    /// Run beside a rig as a service: arm, start, stop and mark over HTTP
    Run(run::Args),
    /// Make a take of a C3D, TRC, QTM TSV or CSV file
    Import(import::Args),
    /// Write a take as other tools read it: C3D, TRC, CSV, XDF, BIDS and more
    Export(export::Args),
    /// Tell what is in a take: header, ledger, and per marker samples, gaps, knots, error, bytes
    Info(info::Args),
    /// Check a take: checksums, every block, the ledger, and every sample against an original
    Verify(verify::Args),
    /// Write a take again of what can be read of one that was cut off or damaged
    Recover(recover::Args),
    /// Draw a take as SVG or PNG: a trajectory, poses, sizes, quality
    #[command(subcommand)]
    Plot(plot::Plot),
    /// Repeat the study of Shi et al. 2012 on takes: its tables, figures, and bytes
    Study(study::Args),
    /// Prepare a subject: a skeleton out of a body scan, a wireframe fitted to a photograph of the face
    #[command(subcommand)]
    Subject(subject::Subject),
    /// Ask a running service: status, arm, start, stop, mark, takes, events
    Ctl(ctl::Args),
    /// Look whether this machine can record, and say what to type where it cannot
    Doctor(doctor::Args),
    /// Check a configuration of the service, or print one with every key
    #[command(subcommand)]
    Config(config::ConfigCommand),
    /// Measure this machine
    #[command(subcommand)]
    Bench(bench::Bench),
    /// Print what a shell needs to complete this command line
    #[command(hide = true)]
    Completions(manual::Completions),
    /// Write the pages of the manual, replacing those that are there
    #[command(hide = true)]
    Man(manual::Pages),
}

/// Reads the arguments. Help and version are printed here.
pub(crate) fn parse() -> anyhow::Result<Cli> {
    Cli::try_parse().map_err(|error| match error.kind() {
        ErrorKind::DisplayHelp
        | ErrorKind::DisplayVersion
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => error.exit(),
        _ => UsageError(usage::one_line(&error)).into(),
    })
}

/// Runs one command.
pub(crate) fn run(cli: Cli) -> anyhow::Result<Outcome> {
    match cli.command {
        Command::Demo(args) => demo::run(&args),
        Command::Devices(args) => devices::run(&args),
        Command::Record(args) => record::run(&args),
        Command::Run(args) => run::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Verify(args) => verify::run(&args),
        Command::Recover(args) => recover::run(&args),
        Command::Plot(plot) => plot::run(&plot),
        Command::Study(args) => study::run(&args),
        Command::Subject(subject) => subject::run(&subject),
        Command::Ctl(args) => ctl::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Config(command) => config::run(&command),
        Command::Bench(bench) => bench::run(&bench),
        Command::Completions(args) => manual::completions(&args),
        Command::Man(args) => manual::pages(&args),
    }
}
