//! The command line.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{CommandFactory, Parser, Subcommand};
use clap_complete::Shell;

mod generate;
mod serve;

/// Simulated motion-capture devices that play recorded or generated motion.
#[derive(Debug, Parser)]
#[command(name = "mocapd-sim", version, propagate_version = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve a simulated device until Ctrl-C.
    ///
    /// Prints one line on stdout: the path for a host to open. The device sends frames once the host sends Start.
    /// Exit codes: 0 done, 1 failed, 2 usage error.
    Serve(Box<serve::ServeArgs>),
    /// Write a data set of generated jumps: one C3D file per jump, and the phases of all.
    ///
    /// The default has the size of the data set of Shi et al. 2012: 326 standing long jumps by 10 subjects at 60 Hz.
    Generate(generate::GenerateArgs),
    /// Print the completion script for a shell
    #[command(hide = true)]
    Completions {
        /// The shell
        shell: Shell,
    },
    /// Write the manual pages, replacing existing ones
    #[command(hide = true)]
    Man {
        /// An existing folder for the pages
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
}

/// The error that ended the program, and its exit code.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) code: u8,
    pub(crate) error: anyhow::Error,
}

impl Failure {
    /// A usage error.
    fn usage(error: impl Into<anyhow::Error>) -> Self {
        Self { code: 2, error: error.into() }
    }
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self { code: 1, error: error.into() }
    }
}

pub(crate) fn run(cli: &Cli) -> Result<(), Failure> {
    match &cli.command {
        Command::Serve(args) => serve::run(args),
        Command::Generate(args) => generate::run(args),
        Command::Completions { shell } => completions(*shell),
        Command::Man { out } => pages(out),
    }
}

fn completions(shell: Shell) -> Result<(), Failure> {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "mocapd-sim", &mut text);
    Ok(std::io::stdout().write_all(&text)?)
}

fn pages(out: &Path) -> Result<(), Failure> {
    let written = clap_mangen::generate_to(Cli::command(), out);
    Ok(written.with_context(|| format!("cannot write manual pages to {}", out.display()))?)
}

/// Parses a length in millimetres: `0.05mm`, `50um`, `1cm`; a bare number is millimetres.
pub(super) fn length_mm(text: &str) -> Result<f64, String> {
    with_unit(text, &[("mm", 1.0), ("um", 1e-3), ("cm", 10.0), ("", 1.0)], "0.05mm")
}

/// Parses a duration in seconds: `10s`, `500ms`, `2min`; a bare number is seconds.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let units = [("min", 60.0), ("ms", 1e-3), ("s", 1.0), ("", 1.0)];
    let value = with_unit(text, &units, "10s")?;
    if value > 0.0 { Ok(value) } else { Err("must be greater than 0".to_owned()) }
}

fn with_unit(text: &str, units: &[(&str, f64)], example: &str) -> Result<f64, String> {
    let invalid = || format!("invalid value '{text}': write it like {example}");
    let (number, factor) = units
        .iter()
        .find_map(|(unit, factor)| text.strip_suffix(unit).map(|number| (number, factor)))
        .ok_or_else(invalid)?;
    let number: f64 = number.trim().parse().map_err(|_| invalid())?;
    if number.is_finite() && number >= 0.0 { Ok(number * factor) } else { Err(invalid()) }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn every_subcommand_has_a_page() {
        let folder = tempfile::tempdir().unwrap();
        assert!(pages(folder.path()).is_ok());
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

    #[test]
    fn units_are_parsed() {
        assert_eq!(length_mm("0.5mm"), Ok(0.5));
        assert_eq!(length_mm("50 um"), Ok(0.05));
        assert_eq!(length_mm("0"), Ok(0.0));
        assert_eq!(seconds("500ms"), Ok(0.5));
        assert_eq!(seconds("2min"), Ok(120.0));
        assert_eq!(seconds("10"), Ok(10.0));
        for bad in ["", "mm", "-1", "NaN", "1e999", "inf s", "5 parsec"] {
            assert!(length_mm(bad).is_err() && seconds(bad).is_err(), "{bad}");
        }
        assert!(seconds("0s").is_err());
    }
}
