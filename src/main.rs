//! The `mocapd` program: parses the command line, runs the command and turns its outcome into an exit code.

mod cli;

use std::process::ExitCode;

use mocapd_cli::usage::Parsed;

fn main() -> ExitCode {
    let result = match cli::parse() {
        Ok(Parsed::Arguments(arguments)) => cli::run(arguments),
        Ok(Parsed::Printed(code)) => return ExitCode::from(code),
        Err(error) => Err(error),
    };
    if let Err(error) = &result {
        cli::notify(&mocapd_cli::failure_message(error));
    }
    mocapd::outcome::exit_code(&result)
}
