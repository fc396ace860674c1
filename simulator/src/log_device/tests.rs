use mocapd_drivers::device::{DeviceEvent, Hello, LinkBudget, Pong, Protocol, Status};
use mocapd_drivers::link::{DeviceLink, HostLink};
use mocapd_drivers::raw_log::{Entry, Record, put_header, put_record, records};

use super::*;

const MS: u64 = 1_000_000;

fn from_device(write: impl FnOnce(&mut DeviceLink, &mut Vec<u8>)) -> Vec<u8> {
    let mut bytes = Vec::new();
    write(&mut DeviceLink::new(), &mut bytes);
    bytes
}

fn command(command: Command) -> Vec<u8> {
    let mut bytes = Vec::new();
    HostLink::new().command(command, &mut bytes);
    bytes
}

fn hello() -> Vec<u8> {
    let hello = Hello {
        rate_millihertz: 60_000,
        rate_min_millihertz: 1,
        rate_max_millihertz: 60_000,
        tick_hz: 1,
        ..Hello::default()
    };
    from_device(|link, out| link.hello(&hello, out).unwrap())
}

const START: Command = Command::Start { line_bytes_per_s: 0 };
const BUDGET: LinkBudget =
    LinkBudget { needed_bytes_per_s: 1, available_bytes_per_s: 2, rate_fits_millihertz: 60_000 };

/// A log of two seconds, in which a Ping with the time 5 is answered after 100 ms.
fn log() -> Vec<u8> {
    let pong = |host_ns| from_device(|link, out| link.pong(Pong { host_ns, device_ticks: 9 }, out));
    let entries: [(u64, bool, Vec<u8>); 9] = [
        (0, true, command(Command::Identify)),
        (1, true, command(Command::Ping { host_ns: 5 })),
        (40, false, hello()),
        (100, false, pong(5)),
        (110, true, command(START)),
        (120, false, from_device(|link, out| link.started(BUDGET, out))),
        (600, true, command(Command::Ping { host_ns: 6 })),
        (610, false, pong(6)),
        (2000, false, from_device(|link, out| link.end_of_stream(Status::default(), out))),
    ];
    let mut log = Vec::new();
    put_header(&mut log);
    put_record(&Record { time_ns: 0, entry: Entry::Opened("dvmc a line") }, &mut log);
    for (at_ms, to_device, bytes) in &entries {
        let entry = if *to_device { Entry::ToDevice(bytes) } else { Entry::FromDevice(bytes) };
        put_record(&Record { time_ns: at_ms * MS, entry }, &mut log);
    }
    put_record(&Record { time_ns: 2100 * MS, entry: Entry::Closed }, &mut log);
    put_record(&Record { time_ns: 2100 * MS, entry: Entry::End }, &mut log);
    log
}

/// Plays until the device waits for the host; returns its messages and their times in milliseconds.
fn play(device: &mut LogDevice, now_ms: &mut u64) -> Vec<(u64, String)> {
    let mut host = HostLink::new();
    let mut sent = Vec::new();
    loop {
        let next_ns = device.poll(*now_ms * MS);
        let bytes = device.pending().to_vec();
        device.sent(bytes.len());
        host.push(&bytes, &mut |event| {
            let name = match event {
                DeviceEvent::Hello(_) => "hello".to_owned(),
                DeviceEvent::Pong(pong) => format!("pong {}", pong.host_ns),
                DeviceEvent::Started(_) => "started".to_owned(),
                DeviceEvent::EndOfStream(_) => "end".to_owned(),
                other => format!("{other:?}"),
            };
            sent.push((*now_ms, name));
        });
        if next_ns == u64::MAX {
            return sent;
        }
        *now_ms = next_ns.div_ceil(MS);
    }
}

fn owned(sent: &[(u64, &str)]) -> Vec<(u64, String)> {
    sent.iter().map(|(at, name)| (*at, (*name).to_owned())).collect()
}

#[test]
fn the_replay_waits_for_its_host_and_keeps_the_logged_times() {
    for speed in [1.0, 2.0, 0.5] {
        let at = |ms: u64| (ms as f64 / speed) as u64;
        let mut device = LogDevice::new(&log(), speed).unwrap();
        assert!(device.problems().is_empty() && !device.unplugs());
        let mut now_ms = 7000;
        assert_eq!(play(&mut device, &mut now_ms), []);
        // A second host gets the same replay.
        for begin_ms in [10_000, 20_000] {
            now_ms = begin_ms;
            device.on_bytes(&command(Command::Stop), now_ms * MS);
            device.on_bytes(&command(Command::Identify), now_ms * MS);
            // Its ping comes later than the logged one: the Pong waits, and echoes its time.
            assert_eq!(play(&mut device, &mut now_ms), owned(&[(begin_ms + at(40), "hello")]));
            now_ms = begin_ms + 3000;
            device.on_bytes(&command(Command::Ping { host_ns: 77 }), now_ms * MS);
            assert_eq!(play(&mut device, &mut now_ms), owned(&[(begin_ms + 3000, "pong 77")]));
            now_ms = begin_ms + 4000;
            device.on_bytes(&command(START), now_ms * MS);
            let wanted = [(at(10), "started"), (at(500), "pong 6"), (at(1890), "end")];
            let wanted = wanted.map(|(ms, name)| (begin_ms + 4000 + ms, name));
            assert_eq!(play(&mut device, &mut now_ms), owned(&wanted));
            assert!(device.has_ended());
        }
        assert_eq!(device.log().starts, 2);
    }
}

#[test]
fn a_pong_is_never_older_than_its_ping() {
    for (pinged_ms, answer) in [(580, "pong 88"), (605, "pong 6")] {
        let mut device = LogDevice::new(&log(), 1.0).unwrap();
        let mut now_ms = 0;
        let greeting = [Command::Identify, Command::Ping { host_ns: 77 }].map(command).concat();
        device.on_bytes(&greeting, 0);
        play(&mut device, &mut now_ms);
        // From here on the times are those of the log, in which the ping of `pong 6` came at 600.
        device.on_bytes(&command(START), 110 * MS);
        device.poll(110 * MS);
        device.poll(pinged_ms * MS);
        device.on_bytes(&command(Command::Ping { host_ns: 88 }), pinged_ms * MS);
        now_ms = pinged_ms;
        let sent = play(&mut device, &mut now_ms);
        assert!(sent.contains(&(610, answer.to_owned())), "{pinged_ms}: {sent:?}");
    }
}

#[test]
fn a_host_that_needs_fewer_tries_than_the_logged_one_gets_its_frames() {
    // The logged host asked twice.
    let mut twice = Vec::new();
    put_header(&mut twice);
    let mut asked = false;
    for record in records(&log()).unwrap() {
        let record = record.unwrap();
        put_record(&record, &mut twice);
        if matches!(record.entry, Entry::FromDevice(_)) && !std::mem::replace(&mut asked, true) {
            let entry = Entry::ToDevice(&command(Command::Identify));
            put_record(&Record { time_ns: 50 * MS, entry }, &mut twice);
        }
    }
    let mut device = LogDevice::new(&twice, 1.0).unwrap();
    let mut now_ms = 0;
    let greeting = [Command::Identify, Command::Ping { host_ns: 77 }].map(command).concat();
    device.on_bytes(&greeting, 0);
    assert_eq!(play(&mut device, &mut now_ms), owned(&[(40, "hello")]));
    now_ms = 1000;
    device.on_bytes(&command(START), now_ms * MS);
    let sent = play(&mut device, &mut now_ms);
    assert_eq!(sent[0], (1010, "started".to_owned()));
    assert_eq!(sent.last(), Some(&(2890, "end".to_owned())));
}

#[test]
fn unusable_logs_are_refused() {
    use LogDeviceError::{Driver, Log, Silent, Speed, Unreadable};
    let error = |log: &[u8]| LogDevice::new(log, 1.0).unwrap_err();
    assert!(matches!(error(b"time,x\n"), Log(RawLogError::NotALog)));
    let mut empty = Vec::new();
    put_header(&mut empty);
    let cut = error(&empty);
    assert!(matches!(cut, Unreadable(RawLogError::CutOff { offset: 9 })), "{cut:?}");
    let cut = error(&empty[..8]);
    assert!(matches!(cut, Unreadable(RawLogError::CutOff { offset: 8 })), "{cut:?}");
    let mut silent = empty.clone();
    put_record(&Record { time_ns: 0, entry: Entry::End }, &mut silent);
    assert!(matches!(error(&silent), Silent));
    put_record(&Record { time_ns: 0, entry: Entry::Opened("ndi /dev/ttyUSB0") }, &mut empty);
    put_record(&Record { time_ns: 0, entry: Entry::FromDevice(b"OKAYA896\r") }, &mut empty);
    assert!(matches!(error(&empty), Driver { driver } if driver == "ndi"));
    let still = LogDevice::new(&log(), 0.0).unwrap_err();
    assert!(matches!(still, Speed { found: 0.0 }), "{still:?}");
}

#[test]
fn a_log_without_an_end_of_stream_is_played_once() {
    let whole = log();
    let mut again = Vec::new();
    put_header(&mut again);
    let put = |record: Result<Record<'_>, _>| {
        put_record(&record.unwrap(), &mut again);
        again.len()
    };
    let ends: Vec<usize> = records(&whole).unwrap().map(put).collect();
    // Started, ping, pong, end of stream: the last may be cut off, damaged, or missing because the cable was pulled for
    // good.
    let n = ends.len();
    let mut damaged = whole.clone();
    damaged[ends[n - 4] + 20] ^= 1;
    let mut unplugged = whole[..ends[n - 4]].to_vec();
    put_record(&Record { time_ns: 900 * MS, entry: Entry::Closed }, &mut unplugged);
    put_record(&Record { time_ns: 5000 * MS, entry: Entry::End }, &mut unplugged);
    for (what, log, gone_ms) in [
        ("of a killed recorder", &whole[..ends[n - 4]], 500),
        ("cut off", &whole[..ends[n - 4] + 9], 500),
        ("damaged", &damaged, 500),
        ("unplugged", &unplugged, 790),
    ] {
        let mut device = LogDevice::new(log, 1.0).unwrap();
        assert_eq!(device.problems().len(), usize::from(what != "unplugged"), "{what}");
        assert!(!device.unplugs(), "it needs no stable name: {what}");
        let greeting =
            [Command::Stop, Command::Identify, Command::Ping { host_ns: 77 }].map(command).concat();
        let mut now_ms = 1000;
        device.on_bytes(&greeting, now_ms * MS);
        play(&mut device, &mut now_ms);
        now_ms = 2000;
        device.on_bytes(&command(START), now_ms * MS);
        let sent = play(&mut device, &mut now_ms);
        assert_eq!(sent, owned(&[(2010, "started"), (2500, "pong 6")]), "{what}");
        assert_eq!((now_ms, device.is_gone()), (2000 + gone_ms, true), "{what}");
        assert!(!device.has_ended(), "{what}");
        // A host that asks now gets no answer.
        now_ms = 20_000;
        device.on_bytes(&greeting, now_ms * MS);
        assert_eq!(play(&mut device, &mut now_ms), [], "{what}");
    }
}

#[test]
fn only_a_host_that_opens_the_line_restarts_the_log() {
    let greeting = [Command::Stop, Command::Identify].map(command).concat();
    let begun = || {
        let mut device = LogDevice::new(&log(), 1.0).unwrap();
        device.on_bytes(&[&greeting[..], &command(Command::Ping { host_ns: 7 })].concat(), 0);
        play(&mut device, &mut 0);
        device.on_bytes(&command(START), 110 * MS);
        device.poll(110 * MS);
        device.poll(500 * MS);
        let n = device.pending().len();
        device.sent(n);
        device
    };
    // A host that misses frames sends Identify: the log has no answer, and continues.
    let mut device = begun();
    device.on_bytes(&command(Command::Identify), 500 * MS);
    let mut now_ms = 500;
    let rest = owned(&[(610, "pong 6"), (2000, "end")]);
    assert_eq!(play(&mut device, &mut now_ms), rest);
    // Another one after a recorder that was killed.
    let mut device = begun();
    device.on_bytes(&greeting, 500 * MS);
    now_ms = 500;
    assert_eq!(play(&mut device, &mut now_ms), owned(&[(540, "hello")]));
}

#[test]
fn a_log_that_is_cut_off_or_has_gaps_is_played_with_a_warning() {
    let whole = log();
    let cut = LogDevice::new(&whole[..whole.len() - 30], 1.0).unwrap();
    let [LogProblem::Unreadable(RawLogError::CutOff { offset })] = cut.problems() else {
        panic!("{:?}", cut.problems());
    };
    assert!((1..whole.len() - 30).contains(offset), "{offset}");
    let mut holes = whole[..whole.len() - 2 * 17].to_vec();
    put_record(&Record { time_ns: 1, entry: Entry::Missing(99) }, &mut holes);
    put_record(&Record { time_ns: 1, entry: Entry::End }, &mut holes);
    let holes = LogDevice::new(&holes, 1.0).unwrap();
    assert_eq!(holes.problems(), [LogProblem::Missing { bytes: 99 }]);
}

/// Logs of any records in any order, and hosts that send anything: the replay never panics or stops making progress.
#[test]
fn any_log_and_any_host_reach_an_end() {
    for seed in 0..300 {
        let mut rng = crate::generator::Rng::new(seed);
        let mut below = |n: u64| rng.next_u64() % n;
        let mut log = Vec::new();
        put_header(&mut log);
        let commands = [
            Command::Identify,
            START,
            Command::Stop,
            Command::Ping { host_ns: 3 },
            Command::SetRate(5),
        ];
        let pong = from_device(|link, out| link.pong(Pong { host_ns: 1, device_ticks: 2 }, out));
        let mut time_ns = 0;
        put_record(&Record { time_ns, entry: Entry::Opened("dvmc x") }, &mut log);
        for _ in 0..40 {
            time_ns = (time_ns + below(400 * MS)).saturating_sub(below(100 * MS));
            let sent = command(commands[below(5) as usize]);
            let noise: Vec<u8> = (0..below(60)).map(|_| below(5) as u8).collect();
            let entry = match below(8) {
                0 => Entry::ToDevice(&sent),
                1 => Entry::ToDevice(&noise),
                2 => Entry::Closed,
                3 => Entry::Opened("dvmc y"),
                4 => Entry::FromDevice(&pong),
                5 => Entry::Missing(3),
                _ => Entry::FromDevice(&noise),
            };
            put_record(&Record { time_ns, entry }, &mut log);
        }
        let cut = below(log.len() as u64 / 4) as usize;
        log.truncate(log.len() - cut);
        let Ok(mut device) = LogDevice::new(&log, 1.0) else { continue };
        let mut now_ns = 1;
        for _ in 0..400 {
            if below(3) == 0 {
                device.on_bytes(&command(commands[below(5) as usize]), now_ns);
            }
            let next_ns = device.poll(now_ns);
            let n = device.pending().len();
            device.sent(n);
            assert!(next_ns > now_ns || n > 0, "seed {seed}: due, but no progress");
            now_ns = next_ns.min(now_ns + 50 * MS).max(now_ns);
        }
        assert!(device.log().bytes_sent < 400 * 40 * 60, "seed {seed}");
    }
}

#[test]
fn other_bytes_pass_unchanged_in_pieces_of_any_size() {
    let frames: Vec<u8> = (0..4000u32).map(|i| ((i * i) >> 3) as u8 % 7).collect();
    let pong = from_device(|link, out| link.pong(Pong { host_ns: 1, device_ticks: 2 }, out));
    let all = [&frames[..], &[0], &pong, &frames, &[0, 0, 0], &pong].concat();
    for chunk in [1, 5, 24, 25, 1000, all.len()] {
        let (mut pongs, mut out) = (PongRewriter::new(), Vec::new());
        for piece in all.chunks(chunk) {
            assert_eq!(pongs.pass(piece, 5, false, |_| None, &mut out), piece.len());
        }
        pongs.flush(&mut out);
        assert_eq!(out, all, "{chunk}");
    }
}
