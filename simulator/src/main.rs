//! `mocapd-sim`: a take in, a device out.

mod cli;

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use mocapd_take::escape::{visible, visible_lines};

/// The exit code where the command line is refused.
const USAGE: u8 = 2;

fn main() -> ExitCode {
    let cli = match cli::Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => {
            let words = error.render().to_string();
            drop(write!(std::io::stderr(), "{}", visible_lines(&words)));
            return ExitCode::from(USAGE);
        }
        // Help and version, which are on their way to stdout.
        Err(error) => error.exit(),
    };
    match cli::run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            let error = format!("{:#}", failure.error);
            let said = writeln!(std::io::stderr(), "mocapd-sim: {}", visible(error.trim_end()));
            // Nobody reads stderr: the exit code still says it.
            drop(said);
            ExitCode::from(failure.code)
        }
    }
}
