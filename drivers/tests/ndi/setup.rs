//! The bring-up, request by request.

use std::collections::HashSet;

use mocapd_drivers::device::{Command, MarkerInfo, Protocol};
use mocapd_drivers::ndi::NdiHost;
use mocapd_drivers::transport::{Transport, polled::line_command_channel};
use mocapd_testkit::memory;

use super::script::{Script, text};

#[test]
fn a_vega_with_one_tool() {
    let mut script = Script::new(|_| None);
    script.command(Command::Identify);
    script.read(60);
    assert_eq!(
        script.sent,
        [
            "INIT:E3A5\r",
            "COMM:60000000C\r",
            "VER:065EE\r",
            "APIREV:443E\r",
            "GET:Param.Tracking.Frame FrequencyEF07\r",
            "GET:Param.Tracking.Track FrequencyDD48\r",
            "PHSR:01E03E\r",
            "PHSR:02E17E\r",
            "PHSR:0321BF\r",
            "PHSR:04E3FE\r",
            "PHINF:0100050CAD\r",
        ]
    );
    assert_eq!(script.bauds, [9_600, 921_600]);
    let hello = script.hello.clone().unwrap();
    assert_eq!(hello.model, "Polaris Vega Control Firmware");
    assert_eq!((hello.serial.as_str(), hello.firmware.as_str()), ("P9-00123", "Polaris Vega 008"));
    assert_eq!((hello.rate_millihertz, hello.tick_hz), (60_000, 1_000_000_000));
    let label = "8700449".to_owned();
    assert_eq!(script.markers, [MarkerInfo { id: 1, label, labelled: true }]);
    assert_eq!(script.counters().messages, 11);
}

#[test]
fn handles_are_freed_initialized_and_enabled_in_turn() {
    let mut lists = 0;
    let mut script = Script::new(move |request| match request {
        b"PHSR:01E03E\r" => Some(text("010B001")),
        b"PHSR:02E17E\r" => {
            // Initializing the first two reveals a third.
            lists += 1;
            Some(text(["020A0010B001", "010C001", "00"][lists - 1]))
        }
        b"PHSR:0321BF\r" => Some(text("030A0110B0110C011")),
        b"PHSR:04E3FE\r" => Some(text("030A0310B0310C031")),
        _ if request.starts_with(b"PHINF:") => Some(text("02000000NDI         0010000000031")),
        _ => None,
    });
    script.command(Command::Identify);
    script.read(100);
    let requests: Vec<_> = script.sent.iter().map(|s| &s[..s.len() - 5]).collect();
    let from = requests.iter().position(|request| *request == "PHSR:01").unwrap();
    assert_eq!(
        requests[from..],
        [
            "PHSR:01",
            "PHF:0B",
            "PHSR:02",
            "PINIT:0A",
            "PINIT:0B",
            "PHSR:02",
            "PINIT:0C",
            "PHSR:02",
            "PHSR:03",
            "PENA:0AD",
            "PENA:0BD",
            "PENA:0CD",
            "PHSR:04",
            "PHINF:0A0005",
            "PHINF:0B0005",
            "PHINF:0C0005",
        ]
    );
    let labels: Vec<_> = script.markers.iter().map(|marker| marker.label.as_str()).collect();
    assert_eq!(labels, ["port 0A", "port 0B", "port 0C"]);
}

#[test]
fn without_bx2_the_clock_is_the_frame_number() {
    for revision in [text("D.001.007"), text("G.002.009"), text("ERROR01")] {
        let mut script = Script::new(move |request| match request {
            b"APIREV:443E\r" => Some(revision.clone()),
            b"GET:Param.Tracking.Track FrequencyDD48\r" => Some(text("ERROR01")),
            b"GET:Param.Tracking.Frame FrequencyEF07\r" => Some(text("ERROR01")),
            _ => None,
        })
        .started();
        script.read(1);
        let hello = script.hello.unwrap();
        assert_eq!((hello.rate_millihertz, hello.tick_hz), (60_000, 60_000));
        assert!(script.sent.contains(&"BX:10013E6C\r".to_owned()), "{:?}", script.sent);
    }
}

#[test]
fn refusals_say_what_to_do() {
    let (mut whats, mut remedies) = (HashSet::new(), HashSet::new());
    for (request, code, is_of_a_tool) in [
        ("PINIT:01", "ERROR13", true),
        ("PENA:01D", "ERROR0E", true),
        ("PHSR:04", "ERROR10", false),
        ("INIT:", "ERROR15", false),
        ("PHSR:01", "ERROR7E", false),
        ("PHSR:03", "ERROR29", false),
        ("TSTART:", "ERROR12", false),
    ] {
        let mut listed = 0;
        let mut script = Script::new(move |wire| match wire {
            _ if wire.starts_with(request.as_bytes()) => Some(text(code)),
            b"PHSR:02E17E\r" => {
                listed += 1;
                Some(text(if listed == 1 { "0101001" } else { "00" }))
            }
            b"PHSR:0321BF\r" => Some(text("0101011")),
            _ => None,
        });
        script.command(Command::Identify);
        script.read(100);
        script.command(Command::Start { line_bytes_per_s: 0 });
        script.read(10);
        let message = script.failed.clone().unwrap();
        assert_eq!(message.contains("port 01"), is_of_a_tool, "{message}");
        let (what, remedy) = message.split_once(code).expect("the error code in the message");
        whats.insert(what.to_owned());
        remedies.insert(remedy.to_owned());
        let tries = script.sent.iter().filter(|sent| sent.starts_with(request)).count();
        assert_eq!(tries, 3, "{request}: {:?}", script.sent);
        // It starts over on the next command.
        script.sent.clear();
        script.command(Command::Identify);
        script.read(1);
        assert_eq!(script.sent, ["INIT:E3A5\r"]);
    }
    // Three of the requests list ports.
    assert_eq!((whats.len(), remedies.len()), (5, 7), "{whats:?} {remedies:?}");
}

#[test]
fn a_break_is_tried_when_init_has_no_answer() {
    let mut inits = 0;
    let mut script = Script::new(move |request| match request {
        b"INIT:E3A5\r" => {
            inits += 1;
            (inits == 1).then(Vec::new)
        }
        _ => None,
    });
    script.command(Command::Identify);
    script.read(20);
    assert_eq!(script.sent, ["INIT:E3A5\r", "(break)"]);
    // No request is sent before RESET, or its time-out.
    script.read(40);
    assert_eq!(script.sent.len(), 2);
    script.read(60);
    assert_eq!(script.sent[2], "INIT:E3A5\r");
    assert_eq!(script.bauds[..3], [9_600, 9_600, 921_600]);
}

#[test]
fn refused_descriptive_requests_are_tolerated() {
    let mut script = Script::new(|request| {
        let refused = request.starts_with(b"VER:") || request.starts_with(b"PHINF:");
        refused.then(|| text("ERROR01"))
    });
    script.command(Command::Identify);
    script.read(100);
    assert_eq!(script.hello.unwrap().model, "NDI system");
    assert_eq!(script.markers[0].label, "port 01");
}

#[test]
fn a_system_that_tracks_for_a_host_that_was_killed_is_stopped_first() {
    let mut tracks = true;
    let mut script = Script::new(move |request| {
        tracks &= !request.starts_with(b"TSTOP:");
        (tracks && request.starts_with(b"INIT:")).then(|| text("ERROR0C"))
    });
    script.command(Command::Identify);
    script.read(100);
    assert!(script.hello.is_some(), "{:?}", script.sent);
    let requests = ["INIT:E3A5\r", "INIT:E3A5\r", "INIT:E3A5\r", "TSTOP:2C14\r", "INIT:E3A5\r"];
    assert_eq!(script.sent[..5], requests);
}

#[test]
fn a_start_whose_reply_was_lost_still_counts() {
    let mut starts = 0;
    let mut script = Script::new(move |request| {
        if !request.starts_with(b"TSTART:") {
            return None;
        }
        starts += 1;
        Some(if starts == 1 { Vec::new() } else { text("ERROR0C") })
    });
    script.command(Command::Identify);
    script.read(100);
    script.command(Command::Start { line_bytes_per_s: 0 });
    script.read(150);
    assert!(script.failed.is_none(), "{:?}", script.failed);
    assert!(script.sent.iter().any(|request| request.starts_with("BX2")), "{:?}", script.sent);
}

#[test]
fn an_invalid_port_list_is_quoted_escaped_and_shortened() {
    let mut script = Script::new(|request| {
        request.starts_with(b"PHSR:01").then(|| text(&format!("\u{1b}[2J{}", "x".repeat(500))))
    });
    script.command(Command::Identify);
    script.read(100);
    let message = script.failed.unwrap();
    assert!(message.contains("\\u{1b}[2Jxxx") && message.len() < 150, "{message}");
}

#[test]
fn immediate_wrong_replies_do_not_cause_a_busy_loop() {
    type Wrong = fn(&[u8]) -> Option<Vec<u8>>;
    // An echo, a device that is always busy, and one that replies OKAY even to polls.
    let wrong: [Wrong; 3] = [
        |request| Some(request.to_vec()),
        |request| request.starts_with(b"INIT:").then(|| text("ERROR0C")),
        |_| None,
    ];
    for reply in wrong {
        let mut script = Script::new(reply);
        script.command(Command::Identify);
        script.read(100);
        script.command(Command::Start { line_bytes_per_s: 0 });
        let (n_requests, before_ns) = (script.sent.len(), script.now_ns());
        script.read(2_000);
        let n_requests = (script.sent.len() - n_requests) as u64;
        let ms = (script.now_ns() - before_ns) / 1_000_000;
        assert!(n_requests <= ms, "{n_requests} requests in {ms} ms");
        assert!(script.frames.is_empty());
    }
}

#[test]
fn a_reattach_begins_with_init() {
    let mut host = NdiHost::new(line_command_channel().0, 921_600);
    for _ in 0..2 {
        let (line, mut device) = memory::pair(256);
        let mut line = host.attach(Box::new(line));
        host.command(Command::Identify, &mut Vec::new());
        let mut buf = [0; 64];
        assert_eq!(line.read(&mut buf).unwrap(), 0);
        host.push(&[], &mut |_| {});
        assert_eq!(device.read(&mut buf).unwrap(), 10);
        assert_eq!(&buf[..10], b"INIT:E3A5\r");
        device.write_all(b"OKAYA896\r").unwrap();
        let n = line.read(&mut buf).unwrap();
        host.push(&buf[..n], &mut |_| {});
        assert_eq!(line.read(&mut buf[20..]).unwrap(), 0);
        let n = device.read(&mut buf).unwrap();
        assert_eq!(&buf[..n], b"COMM:60000000C\r");
    }
}

#[test]
fn a_reattach_tries_the_requested_baud_rate_again() {
    let mut host = NdiHost::new(line_command_channel().0, 921_600);
    for expected in [&b"6A"[..], b"6"] {
        let (line, mut device) = memory::pair(256);
        let mut line = host.attach(Box::new(line));
        host.command(Command::Identify, &mut Vec::new());
        let (mut buf, mut speeds, mut n_silent) = ([0; 256], Vec::new(), 0);
        while speeds.len() < expected.len() {
            let n = line.read(&mut buf).unwrap();
            host.push(&buf[..n], &mut |_| {});
            let n = device.read(&mut buf).unwrap();
            match &buf[..n] {
                b"INIT:E3A5\r" => device.write_all(b"OKAYA896\r").unwrap(),
                request if request.starts_with(b"COMM:") => {
                    speeds.push(request[5]);
                    device.write_all(b"OKAYA896\r").unwrap();
                }
                // This line does not carry the break: report a reset now and then.
                b"" => {
                    n_silent += 1;
                    if n_silent % 8 == 0 && !speeds.is_empty() {
                        device.write_all(b"RESETBE6F\r").unwrap();
                    }
                }
                // At the new baud rate it sends only noise.
                _ => device.write_all(&[0x55; 80]).unwrap(),
            }
        }
        assert_eq!(speeds, expected);
    }
}
