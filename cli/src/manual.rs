//! Shell completions and manual pages, generated from the definition of a command line.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::Context;
use clap::Command;
use clap_complete::Shell;
use clap_mangen::Man;

#[expect(missing_docs, reason = "clap would show it in place of the command's text")]
#[derive(Debug, clap::Args)]
pub struct CompletionsArgs {
    /// The shell to complete for
    shell: Shell,
}

#[expect(missing_docs, reason = "clap would show it in place of the command's text")]
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
#[error("'{program}' has no command '{name}'; its commands: {known}")]
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

/// The section of manual pages on commands.
const SECTION: &str = "1";

/// Returns the page to print; with `--out`, writes all pages instead and returns an empty text. `exit_status` has the codes
/// that the program exits with, and what each means.
///
/// # Errors
/// [`UnknownCommand`]; why the pages cannot be written.
pub fn pages(
    args: &ManArgs,
    program: Command,
    exit_status: &[(u8, &str)],
) -> anyhow::Result<String> {
    let mut program = program.disable_help_subcommand(true);
    // The name of a page contains the names of the commands above it, which are set when the program is built.
    program.build();
    let manual = Manual { program: program.clone(), exit_status };
    match &args.out {
        Some(folder) => manual.write(&program, folder).map(|()| String::new()),
        None => {
            let mut command = &program;
            for name in &args.command {
                let found = visible(command).find(|sub| sub.get_name() == name);
                command = found.ok_or_else(|| unknown(command, name))?;
            }
            manual.page(command)
        }
    }
}

/// The pages of a program.
struct Manual<'a> {
    program: Command,
    exit_status: &'a [(u8, &'a str)],
}

impl Manual<'_> {
    /// Writes the pages of a command and of those below it.
    fn write(&self, command: &Command, folder: &Path) -> anyhow::Result<()> {
        let name = command.get_display_name().unwrap_or(command.get_name());
        let path = folder.join(format!("{name}.{SECTION}"));
        let writing = || format!("cannot write manual pages to {}", folder.display());
        fs::write(&path, self.page(command)?).with_context(writing)?;
        visible(command).try_for_each(|sub| self.write(sub, folder))
    }

    /// The page of a command, in the format of `man`.
    fn page(&self, command: &Command) -> anyhow::Result<String> {
        let program = self.program.get_name();
        let name = command.get_display_name().unwrap_or(command.get_name());
        let version = self.program.get_version().unwrap_or_default();
        let man = Man::new(command.clone())
            .title(name.to_uppercase())
            .section(SECTION)
            .source(format!("{program} {version}").trim_end())
            .manual(format!("{program} manual"));
        let mut text = Vec::new();
        man.render(&mut text)?;
        let mut text = String::from_utf8_lossy(&text).into_owned();
        // After the options and commands, before the examples, as is customary.
        let place = [".SH EXTRA\n", ".SH VERSION\n", ".SH AUTHORS\n"].map(|next| text.find(next));
        let place = place.into_iter().flatten().min().unwrap_or(text.len());
        text.insert_str(place, &self.exit_status());
        Ok(text)
    }

    fn exit_status(&self) -> String {
        let mut section = ".SH \"EXIT STATUS\"\n".to_owned();
        for (code, meaning) in self.exit_status {
            section.push_str(&format!(".TP\n\\fB{code}\\fR\n{}\n", meaning.replace('-', "\\-")));
        }
        section
    }
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

    const EXIT_STATUS: [(u8, &str); 2] = [(0, "Done."), (130, "Ended by Ctrl-C.")];

    fn program() -> Command {
        let option = Arg::new("at").long("at").action(ArgAction::Set).help("When it happens");
        let pose = Command::new("pose").about("Plot stick figures").arg(option);
        let hidden = Command::new("device").hide(true);
        let plot = Command::new("plot").about("Plot takes").subcommands([pose, hidden]);
        Command::new("rig").version("1.2.3").about("Does things").subcommand(plot)
    }

    fn printed(names: &[&str]) -> anyhow::Result<String> {
        let command = names.iter().map(|&name| name.to_owned()).collect();
        pages(&ManArgs { command, out: None }, program(), &EXIT_STATUS)
    }

    #[test]
    fn a_page_has_the_name_and_the_options_of_its_command() {
        let text = printed(&[]).unwrap();
        assert!(text.contains(".TH RIG 1  \"rig 1.2.3\" \"rig manual\""), "{text}");
        let at =
            |text: &str, part: &str| text.find(part).unwrap_or_else(|| panic!("{part}: {text}"));
        assert!(at(&text, "Does things") < at(&text, ".SH SUBCOMMANDS"));
        let status =
            ".SH \"EXIT STATUS\"\n.TP\n\\fB0\\fR\nDone.\n.TP\n\\fB130\\fR\nEnded by Ctrl\\-C.\n";
        assert!(at(&text, ".SH SUBCOMMANDS") < at(&text, status), "{text}");
        assert!(at(&text, status) < at(&text, ".SH VERSION"), "{text}");
        let text = printed(&["plot", "pose"]).unwrap().replace('\\', "");
        assert!(text.contains(".TH RIG-PLOT-POSE 1") && text.contains("--at"), "{text}");
    }

    #[test]
    fn an_unknown_command_is_refused_with_a_list_of_commands() {
        for (names, expected) in [
            (&["frob"][..], "'rig' has no command 'frob'; its commands: plot"),
            (&["plot", "device"], "'rig plot' has no command 'device'; its commands: pose"),
            (&["plot", "pose", "x"], "'rig plot pose' has no command 'x'; its commands: none"),
        ] {
            let error = printed(names).unwrap_err();
            assert!(error.is::<UnknownCommand>());
            assert_eq!(error.to_string(), expected);
        }
    }

    #[test]
    fn all_pages_are_written_as_they_are_printed() {
        let folder = tempfile::tempdir().unwrap();
        let args = ManArgs { command: Vec::new(), out: Some(folder.path().to_owned()) };
        assert_eq!(pages(&args, program(), &EXIT_STATUS).unwrap(), "");
        for (file, names) in
            [("rig.1", &[][..]), ("rig-plot.1", &["plot"]), ("rig-plot-pose.1", &["plot", "pose"])]
        {
            let written = fs::read_to_string(folder.path().join(file)).unwrap();
            assert_eq!(written, printed(names).unwrap(), "{file}");
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
        let nowhere = ManArgs { command: Vec::new(), out: Some(folder.path().join("none")) };
        let error = format!("{:#}", pages(&nowhere, program(), &EXIT_STATUS).unwrap_err());
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
