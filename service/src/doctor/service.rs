//! The service: whether it is installed, which rigs are configured and how they are doing, and who may access it.

use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
};

use super::Finding;

/// Folders of systemd units.
const UNITS: [&str; 3] = ["/etc/systemd/system", "/usr/lib/systemd/system", "/lib/systemd/system"];

/// Folder of the configurations: NAME.toml belongs to `mocapd@NAME`.
const CONFIGURATIONS: &str = "/etc/mocapd";

/// The example of the package, which is not a rig.
const EXAMPLE: &str = "example";

/// Maximum number of rigs that are reported: a machine has one or a few.
const RIGS_MAX: usize = 64;

pub(super) fn examine(report: &mut dyn FnMut(Finding)) {
    // Without systemd, the service is started in another way.
    if Path::new("/run/systemd/system").exists() {
        let rigs = rigs(Path::new(CONFIGURATIONS));
        report(installed(&UNITS, &rigs));
        rigs.iter().filter_map(|name| Some(rig(name, &state(name)?))).for_each(&mut *report);
    }
    let Ok(groups) = fs::read_to_string("/etc/group") else { return };
    let me = CurrentUser::now();
    let why = ["open serial ports and rigs", "read the service's takes and control it"];
    for (name, why) in ["dialout", "mocapd"].into_iter().zip(why) {
        group(&groups, &me, name, why).into_iter().for_each(&mut *report);
    }
}

/// The names of the configured rigs.
fn rigs(folder: &Path) -> Vec<String> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let names = entries.flatten().filter_map(|entry| {
        let name = entry.file_name().into_string().ok()?.strip_suffix(".toml")?.to_owned();
        // Names that systemd would escape are skipped.
        let is_plain = name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.:".contains(c));
        (is_plain && name != EXAMPLE).then_some(name)
    });
    let mut names: Vec<_> = names.take(RIGS_MAX).collect();
    names.sort();
    names
}

fn installed(folders: &[&str], rigs: &[String]) -> Finding {
    let what = "service";
    if !folders.iter().any(|folder| Path::new(folder).join("mocapd@.service").exists()) {
        return Finding::note(what, "not installed: recordings must be started by hand");
    }
    if rigs.is_empty() {
        let remedy = format!(
            "`sudo cp {CONFIGURATIONS}/{EXAMPLE}.toml {CONFIGURATIONS}/NAME.toml`, edit it, and \
             `sudo systemctl enable --now mocapd@NAME`"
        );
        return with_remedy(Finding::note(what, "installed, but no rig is configured"), remedy);
    }
    Finding::good(what, format!("installed; rigs: {}", rigs.join(", ")))
}

/// The state of a unit according to systemd.
#[derive(Debug, Clone, Default, PartialEq)]
struct UnitState {
    active: String,
    enabled: String,
    status: String,
}

fn state(name: &str) -> Option<UnitState> {
    let mut command = Command::new("systemctl");
    let properties = ["show", "-p", "ActiveState", "-p", "UnitFileState", "-p", "StatusText"];
    command.args(properties).arg(format!("mocapd@{name}.service")).stdin(Stdio::null());
    let output = command.output().ok()?;
    Some(parse(&String::from_utf8_lossy(&output.stdout)))
}

fn parse(shown: &str) -> UnitState {
    let mut state = UnitState::default();
    for (key, value) in shown.lines().filter_map(|line| line.split_once('=')) {
        match key {
            "ActiveState" => value.clone_into(&mut state.active),
            "UnitFileState" => value.clone_into(&mut state.enabled),
            "StatusText" => value.clone_into(&mut state.status),
            _ => {}
        }
    }
    state
}

fn rig(name: &str, state: &UnitState) -> Finding {
    let what = format!("mocapd@{name}");
    let status = match state.status.as_str() {
        "" => String::new(),
        text => format!(": {text}"),
    };
    let at_boot = state.enabled.starts_with("enabled");
    match (state.active.as_str(), at_boot) {
        ("active" | "reloading", true) => {
            Finding::good(&what, format!("running, and started at boot{status}"))
        }
        ("active" | "reloading", false) => with_remedy(
            Finding::good(&what, format!("running, but not started at boot{status}")),
            format!("`sudo systemctl enable {what}` starts it at boot"),
        ),
        ("failed", _) => Finding::failure(
            &what,
            "has failed",
            format!("`journalctl -u {what} -n 50` shows why; then `sudo systemctl restart {what}`"),
        ),
        ("activating" | "deactivating", _) => {
            Finding::note(&what, format!("{}{status}", state.active))
        }
        _ => with_remedy(
            Finding::note(&what, "not running"),
            format!("`sudo systemctl enable --now {what}`"),
        ),
    }
}

fn with_remedy(finding: Finding, remedy: impl Into<String>) -> Finding {
    Finding { remedy: Some(remedy.into()), ..finding }
}

/// The user who runs the check.
#[derive(Debug)]
struct CurrentUser {
    name: Option<String>,
    is_root: bool,
    groups: Vec<u32>,
}

impl CurrentUser {
    fn now() -> Self {
        let uid = rustix::process::getuid().as_raw();
        let mut groups = vec![rustix::process::getegid().as_raw()];
        let more = rustix::process::getgroups().unwrap_or_default();
        groups.extend(more.into_iter().map(rustix::process::Gid::as_raw));
        let users = fs::read_to_string("/etc/passwd").unwrap_or_default();
        let name = users.lines().find_map(|line| {
            let mut fields = line.split(':');
            let name = fields.next()?;
            (fields.nth(1)?.parse() == Ok(uid)).then(|| name.to_owned())
        });
        Self { name, is_root: uid == 0, groups }
    }
}

/// Checks membership of a group; `None` if the group does not exist.
fn group(groups: &str, me: &CurrentUser, name: &str, why: &str) -> Option<Finding> {
    let line = groups.lines().find(|line| line.split(':').next() == Some(name))?;
    let mut fields = line.split(':').skip(2);
    let id: u32 = fields.next()?.parse().ok()?;
    let mut members = fields.next().unwrap_or_default().split(',');
    let what = format!("group {name}");
    if me.is_root {
        return Some(Finding::good(&what, "not needed by root"));
    }
    if me.groups.contains(&id) {
        return Some(Finding::good(&what, format!("you may {why}")));
    }
    let is_member = me.name.as_deref().is_some_and(|me| members.any(|member| member == me));
    if is_member {
        let seen = "your membership takes effect at the next login";
        return Some(Finding::warning(&what, seen, "log in again"));
    }
    let seen = format!("you are not a member: you may not {why}");
    let remedy = format!("`sudo usermod -aG {name} $USER`, and log in again");
    Some(with_remedy(Finding::note(&what, seen), remedy))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Verdict;

    #[test]
    fn installation_and_rigs_are_reported() {
        let folder = tempfile::tempdir().unwrap();
        let folders = [folder.path().to_str().unwrap()];
        let not = installed(&folders, &[]);
        fs::write(folder.path().join("mocapd@.service"), "").unwrap();
        let none = installed(&folders, &[]);
        assert_ne!(none.seen, not.seen);
        assert!(none.remedy.unwrap().contains("`sudo cp /etc/mocapd/example.toml"));
        for name in ["hall.toml", "example.toml", "token", "left-2.toml", "bad name.toml"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let rigs = rigs(folder.path());
        assert_eq!(rigs, ["hall", "left-2"]);
        let seen = installed(&folders, &rigs).seen;
        assert!(seen.contains("hall, left-2") && !seen.contains("example"), "{seen}");
        assert_eq!(super::rigs(&folder.path().join("none")), Vec::<String>::new());
    }

    #[test]
    fn the_state_of_a_rig_is_reported_with_a_command() {
        let of = |text: &str| rig("hall", &parse(text));
        let all_well = of("ActiveState=active\nUnitFileState=enabled\nStatusText=armed = yes\n");
        assert_eq!(all_well.verdict, Verdict::Good);
        assert!(all_well.seen.contains("armed = yes"), "{}", all_well.seen);
        assert_eq!(all_well.remedy, None);
        let by_hand = of("ActiveState=active\nUnitFileState=disabled\n");
        assert!(by_hand.remedy.unwrap().contains("`sudo systemctl enable mocapd@hall`"));
        let failed = of("ActiveState=failed\nUnitFileState=enabled\n");
        assert_eq!(failed.verdict, Verdict::Failure);
        assert!(failed.remedy.unwrap().contains("journalctl -u mocapd@hall"));
        let stopped = of("ActiveState=inactive\nUnitFileState=\n");
        assert_eq!(stopped.verdict, Verdict::Note);
        assert_eq!(stopped.remedy.unwrap(), "`sudo systemctl enable --now mocapd@hall`");
        let activating = of("ActiveState=activating\n");
        assert!(activating.seen.contains("activating"), "{}", activating.seen);
    }

    #[test]
    fn group_membership_is_reported() {
        let groups = "root:x:0:\ndialout:x:20:ann\nmocapd:x:990:ann,bob\n";
        let me = |name: &str, groups: &[u32]| CurrentUser {
            name: Some(name.to_owned()),
            is_root: false,
            groups: groups.to_vec(),
        };
        let found = |me: &CurrentUser| group(groups, me, "mocapd", "read takes").unwrap();
        let member = found(&me("ann", &[1000, 990]));
        assert_eq!((member.verdict, member.remedy), (Verdict::Good, None));
        assert!(member.seen.contains("read takes"), "{}", member.seen);
        let join = "`sudo usermod -aG mocapd $USER`";
        assert!(!found(&me("bob", &[1001])).remedy.unwrap().contains(join));
        let outside = found(&me("eve", &[1002]));
        assert_eq!(outside.verdict, Verdict::Note);
        assert!(outside.remedy.unwrap().contains(join));
        let root = CurrentUser { is_root: true, ..me("root", &[0]) };
        assert_eq!(found(&root).verdict, Verdict::Good);
        assert_eq!(group(groups, &root, "uucp", "x"), None);
    }
}
