//! The command line, its completions and its manual pages.

mod files;
mod generate;
mod output;
mod serve;

use clap::{CommandFactory, Parser, Subcommand};
use mocapd_cli::{
    manual::{self, CompletionsArgs, ManArgs, UnknownCommand},
    usage::{self, ParseError, Parsed},
};

use output::print_exact;

pub(crate) use output::notify;

/// Simulate motion-capture devices that play recorded or generated motion
#[derive(Debug, Parser)]
#[command(
    name = "mocapd-sim",
    version,
    propagate_version = true,
    after_help = "Exit codes: 0 done, 1 failed, 2 usage error or invalid value"
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
    /// Generate a data set of jumps: one C3D file per jump, and phases.csv with the phases of all jumps
    ///
    /// The default has the size of the data set of Shi et al. 2012: 326 standing long jumps by 10 subjects at 60 Hz.
    /// The folder appears when it is complete.
    Generate(generate::GenerateArgs),
    /// Print the script that completes commands and options in a shell
    #[command(after_help = COMPLETIONS_EXAMPLES)]
    Completions(CompletionsArgs),
    /// Print the manual page of a command, or write all pages into a folder
    #[command(after_help = MAN_EXAMPLES)]
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
        Command::Completions(args) => completions(&args),
        Command::Man(args) => pages(&args),
    }
}

const COMPLETIONS_EXAMPLES: &str = "\
Install it, for new shells:
  mocapd-sim completions bash >~/.local/share/bash-completion/completions/mocapd-sim
  mocapd-sim completions fish >~/.config/fish/completions/mocapd-sim.fish
  mocapd-sim completions zsh >DIR/_mocapd-sim     DIR is a folder in $fpath

The Debian package already does this.";

const MAN_EXAMPLES: &str = "\
Examples:
  mocapd-sim man serve | man -l -
  mocapd-sim man --out ~/.local/share/man/man1     then: man mocapd-sim-serve

The Debian package installs the pages.";

/// The exit codes of every command.
const EXIT_STATUS: [(u8, &str); 3] = [
    (0, "Done; for serve also: ended by Ctrl-C."),
    (1, "Failed, with a message."),
    (2, "Usage error, or an invalid value."),
];

fn completions(args: &CompletionsArgs) -> Result<(), Failure> {
    Ok(print_exact(&manual::completions(args, Cli::command()))?)
}

fn pages(args: &ManArgs) -> Result<(), Failure> {
    let page = manual::pages(args, Cli::command(), &EXIT_STATUS).map_err(|error| {
        if error.is::<UnknownCommand>() { Failure::usage(error) } else { error.into() }
    })?;
    Ok(print_exact(&page)?)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn every_subcommand_has_a_page_with_its_options() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        run(Cli::parse_from(["mocapd-sim", "man", "--out", out])).unwrap();
        let command = Cli::command();
        let mut names: Vec<_> = command
            .get_subcommands()
            .map(|sub| format!("mocapd-sim-{}.1", sub.get_name()))
            .collect();
        names.push("mocapd-sim.1".to_owned());
        names.sort();
        let found = fs::read_dir(folder.path()).unwrap();
        let mut found: Vec<_> =
            found.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        found.sort();
        assert_eq!(found, names);
        for sub in command.get_subcommands() {
            let page = folder.path().join(format!("mocapd-sim-{}.1", sub.get_name()));
            let page = fs::read_to_string(page).unwrap().replace('\\', "");
            for option in sub.get_opts().filter(|option| !option.is_hide_set()) {
                let name = format!("--{}", option.get_long().unwrap());
                assert!(page.contains(&name), "the page of {} has no {name}", sub.get_name());
            }
        }
    }

    #[test]
    fn an_unknown_command_is_a_usage_error() {
        let failure = run(Cli::parse_from(["mocapd-sim", "man", "frob"])).unwrap_err();
        assert_eq!(failure.code, 2);
        assert_eq!(
            failure.error.to_string(),
            "'mocapd-sim' has no command 'frob'; its commands: serve, generate, completions, man"
        );
    }
}
