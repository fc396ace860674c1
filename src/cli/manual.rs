//! Shell completions and manual pages for packages, generated from the definition of the command line.

use std::path::PathBuf;

use anyhow::Context;
use clap::CommandFactory;
use clap_complete::Shell;
use mocapd::outcome::Outcome;

use super::{Cli, output::print_exact};

#[derive(Debug, clap::Args)]
pub(crate) struct Completions {
    /// The shell to complete for
    shell: Shell,
}

#[derive(Debug, clap::Args)]
pub(crate) struct Pages {
    /// Folder for the pages; it must exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn completions(args: &Completions) -> anyhow::Result<Outcome> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "mocapd", &mut text);
    print_exact(&String::from_utf8_lossy(&text))?;
    Ok(Outcome::Done)
}

pub(crate) fn pages(args: &Pages) -> anyhow::Result<Outcome> {
    clap_mangen::generate_to(Cli::command(), &args.out)
        .with_context(|| format!("cannot write manual pages to {}", args.out.display()))?;
    Ok(Outcome::Done)
}

#[cfg(test)]
mod tests {
    use std::{fs, path::Path};

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

    #[test]
    fn every_subcommand_has_a_page_with_all_its_options() {
        let folder = tempfile::tempdir().unwrap();
        pages(&Pages { out: folder.path().to_owned() }).unwrap();
        let mut expected = Vec::new();
        page_names(&Cli::command(), "mocapd", &mut expected);
        assert!(expected.len() > 10, "{expected:?}");
        for (name, command) in &expected {
            check(&folder.path().join(format!("{name}.1")), command);
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), expected.len(), "and no other");
        let nowhere = Pages { out: folder.path().join("none") };
        let error = format!("{:#}", pages(&nowhere).unwrap_err());
        assert!(error.contains("cannot write manual pages"), "{error}");
    }

    #[test]
    fn shells_complete_every_subcommand() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let mut text = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "mocapd", &mut text);
            let text = String::from_utf8(text).unwrap();
            for sub in Cli::command().get_subcommands().filter(|sub| !sub.is_hide_set()) {
                assert!(text.contains(sub.get_name()), "{shell}: {}", sub.get_name());
            }
        }
    }
}
