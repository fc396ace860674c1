//! The machine itself: processors, memory, and the service.

use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
};

use super::Finding;

/// The rings, coded stretches and a stall of 30 s at 200 markers x 1000 Hz, and as much for everything else.
const MEMORY_MIB_LEAST: u64 = 600;

/// Where units are.
const UNITS: [&str; 3] = ["/etc/systemd/system", "/usr/lib/systemd/system", "/lib/systemd/system"];

pub(super) fn examine(tell: &mut dyn FnMut(Finding)) {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    tell(processors(cores));
    if let Some(finding) = fs::read_to_string("/proc/meminfo").ok().and_then(|text| memory(&text)) {
        tell(finding);
    }
    // What runs on a machine without systemd starts it in another way.
    if Path::new("/run/systemd/system").exists() {
        tell(unit(&UNITS, is_active().as_deref()));
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

fn is_active() -> Option<String> {
    let mut command = Command::new("systemctl");
    let output = command.args(["is-active", "mocapd"]).stdin(Stdio::null()).output().ok()?;
    Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn unit(folders: &[&str], state: Option<&str>) -> Finding {
    let what = "service";
    let installed = folders.iter().any(|folder| Path::new(folder).join("mocapd.service").exists());
    match (installed, state) {
        (false, _) => Finding::note(what, "not installed: recordings are started by hand"),
        (true, Some("active")) => Finding::good(what, "runs"),
        (true, Some("failed")) => {
            Finding::failure(what, "has failed", "`journalctl -u mocapd -n 50` says why")
        }
        (true, _) => {
            Finding::note(what, "installed, and does not run: `sudo systemctl start mocapd`")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Verdict;

    #[test]
    fn what_is_found_of_the_machine() {
        assert_eq!(processors(1).verdict, Verdict::Warning);
        assert_eq!(processors(4).verdict, Verdict::Good);
        let text = "MemTotal:  8000000 kB\nMemAvailable:  4000000 kB\n";
        assert_eq!(memory(text).unwrap().seen, "3906 MiB available");
        assert_eq!(memory("MemAvailable: 100000 kB\n").unwrap().verdict, Verdict::Warning);
        assert_eq!(memory(""), None);
    }

    #[test]
    fn what_is_found_of_the_service() {
        let folder = tempfile::tempdir().unwrap();
        let folders = [folder.path().to_str().unwrap()];
        assert_eq!(unit(&folders, Some("inactive")).verdict, Verdict::Note);
        fs::write(folder.path().join("mocapd.service"), "").unwrap();
        assert_eq!(unit(&folders, Some("active")).verdict, Verdict::Good);
        let failed = unit(&folders, Some("failed"));
        assert_eq!(failed.verdict, Verdict::Failure);
        assert!(failed.remedy.unwrap().contains("journalctl"));
    }
}
