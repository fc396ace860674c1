//! The program run without root's privileges.

use std::{
    fs::{Permissions, set_permissions},
    os::unix::fs::PermissionsExt,
    path::Path,
    process::{Command, Stdio},
};

use super::Folder;

/// Makes commands that run the program in `folder` without root's rights; `None`, with the reason printed,
/// if that is impossible.
#[expect(clippy::print_stderr, reason = "a test that is skipped says why")]
pub(super) fn command_in(folder: &Folder) -> Option<impl Fn(&[&str]) -> Command> {
    let is_root = rustix::process::geteuid().is_root();
    let folder = folder.path("");
    if is_root {
        // Other users must be able to create files in the folder.
        set_permissions(&folder, Permissions::from_mode(0o777)).unwrap();
    }
    let command = move |args: &[&str]| {
        let program = env!("CARGO_BIN_EXE_mocapd");
        let mut command = Command::new(if is_root { "setpriv" } else { program });
        if is_root {
            command.args(["--reuid=65534", "--regid=65534", "--clear-groups", program]);
        }
        command.args(args).current_dir(&folder);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    };
    if command(&["--version"]).output().is_ok_and(|output| output.status.success()) {
        return Some(command);
    }
    eprintln!("skipped: root, and no setpriv that runs the program as somebody else");
    None
}

/// Removes all permissions of a file or folder.
pub(super) fn forbid(path: &Path) {
    set_permissions(path, Permissions::from_mode(0o000)).unwrap();
}
