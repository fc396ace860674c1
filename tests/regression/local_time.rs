//! Names of takes used local time, lists and logs UTC.

use jiff::{Timestamp, Unit, civil::DateTime};

use crate::{
    cli::{Folder, devices::Simulated},
    regression::control_characters::{Service, ctl},
    support::jump,
};

/// 5:45 h ahead of UTC, an unlikely default; POSIX inverts the sign.
const ZONE: (&str, &str) = ("TZ", "XYZ-05:45");
const OFFSET: &str = "+05:45";

#[test]
fn times_for_people_are_local_and_state_their_zone() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 3.0));
    let mut service = Service::start(&folder, &device, &[ZONE]);
    let started = ctl(&folder, &["start", "--json"]).with_code(0).json();
    ctl(&folder, &["stop"]);
    let name = started["name"].as_str().unwrap();
    let take = format!("takes/{name}.take");
    let in_zone = |args: &[&str]| {
        let ran: crate::cli::Ran =
            folder.command(args).env(ZONE.0, ZONE.1).output().unwrap().into();
        ran.with_code(0)
    };

    let info = in_zone(&["info", &take]).stdout;
    let made = info.lines().find_map(|line| line.strip_prefix("made")).unwrap().trim();
    let made = made.split(' ').next().unwrap();
    assert!(made.ends_with(OFFSET), "{made}");
    let listed = in_zone(&["ctl", "--connect", "unix:rig.sock", "takes"]).stdout;
    let listed = listed.split(' ').next().unwrap();
    assert!(listed.ends_with(OFFSET), "{listed}");
    // 2026-11-23_14-05-09_rig, a moment before.
    let civil = |form: &str, text: &str| DateTime::strptime(form, &text[..19]).unwrap();
    let apart = civil("%Y-%m-%dT%H:%M:%S", made) - civil("%Y-%m-%d_%H-%M-%S", name);
    assert!(apart.total(Unit::Second).unwrap().abs() < 60.0, "{name} was made {made}");
    let made: Timestamp = made.parse().unwrap();
    // For programs.
    let report = in_zone(&["info", &take, "--json"]).json();
    let created = report["created"].as_str().unwrap();
    assert!(created.ends_with('Z'), "{created}");
    assert_eq!(created.parse::<Timestamp>().unwrap().as_second(), made.as_second());

    service.end();
    let log = folder.text("log");
    let line = log.lines().find(|line| line.contains(name)).unwrap();
    assert!(line.split(' ').next().unwrap().ends_with(OFFSET), "{line}");
}
