//! Whether this machine can record: each finding says what was looked at, and what to type where something is wrong.

mod devices;
mod disk;
mod service;

use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use mocapd_acquire::latency::Latency;

/// How much a finding matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// As it should be.
    Good,
    /// To be known; nothing is wrong.
    Note,
    /// A recording goes, and may lose more than it should.
    Warning,
    /// A recording cannot go so.
    Failure,
}

/// What was found of one thing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// `disk speed`, `serial:/dev/ttyUSB0`...
    pub what: String,
    /// How it is.
    pub verdict: Verdict,
    /// What was seen, with its figures.
    pub seen: String,
    /// What to type or to do, where something is to be done.
    pub remedy: Option<String>,
}

impl Finding {
    fn good(what: &str, seen: impl Into<String>) -> Self {
        Self { what: what.to_owned(), verdict: Verdict::Good, seen: seen.into(), remedy: None }
    }

    fn note(what: &str, seen: impl Into<String>) -> Self {
        Self { verdict: Verdict::Note, ..Self::good(what, seen) }
    }

    fn warning(what: &str, seen: impl Into<String>, remedy: impl Into<String>) -> Self {
        let remedy = Some(remedy.into());
        Self { verdict: Verdict::Warning, remedy, ..Self::good(what, seen) }
    }

    fn failure(what: &str, seen: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { verdict: Verdict::Failure, ..Self::warning(what, seen, remedy) }
    }
}

/// Looks at everything, telling each finding as it comes; takes some seconds. Takes would go to `folder`, of whose
/// disk so much is to stay free.
pub fn examine(folder: &Path, keep_free_bytes: u64, report: &mut dyn FnMut(Finding)) {
    devices::examine(report);
    disk::examine(folder, keep_free_bytes, report);
    clocks(report);
    processors_and_memory(report);
    service::examine(report);
}

const SOURCE: &str = "/sys/devices/system/clocksource/clocksource0/current_clocksource";

/// Sleeps that are timed, and how long each is.
const SLEEPS: usize = 300;
const SLEEP: Duration = Duration::from_millis(1);

/// A reader that is woken later has sixteen frames of 1000 Hz at once: nothing is lost, and latency is.
const LATE_NS_MAX: u64 = 16_000_000;

fn clocks(report: &mut dyn FnMut(Finding)) {
    if let Ok(text) = fs::read_to_string(SOURCE) {
        report(source(text.trim()));
    }
    report(timer_latency());
    report(synchronised(timedatectl().as_deref()));
}

fn source(name: &str) -> Finding {
    let what = "clock source";
    match name {
        "hpet" | "acpi_pm" | "pit" | "jiffies" | "refined-jiffies" => Finding::warning(
            what,
            format!("{name}: slow to read, and coarse"),
            "`dmesg | grep -i tsc` says why the processor's own clock is not used",
        ),
        _ => Finding::good(what, name),
    }
}

/// How late a thread that sleeps is woken: what a reader would see of it.
fn timer_latency() -> Finding {
    let mut late = Latency::default();
    for _ in 0..SLEEPS {
        let before = Instant::now();
        std::thread::sleep(SLEEP);
        late.add(before.elapsed().saturating_sub(SLEEP).as_nanos() as u64);
    }
    timer_finding(&late)
}

fn timer_finding(late: &Latency) -> Finding {
    let us = |ns: u64| ns / 1000;
    let (p99, max) = (late.quantile_ns(0.99), late.max_ns());
    let seen = format!(
        "sleepers wake {} us late (p99), {} us at most of {}",
        us(p99),
        us(max),
        late.count()
    );
    if p99 > LATE_NS_MAX {
        Finding::warning(
            "wake-ups",
            seen,
            "close what else runs here, or give mocapd a core of its own",
        )
    } else {
        Finding::good("wake-ups", seen)
    }
}

/// What systemd says of the time; `None` where it does not.
fn timedatectl() -> Option<String> {
    let mut command = Command::new("timedatectl");
    command.args(["show", "--property=NTPSynchronized", "--value"]);
    let output = command.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn synchronised(answer: Option<&str>) -> Finding {
    let what = "time of day";
    match answer {
        Some("yes") => Finding::good(what, "follows a time server"),
        Some("no") => Finding::warning(
            what,
            "follows no time server: a take says when it was made by it",
            "`sudo timedatectl set-ntp true`",
        ),
        _ => Finding::note(what, "systemd does not report whether it follows a time server"),
    }
}

/// The rings, coded stretches and a stall of 30 s at 200 markers x 1000 Hz, and as much for everything else.
const MEMORY_MIB_LEAST: u64 = 600;

fn processors_and_memory(report: &mut dyn FnMut(Finding)) {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    report(processors(cores));
    if let Some(finding) = fs::read_to_string("/proc/meminfo").ok().and_then(|text| memory(&text)) {
        report(finding);
    }
}

fn processors(cores: usize) -> Finding {
    let what = "processors";
    match cores {
        1 => Finding::warning(
            what,
            "one: reading, coding and writing share it",
            "record with --resampler fast",
        ),
        n => Finding::good(what, format!("{n}")),
    }
}

fn memory(text: &str) -> Option<Finding> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let mib = line.split_whitespace().next()?.parse::<u64>().ok()? / 1024;
    let seen = format!("{mib} MiB available");
    Some(if mib < MEMORY_MIB_LEAST {
        Finding::warning("memory", seen, "close what else runs here")
    } else {
        Finding::good("memory", seen)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_found_of_clocks() {
        assert_eq!(source("tsc").verdict, Verdict::Good);
        assert_eq!(source("hpet").verdict, Verdict::Warning);
        assert_eq!(synchronised(Some("yes")).verdict, Verdict::Good);
        assert!(synchronised(Some("no")).remedy.unwrap().contains("set-ntp"));
        assert_eq!(synchronised(None).verdict, Verdict::Note);
        let mut late = Latency::default();
        (0..100).for_each(|_| late.add(60_000));
        assert_eq!(timer_finding(&late).verdict, Verdict::Good);
        (0..10).for_each(|_| late.add(30_000_000));
        assert_eq!(timer_finding(&late).verdict, Verdict::Warning);
    }

    #[test]
    fn what_is_found_of_the_machine() {
        assert_eq!(processors(1).verdict, Verdict::Warning);
        assert_eq!(processors(4).verdict, Verdict::Good);
        let text = "MemTotal:  8000000 kB\nMemAvailable:  4000000 kB\n";
        assert!(memory(text).unwrap().seen.contains("3906 MiB"));
        assert_eq!(memory("MemAvailable: 100000 kB\n").unwrap().verdict, Verdict::Warning);
        assert_eq!(memory(""), None);
    }
}
