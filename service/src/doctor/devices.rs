//! Devices and serial lines: who may open them, and how soon their bytes arrive.

use std::{fs, path::Path};

use mocapd_drivers::{registry, transport::Access};

use super::Finding;

/// USB serial adapters, some of which hold bytes back.
const ADAPTERS: &str = "/sys/bus/usb-serial/devices";

/// Limit on the memory of all USB transfers.
const USBFS_MIB: &str = "/sys/module/usbcore/parameters/usbfs_memory_mb";

/// The kernel's default is enough for one rig and little else.
const USBFS_MIB_LEAST: u64 = 16;

pub(super) fn examine(report: &mut dyn FnMut(Finding)) {
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
        USBFS_MIB_LEAST.. => Finding::good(what, seen),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Verdict;

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
}
