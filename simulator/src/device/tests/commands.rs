//! Commands, answers and refusals.

use proptest::prelude::*;

use super::*;

#[test]
fn a_second_run_continues_the_counter_and_repeats_the_motion() {
    let motion = jump(0.5);
    let mut bench = Bench::new(motion.clone(), DeviceSettings::default());
    for run in 0..3u32 {
        bench.events.clear();
        bench.send(Command::Identify);
        bench.send(start());
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

/// `EndOfStream` may have been lost on the line: an Identify is then answered with the number of frames.
#[test]
fn a_finished_device_reports_its_frames_on_identify() {
    let mut bench = Bench::new(jump(0.5), DeviceSettings::default());
    let asked = |bench: &mut Bench| {
        bench.events.clear();
        bench.send(Command::Identify);
        bench.pass(MS, true);
        match &bench.events[..] {
            [Event::Status(status), Event::Hello(hello), Event::Markers(_)] => {
                assert_eq!(status.frames_produced, hello.n_frames);
                true
            }
            [Event::Hello(_), Event::Markers(_)] => false,
            other => panic!("{other:?}"),
        }
    };
    assert!(!asked(&mut bench), "nothing was sent");
    bench.send(start());
    bench.pass(200 * MS, true);
    assert!(!asked(&mut bench), "the stream did not end by itself");
    bench.send(start());
    bench.pass(2_000 * MS, true);
    // Each time: an answer may be lost, too.
    assert!(asked(&mut bench) && asked(&mut bench));
    bench.send(Command::Stop);
    bench.pass(MS, true);
    assert!(!asked(&mut bench), "a host that sends Stop knows of the end");
    bench.send(start());
    bench.pass(2_000 * MS, true);
    bench.device.lose_power();
    bench.device.power_up(bench.now_ns, false);
    assert!(!asked(&mut bench), "a loss of power clears the memory");
}

#[test]
fn stop_ends_after_the_frames_that_were_due() {
    let mut bench = Bench::new(jump(3.0), DeviceSettings::default());
    bench.send(start());
    bench.pass(1_005 * MS, true);
    bench.send(Command::Stop);
    bench.pass(5_000 * MS, true);
    assert_eq!(bench.frames().len(), 101);
    assert!(matches!(bench.events.last(), Some(Event::End(s)) if s.frames_produced == 101));
    // Repeated, because the answer may have been lost.
    bench.send(Command::Stop);
    bench.pass(MS, true);
    assert_eq!(bench.ends().len(), 2);
}

#[test]
fn a_repeated_start_does_not_restart_the_run() {
    let mut bench = Bench::new(jump(1.0), DeviceSettings::default());
    bench.send(start());
    bench.pass(300 * MS, true);
    bench.send(start());
    bench.pass(5_000 * MS, true);
    assert_eq!(bench.frames().len(), 100);
    assert_eq!(bench.events.iter().filter(|h| matches!(h, Event::Started(_))).count(), 2);
    assert_eq!(bench.device.log().starts, 1);
}

#[test]
fn identify_stops_the_run_and_clears_the_queue() {
    let mut bench = Bench::new(jump(3.0), DeviceSettings::default());
    bench.send(start());
    bench.pass(500 * MS, false);
    // The host that did not read is gone, and half a message is on the line.
    let half: Vec<u8> = bench.device.pending()[..100].to_vec();
    bench.device.sent(half.len());
    bench.host.push(&half, &mut |_| {});
    bench.send(Command::Identify);
    let bytes = bench.device.pending().to_vec();
    let mut hellos = 0;
    bench
        .host
        .push(&bytes, &mut |event| hellos += u32::from(matches!(event, DeviceEvent::Hello(_))));
    assert_eq!(hellos, 1);
    assert!(bench.host.counters().messages_damaged <= 1);
    assert!(!bench.device.is_running());
    assert_eq!(bench.device.log().frames_discarded, 51);
    bench.assert_counts_add_up();
}

#[test]
fn rates_are_set_and_refused() {
    let motion = jump(2.0);
    let mut bench = Bench::new(motion.clone(), DeviceSettings::default());
    bench.send(Command::SetRate(400_000));
    bench.send(Command::SetRate(999));
    bench.send(Command::SetRate(10_000_001));
    bench.send(Command::SetRate(0));
    bench.send(start());
    bench.pass(100 * MS, true);
    bench.send(Command::SetRate(50_000));
    bench.pass(10_000 * MS, true);
    assert_eq!(bench.events[0], Event::RateSet(400_000));
    let refusals: Vec<_> = bench
        .events
        .iter()
        .filter_map(|h| if let Event::Refused(b) = h { Some(b.rate_fits_millihertz) } else { None })
        .collect();
    // During a run, the only rate that fits is the current one.
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
    bench.send(line);
    bench.read();
    let Event::Refused(budget) = bench.events[0] else { panic!("{:?}", bench.events) };
    assert!(budget.needed_bytes_per_s > 11_520 && budget.available_bytes_per_s == 11_520);
    assert!((10_000..100_000).contains(&budget.rate_fits_millihertz));
    bench.pass(500 * MS, true);
    assert!(bench.frames().is_empty());
    bench.send(Command::SetRate(budget.rate_fits_millihertz));
    bench.send(line);
    bench.pass(3_000 * MS, true);
    assert!(bench.events.iter().any(|h| matches!(h, Event::Started(_))));
    // It then sends no more than the budget.
    let sent = bench.device.log();
    assert!(sent.bytes_sent < 11_520, "{sent:?}");
    // The device also knows the limit of its own line.
    let slow = DeviceSettings { line_bytes_per_s: 11_520, ..DeviceSettings::default() };
    let mut bench = Bench::new(jump(1.0), slow);
    bench.send(start());
    bench.read();
    assert!(matches!(bench.events[0], Event::Refused(_)));
}

#[test]
fn queued_answers_are_bounded() {
    let settings = DeviceSettings { queue_bytes: Some(1), ..DeviceSettings::default() };
    let mut bench = Bench::new(jump(0.1), settings);
    for _ in 0..10_000 {
        bench.send(Command::Ping { host_ns: 1 });
        assert!(bench.device.pending().len() < 4_096);
    }
    assert!(bench.device.log().answers_dropped > 9_000);
    // Frames never come without a Started before them.
    bench.send(start());
    assert!(!bench.device.is_running());
    // Identify still works.
    bench.send(Command::Identify);
    bench.read();
    assert!(bench.events.iter().any(|h| matches!(h, Event::Hello(_))));
}

#[test]
fn a_pong_carries_the_device_ticks() {
    let mut bench = Bench::new(jump(0.1), DeviceSettings::default());
    bench.device.poll(bench.now_ns);
    bench.now_ns += 1_234_567_890;
    bench.send(Command::Ping { host_ns: 42 });
    bench.read();
    assert_eq!(bench.events, [Event::Pong(Pong { host_ns: 42, device_ticks: 12_345_678 })]);
}

#[test]
fn unsuitable_motions_and_settings_are_refused() {
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
    fn the_device_survives_any_bytes(pieces in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..80), 0..20),
                                   commands in prop::collection::vec(0u8..5, 0..20)) {
        let mut bench = Bench::new(jump(0.05), DeviceSettings::default());
        for (i, piece) in pieces.iter().enumerate() {
            bench.device.on_bytes(piece, bench.now_ns);
            bench.device.on_bytes(&[0], bench.now_ns);
            if let Some(command) = commands.get(i) {
                bench.send(match command {
                    0 => Command::Identify,
                    1 => start(),
                    2 => Command::Stop,
                    3 => Command::SetRate(u32::from(*command) * 77_777),
                    _ => Command::Ping { host_ns: 3 },
                });
            }
            bench.pass(7 * MS, i % 3 == 0);
            bench.assert_counts_add_up();
        }
    }
}
