//! Output of `ctl` and `config check`: a short save, the warnings of `run`, the figures while armed, and the
//! stop of a failed take.

use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::{
    cli::{Folder, Ran, devices::Simulated},
    service::engine::wait_until,
    support::{assert_mentions, jump, mentions},
};

/// `mocapd run`, and `ctl` to control it.
struct Service<'a> {
    folder: &'a Folder,
    child: Child,
}

impl<'a> Service<'a> {
    /// Runs it under limits of the shell; also returns its standard error.
    fn run(folder: &'a Folder, limits: &str, device: &Path, config: &str) -> Self {
        let device = device.display();
        let config = format!(
            "[device]\nuri = 'serial:{device}'\n[take]\ndirectory = 'takes'\nlossless = true\n{config}"
        );
        folder.write("rig.toml", config);
        let script =
            format!("{limits} exec '{}' run --config rig.toml", env!("CARGO_BIN_EXE_mocapd"));
        let mut command = Command::new("sh");
        command.args(["-c", &script]).current_dir(folder.path("."));
        let child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        Self { folder, child }
    }

    fn ctl(&self, args: &[&str]) -> Ran {
        let connect = format!("unix:{}", self.folder.path("rig.sock").display());
        self.folder.run(&[&["ctl", "--connect", &connect], args].concat())
    }

    fn status(&self) -> Value {
        self.ctl(&["status", "--json"]).json()
    }

    fn wait_for_state(&self, state: &str) {
        wait_until("the socket", || self.folder.path("rig.sock").exists());
        wait_until(state, || self.status()["state"] == state);
    }
}

impl Drop for Service<'_> {
    fn drop(&mut self) {
        let pid = Pid::from_child(&self.child);
        kill_process(pid, Signal::TERM).ok();
        self.child.wait().ok();
    }
}

const ALONE: &str = "[http]\nsocket = 'rig.sock'\nlisten = ''\n";

#[test]
fn a_save_longer_than_the_pre_roll_is_reported_and_the_watch_shows_the_pre_roll() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 3.0));
    let service = Service::run(&folder, "", &device.path, ALONE);
    service.wait_for_state("armed");
    wait_until("half a second of pre-roll", || {
        service.status()["pre_roll"]["held_s"].as_f64().unwrap() > 1.0
    });
    let saved = service.ctl(&["save-last", "500s", "--json"]).with_code(0);
    let answer = saved.json();
    let short_by_s = answer["short_by_s"].as_f64().unwrap();
    assert!((short_by_s + answer["seconds"].as_f64().unwrap() - 500.0).abs() < 1e-6, "{answer}");
    assert_eq!(answer["remarks"].as_array().unwrap().len(), 1);
    assert!(saved.stderr.contains(answer["remarks"][0].as_str().unwrap()), "{}", saved.stderr);
    let whole = service.ctl(&["save-last", "500ms", "--json"]).with_code(0);
    assert_eq!((&whole.json()["short_by_s"], whole.stderr.as_str()), (&Value::from(0.0), ""));

    let connect = format!("unix:{}", folder.path("rig.sock").display());
    let mut watch =
        folder.command(&["ctl", "--connect", &connect, "status", "--watch"]).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(watch.stdout.take().unwrap()).read_line(&mut line).unwrap();
    watch.kill().unwrap();
    watch.wait().unwrap();
    assert_mentions(&line, &["armed", "lost", "Hz", "pre-roll", "free"]);
}

#[test]
fn config_check_warns_of_what_run_warns_of() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 1.0));
    let config = "[http]\nsocket = 'nowhere/rig.sock'\nlisten = '127.0.0.1:0'\n\
                  [trigger]\nlisten = '0.0.0.0:0'\n";
    let mut service = Service::run(&folder, "", &device.path, config);
    // Warnings precede the address of the dashboard.
    let lines = BufReader::new(service.child.stderr.take().unwrap()).lines().map(Result::unwrap);
    let lines: Vec<_> = lines.take_while(|line| !line.contains("http://")).collect();
    let warned: Vec<_> = lines.iter().filter_map(|line| line.split_once(" WARN ")).collect();
    let checked = folder.run(&["config", "check", "rig.toml", "--json"]).with_code(0).json();
    let notes = checked["notes"].as_array().unwrap();
    assert_eq!((warned.len(), notes.len()), (2, 2), "{lines:?} {notes:?}");
    for note in notes {
        let note = note.as_str().unwrap();
        assert!(warned.iter().any(|(_, warning)| warning.starts_with(note)), "{note}: {warned:?}");
    }
}

#[test]
fn a_stop_of_a_take_that_has_failed_says_why() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 3.0));
    // No file grows beyond 32 KiB at most: the take fails after a second or two, and an earlier one is in the folder.
    let limits = "trap '' XFSZ; ulimit -f 32;";
    let config = format!("{ALONE}[arm]\npre_roll = '0s'\n");
    let service = Service::run(&folder, limits, &device.path, &config);
    service.wait_for_state("armed");
    service.ctl(&["start", "--name", "before"]).with_code(0);
    service.ctl(&["stop"]).with_code(0);
    service.ctl(&["start", "--name", "fails"]).with_code(0);
    service.wait_for_state("failed");
    let failure = service.status()["failure"].as_str().unwrap().to_owned();
    let refused = service.ctl(&["stop"]).with_code(1);
    assert!(failure.contains("fails") && refused.stderr.contains(&failure), "{}", refused.stderr);
    // The answer is not about the take before.
    assert!(!mentions(&refused.stderr, "before"), "{}", refused.stderr);
}
