//! `mocapd-sim completions` and `mocapd-sim man`: shell completions and manual pages.

use clap::CommandFactory;
use mocapd_cli::manual::{self, CompletionsArgs, ManArgs, UnknownCommand};

use super::{Cli, Failure, output::print_exact};

pub(super) const COMPLETIONS_EXAMPLES: &str = "\
Install it, for new shells:
  mocapd-sim completions bash >~/.local/share/bash-completion/completions/mocapd-sim
  mocapd-sim completions fish >~/.config/fish/completions/mocapd-sim.fish
  mocapd-sim completions zsh >DIR/_mocapd-sim     DIR is a folder in $fpath

The Debian package has done this.";

pub(super) const MAN_EXAMPLES: &str = "\
Examples:
  mocapd-sim man serve | man -l -
  mocapd-sim man --out ~/.local/share/man/man1     then: man mocapd-sim-serve

The Debian package has installed the pages.";

/// The exit codes of every command.
const EXIT_STATUS: [(u8, &str); 3] = [
    (0, "Done; for serve also: ended by Ctrl-C."),
    (1, "Failed, with a message."),
    (2, "Wrong usage, or a value that is refused."),
];

pub(super) fn completions(args: &CompletionsArgs) -> Result<(), Failure> {
    Ok(print_exact(&manual::completions(args, Cli::command()))?)
}

pub(super) fn pages(args: &ManArgs) -> Result<(), Failure> {
    let page = manual::pages(args, Cli::command(), &EXIT_STATUS).map_err(|error| {
        if error.is::<UnknownCommand>() { Failure::usage(error) } else { error.into() }
    })?;
    Ok(print_exact(&page)?)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use clap::Parser;

    use super::*;

    #[test]
    fn every_subcommand_has_a_page_with_its_options() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        crate::cli::run(Cli::parse_from(["mocapd-sim", "man", "--out", out])).unwrap();
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
        let failure = crate::cli::run(Cli::parse_from(["mocapd-sim", "man", "frob"])).unwrap_err();
        assert_eq!(failure.code, 2);
        assert_eq!(
            failure.error.to_string(),
            "'mocapd-sim' has no command 'frob': it has serve, generate, completions, man"
        );
    }
}
