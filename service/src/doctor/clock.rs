//! The host's clocks: the one that arrivals are told by, and the one that says what day it is.

use std::{
    fs,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use mocapd_acquire::latency::Latency;

use super::Finding;

const SOURCE: &str = "/sys/devices/system/clocksource/clocksource0/current_clocksource";

/// Sleeps that are timed, and how long each is.
const SLEEPS: usize = 300;
const SLEEP: Duration = Duration::from_millis(1);

/// A reader that is woken later has sixteen frames of 1000 Hz at once: nothing is lost, and latency is.
const LATE_NS_MAX: u64 = 16_000_000;

pub(super) fn examine(tell: &mut dyn FnMut(Finding)) {
    if let Ok(text) = fs::read_to_string(SOURCE) {
        tell(source(text.trim()));
    }
    tell(wakes());
    tell(synchronised(timedatectl().as_deref()));
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
fn wakes() -> Finding {
    let mut late = Latency::default();
    for _ in 0..SLEEPS {
        let before = Instant::now();
        std::thread::sleep(SLEEP);
        late.add(before.elapsed().saturating_sub(SLEEP).as_nanos() as u64);
    }
    late_wakes(&late)
}

fn late_wakes(late: &Latency) -> Finding {
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
        _ => Finding::note(what, "systemd does not tell whether it follows a time server"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Verdict;

    #[test]
    fn what_is_found_of_clocks() {
        assert_eq!(source("tsc").verdict, Verdict::Good);
        assert_eq!(source("hpet").verdict, Verdict::Warning);
        assert_eq!(synchronised(Some("yes")).verdict, Verdict::Good);
        assert!(synchronised(Some("no")).remedy.unwrap().contains("set-ntp"));
        assert_eq!(synchronised(None).verdict, Verdict::Note);
        let mut late = Latency::default();
        (0..100).for_each(|_| late.add(60_000));
        assert_eq!(late_wakes(&late).verdict, Verdict::Good);
        (0..10).for_each(|_| late.add(30_000_000));
        assert_eq!(late_wakes(&late).verdict, Verdict::Warning);
    }
}
