//! Existing files are not overwritten, and failed commands leave nothing behind.

use std::{
    os::unix::fs::symlink,
    process::{Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use mocapd_acquire::files::{FileError, NameTaken};
use mocapd_simulator::generator::JumpSpec;
use mocapd_take::motion::GAP;
use rustix::process::{Pid, Signal, kill_process};

use super::{Folder, unprivileged};
use crate::support::{assert_mentions, jump};

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(1, 60.0, 0.5));
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    folder
}

#[test]
fn existing_files_are_not_overwritten() {
    let folder = folder();
    folder.write("mine.take", "mine");
    folder.write("mine.csv", "mine");
    symlink("nowhere", folder.path("link.take")).unwrap();
    symlink("nowhere", folder.path("link.csv")).unwrap();
    std::fs::create_dir(folder.path("folder.take")).unwrap();
    for file in ["mine.take", "link.take", "folder.take"] {
        let expected = exists(file);
        assert_eq!(folder.refuses(&["import", "jump.csv", "-o", file], 1), expected);
        // Checked before the (invalid) device is opened.
        let record = ["record", "-d", "serial:/dev/null", "-o", file];
        assert_eq!(folder.refuses(&record, 1), expected);
    }
    for file in ["mine.csv", "link.csv"] {
        assert_eq!(folder.refuses(&["export", "jump.take", "-o", file], 1), exists(file));
    }
    let import = ["import", "jump.csv", "-o", "jump.take"];
    assert_eq!(folder.refuses(&import, 1), exists("jump.take"));
}

/// The error about an existing file.
fn exists(file: &str) -> String {
    NameTaken { path: file.into() }.to_string()
}

#[test]
fn a_missing_folder_is_not_created() {
    let folder = folder();
    let expected = FileError::NoFolder("no/such".into()).to_string();
    for args in [
        &["import", "jump.csv", "-o", "no/such/new.take"][..],
        &["record", "-d", "serial:/dev/null", "-o", "no/such/new.take"],
        &["export", "jump.take", "-o", "no/such/new.csv"],
    ] {
        assert_eq!(folder.refuses(args, 1), expected, "{args:?}");
    }
    assert_mentions(&folder.refuses(&["bench", "pipeline", "--dir", "no/such"], 1), &["no/such"]);
    folder.write("file", "");
    let line = folder.refuses(&["import", "jump.csv", "-o", "file/new.take"], 1);
    assert_mentions(&line, &["file/new.take"]);
    let line = folder.refuses(&["demo", "--seconds", "1", "--out", "file"], 1);
    assert_mentions(&line, &["file"]);
}

#[test]
fn a_folder_that_may_not_be_written_to() {
    let folder = folder();
    std::fs::create_dir(folder.path("locked")).unwrap();
    let Some(user) = unprivileged::command_in(&folder) else { return };
    unprivileged::forbid(&folder.path("locked"));
    for args in [
        ["import", "jump.csv", "-o", "locked/new.take"],
        ["export", "jump.take", "-o", "locked/new.csv"],
    ] {
        let expected = FileError::NotWritable(args[3].into()).to_string();
        assert_eq!(folder.refused(user(&args), 1), expected);
    }
}

/// The resampler refuses the motion after the output was opened.
#[test]
fn an_import_that_fails_leaves_nothing() {
    let folder = Folder::new();
    let spec = JumpSpec { seconds: Some(15.0), ..JumpSpec::new(1, 120.0) };
    folder.write_motion("long.csv", &spec.generate().unwrap().motion);
    let import = ["import", "long.csv", "-o", "new.take", "--resampler", "spline:exhaustive"];
    assert_mentions(&folder.refuses(&import, 1), &["new.take", "1024", "1800", ":worst-sample"]);
}

#[test]
fn a_closed_pipe_is_not_a_failure() {
    let folder = folder();
    for args in [
        &["info", "jump.take"][..],
        &["info", "jump.take", "--json"],
        &["verify", "jump.take"],
        &["import", "jump.csv", "-o", "new.take"],
    ] {
        let mut nobody = Command::new("true").stdin(Stdio::piped()).spawn().unwrap();
        let pipe = nobody.stdin.take().unwrap();
        nobody.wait().unwrap();
        let ran = folder.command(args).stdout(pipe).output().unwrap();
        assert_eq!(String::from_utf8_lossy(&ran.stderr), "", "{args:?}");
        assert_eq!(ran.status.code(), Some(0), "{args:?}");
    }
    assert!(folder.path("new.take").exists());
}

#[test]
fn labels_do_not_control_the_terminal() {
    let folder = Folder::new();
    folder.write(
        "a.csv",
        "# rate=60\n\x1b[31mhead\x07_x,\x1b[31mhead\x07_y,\x1b[31mhead\x07_z\n1,2,3\n1,2,3\n",
    );
    folder.run(&["import", "a.csv", "-o", "a.take"]).with_code(0);
    let info = folder.run(&["info", "a.take", "--markers"]).with_code(0).stdout;
    assert!(info.contains("[31mhead"), "{info}");
    assert!(!info.contains(['\x1b', '\x07']), "{info:?}");
    // JSON escapes them, and keeps them.
    let report = folder.run(&["info", "a.take", "--json"]).with_code(0).json();
    assert_eq!(report["channels"][0]["label"], "\x1b[31mhead\x07");
}

#[test]
fn info_is_a_summary_unless_markers_are_asked_for() {
    let folder = Folder::new();
    // The rate is a float32 in the file, as in every C3D.
    let mut motion = jump(1, f64::from(59.94_f32), 2.0);
    motion.positions_mm[2 * motion.info.markers.len() + 3] = GAP;
    folder.write_motion("a.c3d", &motion);
    folder.run(&["import", "a.c3d", "-o", "a.take"]).with_code(0);
    let report = folder.run(&["info", "a.take", "--json"]).with_code(0).json();
    let short = folder.run(&["info", "a.take"]).with_code(0).stdout;
    let long = folder.run(&["info", "a.take", "--markers"]).with_code(0).stdout;
    assert!(long.starts_with(&short), "{short}{long}");
    let n_markers = motion.info.markers.len();
    assert_eq!(long.lines().count(), short.lines().count() + 1 + n_markers);
    assert_mentions(&short, &["59.94 Hz", &format!("{n_markers} of {n_markers} markers seen")]);
    for figure in ["SR1", "SR2", "59.939"] {
        assert!(!long.contains(figure), "{long}");
    }
    assert!(report["sr1"].as_f64().is_some() && report["sr2"].as_f64().is_some());
    // The sizes of the file that was imported, and of the parts of the take.
    let source_bytes = folder.read("a.c3d").len() as u64;
    assert_eq!(report["source"]["bytes"], source_bytes);
    assert_mentions(&short, &["in the imported file", "for trajectories", "for the rest"]);
    let parts = report["foreign_parts"].as_array().unwrap().iter();
    let stored: u64 = parts.map(|part| part["stored_bytes"].as_u64().unwrap()).sum();
    assert!(stored > 0 && stored < report["bytes"]["foreign"].as_u64().unwrap(), "{report}");
}

/// Interrupted while encoding, as by Ctrl-C: the output is open, but has no name yet. (If a shell runs a test in
/// the background, its children ignore Ctrl-C.)
#[test]
fn an_import_that_is_interrupted_leaves_nothing() {
    let folder = Folder::new();
    let spec = JumpSpec { seconds: Some(8.0), ..JumpSpec::new(1, 120.0) };
    folder.write_motion("long.csv", &spec.generate().unwrap().motion);
    let before = folder.content();
    // Minutes of work, so that it cannot be done yet.
    let import = ["import", "long.csv", "-o", "new.take", "--resampler", "spline:exhaustive"];
    let mut child = folder.command(&import).spawn().unwrap();
    let begun = Instant::now();
    while !has_begun(&folder, child.id()) {
        assert!(begun.elapsed() < Duration::from_secs(60), "no output is begun");
        assert!(child.try_wait().unwrap().is_none(), "it ended");
        sleep(Duration::from_millis(5));
    }
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    assert_eq!(child.wait().unwrap().code(), None);
    assert!(folder.content() == before, "{:?}", folder.content().keys());
}

/// Whether a process has a file open in the folder besides the motion that it reads.
fn has_begun(folder: &Folder, process: u32) -> bool {
    let open = std::fs::read_dir(format!("/proc/{process}/fd")).into_iter().flatten();
    let open = open.filter_map(|entry| std::fs::read_link(entry.ok()?.path()).ok());
    let mut here = open.filter(|path| path.starts_with(folder.path("")));
    here.any(|path| path != folder.path("long.csv"))
}
