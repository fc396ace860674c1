//! What packages are made of beside programs: completions of shells, and pages of the manual. Both come out of the
//! command line's own definition.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context;
use clap::CommandFactory;
use clap_complete::Shell;

use super::{Cli, Failure};

#[derive(Debug, clap::Args)]
pub(crate) struct Completions {
    /// The shell
    shell: Shell,
}

#[derive(Debug, clap::Args)]
pub(crate) struct Pages {
    /// Folder for them, which exists
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn completions(args: &Completions) -> Result<(), Failure> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "mocapd-sim", &mut text);
    Ok(std::io::stdout().write_all(&text)?)
}

pub(crate) fn pages(args: &Pages) -> Result<(), Failure> {
    clap_mangen::generate_to(Cli::command(), &args.out)
        .with_context(|| format!("cannot write pages to {}", args.out.display()))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn every_subcommand_has_a_page() {
        let folder = tempfile::tempdir().unwrap();
        assert!(pages(&Pages { out: folder.path().to_owned() }).is_ok());
        let visible = Cli::command();
        let visible = visible.get_subcommands().filter(|sub| !sub.is_hide_set());
        let mut names: Vec<_> =
            visible.map(|sub| format!("mocapd-sim-{}.1", sub.get_name())).collect();
        names.push("mocapd-sim.1".to_owned());
        names.sort();
        let found = fs::read_dir(folder.path()).unwrap();
        let mut found: Vec<_> =
            found.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        found.sort();
        assert_eq!(found, names);
        let serve = fs::read_to_string(folder.path().join("mocapd-sim-serve.1")).unwrap();
        assert!(serve.replace('\\', "").contains("--faults"));
    }
}
