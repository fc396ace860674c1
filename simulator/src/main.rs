//! The program `mocapd-sim`: plays a take as a device.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    match cli::parse().and_then(cli::run) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            cli::notify(&mocapd_cli::failure_message(&failure.error));
            ExitCode::from(failure.code)
        }
    }
}
