//! `mocapd-sim` as a program: its output, exit codes and messages.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod generate;
mod pty_option;

use std::collections::HashSet;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use mocapd_drivers::device::{Command as HostCommand, DeviceEvent, Protocol};
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
    let message = String::from_utf8(stderr).unwrap();
    assert_eq!(status.code(), Some(code), "{args:?}: {message}");
    assert!(stdout.is_empty(), "{args:?} printed on stdout");
    message
}

/// The whole numbers in a message.
fn numbers(message: &str) -> Vec<u64> {
    message.split(|c: char| !c.is_alphanumeric()).filter_map(|word| word.parse().ok()).collect()
}

/// Starts a simulator; returns it with the path that it printed.
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
    let mut message = String::new();
    child.stderr.unwrap().read_to_string(&mut message).unwrap();
    (status.code(), message)
}

/// Opens a line. A line that was just closed may be busy for a moment: a program started by another test also holds it
/// open, between its fork and its exec.
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

/// Records until the end of stream; returns the number of frames.
fn record(path: &str) -> u64 {
    let mut port = open(path);
    let mut link = HostLink::new();
    let mut bytes = Vec::new();
    link.command(HostCommand::Identify, &mut bytes);
    link.command(HostCommand::Start { line_bytes_per_s: 0 }, &mut bytes);
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
fn usage_errors_exit_2_and_failures_1() {
    let message = fails(&["/nowhere/a.xyz", "--pty"], 2);
    assert!(message.contains("/nowhere/a.xyz") && message.contains(".c3d"), "{message}");
    let message = fails(&["/nowhere/a.csv", "--pty"], 1);
    assert!(message.ends_with("mocapd-sim: /nowhere/a.csv does not exist\n"), "{message}");
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
        &["--generate", "jump", "--pty", "--protocol", "ndi", "--residuals"],
        &["--generate", "jump", "--protocol", "lsl", "--residuals"],
        &["--generate", "jump", "--pty", "--batch", "2s"],
        &["--generate", "jump", "--pty", "--batch", "16ms", "--batch-ms", "16"],
        &["--generate", "jump", "--pty", "--noise", "-1mm"],
        &["--generate", "jump", "--pty", "--frob"],
        &["--generate", "jump", "--pty", "--speed", "fast"],
        &["--generate", "jump", "--pty", "--drift-ppm", "nan"],
        &["--generate", "jump", "--pty", "--occlusion", "-0.1"],
    ] {
        let message = fails(bad, 2);
        assert!(message.starts_with("mocapd-sim: "), "{bad:?}: {message}");
        assert_eq!(message.lines().count(), 1, "{bad:?}: {message}");
    }
    let message = fails(&["--generate", "jump", "--pty", "--log", "/nowhere/log.csv"], 1);
    let expected = "mocapd-sim: the folder /nowhere does not exist: create it first\n";
    assert!(message.ends_with(expected), "{message}");
    let folder = tempfile::tempdir().unwrap();
    let csv = folder.path().join("a.csv");
    std::fs::write(&csv, "time_s,A.x,A.y,A.z\n0,1,2,3\n0.01,1,2,3\n").unwrap();
    let message = fails(&[csv.to_str().unwrap(), "--pty", "--residuals"], 2);
    assert!(message.contains("a.csv has no residuals"), "{message}");
    let taken = folder.path().join("taken");
    std::fs::write(&taken, "").unwrap();
    let link = format!("--pty={}", taken.display());
    let message = fails(&["--generate", "jump", &link], 2);
    assert!(message.contains(taken.to_str().unwrap()), "{message}");
}

#[test]
fn a_missing_usb_device_controller_is_reported() {
    for bad in [
        &["--generate", "jump", "--usb-gadget", "--pty"][..],
        &["--generate", "jump", "--usb-gadget", "--usb-serial"],
        &["--generate", "jump", "--usb-gadget", "--baud", "9600"],
        &["--generate", "jump", "--pty", "--udc", "dummy_udc.0"],
    ] {
        fails(bad, 2);
    }
    let message = fails(&["--generate", "jump", "--usb-gadget", "--serial", "two words"], 2);
    assert!(message.contains("'two words'"), "{message}");
    if std::fs::read_dir("/sys/class/udc").is_ok_and(|mut all| all.next().is_some()) {
        eprintln!("skipped: this machine can be a USB device");
        return;
    }
    for line in ["--usb-gadget", "--usb-serial"] {
        let message = fails(&["--generate", "jump", line], 1);
        assert!(message.contains("hardware-in-the-loop.md"), "{message}");
        assert!(message.contains("`sudo modprobe dummy_hcd`"), "{message}");
    }
}

#[test]
fn once_serves_one_run_and_exits() {
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
    let (code, message) = ended(child);
    assert_eq!(code, Some(0), "{message}");
    let counts = numbers(&message);
    assert_eq!(counts.iter().filter(|n| **n == 150).count(), 2, "produced and sent: {message}");
    assert_eq!(std::fs::read_to_string(&log).unwrap().lines().count(), 151);
    let again = fails(&["--generate", "jump", "--pty", "--log", log.to_str().unwrap()], 1);
    assert!(again.contains(log.to_str().unwrap()) && again.contains("exists already"), "{again}");
    assert!(std::fs::symlink_metadata(&link).is_err(), "the link is still there");
}

#[test]
fn fault_scripts_are_checked_and_played() {
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("faults.toml");
    let with = |more: &[&'static str]| {
        let mut args = vec!["--generate", "jump:5", "--seconds", "1s", "--faults"];
        let path: &'static str = script.to_str().unwrap().to_owned().leak();
        args.push(path);
        args.extend(more);
        args
    };
    let message = fails(&with(&["--pty"]), 1);
    assert!(message.ends_with("faults.toml does not exist\n"), "{message}");
    std::fs::write(&script, "seed = 1\n[[fault]]\nkind = 'stall'\nat = 2\n").unwrap();
    let message = fails(&with(&["--pty"]), 2);
    for fact in ["faults.toml", "'at'", "'at_s'"] {
        assert!(message.contains(fact), "{fact}: {message}");
    }
    assert!(numbers(&message).contains(&4) && message.lines().count() == 1, "{message}");
    std::fs::write(&script, "seed = 1\n[[fault]]\nkind = 'unplug'\nat_s = 1\nfor_s = 1\n").unwrap();
    let message = fails(&with(&["--pty"]), 2);
    assert!(message.contains("faults.toml") && message.contains("--pty PATH"), "{message}");

    std::fs::write(&script, "seed = 1\n[[fault]]\nkind = 'lost-frames'\nrate = 0.2\n").unwrap();
    let log = folder.path().join("sent.csv");
    let path: &'static str = log.to_str().unwrap().to_owned().leak();
    let (child, device) = started(&with(&["--pty", "--once", "--log", path]));
    let n_frames = record(&device);
    let (code, message) = ended(child);
    assert_eq!(code, Some(0), "{message}");
    let lost = 120 - n_frames;
    let faults = message.lines().last().unwrap();
    assert!(faults.starts_with("mocapd-sim: ") && faults.contains("lost-frames"), "{message}");
    // Whole, damaged and lost; then the effects of the kind.
    assert!(lost > 5 && numbers(faults).starts_with(&[n_frames, 0, lost, lost]), "{message}");
    let log = std::fs::read_to_string(&log).unwrap();
    assert!(log.starts_with(
        "run,seq,device_ticks,present,dropped,host_ns,unasked,fate,again,faults,frames\n"
    ));
    let with = |fate: &str| log.lines().filter(|line| line.contains(fate)).count() as u64;
    assert_eq!((with(",whole,0,,1"), with(",lost,0,lost-frames,1")), (n_frames, lost));
}

#[test]
fn a_raw_log_is_replayed() {
    let log = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/logs/stall.rawlog");
    for option in [&["--rate", "60"][..], &["--faults", "x.toml"], &["--loop"], &["--seconds", "1"]]
    {
        let message = fails(&[&[log, "--pty"], option].concat(), 2);
        assert!(message.contains(option[0]) && message.contains("stall.rawlog"), "{message}");
    }
    let pulled = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/logs/unplug.rawlog");
    let message = fails(&[pulled, "--pty"], 2);
    assert!(message.contains("--pty PATH"), "{message}");

    let (child, path) = started(&[log, "--pty", "--speed", "10", "--once"]);
    let mut port = open(&path);
    let mut link = HostLink::new();
    let (mut n_frames, mut at_end, mut greeted, mut n_bytes) = (0, false, false, 0);
    let send = |port: &mut SerialTransport, commands: &[HostCommand]| {
        let mut bytes = Vec::new();
        commands.iter().for_each(|command| HostLink::new().command(*command, &mut bytes));
        port.write_all(&bytes).unwrap();
    };
    send(&mut port, &[HostCommand::Identify, HostCommand::Ping { host_ns: 42 }]);
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
            DeviceEvent::Pong(answer) if answer.host_ns == 42 => pong = true,
            _ => {}
        });
        if pong && !greeted {
            greeted = true;
            send(&mut port, &[HostCommand::Start { line_bytes_per_s: 0 }]);
        }
    }
    // Two seconds of it, ten times as fast.
    assert_eq!(n_frames, 120);
    assert!((0.1..1.9).contains(&begun.elapsed().as_secs_f64()), "{:?}", begun.elapsed());
    let (code, message) = ended(child);
    assert_eq!(code, Some(0), "{message}");
    assert_eq!(numbers(message.lines().last().unwrap()), [1, n_bytes], "{message}");
}

#[test]
fn each_unusable_file_has_its_own_error() {
    let log =
        std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/logs/stall.rawlog")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.rawlog");
    let mut bad_head = log.clone();
    bad_head[2] ^= 0x40;
    let mut messages = HashSet::new();
    for (bytes, code, fact) in [
        (&b""[..], 1, "empty"),
        (&log[..5], 1, "raw log"),
        (&log[..8], 1, "byte 8"),
        (&log[..30], 1, "byte 9"),
        (&bad_head, 1, "8 bytes"),
        (b"time,x,y\n1,2,3\n", 2, ".c3d"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let message = fails(&[path.to_str().unwrap(), "--pty"], code);
        assert!(message.contains(fact) && message.contains("a.rawlog"), "{message}");
        assert_eq!(message.lines().count(), 1, "{message}");
        assert!(messages.insert(message.clone()), "one message for two files: {message}");
    }
    let message = fails(&[folder.path().to_str().unwrap(), "--pty"], 1);
    assert!(message.contains(&NotAFile::Folder.to_string()), "{message}");
}

/// Reading a pipe without a writer would block, and a device may have no end.
#[test]
fn pipes_and_devices_are_refused_at_once() {
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
            let (code, message) = ended(sim(&args).spawn().unwrap());
            assert!(matches!(code, Some(1 | 2)), "{args:?}: {message}");
            assert!(message.contains(&what.to_string()), "{args:?}: {message}");
        }
    }
}

#[test]
fn a_log_without_an_end_is_played_once_and_the_device_disappears() {
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
    for command in [HostCommand::Stop, HostCommand::Identify, HostCommand::Ping { host_ns: 42 }] {
        link.command(command, &mut bytes);
    }
    link.command(HostCommand::Start { line_bytes_per_s: 0 }, &mut bytes);
    port.write_all(&bytes).unwrap();
    let mut buffer = [0; 4096];
    let begun = Instant::now();
    let mut n_bytes = 0;
    while let Ok(n) = port.read(&mut buffer) {
        n_bytes += n as u64;
        link.push(&buffer[..n], &mut |event| {
            assert!(!matches!(event, DeviceEvent::EndOfStream(_)), "it was cut off");
        });
        assert!(begun.elapsed() < Duration::from_secs(20), "the device stays");
    }
    let (code, message) = ended(child);
    assert_eq!(code, Some(0), "{message}");
    let lines: Vec<&str> = message.lines().collect();
    // The log's problem, what is played, that it is over, and what was sent.
    assert!(lines.len() == 4 && lines[0].contains(&cut_off.to_string()), "{message}");
    assert_eq!(numbers(lines[3]), [1, n_bytes], "{message}");
}

/// `timeout -s INT` signals a process and then its group.
#[test]
fn a_doubled_signal_counts_once_and_a_later_one_ends_the_program_at_once() {
    // Half a second of unread frames: on a stop, the simulator waits a second for its host.
    let args = ["--generate", "jump", "--pty", "--rate", "1000", "--loop"];
    for (pause_ms, code) in [(100, Some(0)), (700, Some(1))] {
        let (child, path) = started(&args);
        let mut port = open(&path);
        let mut bytes = Vec::new();
        HostLink::new().command(HostCommand::Start { line_bytes_per_s: 0 }, &mut bytes);
        port.write_all(&bytes).unwrap();
        std::thread::sleep(Duration::from_millis(500));
        let signal = || kill_process(Pid::from_child(&child), Signal::INT).unwrap();
        signal();
        std::thread::sleep(Duration::from_millis(pause_ms));
        signal();
        let (ended, message) = ended(child);
        assert_eq!(ended, code, "{pause_ms} ms: {message}");
        drop(port);
    }
}

#[test]
fn signals_end_the_program_cleanly() {
    for signal in [Signal::INT, Signal::TERM] {
        let args = ["--generate", "jump", "--pty", "--speed", "4", "--seconds", "200ms"];
        let (child, path) = started(&args);
        assert!(path.starts_with("/dev/pts/"), "{path}");
        // It keeps serving after the end of stream: a second recording works.
        assert_eq!(record(&path), 24);
        assert_eq!(record(&path), 24);
        kill_process(Pid::from_child(&child), signal).unwrap();
        let (code, message) = ended(child);
        assert_eq!(code, Some(0), "{message}");
        assert!(numbers(message.lines().last().unwrap()).starts_with(&[2, 48, 48]), "{message}");
    }
}
