//! The scenarios of `tests/vm/run usb` (mocapd, its simulator and misbehaving devices on the kernel's own USB stack)
//! and of `tests/vm/run systemd` (the package, and the service under Debian's systemd).
//!
//! Runs as root in the emulated machine of `tests/vm`. Its two USB device controllers loop back: a program in the
//! machine acts as a USB device, and another one is its host.

#![expect(clippy::print_stdout, reason = "its output is the test's report")]

mod attached;
mod ledger;
mod misbehaving;
mod recorder;
mod scenarios;
mod service;
mod simulator;
mod table;

use std::process::ExitCode;

use table::Table;

/// Result of a scenario: a description of what it measured, or what went wrong.
type Measurement = anyhow::Result<String>;

/// A scenario.
type Scenario = fn() -> Measurement;

/// File with parts of scenario names, one per line: only matching scenarios run. If it is empty, all run.
const ARGUMENTS_FILE: &str = "/arguments";

/// A file that exists if the guest has systemd.
const SYSTEMD_MARKER: &str = "/kind";

fn main() -> ExitCode {
    let Ok(wanted) = std::fs::read_to_string(ARGUMENTS_FILE) else {
        println!("this program runs in the emulated machine: use tests/vm/run usb");
        return ExitCode::from(2);
    };
    let wanted: Vec<&str> = wanted.lines().collect();
    let has_systemd = std::path::Path::new(SYSTEMD_MARKER).exists();
    let (all, long, prepare) = match has_systemd {
        true => (service::ALL, &[][..], service::prepare as fn() -> anyhow::Result<()>),
        false => (scenarios::ALL, scenarios::LONG, attached::set_our_rules as _),
    };
    let names = || all.iter().chain(long).map(|(name, _)| *name);
    if let Some(part) = wanted.iter().find(|part| !names().any(|name| name.contains(**part))) {
        println!("no scenario matches '{part}'; the scenarios are:");
        names().for_each(|name| println!("  {name}"));
        println!("0 passed, 1 failed");
        return ExitCode::FAILURE;
    }
    let mut table = Table::default();
    let is_named = |name: &str| wanted.iter().any(|part| name.contains(part));
    let asked_for = all.iter().filter(|(name, _)| wanted.is_empty() || is_named(name));
    for (name, scenario) in asked_for.chain(long.iter().filter(|(name, _)| is_named(name))) {
        table.run(name, prepare, *scenario);
    }
    table.print();
    if table.failed() == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
