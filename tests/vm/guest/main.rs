//! The scenarios of `tests/vm/run usb`: mocapd, its simulator, and devices that misbehave, on the kernel's own USB stack;
//! and those of `tests/vm/run systemd`: the package, and the service under Debian's systemd.
//!
//! Runs as root in the emulated machine of `tests/vm`, whose two controllers are loops of cable: what a program here
//! is as a USB device, another one here is the host of.

#![expect(clippy::print_stdout, reason = "its output is the test's report")]

mod attached;
mod ledger;
mod odd;
mod recorder;
mod scenarios;
mod service;
mod simulator;
mod table;

use std::process::ExitCode;

use table::Table;

/// What a scenario measured, in words.
type Measured = anyhow::Result<String>;

/// One scenario: it measures, or says what went wrong.
type Scenario = fn() -> Measured;

/// A part of a scenario's name a line: only those that have one of them in it. None: all.
const WANTED: &str = "/arguments";

/// Says that the guest has systemd.
const KIND: &str = "/kind";

fn main() -> ExitCode {
    let Ok(wanted) = std::fs::read_to_string(WANTED) else {
        println!("this runs in the emulated machine: tests/vm/run usb");
        return ExitCode::from(2);
    };
    let wanted: Vec<&str> = wanted.lines().collect();
    let has_systemd = std::path::Path::new(KIND).exists();
    let (all, long, prepare) = match has_systemd {
        true => (service::ALL, &[][..], service::prepare as fn() -> anyhow::Result<()>),
        false => (scenarios::ALL, scenarios::LONG, attached::set_our_rules as _),
    };
    let names = || all.iter().chain(long).map(|(name, _)| *name);
    if let Some(part) = wanted.iter().find(|part| !names().any(|name| name.contains(**part))) {
        println!("no scenario has '{part}' in its name; there are:");
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
