//! `--pty`, `--pty PATH` and `--pty=PATH`, before and after what is played.

use std::path::Path;

use rustix::process::{Pid, Signal, kill_process};

use super::{ended, fails, sim, started};

/// A motion of two markers, and a log without an extension, in a folder of their own.
struct Files {
    folder: tempfile::TempDir,
}

impl Files {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let rows: String =
            (0..30).map(|i| format!("{},{i},0,0,0,{i},0\n", f64::from(i) / 60.0)).collect();
        let csv = format!("time,a_x,a_y,a_z,b_x,b_y,b_z\n{rows}");
        std::fs::write(folder.path().join("jump.csv"), csv).unwrap();
        let log = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/logs/stall.rawlog");
        std::fs::copy(log, folder.path().join("log")).unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).to_str().unwrap().to_owned()
    }

    /// The arguments with JUMP, LOG and LINK replaced by paths.
    fn arguments(&self, words: &str) -> Vec<String> {
        let replaced =
            words.replace("JUMP", &self.path("jump.csv")).replace("LOG", &self.path("log"));
        replaced.replace("LINK", &self.path("rig")).split(' ').map(str::to_owned).collect()
    }
}

/// The path that a simulator with these arguments prints; it has ended again.
fn served(files: &Files, words: &str) -> String {
    let arguments = files.arguments(words);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (child, path) = started(&arguments);
    assert!(Path::new(&path).exists(), "{words} printed '{path}'");
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    assert_eq!(ended(child).0, Some(0), "{words}");
    path
}

#[test]
fn a_path_after_the_option_is_the_link_at_any_position() {
    let files = Files::new();
    for words in [
        "JUMP --pty LINK",
        "JUMP --pty=LINK",
        "--pty LINK JUMP",
        "--pty=LINK JUMP",
        "--pty LINK --loop JUMP",
        "--loop --pty LINK -- JUMP",
        "--pty LINK LOG",
        "LOG --pty LINK",
        "--generate jump --pty LINK",
        "--pty LINK --generate jump",
    ] {
        assert_eq!(served(&files, words), files.path("rig"), "{words}");
        assert!(std::fs::symlink_metadata(files.path("rig")).is_err(), "{words}: the link stays");
    }
}

#[test]
fn pty_without_a_path_creates_no_link() {
    let files = Files::new();
    for words in [
        "JUMP --pty",
        "--pty JUMP",
        "--pty=JUMP",
        "--pty --loop JUMP",
        "--pty -- JUMP",
        "--pty LOG",
        "LOG --pty",
        "--generate jump --pty",
        "--pty --generate jump",
    ] {
        assert!(served(&files, words).starts_with("/dev/pts/"), "{words}");
    }
}

#[test]
fn a_file_to_play_is_never_the_link() {
    let files = Files::new();
    for (words, facts) in [
        ("--pty LINK", &["nothing to play", "--generate jump"][..]),
        ("--pty=LINK --loop", &["nothing to play"]),
        ("--pty", &["nothing to play"]),
        ("JUMP --pty LOG", &["log is a motion or a log", "link to create"]),
        ("--pty JUMP LOG", &["jump.csv is a motion or a log"]),
        ("JUMP --pty LINK.take", &["rig.take is a motion or a log"]),
        ("--generate jump --pty JUMP", &["jump.csv is a motion or a log"]),
    ] {
        let arguments = files.arguments(words);
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let message = fails(&arguments, 2);
        for fact in facts {
            assert!(message.contains(fact), "{words}: {message}");
        }
        assert_eq!(message.lines().count(), 1, "{words}: {message}");
    }
    assert!(std::fs::metadata(files.path("jump.csv")).unwrap().len() > 100, "untouched");
    // Options of generated motions need one, regardless of what follows --pty.
    let jump = files.path("jump.csv");
    let message = fails(&["--pty", &jump, "--markers", "3"], 2);
    assert!(message.contains("--generate"), "{message}");
}

#[test]
fn json_has_the_path_and_the_sent_totals() {
    let files = Files::new();
    let jump = files.path("jump.csv");
    let mut child = sim(&["--json", "--pty", &jump]).spawn().unwrap();
    let mut out = std::io::BufReader::new(child.stdout.take().unwrap());
    let mut line = String::new();
    std::io::BufRead::read_line(&mut out, &mut line).unwrap();
    let document: serde_json::Value = serde_json::from_str(&line).unwrap();
    let path = document["path"].as_str().unwrap();
    assert_eq!(super::record(path), 30);
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    let (code, message) = ended(child);
    assert_eq!(code, Some(0), "{message}");
    let rest = std::io::read_to_string(out).unwrap();
    let report: serde_json::Value = serde_json::from_str(&rest).unwrap();
    assert_eq!((&report["runs"], &report["frames"]["sent"]), (&1.into(), &30.into()), "{report}");
    assert_eq!(report["faults"], serde_json::Value::Null);
    let page = include_str!("../../../docs/json.md");
    let (_, page) = page.split_once("## `mocapd-sim serve`").unwrap();
    let documented = |path: &str| page.contains(&format!("| `{path}` |"));
    for (name, value) in report.as_object().unwrap() {
        assert!(documented(name), "{name} is not in docs/json.md");
        for inner in value.as_object().into_iter().flat_map(serde_json::Map::keys) {
            assert!(
                documented(&format!("{name}.{inner}")),
                "{name}.{inner} is not in docs/json.md"
            );
        }
    }
}
