//! The `mocapd` program: parses the command line, runs the command and turns its outcome into an exit code.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    let result = cli::parse().and_then(cli::run);
    if let Err(error) = &result {
        cli::notify(&mocapd_cli::failure_message(error));
    }
    mocapd::outcome::exit_code(&result)
}
