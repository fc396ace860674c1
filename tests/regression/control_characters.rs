//! A mark with a newline wrote a separate line into the log; labels and file names could control a terminal.

use std::{
    fs::File,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use mocapd_take::{
    interchange::Format,
    motion::{FrameSource, MotionFrames},
};
use rustix::process::{Pid, Signal, kill_process};

use crate::{
    cli::{Folder, devices::Simulated},
    service::engine::read,
    support::{config, dense, jump, record},
};

/// A new line, a forged log line, a clear screen, a change of text direction, hidden text, other line separators.
const HOSTILE: &str = "first\n2026-01-01T00:00:00Z ERROR forged\x1b[2J\u{9b}31m\u{202e}\u{2066}\u{200f}\u{61c}\u{2028}\r\u{7f}";

/// The control and formatting characters of a text, except line ends.
fn unsafe_characters(text: &str) -> Vec<char> {
    let is_format = |c: char| matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    text.chars().filter(|&c| c != '\n' && (c.is_control() || is_format(c))).collect()
}

/// `mocapd run` in a separate process, with its log in a file.
pub(super) struct Service {
    child: Child,
}

impl Service {
    pub(super) fn start(folder: &Folder, device: &Simulated, more: &[(&str, &str)]) -> Self {
        folder.write(
            "rig.toml",
            format!(
                "[device]\nuri = '{}'\n[take]\ndirectory = 'takes'\n[http]\nsocket = 'rig.sock'\nlisten = ''\n",
                device.uri()
            ),
        );
        let mut run: Command = folder.command(&["run", "--config", "rig.toml"]);
        let log = File::create(folder.path("log")).unwrap();
        run.envs(more.iter().copied()).stdout(Stdio::null()).stderr(log);
        let child = run.spawn().unwrap();
        let service = Self { child };
        service.until(folder, |status| status["state"] == "armed");
        service
    }

    fn until(&self, folder: &Folder, is_so: impl Fn(&serde_json::Value) -> bool) {
        let began = Instant::now();
        loop {
            let ran = ctl(folder, &["status", "--json"]);
            if ran.code == Some(0) && is_so(&ran.json()) {
                return;
            }
            assert!(began.elapsed() < Duration::from_secs(20), "{ran:?}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub(super) fn end(&mut self) {
        let pid = Pid::from_child(&self.child);
        if kill_process(pid, Signal::TERM).is_ok() {
            self.child.wait().unwrap();
        }
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // Fails if the process has ended already, which is fine.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

pub(super) fn ctl(folder: &Folder, args: &[&str]) -> crate::cli::Ran {
    let args = ["ctl", "--connect", "unix:rig.sock"].iter().chain(args);
    folder.command(&args.collect::<Vec<_>>()).output().unwrap().into()
}

#[test]
fn a_mark_is_one_line_of_the_log() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 3.0));
    let mut service = Service::start(&folder, &device, &[]);
    ctl(&folder, &["start", "--name", "walk", "--notes", HOSTILE]).with_code(0);
    ctl(&folder, &["mark", HOSTILE]).with_code(0);
    events_are_exact_and_command_no_terminal(&folder);
    let watched = ctl(&folder, &["status", "--json"]).with_code(0);
    assert_eq!(unsafe_characters(&watched.stdout), Vec::<char>::new(), "{watched:?}");
    let stopped = ctl(&folder, &["stop"]);
    assert!(matches!(stopped.code, Some(0 | 3)), "{stopped:?}");
    service.end();
    let log = folder.text("log");
    let forged: Vec<_> = log.lines().filter(|line| line.contains("forged")).collect();
    assert!(!forged.is_empty() && forged.iter().all(|line| line.contains("first")), "{log}");
    assert_eq!(unsafe_characters(&log), Vec::<char>::new(), "{log:?}");
    // The take has it exactly.
    let take = read(&folder.path("takes/walk.take"));
    assert!(take.take.events.iter().any(|event| event.text == HOSTILE), "{:?}", take.take.events);
}

fn events_are_exact_and_command_no_terminal(folder: &Folder) {
    folder.write("events", "");
    let events = File::options().append(true).open(folder.path("events")).unwrap();
    let mut follow = folder.command(&["ctl", "--connect", "unix:rig.sock", "events", "--json"]);
    let follow = follow.stdout(events).stderr(Stdio::null()).spawn().unwrap();
    // Killed at the end of the scope.
    let _follow = Service { child: follow };
    let began = Instant::now();
    let line = loop {
        // It receives events once it is connected.
        ctl(folder, &["mark", HOSTILE]).with_code(0);
        let text = folder.text("events");
        if let Some(line) = text.lines().find(|line| line.contains("forged") && line.ends_with('}'))
        {
            break line.to_owned();
        }
        assert!(began.elapsed() < Duration::from_secs(20), "{text:?}");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(unsafe_characters(&line), Vec::<char>::new(), "{line:?}");
    let event: serde_json::Value = serde_json::from_str(&line).unwrap();
    assert!(event["message"].as_str().unwrap().contains(HOSTILE), "{line:?}");
}

#[test]
fn names_of_files_and_labels_do_not_control_the_terminal() {
    let folder = Folder::new();
    let mut motion = jump(1, 60.0, 0.5);
    motion.info.markers[0].label = HOSTILE.to_owned();
    let take = record(&motion, &config(&motion, dense(0.5)), 0..motion.n_frames()).1;
    let name = format!("{}.take", HOSTILE.replace('/', ""));
    folder.write(&name, &take);
    folder.write("cut.take", &take[..take.len() * 2 / 3]);
    for args in [
        &["info", &name][..],
        &["verify", &name],
        &["recover", "cut.take", "-o", &format!("r{name}")],
        &["export", &name, "-o", &format!("{name}.csv")],
        // Refused, with the name in the reason.
        &["export", &name, "-o", &name],
        &["info", "no\x1b[2J\nsuch.take"],
        &["info", &name, "--no\u{202e}such"],
    ] {
        let ran = folder.run(args);
        for text in [&ran.stdout, &ran.stderr] {
            assert_eq!(unsafe_characters(text), Vec::<char>::new(), "{args:?}: {text:?}");
            assert!(!text.lines().any(|line| line.starts_with("2026-01-01")), "{args:?}: {text:?}");
        }
    }
    // JSON escapes them, and keeps the exact text.
    let ran = folder.run(&["info", &name, "--json"]).with_code(0);
    assert_eq!(unsafe_characters(&ran.stdout), Vec::<char>::new(), "{ran:?}");
    assert_eq!(ran.json()["channels"][0]["label"], HOSTILE);
}

#[test]
fn labels_in_a_csv_file_are_text_and_come_back() {
    let folder = Folder::new();
    let labels =
        [HOSTILE, "=1+1", "@sum", "-2", "+3", "\t=4", "\\u{a}", "＝5", "S01:\\nose", "a,\"b\"#"];
    let mut motion = jump(1, 60.0, 0.5);
    for (marker, label) in motion.info.markers.iter_mut().zip(labels) {
        marker.label = label.to_owned();
    }
    let take = record(&motion, &config(&motion, dense(0.5)), 0..motion.n_frames()).1;
    folder.write("a.take", take);
    for layout in ["wide", "long"] {
        let name = format!("{layout}.csv");
        let command = ["export", "a.take", "-o", &name, "--layout", layout];
        folder.run(&command).with_code(0);
        let csv = folder.text(&name);
        assert_eq!(unsafe_characters(&csv), Vec::<char>::new());
        let found = Format::Csv.read(csv.as_bytes()).unwrap();
        let found: Vec<&str> =
            found.info.markers.iter().map(|marker| marker.label.as_str()).collect();
        for label in labels {
            assert!(found.contains(&label), "{label:?} is not in {found:?}");
        }
        // For a spreadsheet no label begins a formula.
        let name = format!("spreadsheet-{layout}.csv");
        let command = ["export", "a.take", "-o", &name, "--layout", layout, "--for-spreadsheet"];
        folder.run(&command).with_code(0);
        let csv = folder.text(&name);
        let found = Format::Csv.read(csv.as_bytes()).unwrap();
        let mut guarded = 0;
        for marker in MotionFrames::new(&found).info().markers.clone() {
            assert!(
                !marker.label.starts_with(['=', '+', '-', '@', '\t', '\r', '＝']),
                "{marker:?}"
            );
            guarded += usize::from(marker.label.starts_with('\''));
        }
        assert_eq!(guarded, 6, "{layout}");
    }
    folder.refuses(&["export", "a.take", "-o", "a.trc", "--for-spreadsheet"], 2);
}
