//! The command line: one file or folder per subcommand, and what several of them share. Data goes to standard output,
//! messages go to standard error.

mod archive;
mod batch;
mod bench;
mod concat;
mod config;
mod ctl;
mod cut;
mod demo;
mod devices;
mod diff;
mod doctor;
mod export;
mod gaps;
mod import;
mod info;
mod ledger;
mod motion_file_reports;
mod motion_files;
mod output;
mod paths;
mod plot;
mod record;
mod recover;
mod remote;
mod repack;
mod run;
mod study;
mod subject;
mod values;
mod verify;
mod view;

use clap::{CommandFactory, Parser, Subcommand};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::files;
use mocapd_cli::{
    manual::{self, CompletionsArgs, ManArgs, UnknownCommand},
    stop,
    usage::{self, ParseError, Parsed},
};

use output::print_exact;

pub(crate) use output::notify;

/// Record optical motion capture: error-bounded takes, and a ledger that accounts for every frame
#[derive(Debug, Parser)]
#[command(
    version,
    propagate_version = true,
    after_help = "Exit codes: 0 done, 1 failed, 2 usage error or invalid value, 3 done but data was lost"
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

// The options of a command are built when it is chosen: those of all commands take 0.3 ms, a ninth of the time of `info`.
#[derive(Debug, Subcommand)]
#[command(defer = true)]
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
    /// Convert a take to the format of another tool: C3D, TRC, CSV, XDF, BIDS, a page that plays it, and more
    Export(export::Args),
    /// Show what is in a take: header, sizes and ledger; samples, gaps, kept samples and error of each marker
    Info(info::Args),
    /// Show the gaps of each marker, or, with -o, write each gap with its cause to a CSV file
    Gaps(gaps::Args),
    /// Check a take: every checksum and block, the ledger, and with --against every sample
    Verify(verify::Args),
    /// Write a new take from what can be read of a truncated or damaged one
    Recover(recover::Args),
    /// Write a part of a take as a new take; samples stay unchanged
    Cut(cut::Args),
    /// Join takes with the same markers one after another; samples stay unchanged
    Concat(concat::Args),
    /// Write takes again in fewer bytes: with the same samples, or, with --tolerance, lossless takes within it
    Repack(repack::Args),
    /// Show how two takes differ: markers, frames, gaps, samples, times, events, ledger, header and settings
    Diff(diff::Args),
    /// Play takes, C3D, TRC, TSV or CSV files in a browser, on this machine
    View(view::Args),
    /// Plot takes as SVG or PNG: a trajectory, poses, file sizes, analog channels, force plates, rigid bodies, marker quality
    #[command(subcommand)]
    Plot(plot::Plot),
    /// Repeat the study of Shi et al. 2012 on your takes: its tables and figures, and file sizes
    Study(study::Args),
    /// Prepare a subject: a skeleton from body scans, a wireframe fitted to a photograph of the face
    #[command(subcommand)]
    Subject(subject::SubjectCommand),
    /// Keep many takes in an archive: import them on a cluster, query the catalogue, verify, repack
    Archive(archive::Args),
    /// Control a running service: status, arm, start, stop, mark, takes, events
    Ctl(ctl::Args),
    /// Check whether this machine can record, and show how to fix what prevents it
    Doctor(doctor::Args),
    /// Check a configuration of the service, or print an example with every key
    #[command(subcommand)]
    Config(config::ConfigCommand),
    /// Benchmark the resamplers and the recording pipeline on this machine
    #[command(subcommand)]
    Bench(bench::Bench),
    /// Print the script that completes commands and options in a shell
    #[command(after_help = COMPLETIONS_EXAMPLES)]
    Completions(CompletionsArgs),
    /// Print the manual page of a command, or write all pages into a folder
    #[command(after_help = MAN_EXAMPLES)]
    Man(ManArgs),
}

impl Command {
    /// Whether Ctrl-C stops the command in order, as for a recording or a service, instead of ending it immediately.
    fn stops_in_order(&self) -> bool {
        matches!(
            self,
            Self::Demo(_)
                | Self::Record(_)
                | Self::Run(_)
                | Self::View(_)
                | Self::Ctl(_)
                | Self::Bench(_)
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
    // `info` writes no file. A thread that waits for Ctrl-C would take 0.2 ms.
    let is_read_only = matches!(cli.command, Command::Info(_));
    if !cli.command.stops_in_order() && !is_read_only {
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
        Command::Repack(args) => repack::run(&args),
        Command::Diff(args) => diff::run(&args),
        Command::View(args) => view::run(&args),
        Command::Plot(plot) => plot::run(&plot),
        Command::Study(args) => study::run(&args),
        Command::Subject(command) => subject::run(&command),
        Command::Archive(args) => archive::run(&args),
        Command::Ctl(args) => ctl::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Config(command) => config::run(&command),
        Command::Bench(bench) => bench::run(&bench),
        Command::Completions(args) => completions(&args),
        Command::Man(args) => pages(&args),
    }
}

const COMPLETIONS_EXAMPLES: &str = "\
Install it, for new shells:
  mocapd completions bash >~/.local/share/bash-completion/completions/mocapd
  mocapd completions fish >~/.config/fish/completions/mocapd.fish
  mocapd completions zsh >DIR/_mocapd     DIR is a folder in $fpath

The Debian package already does this.";

const MAN_EXAMPLES: &str = "\
Examples:
  mocapd man import | man -l -
  mocapd man plot pose | man -l -
  mocapd man --out ~/.local/share/man/man1     then: man mocapd-import

The Debian package installs the pages.";

/// The exit codes of every command.
const EXIT_STATUS: [(u8, &str); 5] = [
    (0, "Done, and nothing was lost."),
    (1, "Failed, with a message; of several files, at least one failed."),
    (2, "Usage error, or an invalid value."),
    (
        3,
        "Done, but data was lost: the input or the result is damaged, incomplete or outside its bound.",
    ),
    (
        130,
        "Ended by Ctrl-C, without an incomplete output. Commands that record end their take in order instead, and exit \
         with its code.",
    ),
];

pub(crate) fn completions(args: &CompletionsArgs) -> anyhow::Result<Outcome> {
    print_exact(&manual::completions(args, Cli::command()))?;
    Ok(Outcome::Done)
}

pub(crate) fn pages(args: &ManArgs) -> anyhow::Result<Outcome> {
    let page = manual::pages(args, Cli::command(), &EXIT_STATUS).map_err(|error| {
        match error.downcast_ref() {
            Some(unknown @ UnknownCommand { .. }) => UsageError(unknown.to_string()).into(),
            None => error,
        }
    })?;
    print_exact(&page)?;
    Ok(Outcome::Done)
}

#[cfg(test)]
mod tests {
    use std::{fs, path::Path};

    use clap::Parser;
    use mocapd_cli::usage::one_line;

    use super::*;

    /// Every visible subcommand under `command`, named as its page is.
    fn page_names(command: &clap::Command, prefix: &str, into: &mut Vec<(String, clap::Command)>) {
        into.push((prefix.to_owned(), command.clone()));
        for sub in command.get_subcommands().filter(|sub| !sub.is_hide_set()) {
            page_names(sub, &format!("{prefix}-{}", sub.get_name()), into);
        }
    }

    fn check(page: &Path, command: &clap::Command) {
        let text = fs::read_to_string(page).unwrap().replace('\\', "");
        assert!(text.contains(".SH NAME"), "{}", page.display());
        for option in command.get_opts().filter(|option| !option.is_hide_set()) {
            let name =
                format!("--{}", option.get_long().unwrap_or_else(|| option.get_id().as_str()));
            assert!(text.contains(&name), "{} does not mention {name}", page.display());
        }
    }

    fn refused(args: &[&str]) -> String {
        let args = ["mocapd"].iter().chain(args);
        one_line(&Cli::try_parse_from(args).unwrap_err())
    }

    #[test]
    fn every_subcommand_has_a_page_with_all_its_options() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        let cli = Cli::try_parse_from(["mocapd", "man", "--out", out]).unwrap();
        run(cli).unwrap();
        let mut expected = Vec::new();
        let mut command = Cli::command().disable_help_subcommand(true);
        command.build();
        page_names(&command, "mocapd", &mut expected);
        assert!(expected.len() > 10, "{expected:?}");
        for (name, command) in &expected {
            check(&folder.path().join(format!("{name}.1")), command);
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), expected.len(), "and no other");
    }

    #[test]
    fn shells_complete_every_subcommand() {
        for shell in ["bash", "zsh", "fish"] {
            let cli = Cli::try_parse_from(["mocapd", "completions", shell]).unwrap();
            let Command::Completions(args) = cli.command else { panic!("{shell}") };
            let text = manual::completions(&args, Cli::command());
            for sub in Cli::command().get_subcommands().filter(|sub| !sub.is_hide_set()) {
                assert!(text.contains(sub.get_name()), "{shell}: {}", sub.get_name());
            }
        }
    }

    #[test]
    fn the_messages_about_arguments_are_one_line() {
        assert_eq!(
            refused(&["info", "a.take", "--jsn"]),
            "unexpected argument '--jsn' found; tip: a similar argument exists: '--json'; try --help"
        );
        assert_eq!(
            refused(&["import", "a.csv", "-o", "a.take", "--tolerance", "0"]),
            "invalid value '0' for '--tolerance <LENGTH>': a tolerance of 0 keeps every bit: use --lossless"
        );
    }
}
