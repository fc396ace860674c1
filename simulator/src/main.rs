//! The program `mocapd-sim`: plays a take as a device.

mod cli;

use std::process::ExitCode;

use mocapd_cli::usage::Parsed;

fn main() -> ExitCode {
    let result = match cli::parse() {
        Ok(Parsed::Arguments(arguments)) => cli::run(arguments),
        Ok(Parsed::Printed(code)) => return ExitCode::from(code),
        Err(failure) => Err(failure),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            cli::notify(&mocapd_cli::failure_message(&failure.error));
            ExitCode::from(failure.code)
        }
    }
}
