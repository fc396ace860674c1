//! From a line in an unknown state to a device that is set up.

use mocapd_drivers::device::{Command, Protocol};
use mocapd_drivers::ndi::BAUDS;
use mocapd_drivers::transport::polled::Request;
use mocapd_simulator::device::LineDevice;
use mocapd_simulator::ndi::NdiSettings;

use super::bench::{Bench, MS, jump, settings};

fn bench(tools: &[&str], baud_max: u32) -> Bench {
    Bench::new(jump(20, 60.0, 1.0), settings(tools, true), baud_max)
}

/// Another host left the device at this speed.
fn left_at(bench: &mut Bench, baud: u32) {
    let (_, digit) = BAUDS.into_iter().find(|(known, _)| *known == baud).unwrap();
    for text in ["INIT:".to_owned(), format!("COMM:{digit}0000")] {
        let crc = mocapd_drivers::ndi::crc16(text.as_bytes());
        bench.device.on_bytes(format!("{text}{crc:04X}\r").as_bytes(), bench.now_ns);
        let n = bench.device.pending().len();
        bench.device.sent(n);
    }
    assert_eq!(bench.device.baud(), Some(baud));
}

#[test]
fn a_device_that_was_just_switched_on() {
    let mut bench = bench(&["pelvis", "head"], 921_600);
    bench.send(Command::Identify);
    bench.send(Command::Ping { host_ns: 5 });
    bench.run_until(|bench| !bench.pongs.is_empty());
    let hello = &bench.hellos[0];
    assert_eq!(hello.model, "mocapd-sim Control Firmware");
    assert_eq!(hello.serial, "SIM0001");
    assert_eq!((hello.rate_millihertz, hello.tick_hz), (60_000, 1_000_000_000));
    let table: Vec<_> =
        bench.markers.iter().map(|m| (m.id, m.label.as_str(), m.labelled)).collect();
    assert_eq!(table, [(1, "pelvis", true), (2, "head", true)]);
    assert_eq!((bench.device.baud(), bench.host_baud), (Some(921_600), 921_600));
    assert_eq!(bench.breaks, 0, "a device that answers is not reset");
    assert_eq!(
        bench.requests_as_text(),
        [
            "INIT:E3A5",
            "COMM:60000000C",
            "VER:065EE",
            "APIREV:443E",
            "GET:Param.Tracking.Frame FrequencyEF07",
            "GET:Param.Tracking.Track FrequencyDD48",
            "PHSR:01E03E",
            "PHSR:02E17E",
            "PINIT:0131EA",
            "PINIT:0230AA",
            "PHSR:02E17E",
            "PHSR:0321BF",
            "PENA:01D6D3B",
            "PENA:02D9D3B",
            "PHSR:04E3FE",
            "PHINF:0100050CAD",
            "PHINF:0200050CE9",
        ]
    );
    bench.read();
    let farewell: Vec<_> = bench.farewell.iter().map(Request::as_bytes).collect();
    assert_eq!(farewell, [b"COMM:000000084\r"]);
    assert!(bench.now_ns < 1_000 * MS, "{} ns", bench.now_ns);
}

#[test]
fn a_break_resets_the_device_at_any_speed() {
    for (baud, _) in BAUDS.into_iter().skip(1) {
        let mut bench = bench(&[], 921_600);
        left_at(&mut bench, baud);
        bench.identify();
        assert_eq!(bench.breaks, 1, "{baud}");
        assert_eq!((bench.device.baud(), bench.host_baud), (Some(921_600), 921_600), "{baud}");
        assert_eq!(bench.host.counters().messages_damaged, 0, "wrong guesses are no damage");
    }
}

#[test]
fn without_breaks_every_speed_is_tried() {
    for (baud, _) in BAUDS {
        let mut bench = bench(&[], 921_600);
        bench.has_break = false;
        left_at(&mut bench, baud);
        bench.identify();
        // 1228739 is above the requested speed: the host lowers it.
        assert_eq!((bench.device.baud(), bench.host_baud), (Some(921_600), 921_600), "{baud}");
        assert!(
            bench.now_ns < 4_900 * MS,
            "{baud}: the daemon waits for 5 s, not {}",
            bench.now_ns
        );
    }
}

#[test]
fn the_speed_is_limited_by_the_request_and_the_device() {
    for (asked, can, reached) in [
        (115_200, 1_228_739, 115_200),
        (100_000, 1_228_739, 57_600),
        (9_600, 1_228_739, 9_600),
        (4_000_000, 1_228_739, 1_228_739),
        (921_600, 115_200, 115_200),
        (921_600, 9_600, 9_600),
    ] {
        let settings = NdiSettings { baud_max: can, ..NdiSettings::default() };
        let mut bench = Bench::new(jump(20, 60.0, 1.0), settings, asked);
        bench.identify();
        assert_eq!(
            (bench.device.baud(), bench.host_baud),
            (Some(reached), reached),
            "{asked} {can}"
        );
    }
}

#[test]
fn a_line_that_garbles_the_highest_speed_is_used_below_it() {
    for has_break in [true, false] {
        let mut bench = bench(&[], 921_600);
        (bench.line_baud_max, bench.has_break) = (115_200, has_break);
        if !has_break {
            // Without breaks, a device that has changed to such a speed is out of reach: only a break or its power
            // switch would bring it back.
            bench.send(Command::Identify);
            bench.run_for(20_000 * MS);
            assert!(bench.hellos.is_empty() && bench.failed.is_none());
            continue;
        }
        bench.identify();
        assert_eq!((bench.device.baud(), bench.host_baud), (Some(115_200), 115_200));
        assert_eq!(bench.breaks, 2, "once for each speed that failed");
    }
}

#[test]
fn a_speed_that_failed_is_tried_again_once_the_line_was_good_for_long() {
    for (seconds, reached) in [(1, 115_200), (60, 921_600)] {
        let settings = NdiSettings { looping: true, ..settings(&["head"], true) };
        let mut bench = Bench::new(jump(20, 60.0, 3.0), settings, 921_600);
        bench.line_baud_max = 115_200;
        bench.identify();
        assert_eq!((bench.device.baud(), bench.host_baud), (Some(115_200), 115_200));
        bench.line_baud_max = u32::MAX;
        bench.start();
        bench.run_for(seconds * 1_000 * MS);
        // Its power fails.
        bench.device.on_break(bench.now_ns);
        bench.run_until(|bench| bench.hellos.len() == 2);
        assert_eq!((bench.device.baud(), bench.host_baud), (Some(reached), reached), "{seconds} s");
    }
}

#[test]
fn the_search_for_an_absent_device_does_not_end() {
    let mut bench = bench(&[], 921_600);
    bench.damage = Box::new(Vec::clear);
    bench.send(Command::Identify);
    bench.send(Command::Ping { host_ns: 1 });
    bench.run_for(60_000 * MS);
    assert!(bench.hellos.is_empty() && bench.pongs.is_empty() && bench.failed.is_none());
    assert!(bench.requests.len() < 400, "{} requests in a minute", bench.requests.len());
    // It is plugged in.
    bench.damage = Box::new(|_| {});
    bench.send(Command::Ping { host_ns: 2 });
    bench.run_until(|bench| bench.pongs.last() == Some(&2));
    assert_eq!(bench.hellos.len(), 1);
}

#[test]
fn the_host_waits_for_a_slow_bring_up() {
    let mut bench = bench(&["head", "pelvis"], 921_600);
    // Every third answer is lost once the line is up, and each of those costs two seconds.
    let mut n_answers = 0;
    bench.damage = Box::new(move |answer| {
        n_answers += 1;
        if n_answers > 4 && n_answers % 3 == 0 {
            answer.clear();
        }
    });
    // Like the daemon: a ping every second for five seconds, and the whole greeting again after a pong.
    let mut pinged = 0;
    while bench.hellos.is_empty() {
        pinged += 1;
        assert!(pinged <= 5, "the daemon has given up");
        bench.send(Command::Stop);
        bench.send(Command::Identify);
        for _ in 0..5 {
            bench.send(Command::Ping { host_ns: pinged });
            let end_ns = bench.now_ns + 1_000 * MS;
            while bench.now_ns < end_ns && bench.pongs.last() != Some(&pinged) {
                bench.read();
            }
        }
        assert_eq!(bench.pongs.last(), Some(&pinged), "try {pinged}");
    }
    assert!(pinged > 2, "{pinged}");
    assert_eq!(bench.markers.len(), 2);
}

#[test]
fn a_second_identify_repeats_the_hello_without_another_setup() {
    let mut bench = bench(&["head"], 921_600);
    bench.identify();
    let n_requests = bench.requests.len();
    bench.send(Command::Stop);
    bench.send(Command::Identify);
    bench.send(Command::Ping { host_ns: 9 });
    bench.run_until(|bench| bench.pongs == [9]);
    assert_eq!(bench.hellos.len(), 2);
    assert_eq!(bench.hellos[0], bench.hellos[1]);
    assert_eq!(bench.requests.len(), n_requests);
}

#[test]
fn a_system_that_numbers_frames_by_tools_needs_one() {
    let mut bench = Bench::new(jump(20, 60.0, 1.0), settings(&[], false), 921_600);
    bench.send(Command::Identify);
    bench.run_for(2_000 * MS);
    let message = bench.failed.unwrap();
    assert!(message.contains("tool") && !message.contains("ERROR"), "{message}");
}

#[test]
fn a_line_that_is_too_slow_is_refused_with_a_remedy() {
    let tools = ["head", "throat", "pelvis", "l_shoulder"];
    let mut bench = Bench::new(jump(20, 60.0, 1.0), settings(&tools, true), 9_600);
    bench.identify();
    bench.send(Command::Start { line_bytes_per_s: 0 });
    bench.run_for(100 * MS);
    let message = bench.failed.unwrap();
    for fact in ["4 tools", "9600 baud", "4.0", "60 Hz", "@230400"] {
        assert!(message.contains(fact), "{fact}: {message}");
    }
}
