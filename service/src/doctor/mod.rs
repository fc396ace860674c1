//! Checks whether this machine can record. Each finding says what was checked, and what to do if something is wrong.
//!
//! Here are the checks of the machine itself and of its network, for devices on it: buffers for datagrams, interfaces, and
//! firewalls as far as a user can see them.

mod disk;
mod service;

use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use mocapd_acquire::host_clock::LatencyHistogram;
use mocapd_drivers::{
    registry,
    transport::{
        Access,
        network::{self, Interface},
    },
};

/// The severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// As expected.
    Good,
    /// Worth knowing, but nothing is wrong.
    Note,
    /// Recording works, but may lose more than it should.
    Warning,
    /// Recording does not work.
    Failure,
}

/// The result of one check.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What was checked, such as `disk speed` or `serial:/dev/ttyUSB0`.
    pub what: String,
    /// The severity.
    pub verdict: Verdict,
    /// The result, with figures.
    pub seen: String,
    /// What to type or do, if anything.
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

    /// A warning if the value is out of its bounds.
    fn warning_if(is_bad: bool, what: &str, seen: String, remedy: &str) -> Self {
        if is_bad { Self::warning(what, seen, remedy) } else { Self::good(what, seen) }
    }
}

/// Runs all checks and reports each finding as soon as it is known; takes some seconds. `folder` is the one for takes,
/// whose disk must keep `keep_free_bytes` free.
pub fn examine(folder: &Path, keep_free_bytes: u64, report: &mut dyn FnMut(Finding)) {
    examine_devices(report);
    disk::examine(folder, keep_free_bytes, report);
    clocks(report);
    processors_and_memory(report);
    examine_network(report);
    service::examine(report);
}

const SOURCE: &str = "/sys/devices/system/clocksource/clocksource0/current_clocksource";

/// Number and length of the sleeps for measuring the timer latency.
const SLEEPS: usize = 300;
const SLEEP: Duration = Duration::from_millis(1);

/// Latest acceptable wake-up in nanoseconds: the reader then gets 16 frames of 1000 Hz in one read, with more latency
/// but no loss.
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
        "hpet" | "acpi_pm" | "pit" | "jiffies" | "refined-jiffies" => {
            let remedy = "`dmesg | grep -i tsc` shows why the processor's own clock is not used";
            Finding::warning(what, format!("{name}: slow to read, and of low resolution"), remedy)
        }
        _ => Finding::good(what, name),
    }
}

/// Measures how late a sleeping thread is woken, as the reader would be.
fn timer_latency() -> Finding {
    let mut late = LatencyHistogram::default();
    for _ in 0..SLEEPS {
        let before = Instant::now();
        std::thread::sleep(SLEEP);
        late.add(before.elapsed().saturating_sub(SLEEP).as_nanos() as u64);
    }
    timer_finding(&late)
}

fn timer_finding(late: &LatencyHistogram) -> Finding {
    let us = |ns: u64| ns / 1000;
    let (p99, max) = (late.quantile_ns(0.99), late.max_ns());
    let seen = format!(
        "timer latency {} us (p99), {} us (maximum of {} sleeps)",
        us(p99),
        us(max),
        late.count()
    );
    let remedy = "close other programs, or reserve a core for mocapd";
    Finding::warning_if(p99 > LATE_NS_MAX, "wake-ups", seen, remedy)
}

/// Whether systemd reports a synchronised clock; `None` without an answer.
fn timedatectl() -> Option<String> {
    let mut command = Command::new("timedatectl");
    command.args(["show", "--property=NTPSynchronized", "--value"]);
    let output = command.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn synchronised(answer: Option<&str>) -> Finding {
    let what = "time of day";
    match answer {
        Some("yes") => Finding::good(what, "synchronised with a time server"),
        Some("no") => {
            let seen = "not synchronised: the creation time of takes may be wrong";
            Finding::warning(what, seen, "`sudo timedatectl set-ntp true`")
        }
        _ => Finding::note(what, "systemd does not report whether it is synchronised"),
    }
}

/// Memory for the rings, coded stretches and a stall of 30 s at 200 markers x 1000 Hz, and as much again for everything
/// else.
const MEMORY_MIB_MIN: u64 = 600;

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
        1 => {
            let seen = "only one: reading, compressing and writing share it";
            Finding::warning(what, seen, "record with --resampler fast")
        }
        n => Finding::good(what, format!("{n}")),
    }
}

fn memory(text: &str) -> Option<Finding> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let mib = line.split_whitespace().next()?.parse::<u64>().ok()? / 1024;
    let seen = format!("{mib} MiB available");
    Some(Finding::warning_if(mib < MEMORY_MIB_MIN, "memory", seen, "close other programs"))
}

/// USB serial adapters, some of which delay bytes.
const ADAPTERS: &str = "/sys/bus/usb-serial/devices";

/// Limit on the memory of all USB transfers.
const USBFS_MIB: &str = "/sys/module/usbcore/parameters/usbfs_memory_mb";

/// The kernel's default is enough for one rig and little else.
const USBFS_MIB_MIN: u64 = 16;

fn examine_devices(report: &mut dyn FnMut(Finding)) {
    match registry::devices() {
        Err(error) => report(Finding::warning("devices", error.to_string(), "mount /sys and /dev")),
        Ok(devices) if devices.is_empty() => {
            report(Finding::note("devices", "none attached (`mocapd demo` needs none)"));
        }
        Ok(devices) => {
            for device in devices.into_iter().filter(|device| device.family.is_some()) {
                let what = device.candidate.location.to_string();
                report(match device.access {
                    Access::Accessible => Finding::good(&what, "can be opened"),
                    Access::Refused(error) => {
                        let remedy = "follow the instructions in the message";
                        Finding::failure(&what, error.to_string(), remedy)
                    }
                });
            }
        }
    }
    for adapter in adapters(Path::new(ADAPTERS)) {
        report(adapter);
    }
    if let Some(finding) = fs::read_to_string(USBFS_MIB).ok().and_then(|text| usbfs(&text)) {
        report(finding);
    }
    report(rules(&["/etc/udev/rules.d", "/usr/lib/udev/rules.d", "/lib/udev/rules.d"]));
}

/// Checks the latency timers of serial adapters.
fn adapters(folder: &Path) -> Vec<Finding> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let mut found = Vec::new();
    for entry in entries.flatten() {
        let timer = entry.path().join("latency_timer");
        let Ok(text) = fs::read_to_string(&timer) else { continue };
        let Ok(ms) = text.trim().parse::<u32>() else { continue };
        let what = format!("latency timer of {}", entry.file_name().display());
        let seen = format!("holds bytes back for {ms} ms");
        let type_this =
            format!("`echo 1 | sudo tee {}`, or install systemd/60-mocapd.rules", timer.display());
        found.push(Finding::warning_if(ms > 1, &what, seen, &type_this));
    }
    found.sort_by(|a, b| a.what.cmp(&b.what));
    found
}

fn usbfs(text: &str) -> Option<Finding> {
    let what = "USB transfer memory";
    let mib: u64 = text.trim().parse().ok()?;
    let seen = format!("{mib} MiB for all programs");
    Some(match mib {
        0 => Finding::good(what, "no limit"),
        USBFS_MIB_MIN.. => Finding::good(what, seen),
        _ => Finding::warning(what, seen, format!("`echo 64 | sudo tee {USBFS_MIB}`")),
    })
}

fn rules(folders: &[&str]) -> Finding {
    const NAME: &str = "60-mocapd.rules";
    let what = "udev rules";
    match folders.iter().map(|folder| Path::new(folder).join(NAME)).find(|path| path.exists()) {
        Some(path) => Finding::good(what, format!("{} is installed", path.display())),
        None => Finding::warning(
            what,
            format!(
                "{NAME} is not installed: only root may open rigs, and serial adapters hold bytes back for up to 16 ms"
            ),
            format!(
                "`sudo install -m 644 systemd/{NAME} /etc/udev/rules.d/ && sudo udevadm control --reload`"
            ),
        ),
    }
}

/// Largest receive buffer that a program may have, in bytes.
const RECEIVE_BUFFER_MAX: &str = "/proc/sys/net/core/rmem_max";

/// What mocapd asks for: a second of 200 markers at 1000 Hz.
const RECEIVE_BUFFER_BYTES: u64 = 4 << 20;

fn examine_network(report: &mut dyn FnMut(Finding)) {
    let stated = fs::read_to_string(RECEIVE_BUFFER_MAX).ok();
    if let Some(bytes) = stated.and_then(|text| text.trim().parse().ok()) {
        report(receive_buffers(bytes));
    }
    let found = network::interfaces().unwrap_or_default();
    let beyond = found.into_iter().filter(|interface| !interface.address.is_loopback());
    report(interfaces(&beyond.collect::<Vec<_>>()));
    let ufw = fs::read_to_string("/etc/ufw/ufw.conf").unwrap_or_default();
    report(firewall(&ufw, is_active("firewalld")));
}

fn receive_buffers(bytes: u64) -> Finding {
    let what = "datagram buffers";
    let seen = format!("net.core.rmem_max is {} KiB", bytes >> 10);
    if bytes >= RECEIVE_BUFFER_BYTES {
        return Finding::good(what, seen);
    }
    Finding::note(
        what,
        format!(
            "{seen}: with transport=udp a busy machine may lose datagrams; \
             `sudo sysctl net.core.rmem_max={RECEIVE_BUFFER_BYTES}` lets mocapd buffer a second"
        ),
    )
}

fn interfaces(interfaces: &[Interface]) -> Finding {
    let what = "network";
    if interfaces.is_empty() {
        let seen = "no interface is up: a device on the network cannot be reached; connect the cable, `ip address` lists \
                    the interfaces";
        return Finding::note(what, seen);
    }
    let one = |interface: &Interface| {
        let without = if interface.has_multicast { "" } else { ", no multicast" };
        format!("{} {}{without}", interface.name, interface.address)
    };
    Finding::good(what, interfaces.iter().map(one).collect::<Vec<_>>().join("; "))
}

/// Whether a unit is active; `false` without systemd.
fn is_active(unit: &str) -> bool {
    let mut command = Command::new("systemctl");
    command.args(["is-active", "--quiet", unit]);
    let status = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success())
}

/// Only root can list the rules of a firewall.
fn firewall(ufw_conf: &str, has_firewalld: bool) -> Finding {
    let what = "firewall";
    let has_ufw = ufw_conf.lines().any(|line| line.trim().eq_ignore_ascii_case("ENABLED=yes"));
    let (name, command) = match (has_ufw, has_firewalld) {
        (true, _) => ("ufw", "`sudo ufw allow from ADDRESS proto udp to any`"),
        (_, true) => (
            "firewalld",
            "`sudo firewall-cmd --add-rich-rule='rule family=ipv4 source address=ADDRESS accept'`",
        ),
        _ => return Finding::good(what, "neither ufw nor firewalld is on"),
    };
    Finding::note(
        what,
        format!(
            "{name} is on: {command} lets in the datagrams of a QTM at ADDRESS (transport=udp); by TCP nothing is needed"
        ),
    )
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;
    use crate::doctor::Verdict;

    #[test]
    fn findings_about_clocks() {
        assert_eq!(source("tsc").verdict, Verdict::Good);
        assert_eq!(source("hpet").verdict, Verdict::Warning);
        assert_eq!(synchronised(Some("yes")).verdict, Verdict::Good);
        assert!(synchronised(Some("no")).remedy.unwrap().contains("set-ntp"));
        assert_eq!(synchronised(None).verdict, Verdict::Note);
        let mut late = LatencyHistogram::default();
        (0..100).for_each(|_| late.add(60_000));
        assert_eq!(timer_finding(&late).verdict, Verdict::Good);
        (0..10).for_each(|_| late.add(30_000_000));
        assert_eq!(timer_finding(&late).verdict, Verdict::Warning);
    }

    #[test]
    fn findings_about_the_machine() {
        assert_eq!(processors(1).verdict, Verdict::Warning);
        assert_eq!(processors(4).verdict, Verdict::Good);
        let text = "MemTotal:  8000000 kB\nMemAvailable:  4000000 kB\n";
        assert!(memory(text).unwrap().seen.contains("3906 MiB"));
        assert_eq!(memory("MemAvailable: 100000 kB\n").unwrap().verdict, Verdict::Warning);
        assert_eq!(memory(""), None);
    }

    #[test]
    fn an_adapter_that_holds_bytes_back_is_reported_with_the_command() {
        let sysfs = tempfile::tempdir().unwrap();
        for (port, ms) in [("ttyUSB0", "16\n"), ("ttyUSB1", "1\n")] {
            fs::create_dir(sysfs.path().join(port)).unwrap();
            fs::write(sysfs.path().join(port).join("latency_timer"), ms).unwrap();
        }
        fs::create_dir(sysfs.path().join("ttyUSB2")).unwrap();
        let found = adapters(sysfs.path());
        let verdicts: Vec<_> = found.iter().map(|finding| finding.verdict).collect();
        assert_eq!(verdicts, [Verdict::Warning, Verdict::Good]);
        assert!(found[0].seen.contains("16 ms"), "{found:?}");
        let remedy = found[0].remedy.as_deref().unwrap();
        assert!(remedy.contains("`echo 1 | sudo tee ") && remedy.contains("ttyUSB0/latency_timer"));
        assert_eq!(adapters(&sysfs.path().join("no-such-folder")), []);
    }

    #[test]
    fn limits_and_rules() {
        let no_limit = usbfs("0\n").unwrap();
        assert!(no_limit.verdict == Verdict::Good && !no_limit.seen.contains('0'), "{no_limit:?}");
        assert_eq!(usbfs("16\n").unwrap().verdict, Verdict::Good);
        assert_eq!(usbfs("4\n").unwrap().verdict, Verdict::Warning);
        assert_eq!(usbfs("?"), None);
        let folder = tempfile::tempdir().unwrap();
        let folders = [folder.path().to_str().unwrap()];
        assert_eq!(rules(&folders).verdict, Verdict::Warning);
        fs::write(folder.path().join("60-mocapd.rules"), "").unwrap();
        assert_eq!(rules(&folders).verdict, Verdict::Good);
    }

    #[test]
    fn small_buffers_name_the_command() {
        let small = receive_buffers(212_992);
        assert_eq!(small.verdict, Verdict::Note);
        assert!(small.seen.contains("208 KiB") && small.seen.contains("rmem_max=4194304"));
        assert_eq!(receive_buffers(4 << 20).verdict, Verdict::Good);
    }

    #[test]
    fn interfaces_are_listed_with_what_they_lack() {
        let network = |name: &str, has_multicast| Interface {
            name: name.to_owned(),
            address: Ipv4Addr::new(10, 0, 0, 2),
            broadcast: Some(Ipv4Addr::new(10, 0, 0, 255)),
            has_multicast,
        };
        let two = interfaces(&[network("eth0", true), network("tun0", false)]);
        assert_eq!(two.seen, "eth0 10.0.0.2; tun0 10.0.0.2, no multicast");
        assert_eq!(interfaces(&[]).verdict, Verdict::Note);
    }

    #[test]
    fn a_firewall_that_is_on_names_the_command() {
        assert_eq!(firewall("# ENABLED=yes or no\nENABLED=no\n", false).verdict, Verdict::Good);
        assert!(firewall("ENABLED=yes\n", false).seen.contains("sudo ufw allow"));
        assert!(firewall("", true).seen.contains("firewall-cmd"));
    }
}
