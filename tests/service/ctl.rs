//! `mocapd ctl` with a fake service: output, JSON, exit codes.

use std::{
    io::{BufRead, BufReader},
    process::{Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use mocapd_acquire::files::NameTaken;
use mocapd_service::{
    control::{Control, Request},
    http::{HttpOptions, HttpServer},
    status::{ServiceEventKind, State},
};
use mocapd_take::record::EndingKind;
use serde_json::Value;

use super::fake::Fake;
use crate::{cli::Folder, support::assert_mentions};

const TOKEN: &str = "correct-horse-battery-staple";

struct Rig {
    folder: Folder,
    fake: Arc<Fake>,
    server: HttpServer,
    connect: String,
}

fn rig() -> Rig {
    let folder = Folder::new();
    let takes = folder.path("takes");
    std::fs::create_dir(&takes).unwrap();
    let fake = Fake::new(&takes, super::http::take());
    let socket = folder.path("rig.sock");
    let options = HttpOptions {
        unix_socket: Some(socket.clone()),
        tcp: Some("127.0.0.1:0".parse().unwrap()),
        token: Some(TOKEN.to_owned()),
        ..HttpOptions::default()
    };
    let server = HttpServer::start(options, fake.clone()).unwrap();
    Rig { folder, fake, server, connect: format!("unix:{}", socket.display()) }
}

impl Rig {
    fn ctl(&self, args: &[&str]) -> crate::cli::Ran {
        self.folder.run(&[&["ctl", "--connect", &self.connect], args].concat())
    }
}

#[test]
fn a_session_from_the_command_line() {
    let rig = rig();
    let stdout = |args: &[&str]| rig.ctl(args).with_code(0).stdout;
    assert_mentions(&stdout(&["status"]), &["fake", "idle"]);
    assert_mentions(&stdout(&["arm"]), &["armed"]);
    let started = stdout(&["start", "--name", "jump", "--notes", "left shoe", "--pre-roll", "5s"]);
    assert_mentions(&started, &["jump.take"]);
    assert_mentions(&stdout(&["status"]), &["recording", "jump"]);
    assert_mentions(&stdout(&["mark", "take off"]), &["60"]);
    assert_mentions(&stdout(&["stop"]), &["120 frames", EndingKind::Stopped.name()]);
    assert_mentions(&stdout(&["save-last", "30s", "--name", "last"]), &["last.take"]);
    let takes = stdout(&["takes"]);
    assert_eq!(takes.lines().count(), 2, "{takes}");
    assert_mentions(&takes, &["jump", "last"]);
    stdout(&["download", "jump"]);
    assert_eq!(rig.folder.read("jump.take"), rig.folder.read("takes/jump.take"));
    assert!(!rig.folder.content().iter().any(|file| file.0 == "jump.notes.json"));
    let again = rig.ctl(&["download", "jump"]).with_code(1);
    let exists = NameTaken { path: "jump.take".into() };
    assert_eq!(again.stderr, format!("mocapd: {exists}\n"));
    let report = rig.ctl(&["download", "jump", "-o", "other.take", "--json"]).with_code(0).json();
    assert_eq!(report["bytes"], rig.folder.read("other.take").len());
    assert_eq!(rig.ctl(&["takes", "--limit", "1", "--json"]).json()[0]["name"], "last");
    assert!(rig.ctl(&["devices", "--json"]).with_code(0).json().is_array());
    assert_mentions(&stdout(&["disarm"]), &["idle"]);
    assert_eq!(rig.ctl(&["status", "--json"]).json()["state"], "idle");
}

#[test]
fn finished_takes_from_the_command_line() {
    let rig = rig();
    let stdout = |args: &[&str]| rig.ctl(args).with_code(0).stdout;
    stdout(&["start", "--name", "jump"]);
    stdout(&["stop"]);
    let rated = stdout(&["rate", "jump", "good", "--notes", "left shoe\nsecond line"]);
    assert_mentions(&rated, &["jump", "good", "second line"]);
    assert_mentions(&stdout(&["rate", "jump", "bad"]), &["bad", "second line"]);
    let takes = stdout(&["takes"]);
    assert!(takes.lines().count() == 1 && takes.contains("[bad: left"), "{takes}");
    rig.ctl(&["rate", "jump"]).with_code(2);
    rig.ctl(&["rate", "jump", "great"]).with_code(2);
    rig.ctl(&["rate", "none", "good"]).with_code(1);
    assert_mentions(&stdout(&["rename", "jump", "walk 1"]), &["walk 1.take"]);
    rig.ctl(&["rename", "walk 1", "../x"]).with_code(2);
    rig.ctl(&["rename", "jump", "x"]).with_code(1);
    // Both files are downloaded, or none.
    rig.folder.write("walk 1.notes.json", "mine");
    rig.ctl(&["download", "walk 1"]).with_code(1);
    assert!(!rig.folder.content().iter().any(|file| file.0 == "walk 1.take"));
    let report = rig.ctl(&["download", "walk 1", "-o", "copy.take", "--json"]).with_code(0).json();
    assert_eq!(report["notes"], "copy.notes.json");
    for name in ["take", "notes.json"] {
        let taken = rig.folder.read(&format!("takes/walk 1.{name}"));
        assert_eq!(rig.folder.read(&format!("copy.{name}")), taken);
    }
    assert_mentions(&stdout(&["trash", "walk 1"]), &["walk 1", "until"]);
    assert_mentions(&stdout(&["trashed"]), &["1796000000000-0000000000000.walk 1"]);
    assert_eq!(stdout(&["takes"]), "no takes\n");
    rig.ctl(&["restore", "jump"]).with_code(1);
    assert_mentions(&stdout(&["restore", "walk 1", "--to", "jump"]), &["jump.take"]);
    assert_eq!(stdout(&["trashed"]), "the trash is empty\n");
    assert_eq!(rig.ctl(&["takes", "--json"]).json()[0]["notes"]["rating"], "bad");
}

#[test]
fn a_start_that_waits_is_shown_and_cancelled() {
    let rig = rig();
    let waits = rig.ctl(&["start", "--at", "14:05:00", "--seconds", "2min"]).with_code(0);
    assert_mentions(&waits.stdout, &["will be started", "14:05:00"]);
    assert_mentions(&waits.stderr, &["not armed"]);
    assert_mentions(&rig.ctl(&["status"]).stdout, &["will be started at 14:05:00"]);
    rig.ctl(&["start", "--at", "15:05:00"]).with_code(1);
    assert_mentions(&rig.ctl(&["stop"]).with_code(0).stdout, &["14:05:00", "cancelled"]);
    rig.ctl(&["cancel"]).with_code(1);
    rig.ctl(&["start", "--at", "noon"]).with_code(2);
    for seconds in ["0", "-1", "x", "nan", "1 floppy"] {
        rig.ctl(&["start", "--seconds", seconds]).with_code(2);
    }
    rig.ctl(&["start", "--seconds", "10", "--name", "a"]).with_code(0);
    rig.ctl(&["start", "--at", "14:05:00"]).with_code(0);
    let stopped = rig.ctl(&["stop"]).with_code(0);
    assert_mentions(&stopped.stderr, &["still waits", "ctl cancel"]);
    rig.ctl(&["cancel"]).with_code(0);
    rig.ctl(&["arm"]).with_code(0);
    rig.ctl(&["save-last", "--name", "all"]).with_code(0);
}

#[test]
fn exit_codes_match_the_other_commands() {
    let rig = rig();
    let refused = rig.ctl(&["stop"]).with_code(1);
    // The message of the service.
    let message = rig.fake.stop(&Request::default()).unwrap_err().message;
    assert_mentions(&refused.stderr, &[&message]);
    assert_eq!(refused.stdout, "");
    rig.ctl(&["start", "--name", "../x"]).with_code(2);
    rig.ctl(&["save-last", "0"]).with_code(2);
    rig.ctl(&["takes", "--limit", "0"]).with_code(2);
    rig.ctl(&["download", "none"]).with_code(1);
    rig.ctl(&["download", "../../etc/passwd"]).with_code(1);
    assert!(rig.folder.content().iter().all(|file| !file.0.ends_with("passwd.take")));
    rig.fake.lose(3);
    rig.ctl(&["start"]).with_code(0);
    let lossy = rig.ctl(&["stop", "--json"]).with_code(3);
    assert_mentions(&lossy.stderr, &["3 frames"]);
    assert_eq!(lossy.json()["ledger"]["lost_on_link"], 3);
    let unreachable =
        rig.folder.run(&["ctl", "--connect", "unix:none.sock", "status"]).with_code(1);
    assert_mentions(&unreachable.stderr, &["unix:none.sock"]);
    rig.folder.run(&["ctl", "--connect", "ftp://x", "status"]).with_code(2);
}

#[test]
fn over_tcp_the_token_is_needed() {
    let rig = rig();
    let address = format!("http://{}", rig.server.tcp_address().unwrap());
    let status =
        |more: &[&str]| rig.folder.run(&[&["ctl", "--connect", &address, "status"], more].concat());
    assert_mentions(&status(&[]).with_code(1).stderr, &[&address, "--token-file"]);
    rig.folder.write("token", format!("{TOKEN}\n"));
    status(&["--token-file", "token"]).with_code(0);
    rig.folder.write("wrong", "something-else-entirely");
    status(&["--token-file", "wrong"]).with_code(1);
    rig.folder.write("empty", "");
    status(&["--token-file", "empty"]).with_code(1);
}

#[test]
fn events_are_followed() {
    let rig = rig();
    let mut child = Command::new(env!("CARGO_BIN_EXE_mocapd"))
        .args(["ctl", "--connect", &rig.connect, "events", "--json"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap());
    let done = AtomicBool::new(false);
    let line = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                rig.fake.feeds.publish(
                    ServiceEventKind::Mark,
                    "take off".to_owned(),
                    State::Recording,
                    None,
                );
                std::thread::sleep(Duration::from_millis(50));
            }
        });
        let mut line = String::new();
        lines.read_line(&mut line).unwrap();
        done.store(true, Ordering::Relaxed);
        line
    });
    child.kill().unwrap();
    child.wait().unwrap();
    let event: Value = serde_json::from_str(&line).unwrap();
    assert_eq!((&event["kind"], &event["message"]), (&"mark".into(), &"take off".into()));
}
