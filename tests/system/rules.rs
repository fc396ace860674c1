//! The udev rules. Debian 12's udev cannot check them without a device; `tests/vm` has devices.

use super::{lines, text};

const OPERATORS: [&str; 6] = ["==", "!=", "+=", "-=", ":=", "="];

/// The parts of a rule: key, operator, value.
fn parts(line: &str) -> Vec<(String, &'static str, String)> {
    let mut parts = Vec::new();
    let mut rest = line;
    while !rest.is_empty() {
        let (head, value) = rest.split_once('"').unwrap_or_else(|| panic!("no value: {rest}"));
        let (value, after) = value.split_once('"').unwrap_or_else(|| panic!("open: {rest}"));
        let operator = OPERATORS.into_iter().find(|operator| head.trim().ends_with(operator));
        let operator = operator.unwrap_or_else(|| panic!("no operator: {head}"));
        let key = head.trim().strip_suffix(operator).unwrap().to_owned();
        parts.push((key, operator, value.to_owned()));
        rest = after.strip_prefix(',').unwrap_or(after).trim_start();
    }
    parts
}

#[test]
fn units_are_well_formed_and_jumps_have_a_target() {
    let rules = text("systemd/60-mocapd.rules");
    let all: Vec<_> = lines(&rules).flat_map(parts).collect();
    assert!(all.len() > 20);
    let of = |key: &str| -> Vec<&str> {
        all.iter().filter(|part| part.0 == key).map(|part| part.2.as_str()).collect()
    };
    assert_eq!(of("GOTO"), of("LABEL"));
    for (key, operator, _) in &all {
        let name = key.split('{').next().unwrap();
        let is_match = ["ACTION", "SUBSYSTEM", "SUBSYSTEMS", "KERNEL", "DRIVER", "ATTRS", "TEST"];
        if is_match.contains(&name) {
            assert_eq!(*operator, "==", "{key} would be assigned");
        }
    }
}

/// A device chooses its serial number: without spaces and slashes in it, the unit's name cannot
/// start another unit of the machine.
#[test]
fn a_serial_number_starts_no_other_unit() {
    let rules = text("systemd/60-mocapd.rules");
    let wants: Vec<_> = lines(&rules).filter(|line| line.contains("SYSTEMD_WANTS")).collect();
    assert_eq!(wants.len(), 1, "{wants:?}");
    let parts = parts(wants[0]);
    let value = |key: &str| parts.iter().find(|part| part.0 == key).map(|part| part.2.as_str());
    assert_eq!(value("ENV{SYSTEMD_WANTS}"), Some("mocapd@$env{ID_SERIAL_SHORT}.service"));
    assert_eq!(value("TEST"), Some("/etc/mocapd/$env{ID_SERIAL_SHORT}.toml"));
    assert!(!wants[0].contains("$attr"), "as the device says it");
}
