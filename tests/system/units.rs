//! The unit files: well-formed, with the settings that the service relies on, and accepted by systemd where it is
//! installed.

use std::{collections::BTreeMap, fs, process::Command};

use super::{lines, text};

const UNITS: [&str; 2] = ["mocapd@.service", "mocapd-sim@.service"];

/// Largest exposure of a unit by `systemd-analyze security`, times ten; systemd/README.md states it.
const EXPOSURE_MAX_TENTHS: &str = "13";

/// The values of each section and key, in order.
type Unit = BTreeMap<(String, String), Vec<String>>;

fn parse(name: &str) -> Unit {
    let (mut unit, mut section) = (Unit::new(), String::new());
    for line in lines(&text(&format!("systemd/{name}"))) {
        if let Some(name) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
            section = name.to_owned();
            continue;
        }
        let (key, value) = line.split_once('=').unwrap_or_else(|| panic!("{name}: '{line}'"));
        unit.entry((section.clone(), key.to_owned())).or_default().push(value.to_owned());
    }
    unit
}

fn only<'a>(unit: &'a Unit, section: &str, key: &str) -> &'a str {
    let values = unit.get(&(section.to_owned(), key.to_owned()));
    match values.map(Vec::as_slice) {
        Some([value]) => value,
        other => panic!("[{section}] {key}: {other:?}"),
    }
}

#[test]
fn the_service_is_as_the_program_expects_it() {
    let unit = parse("mocapd@.service");
    let service = |key| only(&unit, "Service", key);
    assert_eq!(service("Type"), "notify", "notify-reload needs systemd 253");
    assert_eq!(service("ExecStart"), "/usr/bin/mocapd run --config /etc/mocapd/%i.toml");
    assert_eq!(service("ExecReload"), "/bin/kill -HUP $MAINPID");
    assert_eq!(service("StateDirectory"), "mocapd/%i");
    assert_eq!(service("RuntimeDirectory"), "mocapd/%i");
    assert_eq!((service("StateDirectoryMode"), service("UMask")), ("0750", "0027"));
    // The exit code for an invalid configuration.
    assert_eq!(service("RestartPreventExitStatus"), "2");
    assert!(service("WatchdogSec").ends_with('s'));
    // An unplug must not end a take.
    assert!(!unit.keys().any(|(_, key)| key == "BindsTo"), "BindsTo");
}

#[test]
fn users_and_folders_are_made_before_they_are_needed() {
    let users = text("systemd/mocapd.sysusers");
    let folders = text("systemd/mocapd.tmpfiles");
    for name in UNITS {
        let user = parse(name);
        let user = only(&user, "Service", "User");
        assert!(lines(&users).any(|line| line.starts_with(&format!("u {user} "))), "{user}");
    }
    for folder in ["/var/lib/mocapd", "/run/mocapd"] {
        let line = format!("d {folder} 0750 root mocapd -");
        assert!(lines(&folders).any(|found| found == line), "{folder}");
    }
}

#[test]
fn a_thread_of_the_service_may_lower_its_priority() {
    let unit = parse("mocapd@.service");
    let filters = &unit[&("Service".to_owned(), "SystemCallFilter".to_owned())];
    // A later line overrides an earlier one.
    assert_eq!(filters.last().map(String::as_str), Some("setpriority"), "{filters:?}");
    assert!(filters.iter().any(|filter| filter.starts_with('~') && filter.contains("@resources")));
    // A call that is not allowed fails; it does not kill the service.
    assert_eq!(only(&unit, "Service", "SystemCallErrorNumber"), "EPERM");
}

/// Copies of the units that run an existing program, and without manual pages, which are not installed.
fn installable() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in UNITS {
        let unit = text(&format!("systemd/{name}"))
            .replace("/usr/bin/mocapd-sim", "/bin/true")
            .replace("/usr/bin/mocapd", "/bin/true");
        let lines: Vec<_> =
            unit.lines().filter(|line| !line.starts_with("Documentation")).collect();
        fs::write(folder.path().join(name), lines.join("\n")).unwrap();
    }
    folder
}

/// The output of `systemd-analyze`; `None` on a machine without it.
fn analyze(arguments: &[&str]) -> Option<(bool, String)> {
    let output = Command::new("systemd-analyze").args(arguments).output().ok()?;
    let both = [output.stdout, output.stderr].concat();
    Some((output.status.success(), String::from_utf8_lossy(&both).into_owned()))
}

#[test]
fn systemd_finds_nothing_wrong_with_them() {
    let folder = installable();
    for name in UNITS {
        let path = folder.path().join(name);
        let path = path.to_str().unwrap();
        // Without the option an unknown key is not an error.
        let Some((good, report)) = analyze(&["verify", "--recursive-errors=no", path]) else {
            return;
        };
        assert!(good && report.is_empty(), "{name}: {report}");
        let threshold = format!("--threshold={EXPOSURE_MAX_TENTHS}");
        let security = ["security", "--offline=yes", &threshold, path];
        let Some((good, report)) = analyze(&security) else { return };
        assert!(good, "{name}: {}", report.lines().last().unwrap_or_default());
        println!("{name}: {}", report.lines().last().unwrap_or_default());
    }
}

#[test]
fn the_page_states_the_exposure() {
    let (whole, tenth) = EXPOSURE_MAX_TENTHS.split_at(1);
    let report = format!("systemd/mocapd@.service` reports an exposure of {whole}.{tenth},");
    assert!(text("systemd/README.md").contains(&report), "systemd/README.md: '{report}'");
}

#[test]
fn systemd_finds_planted_errors() {
    let folder = installable();
    let path = folder.path().join(UNITS[0]);
    let good = fs::read_to_string(&path).unwrap();
    fs::write(&path, good.replace("ProtectSystem=strict", "ProtectSystem=stric")).unwrap();
    let verify = ["verify", "--recursive-errors=no", path.to_str().unwrap()];
    let Some((passes, report)) = analyze(&verify) else { return };
    assert!(!passes && report.contains("stric"), "{report}");
    fs::write(&path, good.replace("CapabilityBoundingSet=\n", "")).unwrap();
    let threshold = format!("--threshold={EXPOSURE_MAX_TENTHS}");
    let security = ["security", "--offline=yes", &threshold, path.to_str().unwrap()];
    assert!(analyze(&security).is_some_and(|(passes, _)| !passes), "every capability passes");
}
