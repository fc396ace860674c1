//! `mocapd-sim generate`: its files, its report, and how it is interrupted.

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rustix::fs::{Mode, OFlags};
use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};

use super::ended;

#[test]
fn a_data_set_of_jumps() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("jumps");
    let generate = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_mocapd-sim"));
        command.args(["generate", "--subjects", "2", "--out"]).arg(&out);
        command.args(more).output().unwrap()
    };
    for more in [&["--jumps", "0"][..], &["--jumps", "3", "--rate", "0.5"]] {
        let refused = generate(more);
        assert_eq!(refused.status.code(), Some(2), "{refused:?}");
        assert!(!out.exists(), "a refused value creates nothing");
    }
    let done = generate(&["--jumps", "3", "--rate", "30Hz"]);
    assert_eq!(done.status.code(), Some(0));
    let text = String::from_utf8(done.stdout).unwrap();
    assert!(
        text.contains("3 jumps by 2 subjects") && text.contains("15 markers at 30 Hz"),
        "{text}"
    );
    assert!(done.stderr.is_empty(), "a pipe shows no progress");
    let mut names: Vec<String> = std::fs::read_dir(&out)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let jumps = ["subject-01-jump-01.c3d", "subject-01-jump-02.c3d", "subject-02-jump-01.c3d"];
    assert_eq!(names[..1], ["phases.csv"]);
    assert_eq!(names[1..], jumps);
    let phases = std::fs::read_to_string(out.join("phases.csv")).unwrap();
    assert!(phases.starts_with("file,phase,first_frame\n"));
    for jump in jumps {
        assert_eq!(phases.matches(&format!("\n{jump},")).count(), 7, "{phases}");
    }
    let again = generate(&["--jumps", "3", "--rate", "30"]);
    assert_eq!(again.status.code(), Some(1), "an existing folder is not overwritten");
}

/// Jumps that take minutes to generate, into `out`.
fn long(out: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mocapd-sim"));
    command.args(["generate", "--rate", "10kHz", "--out"]).arg(out);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

#[test]
fn ctrl_c_takes_effect_quickly_and_leaves_no_files() {
    let place = tempfile::tempdir().unwrap();
    let mut child = long(&place.path().join("jumps")).spawn().unwrap();
    while std::fs::read_dir(place.path()).unwrap().count() == 0 {
        assert!(child.try_wait().unwrap().is_none(), "it ended");
        std::thread::sleep(Duration::from_millis(10));
    }
    std::thread::sleep(Duration::from_millis(300));
    kill_process(Pid::from_child(&child), Signal::INT).unwrap();
    let signalled = Instant::now();
    let (code, message) = ended(child);
    // 0.3 s are promised; the rest is for a machine that is busy with other tests.
    assert!(signalled.elapsed() < Duration::from_millis(1500), "{:?}", signalled.elapsed());
    assert_eq!(code, Some(1), "{message}");
    assert!(message.contains("interrupted: ") && message.lines().count() == 1, "{message}");
    assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 0, "something is left");
}

#[test]
fn a_terminal_shows_the_percentage_and_the_time_left() {
    let place = tempfile::tempdir().unwrap();
    let terminal = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&terminal).unwrap();
    unlockpt(&terminal).unwrap();
    let name = ptsname(&terminal, Vec::new()).unwrap();
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let stderr = rustix::fs::open(name, flags, Mode::empty()).unwrap();
    let size = Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 };
    tcsetwinsize(&stderr, size).unwrap();
    let mut command = long(&place.path().join("jumps"));
    command.env("TERM", "xterm").stderr(Stdio::from(stderr));
    let mut child = command.spawn().unwrap();
    // The command holds the other copy of the terminal, without which reading would not end.
    drop(command);
    let (mut shown, mut buffer) = (String::new(), [0; 4096]);
    let mut terminal = File::from(terminal);
    while !(shown.contains("generating") && shown.contains(" %")) {
        let n = terminal.read(&mut buffer).unwrap();
        shown.push_str(&String::from_utf8_lossy(&buffer[..n]));
    }
    kill_process(Pid::from_child(&child), Signal::INT).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(1), "{shown}");
}

#[test]
fn the_report_is_documented() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("jumps");
    let mut command = Command::new(env!("CARGO_BIN_EXE_mocapd-sim"));
    command.args(["generate", "--jumps", "1", "--subjects", "1", "--json", "--out"]).arg(&out);
    let output = command.output().unwrap();
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let on_disk =
        |entry: std::io::Result<std::fs::DirEntry>| entry.unwrap().metadata().unwrap().len();
    let bytes: u64 = std::fs::read_dir(&out).unwrap().map(on_disk).sum();
    assert_eq!((&report["jumps"], &report["file_bytes"]), (&1.into(), &bytes.into()), "{report}");
    let page = include_str!("../../../docs/json.md");
    let (_, page) = page.split_once("## `mocapd-sim generate`").unwrap();
    for name in report.as_object().unwrap().keys() {
        assert!(page.contains(&format!("| `{name}` |")), "{name} is not in docs/json.md");
    }
}
