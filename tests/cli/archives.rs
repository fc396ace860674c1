//! `archive`, which Python does.

use std::{fs, os::unix::fs::PermissionsExt};

use super::{Folder, Ran};
use crate::support::assert_mentions;

#[test]
fn arguments_reach_python_as_they_are() {
    let folder = Folder::new();
    let python = folder.path("python");
    fs::write(&python, "#!/bin/sh\nshift 2\nprintf '%s\\n' \"$@\"\nexit 3\n").unwrap();
    fs::set_permissions(&python, fs::Permissions::from_mode(0o755)).unwrap();
    let words = ["ingest", "--help", "--bucket=s3://a/b", "-", "c d/", "--workers", "0"];
    let mut command = folder.command(&[&["archive"][..], &words].concat());
    let ran = Ran::from(command.env("MOCAPD_PYTHON", &python).output().unwrap()).with_code(3);
    assert_eq!(ran.stdout.lines().collect::<Vec<_>>(), words);
}

#[test]
fn without_python_or_its_package_a_line_says_what_to_do() {
    let folder = Folder::new();
    let mut command = folder.command(&["archive", "verify"]);
    command.env("MOCAPD_PYTHON", folder.path("none"));
    assert_mentions(&folder.refused(command, 1), &["none", "MOCAPD_PYTHON", "Python 3.10"]);
    let mut command = folder.command(&["archive", "verify"]);
    command.env_remove("MOCAPD_PYTHON").env("PYTHONPATH", folder.path(""));
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    folder.write("mocapd.py", "raise ImportError('no package')");
    assert_mentions(&folder.refused(command, 1), &["no package", "[archive]", "MOCAPD_PYTHON"]);
    assert_mentions(
        &folder.run(&["archive", "--help"]).with_code(0).stdout,
        &["ingest|sql|verify|repack|collect", "pip install './python[archive]'"],
    );
    folder.refuses(&["archive"], 2);
    // A module among the data is not run.
    let mut command = folder.command(&["archive", "verify"]);
    command.current_dir(folder.path("")).env("PYTHONPATH", folder.path("other"));
    command.env("PYTHONNOUSERSITE", "1").env("PYTHONDONTWRITEBYTECODE", "1");
    let message = folder.refused(command, 1);
    assert!(!message.contains("no package"), "{message}");
}
