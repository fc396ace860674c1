//! `mocapd`: parse, run, turn the outcome into an exit code.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    let result = cli::parse().and_then(cli::run);
    if let Err(error) = &result {
        cli::say(&format!("{error:#}"));
    }
    mocapd::outcome::exit_code(&result)
}
