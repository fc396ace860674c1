//! `mocapd-sim` as a program: its one line, its exit codes, its words.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::HashSet;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use mocapd_drivers::device::{Command as Say, DeviceEvent, Protocol};
use mocapd_drivers::link::HostLink;
use mocapd_drivers::plain_file::NotAFile;
use mocapd_drivers::raw_log::records;
use mocapd_drivers::transport::serial::SerialTransport;
use mocapd_drivers::transport::{Transport, TransportError};
use rustix::process::{Pid, Signal, kill_process};

fn sim(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mocapd-sim"));
    command.arg("serve").args(args).stdin(Stdio::null());
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn fails(args: &[&str], code: i32) -> String {
    let Output { status, stdout, stderr } = sim(args).output().unwrap();
    let words = String::from_utf8(stderr).unwrap();
    assert_eq!(status.code(), Some(code), "{args:?}: {words}");
    assert!(stdout.is_empty(), "{args:?} printed on stdout");
    words
}

/// The whole numbers in words.
fn numbers(words: &str) -> Vec<u64> {
    words.split(|c: char| !c.is_alphanumeric()).filter_map(|word| word.parse().ok()).collect()
}

/// A running simulator, and the path that it printed.
fn started(args: &[&str]) -> (Child, String) {
    let mut child = sim(args).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
    (child, line.trim_end().to_owned())
}

fn ended(mut child: Child) -> (Option<i32>, String) {
    let give_up = Instant::now() + Duration::from_secs(20);
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if Instant::now() > give_up {
            child.kill().unwrap();
        }
        std::thread::sleep(Duration::from_millis(10));
    };
    let mut words = String::new();
    child.stderr.unwrap().read_to_string(&mut words).unwrap();
    (status.code(), words)
}

/// Opens a line. One that was just closed may be busy for a moment: what another test starts has it open, too, between its
/// fork and its exec.
fn open(path: &str) -> SerialTransport {
    let give_up = Instant::now() + Duration::from_secs(5);
    loop {
        match SerialTransport::open(Path::new(path), None) {
            Err(TransportError::Busy { .. }) if Instant::now() < give_up => {
                std::thread::sleep(Duration::from_millis(10));
            }
            opened => return opened.unwrap(),
        }
    }
}

/// Records until the end of stream, and counts frames.
fn record(path: &str) -> u64 {
    let mut port = open(path);
    let mut link = HostLink::new();
    let mut bytes = Vec::new();
    link.command(Say::Identify, &mut bytes);
    link.command(Say::Start { line_bytes_per_s: 0 }, &mut bytes);
    port.write_all(&bytes).unwrap();
    let give_up = Instant::now() + Duration::from_secs(20);
    let (mut n_frames, mut at_end) = (0, false);
    let mut buffer = [0; 4096];
    while !at_end {
        assert!(Instant::now() < give_up, "{n_frames} frames and no end");
        let n = port.read(&mut buffer).unwrap();
        link.push(&buffer[..n], &mut |event| match event {
            DeviceEvent::Frame(_) => n_frames += 1,
            DeviceEvent::EndOfStream(_) => at_end = true,
            _ => {}
        });
    }
    n_frames
}

#[test]
fn refused_values_exit_2_and_failures_1() {
    let words = fails(&["/nowhere/a.xyz", "--pty"], 2);
    assert!(words.contains("/nowhere/a.xyz") && words.contains(".c3d"), "{words}");
    let words = fails(&["/nowhere/a.csv", "--pty"], 1);
    assert!(words.contains("/nowhere/a.csv") && words.contains("os error 2"), "{words}");
    assert_eq!(words.lines().count(), 1, "{words}");
    for bad in [
        &["--generate", "jump", "--pty", "--rate", "0"][..],
        &["--generate", "jump", "--pty", "--rate", "10001"],
        &["--generate", "jump", "--pty", "--speed", "-1"],
        &["--generate", "jump", "--pty", "--speed", "1000"],
        &["--generate", "jump", "--pty", "--markers", "0"],
        &["--generate", "jump", "--pty", "--seconds", "0s"],
        &["--generate", "hop", "--pty"],
        &["--generate", "jump", "--pty", "--baud", "0"],
        &["--generate", "jump", "--pty", "--loop", "--once"],
        &["--generate", "jump"],
        &["a.csv", "--pty", "--markers", "3"],
        &["a.csv", "--generate", "jump", "--pty"],
        &["--pty"],
        &["--generate", "jump", "--pty", "--tool", "head"],
        &["--generate", "jump", "--pty", "--no-bx2"],
        &["--generate", "jump", "--pty", "--protocol", "vicon"],
        &["--generate", "jump", "--pty", "--protocol", "ndi", "--wire", "um"],
        &["--generate", "jump", "--pty", "--protocol", "ndi", "--tool", "nobody"],
        &["--generate", "jump", "--pty", "--protocol", "ndi", "--faults", "faults/garbage.toml"],
    ] {
        fails(bad, 2);
    }
    let words = fails(&["--generate", "jump", "--pty", "--log", "/nowhere/log.csv"], 1);
    assert!(words.contains("/nowhere/log.csv"), "{words}");
    let folder = tempfile::tempdir().unwrap();
    let taken = folder.path().join("taken");
    std::fs::write(&taken, "").unwrap();
    let link = format!("--pty={}", taken.display());
    let words = fails(&["--generate", "jump", &link], 2);
    assert!(words.contains(taken.to_str().unwrap()), "{words}");
}

#[test]
fn a_machine_that_cannot_be_a_usb_device_says_so() {
    for bad in [
        &["--generate", "jump", "--usb-gadget", "--pty"][..],
        &["--generate", "jump", "--usb-gadget", "--usb-serial"],
        &["--generate", "jump", "--usb-gadget", "--baud", "9600"],
        &["--generate", "jump", "--pty", "--udc", "dummy_udc.0"],
    ] {
        fails(bad, 2);
    }
    let words = fails(&["--generate", "jump", "--usb-gadget", "--serial", "two words"], 2);
    assert!(words.contains("'two words'"), "{words}");
    if std::fs::read_dir("/sys/class/udc").is_ok_and(|mut all| all.next().is_some()) {
        eprintln!("skipped: this machine can be a USB device");
        return;
    }
    for line in ["--usb-gadget", "--usb-serial"] {
        let words = fails(&["--generate", "jump", line], 1);
        assert!(words.contains("hardware-in-the-loop.md"), "{words}");
        assert!(words.contains("`sudo modprobe dummy_hcd`"), "{words}");
    }
}

#[test]
fn one_line_one_run_and_out() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("rig");
    let log = folder.path().join("sent.csv");
    let pty = format!("--pty={}", link.display());
    let (child, path) = started(&[
        "--generate",
        "jump:5",
        &pty,
        "--rate",
        "500",
        "--seconds",
        "300ms",
        "--once",
        "--log",
        log.to_str().unwrap(),
    ]);
    assert_eq!(path, link.to_str().unwrap());
    assert_eq!(record(&path), 150);
    let (code, words) = ended(child);
    assert_eq!(code, Some(0), "{words}");
    let said = numbers(&words);
    assert_eq!(said.iter().filter(|n| **n == 150).count(), 2, "produced and sent: {words}");
    assert_eq!(std::fs::read_to_string(&log).unwrap().lines().count(), 151);
    let again = fails(&["--generate", "jump", "--pty", "--log", log.to_str().unwrap()], 1);
    assert!(again.contains(log.to_str().unwrap()) && !again.contains("os error 2"), "{again}");
    assert!(std::fs::symlink_metadata(&link).is_err(), "the link is still there");
}

#[test]
fn scripts_of_faults_are_refused_in_words_and_played() {
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("faults.toml");
    let with = |more: &[&'static str]| {
        let mut args = vec!["--generate", "jump:5", "--seconds", "1s", "--faults"];
        let path: &'static str = script.to_str().unwrap().to_owned().leak();
        args.push(path);
        args.extend(more);
        args
    };
    let words = fails(&with(&["--pty"]), 1);
    assert!(words.contains("faults.toml") && words.contains("os error 2"), "{words}");
    std::fs::write(&script, "seed = 1\n[[fault]]\nkind = 'stall'\nat = 2\n").unwrap();
    let words = fails(&with(&["--pty"]), 2);
    for fact in ["faults.toml", "'at'", "'at_s'"] {
        assert!(words.contains(fact), "{fact}: {words}");
    }
    assert!(numbers(&words).contains(&4) && words.lines().count() == 1, "{words}");
    std::fs::write(&script, "seed = 1\n[[fault]]\nkind = 'unplug'\nat_s = 1\nfor_s = 1\n").unwrap();
    let words = fails(&with(&["--pty"]), 2);
    assert!(words.contains("faults.toml") && words.contains("--pty=LINK"), "{words}");

    std::fs::write(&script, "seed = 1\n[[fault]]\nkind = 'lost-frames'\nrate = 0.2\n").unwrap();
    let log = folder.path().join("sent.csv");
    let path: &'static str = log.to_str().unwrap().to_owned().leak();
    let (child, device) = started(&with(&["--pty", "--once", "--log", path]));
    let n_frames = record(&device);
    let (code, words) = ended(child);
    assert_eq!(code, Some(0), "{words}");
    let lost = 120 - n_frames;
    let faults = words.lines().last().unwrap();
    assert!(faults.starts_with("mocapd-sim: ") && faults.contains("lost-frames"), "{words}");
    // Whole, damaged and lost; then what the kind did.
    assert!(lost > 5 && numbers(faults).starts_with(&[n_frames, 0, lost, lost]), "{words}");
    let log = std::fs::read_to_string(&log).unwrap();
    assert!(log.starts_with(
        "run,seq,device_ticks,present,dropped,host_ns,unasked,fate,again,faults,frames\n"
    ));
    let with = |fate: &str| log.lines().filter(|line| line.contains(fate)).count() as u64;
    assert_eq!((with(",whole,0,,1"), with(",lost,0,lost-frames,1")), (n_frames, lost));
}

#[test]
fn a_raw_log_is_the_device_that_it_is_of() {
    let log = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/logs/stall.rawlog");
    for option in [&["--rate", "60"][..], &["--faults", "x.toml"], &["--loop"], &["--seconds", "1"]]
    {
        let words = fails(&[&[log, "--pty"], option].concat(), 2);
        assert!(words.contains(option[0]) && words.contains("stall.rawlog"), "{words}");
    }
    let pulled = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/logs/unplug.rawlog");
    let words = fails(&[pulled, "--pty"], 2);
    assert!(words.contains("--pty=LINK"), "{words}");

    let (child, path) = started(&[log, "--pty", "--speed", "10", "--once"]);
    let mut port = open(&path);
    let mut link = HostLink::new();
    let (mut n_frames, mut at_end, mut greeted, mut n_bytes) = (0, false, false, 0);
    let say = |port: &mut SerialTransport, commands: &[Say]| {
        let mut bytes = Vec::new();
        commands.iter().for_each(|command| HostLink::new().command(*command, &mut bytes));
        port.write_all(&bytes).unwrap();
    };
    say(&mut port, &[Say::Identify, Say::Ping { host_ns: 42 }]);
    let begun = Instant::now();
    let mut buffer = [0; 4096];
    while !at_end {
        assert!(begun.elapsed() < Duration::from_secs(20), "{n_frames} frames and no end");
        let n = port.read(&mut buffer).unwrap();
        n_bytes += n as u64;
        let mut pong = false;
        link.push(&buffer[..n], &mut |event| match event {
            DeviceEvent::Frame(_) => n_frames += 1,
            DeviceEvent::EndOfStream(_) => at_end = greeted,
            DeviceEvent::Pong(said) if said.host_ns == 42 => pong = true,
            _ => {}
        });
        if pong && !greeted {
            greeted = true;
            say(&mut port, &[Say::Start { line_bytes_per_s: 0 }]);
        }
    }
    // Two seconds of it, ten times as fast.
    assert_eq!(n_frames, 120);
    assert!((0.1..1.9).contains(&begun.elapsed().as_secs_f64()), "{:?}", begun.elapsed());
    let (code, words) = ended(child);
    assert_eq!(code, Some(0), "{words}");
    assert_eq!(numbers(words.lines().last().unwrap()), [1, n_bytes], "{words}");
}

#[test]
fn a_file_that_is_neither_motion_nor_log_is_told_for_what_it_is() {
    let log =
        std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/logs/stall.rawlog")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.rawlog");
    let mut bad_head = log.clone();
    bad_head[2] ^= 0x40;
    let mut told = HashSet::new();
    for (bytes, code, fact) in [
        (&b""[..], 1, "empty"),
        (&log[..5], 1, "raw log"),
        (&log[..8], 1, "byte 8"),
        (&log[..30], 1, "byte 9"),
        (&bad_head, 1, "8 bytes"),
        (b"time,x,y\n1,2,3\n", 2, ".c3d"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let words = fails(&[path.to_str().unwrap(), "--pty"], code);
        assert!(words.contains(fact) && words.contains("a.rawlog"), "{words}");
        assert_eq!(words.lines().count(), 1, "{words}");
        assert!(told.insert(words.clone()), "said of two files: {words}");
    }
    let words = fails(&[folder.path().to_str().unwrap(), "--pty"], 1);
    assert!(words.contains(&NotAFile::Folder.to_string()), "{words}");
}

/// The log of a recorder that was killed: two seconds less their end.
/// A pipe that nobody writes to would be waited for, and a device need not end.
#[test]
fn what_is_no_file_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    for ending in ["take", "csv", "toml"] {
        let pipe = folder.path().join(format!("pipe.{ending}"));
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let device = folder.path().join(format!("device.{ending}"));
        std::os::unix::fs::symlink("/dev/zero", &device).unwrap();
        for (path, what) in [(pipe, NotAFile::Pipe), (device, NotAFile::Device)] {
            let path = path.to_str().unwrap();
            let args = match ending {
                "toml" => vec!["--generate", "jump", "--pty", "--faults", path],
                _ => vec![path, "--pty"],
            };
            let (code, words) = ended(sim(&args).spawn().unwrap());
            assert!(matches!(code, Some(1 | 2)), "{args:?}: {words}");
            assert!(words.contains(&what.to_string()), "{args:?}: {words}");
        }
    }
}

#[test]
fn a_log_without_its_end_is_played_once_and_the_device_goes_away() {
    let log =
        std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/logs/stall.rawlog")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.rawlog");
    let cut = &log[..log.len() - 200];
    let cut_off = records(cut).unwrap().find_map(Result::err).unwrap();
    std::fs::write(&path, cut).unwrap();
    let (child, line) = started(&[path.to_str().unwrap(), "--pty", "--speed", "20"]);
    let mut port = open(&line);
    let mut link = HostLink::new();
    let mut bytes = Vec::new();
    for command in [Say::Stop, Say::Identify, Say::Ping { host_ns: 42 }] {
        link.command(command, &mut bytes);
    }
    link.command(Say::Start { line_bytes_per_s: 0 }, &mut bytes);
    port.write_all(&bytes).unwrap();
    let mut buffer = [0; 4096];
    let begun = Instant::now();
    let mut n_bytes = 0;
    while let Ok(n) = port.read(&mut buffer) {
        n_bytes += n as u64;
        link.push(&buffer[..n], &mut |event| {
            assert!(!matches!(event, DeviceEvent::EndOfStream(_)), "it was cut off");
        });
        assert!(begun.elapsed() < Duration::from_secs(20), "it stays");
    }
    let (code, words) = ended(child);
    assert_eq!(code, Some(0), "{words}");
    let lines: Vec<&str> = words.lines().collect();
    // What is wrong with the log, what is played, that it is over, and what was sent.
    assert!(lines.len() == 4 && lines[0].contains(&cut_off.to_string()), "{words}");
    assert_eq!(numbers(lines[3]), [1, n_bytes], "{words}");
}

/// `timeout -s INT` signals a process and then its group.
#[test]
fn a_signal_that_comes_twice_is_one_and_a_later_one_ends_it_at_once() {
    // Half a second of frames that nobody reads: a device that ends waits a second for its host.
    let args = ["--generate", "jump", "--pty", "--rate", "1000", "--loop"];
    for (pause_ms, code) in [(100, Some(0)), (700, Some(130))] {
        let (child, path) = started(&args);
        let mut port = open(&path);
        let mut bytes = Vec::new();
        HostLink::new().command(Say::Start { line_bytes_per_s: 0 }, &mut bytes);
        port.write_all(&bytes).unwrap();
        std::thread::sleep(Duration::from_millis(500));
        let signal = || kill_process(Pid::from_child(&child), Signal::INT).unwrap();
        signal();
        std::thread::sleep(Duration::from_millis(pause_ms));
        signal();
        let (ended, words) = ended(child);
        assert_eq!(ended, code, "{pause_ms} ms: {words}");
        drop(port);
    }
}

#[test]
fn signals_end_it_cleanly() {
    for signal in [Signal::INT, Signal::TERM] {
        let args = ["--generate", "jump", "--pty", "--speed", "4", "--seconds", "200ms"];
        let (child, path) = started(&args);
        assert!(path.starts_with("/dev/pts/"), "{path}");
        // It stays after the end of stream: a second record works.
        assert_eq!(record(&path), 24);
        assert_eq!(record(&path), 24);
        kill_process(Pid::from_child(&child), signal).unwrap();
        let (code, words) = ended(child);
        assert_eq!(code, Some(0), "{words}");
        assert!(numbers(words.lines().last().unwrap()).starts_with(&[2, 48, 48]), "{words}");
    }
}

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
        assert!(!out.exists(), "nothing is made for a value that is refused");
    }
    assert_eq!(generate(&["--jumps", "3", "--rate", "30"]).status.code(), Some(0));
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
    assert_eq!(again.status.code(), Some(1), "a folder that is there is left alone");
}
