//! `mocapd-sim`: a take in, a device out.

mod cli;

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    let cli = cli::Cli::parse();
    match cli::run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            let said = writeln!(std::io::stderr(), "mocapd-sim: {:#}", failure.error);
            // Nobody reads stderr: the exit code still says it.
            drop(said);
            ExitCode::from(failure.code)
        }
    }
}
