//! `config`: a valid file, invalid ones, and the example.

use std::{fs, os::unix::fs::PermissionsExt};

use mocapd_drivers::plain_file::NotAFile;
use mocapd_service::config::ConfigError;

use super::{Folder, Ran};
use crate::support::assert_mentions;

#[test]
fn the_example_is_valid() {
    let folder = Folder::new();
    let example = folder.run(&["config", "example"]).with_code(0);
    assert_eq!(example.stderr, "");
    assert_eq!(example.stdout, include_str!("../../systemd/mocapd.toml"));
    folder.write("left.toml", &example.stdout);
    let check = |more: &[&str]| -> Ran {
        let mut command = folder.command(&[&["config", "check", "left.toml"], more].concat());
        // The systemd unit creates this folder; without it there is a note about the socket.
        command.env("RUNTIME_DIRECTORY", folder.path("."));
        command.output().unwrap().into()
    };
    let checked = check(&[]).with_code(0);
    assert_eq!(checked.stderr, "");
    assert_mentions(&checked.stdout, &["left.toml"]);
    let json = check(&["--json"]).with_code(0).json();
    assert_eq!(json["config"]["rig"]["name"], "left");
    assert_eq!(json["config"]["take"]["tolerance"], "0.5mm");
    assert!(json["config"]["device"].get("rate_hz").is_none());
}

#[test]
fn each_error_is_one_line() {
    let folder = Folder::new();
    folder.write("left.toml", "[arm]\npre_rol = '10s'\n");
    let line = folder.refuses(&["config", "check", "left.toml"], 2);
    assert_mentions(&line, &["left.toml line 2, column 1", "pre_rol", "[arm]", "pre_roll"]);

    folder.write("left.toml", "[arm]\npre_rol = '10s'\npre_roll = 10\n[log]\nlevel = 'x'\n");
    let ran = folder.run(&["config", "check", "left.toml"]).with_code(2);
    let lines: Vec<_> = ran.stderr.lines().collect();
    assert_eq!(lines.len(), 4, "{}", ran.stderr);
    for (line, place, facts) in [
        (lines[0], "line 2, column 1", ["pre_rol", "pre_roll"]),
        (lines[1], "line 3, column 12", ["arm.pre_roll", "pre_roll = \"10s\""]),
        (lines[2], "line 5, column 9", ["log.level", "level = \"info\""]),
    ] {
        assert_mentions(line, &[&format!("left.toml {place}"), facts[0], facts[1]]);
    }
    assert_mentions(lines[3], &["left.toml", "3"]);
    assert_eq!(ran.stdout, "");
}

#[test]
fn a_missing_configuration_is_an_error_that_says_how_to_write_one() {
    let folder = Folder::new();
    let line = folder.refuses(&["config", "check", "left.toml"], 1);
    assert_eq!(line, ConfigError::NotFound("left.toml".into()).to_string());
    assert_mentions(&line, &["left.toml", "mocapd config example > left.toml"]);
    let line = folder.refuses(&["config", "check", "."], 1);
    assert_mentions(&line, &[".", &NotAFile::Folder.to_string()]);
}

#[test]
fn notes_and_token_files() {
    let folder = Folder::new();
    folder.write("left.toml", "[http]\nsocket = 'rig.sock'\n[trigger]\nlisten = '0.0.0.0:8989'\n");
    let ran = folder.run(&["config", "check", "left.toml"]).with_code(0);
    assert_mentions(&ran.stderr, &["trigger.allow_from", "0.0.0.0:8989"]);
    assert_eq!(ran.stderr.lines().count(), 1);

    folder.write("left.toml", "[http]\nlisten = '0.0.0.0:7060'\ntoken_file = 'token'\n");
    let check = ["config", "check", "left.toml"];
    assert_mentions(&folder.refuses(&check, 1), &["token", "openssl rand -hex 32 > token"]);
    folder.write("token", "0123456789abcdef\n");
    fs::set_permissions(folder.path("token"), fs::Permissions::from_mode(0o640)).unwrap();
    assert_mentions(&folder.refuses(&check, 1), &["0640", "chmod 600 token"]);
    fs::set_permissions(folder.path("token"), fs::Permissions::from_mode(0o600)).unwrap();
    let ran = folder.run(&check).with_code(0);
    assert_mentions(&ran.stderr, &["http.listen", "0.0.0.0:7060", "token"]);
    assert!(!ran.stderr.contains("0123456789abcdef"));
}

#[test]
fn unreadable_subject_files_are_listed_with_the_other_errors() {
    let folder = Folder::new();
    let subject = "[subject]\nskeleton = 's.json'\nface = 'f.json'\nface_markers = 'm.json'\n";
    folder.write("left.toml", format!("{subject}[arm]\npre_rol = '10s'\n"));
    let ran = folder.run(&["config", "check", "left.toml"]).with_code(2);
    let lines: Vec<_> = ran.stderr.lines().collect();
    assert_eq!(lines.len(), 5, "{}", ran.stderr);
    for (line, facts) in [
        (lines[0], ["line 2, column 12", "subject.skeleton: s.json does not exist"]),
        (lines[1], ["line 3, column 8", "subject.face: f.json does not exist"]),
        (lines[2], ["line 4, column 16", "subject.face_markers: m.json does not exist"]),
        (lines[3], ["line 6, column 1", "pre_rol"]),
        (lines[4], ["left.toml is invalid", "4"]),
    ] {
        assert_mentions(line, &facts);
    }
    folder.write("left.toml", "[subject]\nskeleton = 's.json'\n");
    let json = folder.run(&["config", "check", "left.toml", "--json"]).with_code(2).json();
    assert_eq!(json["problems"][0]["key"], "subject.skeleton");
    // A mapping without a face is a problem of the mapping.
    folder.write("m.json", super::subjects::MARKERS);
    folder.write("left.toml", "[subject]\nface_markers = 'm.json'\n");
    assert_mentions(
        &folder.refuses(&["config", "check", "left.toml"], 2),
        &["subject.face_markers: m.json", "give both"],
    );
}

#[test]
fn a_takes_folder_that_cannot_be_written_is_noted() {
    let folder = Folder::new();
    for directory in ["left.toml", "left.toml/takes"] {
        let config = format!("[http]\nsocket = 'rig.sock'\n[take]\ndirectory = '{directory}'\n");
        folder.write("left.toml", config);
        let ran = folder.run(&["config", "check", "left.toml"]).with_code(0);
        assert_eq!(ran.stderr.lines().count(), 1, "{}", ran.stderr);
        assert_mentions(
            &ran.stderr,
            &["note: cannot write to the takes' folder", directory, "take.directory"],
        );
    }
    folder.write("left.toml", "[http]\nsocket = 'rig.sock'\n[take]\ndirectory = 'new'\n");
    assert_eq!(folder.run(&["config", "check", "left.toml"]).with_code(0).stderr, "");
    assert!(!folder.path("new").exists(), "a check creates nothing");
}
