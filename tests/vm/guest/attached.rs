//! The devices that the host sees, and waiting for them.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    thread::sleep,
    time::{Duration, Instant},
};

use anyhow::{Context, bail, ensure};
use mocapd_drivers::transport::usb;

/// Five times the longest wait on a loaded machine.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(20);

/// Folder of udev rules in this machine.
const RULES: &str = "/etc/udev/rules.d";

pub(crate) fn wait_until<T>(
    what: &str,
    within: Duration,
    mut poll: impl FnMut() -> Option<T>,
) -> anyhow::Result<T> {
    let started = Instant::now();
    loop {
        let polled = Instant::now();
        if let Some(found) = poll() {
            return Ok(found);
        }
        if started.elapsed() > within {
            bail!("{what}: not within {:.1} s", within.as_secs_f64());
        }
        // Many polls start a program: emulated, that takes more of the processor than what they wait for.
        sleep(Duration::from_millis(5).max(4 * polled.elapsed()));
    }
}

/// Waits for the USB device with this serial number, and until udev has processed it.
pub(crate) fn wait_for_usb(serial: &str) -> anyhow::Result<PathBuf> {
    let node = wait_until(&format!("a USB device {serial}"), TIMEOUT, || {
        let all = usb::devices().ok()?;
        let found = all.into_iter().find(|device| device.serial.as_deref() == Some(serial))?;
        found.node.exists().then_some(found.node)
    })?;
    settle()?;
    Ok(node)
}

pub(crate) fn wait_for_absence(serial: &str) -> anyhow::Result<()> {
    wait_until(&format!("{serial} to go"), TIMEOUT, || {
        let all = usb::devices().ok()?;
        (!all.iter().any(|device| device.serial.as_deref() == Some(serial))).then_some(())
    })
}

/// Waits for a port under its stable name by udev.
pub(crate) fn wait_for_port(path: &str) -> anyhow::Result<()> {
    wait_until(path, TIMEOUT, || Path::new(path).exists().then_some(()))?;
    settle()
}

pub(crate) fn settle() -> anyhow::Result<()> {
    run("udevadm", &["settle"])
}

/// Replaces mocapd's udev rules; they apply to devices plugged in from now on.
pub(crate) fn set_rules(rules: Option<&str>) -> anyhow::Result<()> {
    let path = Path::new(RULES).join("60-mocapd.rules");
    match rules {
        Some(rules) => fs::write(&path, rules)?,
        None if path.exists() => fs::remove_file(&path)?,
        None => {}
    }
    run("udevadm", &["control", "--reload"])
}

/// The project's udev rules.
pub(crate) fn our_rules() -> anyhow::Result<String> {
    fs::read_to_string("/rules/60-mocapd.rules").context("the project's rules")
}

pub(crate) fn set_our_rules() -> anyhow::Result<()> {
    set_rules(Some(&our_rules()?))
}

pub(crate) fn run(program: &str, arguments: &[&str]) -> anyhow::Result<()> {
    let status = Command::new(program).args(arguments).status().context(program.to_owned())?;
    ensure!(status.success(), "{program} {arguments:?}: {status}");
    Ok(())
}
