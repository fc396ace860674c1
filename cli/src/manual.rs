//! Shell completions and manual pages, generated from the definition of a command line.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Command;
use clap_complete::Shell;
use clap_mangen::Man;

/// The arguments of the command that prints a completion script.
#[derive(Debug, clap::Args)]
pub struct CompletionsArgs {
    /// The shell to complete for
    shell: Shell,
}

/// The arguments of the command that prints a manual page, or writes all of them.
#[derive(Debug, clap::Args)]
pub struct ManArgs {
    /// The command whose page to print; subcommands as further words [default: the program itself]
    #[arg(value_name = "COMMAND")]
    command: Vec<String>,
    /// Write the pages of all commands into this folder instead, which must exist; replaces existing pages
    #[arg(long, value_name = "DIR", conflicts_with = "command")]
    out: Option<PathBuf>,
}

/// A command that the program does not have: a usage error.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{program}' has no command '{name}': it has {known}")]
pub struct UnknownCommand {
    program: String,
    name: String,
    known: String,
}

/// The completion script of a program.
#[must_use]
pub fn completions(args: &CompletionsArgs, mut program: Command) -> String {
    let name = program.get_name().to_owned();
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut program, name, &mut text);
    String::from_utf8_lossy(&text).into_owned()
}

/// Returns the page to print; with `--out`, writes all pages instead and returns an empty text.
///
/// # Errors
/// [`UnknownCommand`]; why the pages cannot be written.
pub fn pages(args: &ManArgs, program: Command) -> anyhow::Result<String> {
    match &args.out {
        Some(folder) => write_pages(program, folder).map(|()| String::new()),
        None => page(program, &args.command),
    }
}

fn write_pages(program: Command, folder: &Path) -> anyhow::Result<()> {
    let writing = || format!("cannot write manual pages to {}", folder.display());
    clap_mangen::generate_to(program, folder).with_context(writing)
}

/// The page of the command that `names` lead to, in the format of `man`.
fn page(program: Command, names: &[String]) -> anyhow::Result<String> {
    let mut command = program.disable_help_subcommand(true);
    // The name of a page contains the names of the commands above it, which are set when the program is built.
    command.build();
    for name in names {
        let found = visible(&command).find(|sub| sub.get_name() == name).cloned();
        command = found.ok_or_else(|| unknown(&command, name))?;
    }
    let mut text = Vec::new();
    Man::new(command).render(&mut text)?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}

fn visible(command: &Command) -> impl Iterator<Item = &Command> {
    command.get_subcommands().filter(|sub| !sub.is_hide_set())
}

fn unknown(command: &Command, name: &str) -> UnknownCommand {
    let known: Vec<_> = visible(command).map(Command::get_name).collect();
    UnknownCommand {
        program: command.get_bin_name().unwrap_or(command.get_name()).to_owned(),
        name: name.to_owned(),
        known: if known.is_empty() { "none".to_owned() } else { known.join(", ") },
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use clap::{Arg, ArgAction};

    use super::*;

    fn program() -> Command {
        let option = Arg::new("at").long("at").action(ArgAction::Set).help("When it happens");
        let pose = Command::new("pose").about("Plot stick figures").arg(option);
        let hidden = Command::new("device").hide(true);
        let plot = Command::new("plot").about("Plot takes").subcommands([pose, hidden]);
        Command::new("rig").version("1.2.3").about("Does things").subcommand(plot)
    }

    fn printed(names: &[&str]) -> anyhow::Result<String> {
        let command = names.iter().map(|&name| name.to_owned()).collect();
        pages(&ManArgs { command, out: None }, program())
    }

    #[test]
    fn a_page_has_the_name_and_the_options_of_its_command() {
        let text = printed(&[]).unwrap();
        assert!(text.contains(".TH rig 1") && text.contains("Does things"), "{text}");
        let text = printed(&["plot", "pose"]).unwrap().replace('\\', "");
        assert!(text.contains(".TH rig-plot-pose 1") && text.contains("--at"), "{text}");
    }

    #[test]
    fn an_unknown_command_is_refused_with_those_there_are() {
        for (names, expected) in [
            (&["frob"][..], "'rig' has no command 'frob': it has plot"),
            (&["plot", "device"], "'rig plot' has no command 'device': it has pose"),
            (&["plot", "pose", "x"], "'rig plot pose' has no command 'x': it has none"),
        ] {
            let error = printed(names).unwrap_err();
            assert!(error.is::<UnknownCommand>());
            assert_eq!(error.to_string(), expected);
        }
    }

    #[test]
    fn all_pages_are_written_and_they_are_those_that_are_printed() {
        let folder = tempfile::tempdir().unwrap();
        let args = ManArgs { command: Vec::new(), out: Some(folder.path().to_owned()) };
        assert_eq!(pages(&args, program()).unwrap(), "");
        for (file, names) in
            [("rig.1", &[][..]), ("rig-plot.1", &["plot"]), ("rig-plot-pose.1", &["plot", "pose"])]
        {
            let written = fs::read_to_string(folder.path().join(file)).unwrap();
            assert_eq!(written, printed(names).unwrap(), "{file}");
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
        let nowhere = ManArgs { command: Vec::new(), out: Some(folder.path().join("none")) };
        let error = format!("{:#}", pages(&nowhere, program()).unwrap_err());
        assert!(error.contains("cannot write manual pages to"), "{error}");
    }

    #[test]
    fn shells_complete_commands_and_options() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let text = completions(&CompletionsArgs { shell }, program());
            for word in ["rig", "plot", "pose"] {
                assert!(text.contains(word), "{shell}: {word}");
            }
        }
    }
}
