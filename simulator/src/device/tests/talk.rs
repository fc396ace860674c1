//! Commands, answers, refusals.

use proptest::prelude::*;

use super::*;

#[test]
fn a_second_run_counts_on_and_brings_the_same_motion() {
    let motion = jump(0.5);
    let mut bench = Bench::new(motion.clone(), DeviceSettings::default());
    for run in 0..3u32 {
        bench.heard.clear();
        bench.say(Command::Identify);
        bench.say(start());
        bench.pass(2_000 * MS, true);
        let frames = bench.frames();
        assert_eq!(frames.len(), 50);
        assert_eq!(frames[0].0, 50 * run);
        assert_eq!(row_of(&frames[49].2), expected(&motion, 49));
        assert_eq!(bench.ends().len(), 1);
        assert_eq!(bench.ends()[0].frames_produced, 50);
        assert!(bench.device.has_ended());
    }
}

/// Its end may have been lost on the line: whoever asks who it is hears how many frames there were.
#[test]
fn a_device_that_played_its_motion_says_so_when_it_is_asked() {
    let mut bench = Bench::new(jump(0.5), DeviceSettings::default());
    let asked = |bench: &mut Bench| {
        bench.heard.clear();
        bench.say(Command::Identify);
        bench.pass(MS, true);
        match &bench.heard[..] {
            [Heard::Status(status), Heard::Hello(hello), Heard::Markers(_)] => {
                assert_eq!(status.frames_produced, hello.n_frames);
                true
            }
            [Heard::Hello(_), Heard::Markers(_)] => false,
            other => panic!("{other:?}"),
        }
    };
    assert!(!asked(&mut bench), "it sent nothing");
    bench.say(start());
    bench.pass(200 * MS, true);
    assert!(!asked(&mut bench), "its stream did not end by itself");
    bench.say(start());
    bench.pass(2_000 * MS, true);
    // As often as it is asked: an answer may be lost, too.
    assert!(asked(&mut bench) && asked(&mut bench));
    bench.say(Command::Stop);
    bench.pass(MS, true);
    assert!(!asked(&mut bench), "a host that says Stop knows");
    bench.say(start());
    bench.pass(2_000 * MS, true);
    bench.device.lose_power();
    bench.device.power_up(bench.now_ns, false);
    assert!(!asked(&mut bench), "it remembers nothing");
}

#[test]
fn stop_ends_after_the_frames_that_were_due() {
    let mut bench = Bench::new(jump(3.0), DeviceSettings::default());
    bench.say(start());
    bench.pass(1_005 * MS, true);
    bench.say(Command::Stop);
    bench.pass(5_000 * MS, true);
    assert_eq!(bench.frames().len(), 101);
    assert!(matches!(bench.heard.last(), Some(Heard::End(s)) if s.frames_produced == 101));
    // Said again, because the answer may have been lost.
    bench.say(Command::Stop);
    bench.pass(MS, true);
    assert_eq!(bench.ends().len(), 2);
}

#[test]
fn start_said_again_does_not_begin_again() {
    let mut bench = Bench::new(jump(1.0), DeviceSettings::default());
    bench.say(start());
    bench.pass(300 * MS, true);
    bench.say(start());
    bench.pass(5_000 * MS, true);
    assert_eq!(bench.frames().len(), 100);
    assert_eq!(bench.heard.iter().filter(|h| matches!(h, Heard::Started(_))).count(), 2);
    assert_eq!(bench.device.log().starts, 1);
}

#[test]
fn identify_stops_and_forgets_what_waited() {
    let mut bench = Bench::new(jump(3.0), DeviceSettings::default());
    bench.say(start());
    bench.pass(500 * MS, false);
    // The host that read nothing is gone; half a message of its is on the line.
    let half: Vec<u8> = bench.device.pending()[..100].to_vec();
    bench.device.sent(half.len());
    bench.host.push(&half, &mut |_| {});
    bench.say(Command::Identify);
    let bytes = bench.device.pending().to_vec();
    let mut hellos = 0;
    bench
        .host
        .push(&bytes, &mut |event| hellos += u32::from(matches!(event, DeviceEvent::Hello(_))));
    assert_eq!(hellos, 1);
    assert!(bench.host.counters().messages_damaged <= 1);
    assert!(!bench.device.is_running());
    assert_eq!(bench.device.log().frames_discarded, 51);
    bench.assert_books_close();
}

#[test]
fn rates_are_set_and_refused() {
    let motion = jump(2.0);
    let mut bench = Bench::new(motion.clone(), DeviceSettings::default());
    bench.say(Command::SetRate(400_000));
    bench.say(Command::SetRate(999));
    bench.say(Command::SetRate(10_000_001));
    bench.say(Command::SetRate(0));
    bench.say(start());
    bench.pass(100 * MS, true);
    bench.say(Command::SetRate(50_000));
    bench.pass(10_000 * MS, true);
    assert_eq!(bench.heard[0], Heard::RateSet(400_000));
    let refusals: Vec<_> = bench
        .heard
        .iter()
        .filter_map(|h| if let Heard::Refused(b) = h { Some(b.rate_fits_mhz) } else { None })
        .collect();
    // While it runs, the rate that fits is the one that it runs at.
    assert_eq!(refusals, [10_000_000, 10_000_000, 10_000_000, 400_000]);
    assert_eq!(bench.device.log().refused, 4);
    let frames = bench.frames();
    assert_eq!(frames.len(), 199 * 4 + 1);
    assert_eq!(frames[4].1 - frames[0].1, 100_000);
    for k in 0..200 {
        assert_eq!(row_of(&frames[4 * k].2), expected(&motion, k));
    }
}

#[test]
fn a_slow_line_is_refused_with_the_rate_that_fits() {
    let mut bench = Bench::new(jump(1.0), DeviceSettings::default());
    let line = Command::Start { line_bytes_per_s: 11_520 };
    bench.say(line);
    bench.read();
    let Heard::Refused(budget) = bench.heard[0] else { panic!("{:?}", bench.heard) };
    assert!(budget.needed_bytes_per_s > 11_520 && budget.available_bytes_per_s == 11_520);
    assert!((10_000..100_000).contains(&budget.rate_fits_mhz));
    bench.pass(500 * MS, true);
    assert!(bench.frames().is_empty());
    bench.say(Command::SetRate(budget.rate_fits_mhz));
    bench.say(line);
    bench.pass(3_000 * MS, true);
    assert!(bench.heard.iter().any(|h| matches!(h, Heard::Started(_))));
    // What it then sends is what it promised.
    let sent = bench.device.log();
    assert!(sent.bytes_sent < 11_520, "{sent:?}");
    // The device knows its own line too.
    let slow = DeviceSettings { line_bytes_per_s: 11_520, ..DeviceSettings::default() };
    let mut bench = Bench::new(jump(1.0), slow);
    bench.say(start());
    bench.read();
    assert!(matches!(bench.heard[0], Heard::Refused(_)));
}

#[test]
fn answers_do_not_fill_memory() {
    let settings = DeviceSettings { queue_bytes: Some(1), ..DeviceSettings::default() };
    let mut bench = Bench::new(jump(0.1), settings);
    for _ in 0..10_000 {
        bench.say(Command::Ping { host_ns: 1 });
        assert!(bench.device.pending().len() < 4_096);
    }
    assert!(bench.device.log().answers_dropped > 9_000);
    // Frames never come without a Started before them.
    bench.say(start());
    assert!(!bench.device.is_running());
    // A host that says Identify is heard all the same.
    bench.say(Command::Identify);
    bench.read();
    assert!(bench.heard.iter().any(|h| matches!(h, Heard::Hello(_))));
}

#[test]
fn pings_tie_the_clocks() {
    let mut bench = Bench::new(jump(0.1), DeviceSettings::default());
    bench.device.poll(bench.now_ns);
    bench.now_ns += 1_234_567_890;
    bench.say(Command::Ping { host_ns: 42 });
    bench.read();
    assert_eq!(bench.heard, [Heard::Pong(Pong { host_ns: 42, device_ticks: 12_345_678 })]);
}

#[test]
fn what_cannot_be_a_device_is_refused() {
    let refuse = |motion: &Motion, settings: DeviceSettings| {
        Device::new(motion.clone(), settings).unwrap_err()
    };
    let good = jump(0.1);
    let settings = DeviceSettings::default;
    let none = Motion::default();
    assert_eq!(refuse(&none, settings()), DeviceError::NoMarkers);
    let mut empty = good.clone();
    empty.positions_mm.clear();
    assert_eq!(refuse(&empty, settings()), DeviceError::NoFrames);
    for rate_hz in [0.0, -60.0, f64::NAN, f64::INFINITY, 1e6] {
        let mut motion = good.clone();
        motion.info.rate_hz = rate_hz;
        let refused = refuse(&motion, settings());
        assert!(matches!(refused, DeviceError::MotionRate { .. }), "{rate_hz}: {refused:?}");
        let asked = DeviceSettings { rate_hz: Some(rate_hz), ..settings() };
        let refused = refuse(&good, asked);
        assert!(matches!(refused, DeviceError::Rate { .. }), "{rate_hz}: {refused:?}");
    }
    for speed in [0.0, -1.0, f64::NAN, 1e4] {
        let refused = refuse(&good, DeviceSettings { speed, ..settings() });
        assert!(matches!(refused, DeviceError::Speed { .. }), "{speed}: {refused:?}");
    }
    let (rate_hz, speed) = (good.info.rate_hz, 1000.0);
    assert_eq!(
        refuse(&good, DeviceSettings { speed, ..settings() }),
        DeviceError::Product { rate_hz, speed, product_hz: 100_000.0 }
    );
    let serial = "x".repeat(65);
    let refused = refuse(&good, DeviceSettings { serial, ..settings() });
    assert!(matches!(refused, DeviceError::Encode(_)), "{refused:?}");
}

proptest! {
    #[test]
    fn no_bytes_of_a_host_break_it(pieces in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..80), 0..20),
                                   commands in prop::collection::vec(0u8..5, 0..20)) {
        let mut bench = Bench::new(jump(0.05), DeviceSettings::default());
        for (i, piece) in pieces.iter().enumerate() {
            bench.device.on_bytes(piece, bench.now_ns);
            bench.device.on_bytes(&[0], bench.now_ns);
            if let Some(command) = commands.get(i) {
                bench.say(match command {
                    0 => Command::Identify,
                    1 => start(),
                    2 => Command::Stop,
                    3 => Command::SetRate(u32::from(*command) * 77_777),
                    _ => Command::Ping { host_ns: 3 },
                });
            }
            bench.pass(7 * MS, i % 3 == 0);
            bench.assert_books_close();
        }
    }
}
