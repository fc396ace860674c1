//! `completions` and `man`: shell completions and manual pages.

use clap::CommandFactory;
use mocapd::outcome::{Outcome, UsageError};
use mocapd_cli::manual::{self, CompletionsArgs, ManArgs, UnknownCommand};

use super::{Cli, output::print_exact};

pub(super) const COMPLETIONS_EXAMPLES: &str = "\
Install it, for new shells:
  mocapd completions bash >~/.local/share/bash-completion/completions/mocapd
  mocapd completions fish >~/.config/fish/completions/mocapd.fish
  mocapd completions zsh >DIR/_mocapd     DIR is a folder in $fpath

The Debian package has done this.";

pub(super) const MAN_EXAMPLES: &str = "\
Examples:
  mocapd man import | man -l -
  mocapd man plot pose | man -l -
  mocapd man --out ~/.local/share/man/man1     then: man mocapd-import

The Debian package has installed the pages.";

/// The exit codes of every command.
const EXIT_STATUS: [(u8, &str); 5] = [
    (0, "Done, and nothing was lost."),
    (1, "Failed, with a message; of several files, at least one failed."),
    (2, "Wrong usage, or a value that is refused."),
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
        crate::cli::run(cli).unwrap();
        let mut expected = Vec::new();
        page_names(&Cli::command(), "mocapd", &mut expected);
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
            let crate::cli::Command::Completions(args) = cli.command else { panic!("{shell}") };
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
