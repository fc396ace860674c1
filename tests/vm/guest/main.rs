//! The scenarios of `tests/vm/run usb`: mocapd, its simulator, and devices that misbehave, on the kernel's own USB stack.
//!
//! Runs as root in the emulated machine of `tests/vm`, whose two controllers are loops of cable: what a program here
//! is as a USB device, another one here is the host of.

#![expect(clippy::print_stdout, reason = "its output is the test's report")]

mod attached;
mod ledger;
mod odd;
mod recorder;
mod scenarios;
mod simulator;
mod table;

use std::process::ExitCode;

use table::Table;

/// What a scenario measured, in words.
type Measured = anyhow::Result<String>;

/// One scenario: it measures, or says what went wrong.
type Scenario = fn() -> Measured;

fn main() -> ExitCode {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    if !std::path::Path::new("/arguments").exists() {
        println!("this runs in the emulated machine: tests/vm/run usb");
        return ExitCode::from(2);
    }
    let mut table = Table::default();
    for (name, scenario) in scenarios::ALL {
        if wanted.is_empty() || wanted.iter().any(|word| name.contains(word.as_str())) {
            table.run(name, *scenario);
        }
    }
    table.print();
    if table.failed() == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
