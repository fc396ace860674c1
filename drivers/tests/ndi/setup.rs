//! The bring-up, request by request.

use std::collections::HashSet;

use mocapd_drivers::device::{Command, MarkerInfo, Protocol};
use mocapd_drivers::ndi::NdiHost;
use mocapd_drivers::transport::{Transport, turns::desk};
use mocapd_testkit::memory;

use super::script::{Script, text};

#[test]
fn a_vega_with_one_tool() {
    let mut script = Script::new(|_| None);
    script.say(Command::Identify);
    script.read(60);
    assert_eq!(
        script.said,
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
    assert_eq!((hello.rate_mhz, hello.tick_hz), (60_000, 1_000_000_000));
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
            // Initializing the first two brings forth a third.
            lists += 1;
            Some(text(["020A0010B001", "010C001", "00"][lists - 1]))
        }
        b"PHSR:0321BF\r" => Some(text("030A0110B0110C011")),
        b"PHSR:04E3FE\r" => Some(text("030A0310B0310C031")),
        _ if request.starts_with(b"PHINF:") => Some(text("02000000NDI         0010000000031")),
        _ => None,
    });
    script.say(Command::Identify);
    script.read(100);
    let said: Vec<_> = script.said.iter().map(|s| &s[..s.len() - 5]).collect();
    let from = said.iter().position(|said| *said == "PHSR:01").unwrap();
    assert_eq!(
        said[from..],
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
fn an_old_system_has_no_bx2_and_its_clock_is_the_frame_number() {
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
        assert_eq!((hello.rate_mhz, hello.tick_hz), (60_000, 60_000));
        assert!(script.said.contains(&"BX:10013E6C\r".to_owned()), "{:?}", script.said);
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
        let mut script = Script::new(move |said| match said {
            _ if said.starts_with(request.as_bytes()) => Some(text(code)),
            b"PHSR:02E17E\r" => {
                listed += 1;
                Some(text(if listed == 1 { "0101001" } else { "00" }))
            }
            b"PHSR:0321BF\r" => Some(text("0101011")),
            _ => None,
        });
        script.say(Command::Identify);
        script.read(100);
        script.say(Command::Start { line_bytes_per_s: 0 });
        script.read(10);
        let words = script.failed.clone().unwrap();
        assert_eq!(words.contains("port 01"), is_of_a_tool, "{words}");
        let (what, remedy) = words.split_once(code).expect("the code that it answered");
        whats.insert(what.to_owned());
        remedies.insert(remedy.to_owned());
        let tries = script.said.iter().filter(|said| said.starts_with(request)).count();
        assert_eq!(tries, 3, "{request}: {:?}", script.said);
        // It begins anew when it is asked again.
        script.said.clear();
        script.say(Command::Identify);
        script.read(1);
        assert_eq!(script.said, ["INIT:E3A5\r"]);
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
    script.say(Command::Identify);
    script.read(20);
    assert_eq!(script.said, ["INIT:E3A5\r", "(break)"]);
    // Nothing is said before the device has said RESET, or not.
    script.read(40);
    assert_eq!(script.said.len(), 2);
    script.read(60);
    assert_eq!(script.said[2], "INIT:E3A5\r");
    assert_eq!(script.bauds[..3], [9_600, 9_600, 921_600]);
}

#[test]
fn what_is_only_for_people_may_be_refused() {
    let mut script = Script::new(|request| {
        let refused = request.starts_with(b"VER:") || request.starts_with(b"PHINF:");
        refused.then(|| text("ERROR01"))
    });
    script.say(Command::Identify);
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
    script.say(Command::Identify);
    script.read(100);
    assert!(script.hello.is_some(), "{:?}", script.said);
    let told = ["INIT:E3A5\r", "INIT:E3A5\r", "INIT:E3A5\r", "TSTOP:2C14\r", "INIT:E3A5\r"];
    assert_eq!(script.said[..5], told);
}

#[test]
fn a_start_whose_answer_was_lost_is_a_start() {
    let mut starts = 0;
    let mut script = Script::new(move |request| {
        if !request.starts_with(b"TSTART:") {
            return None;
        }
        starts += 1;
        Some(if starts == 1 { Vec::new() } else { text("ERROR0C") })
    });
    script.say(Command::Identify);
    script.read(100);
    script.say(Command::Start { line_bytes_per_s: 0 });
    script.read(150);
    assert!(script.failed.is_none(), "{:?}", script.failed);
    assert!(script.said.iter().any(|said| said.starts_with("BX2")), "{:?}", script.said);
}

#[test]
fn an_answer_that_is_no_list_is_quoted_with_care() {
    let mut script = Script::new(|request| {
        request.starts_with(b"PHSR:01").then(|| text(&format!("\u{1b}[2J{}", "x".repeat(500))))
    });
    script.say(Command::Identify);
    script.read(100);
    let words = script.failed.unwrap();
    assert!(words.contains("\\u{1b}[2Jxxx") && words.len() < 150, "{words}");
}

#[test]
fn what_answers_at_once_and_wrongly_is_not_asked_without_a_pause() {
    type Wrong = fn(&[u8]) -> Option<Vec<u8>>;
    // An echo; one that is always busy; one that says OKAY to polls, too.
    let wrong: [Wrong; 3] = [
        |request| Some(request.to_vec()),
        |request| request.starts_with(b"INIT:").then(|| text("ERROR0C")),
        |_| None,
    ];
    for answer in wrong {
        let mut script = Script::new(answer);
        script.say(Command::Identify);
        script.read(100);
        script.say(Command::Start { line_bytes_per_s: 0 });
        let (asked, before_ns) = (script.said.len(), script.now_ns());
        script.read(2_000);
        let asked = (script.said.len() - asked) as u64;
        let ms = (script.now_ns() - before_ns) / 1_000_000;
        assert!(asked <= ms, "{asked} requests in {ms} ms");
        assert!(script.frames.is_empty());
    }
}

#[test]
fn another_line_after_a_replug_begins_with_init() {
    let mut host = NdiHost::new(desk().0, 921_600);
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
fn another_line_after_a_replug_is_as_fast_as_was_asked_for() {
    let mut host = NdiHost::new(desk().0, 921_600);
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
                asked if asked.starts_with(b"COMM:") => {
                    speeds.push(asked[5]);
                    device.write_all(b"OKAYA896\r").unwrap();
                }
                // A break is not heard here: now and then it says that it was reset.
                b"" => {
                    n_silent += 1;
                    if n_silent % 8 == 0 && !speeds.is_empty() {
                        device.write_all(b"RESETBE6F\r").unwrap();
                    }
                }
                // At the new speed all that it says is noise.
                _ => device.write_all(&[0x55; 80]).unwrap(),
            }
        }
        assert_eq!(speeds, expected);
    }
}
