//! The program `mocapd-sim`: plays a take as a device.

mod cli;

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use mocapd_take::escape::{visible, visible_lines};

/// Exit code of a usage error.
const USAGE: u8 = 2;

fn main() -> ExitCode {
    let cli = match cli::Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => {
            let message = error.render().to_string();
            drop(write!(std::io::stderr(), "{}", visible_lines(&message)));
            return ExitCode::from(USAGE);
        }
        // Help and version go to stdout.
        Err(error) => error.exit(),
    };
    match cli::run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            let error = format!("{:#}", failure.error);
            let outcome = writeln!(std::io::stderr(), "mocapd-sim: {}", visible(error.trim_end()));
            // If stderr is closed, the exit code still reports the failure.
            drop(outcome);
            ExitCode::from(failure.code)
        }
    }
}
