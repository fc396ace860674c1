mod kinds;

use std::sync::Arc;

use mocapd_drivers::device::{Command, DeviceEvent, Protocol};
use mocapd_drivers::link::HostLink;

use super::*;
use crate::device::{Device, DeviceSettings, LineDevice};
use crate::generator::JumpSpec;

const SHIPPED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/faults");
const DOCUMENT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/faults.md");

/// A script without its first line, `seed = 1`.
fn parse(rest: &str) -> Result<Script, String> {
    Script::parse("a.toml", &format!("seed = 1\n{rest}")).map_err(|error| error.to_string())
}

/// Line and message of the error for a script: the text is one line and holds these facts.
#[track_caller]
fn refused(script: &str, facts: &[&str]) -> (usize, String) {
    let error = Script::parse("a.toml", script).unwrap_err();
    for fact in facts {
        assert!(error.message.contains(fact), "{fact}: {error}");
    }
    let whole = error.to_string();
    assert!(whole.contains("a.toml") && whole.contains(&error.line.to_string()), "{whole}");
    assert_eq!(whole.lines().count(), 1, "{whole}");
    (error.line, error.message)
}

#[test]
fn errors_name_the_line_and_what_to_write() {
    let flips = "[[fault]]\nkind = 'bit-flips'\n";
    let many = "[[fault]]\nkind = 'bursts'\nperiod_ms = 2\n".repeat(FAULTS_MAX + 1);
    let cases: [(&str, usize, &[&str]); 23] = [
        (&format!("{flips}rat = 1e-4"), 4, &["'rat'", "'bit-flips'", "'rate'"]),
        (&format!("{flips}rate = 1e-4\nseconds = 3"), 5, &["'seconds'", "rate, from_s, to_s"]),
        (flips, 2, &["'bit-flips'", "'rate'"]),
        (&format!("{flips}rate = 0.2"), 4, &["rate", "0.1"]),
        (&format!("{flips}rate = 'x'"), 4, &["rate", "0.1"]),
        (&format!("{flips}rate = true"), 4, &["rate", "0.1"]),
        ("[[fault]]\nkind = 3", 3, &["kind", "bit-flips, dropped-bytes"]),
        ("[[fault]]\nkind = ''", 3, &["''", "bit-flips, dropped-bytes"]),
        ("[expect]\nexit = 'x'", 3, &["exit", "255"]),
        ("[expect]\nexit = 300", 3, &["exit", "255"]),
        ("[expect]\nevents = []", 2, &["[expect]", "'exit'"]),
        ("[expect]\nexit = 0\nevents = 'x'", 4, &["events", "[\"...\"]"]),
        ("[expect]\nexit = 0\nledger = 1", 4, &["ledger", "exact, by-host-clock"]),
        ("expect = 3", 2, &["[expect]"]),
        (&format!("{flips}rate = 1e-4\nfrom_s = 3\nto_s = 2"), 2, &["from_s", "to_s"]),
        ("[[fault]]\nkind = 'bitflips'", 3, &["'bitflips'", "'bit-flips'"]),
        ("[[fault]]\nrate = 1", 2, &["kind", "bit-flips, dropped-bytes"]),
        ("[fault]\nkind = 'bit-flips'", 2, &["[[fault]]"]),
        ("[[faults]]\nkind = 'stall'", 2, &["'faults'", "'fault'"]),
        ("[[fault]]\nkind = 'ghosts'\ncount = 2.5", 4, &["count", "1000", "markers"]),
        (
            "[[fault]]\nkind = 'power-loss'\nat_s = 1\nfor_s = 1\nkeeps_port = 1",
            6,
            &["keeps_port", "true", "false"],
        ),
        (&many, 2, &[&FAULTS_MAX.to_string()]),
        (&"#".repeat(SCRIPT_BYTES_MAX), 1, &[&SCRIPT_BYTES_MAX.to_string()]),
    ];
    let mut messages = std::collections::HashSet::new();
    for (rest, line, facts) in cases {
        let (found, message) = refused(&format!("seed = 1\n{rest}"), facts);
        assert_eq!(found, line, "{message}");
        assert!(messages.insert(message.clone()), "one message for two mistakes: {message}");
    }
    for (rest, line, facts) in [
        ("[[fault]]\nkind = 'gremlins'", 3, &["'gremlins'", "bit-flips, dropped-bytes"][..]),
        (&format!("{flips}rate = nan"), 4, &["rate", "0.1"]),
        ("fault = [3]", 2, &["[[fault]]"]),
        ("[[fault]]\nkind = 'stall'\nat_s = 1\nfor_s = 1\nto_s = 3", 6, &["'to_s'"]),
        ("[expect]\nexit = 0\nevent = []", 4, &["'event'", "'events'"]),
        ("seed = 2", 2, &[]),
        ("= ", 2, &[]),
    ] {
        assert_eq!(refused(&format!("seed = 1\n{rest}"), facts).0, line, "{rest}");
    }
    assert_eq!(refused("[expect]\nexit = 0", &["`seed = 1`"]).0, 1);
    let facts = ["seed", &i64::MAX.to_string()];
    let seeds = ["'x'", "-1", "1.5"].map(|seed| refused(&format!("seed = {seed}"), &facts));
    assert!(seeds.iter().all(|(line, _)| *line == 1), "{seeds:?}");
    assert_ne!(seeds[0], seeds[1], "a wrong type and a wrong range differ");
}

/// A script with every kind and all of its keys, each at its minimum.
fn all_kinds() -> String {
    let mut text = String::new();
    for kind in KINDS {
        text.push_str(&format!("[[fault]]\nkind = '{}'\n", kind.name));
        for KeySpec { name, unit, min, .. } in kind.keys {
            let value = if *unit == "bool" { "false".to_owned() } else { min.to_string() };
            text.push_str(&format!("{name} = {value}\n"));
        }
        if kind.windowed {
            text.push_str("from_s = 1\nto_s = 2.5\n");
        }
    }
    text
}

#[test]
fn every_kind_parses_with_all_its_keys() {
    let script = parse(&all_kinds()).unwrap();
    assert_eq!(script.faults.len(), KINDS.len());
    for (scheduled, keys) in script.faults.iter().zip(KINDS) {
        assert_eq!(scheduled.fault.kind(), keys.kind);
        let to_ns = if keys.windowed { 2_500_000_000 } else { u64::MAX };
        assert_eq!(scheduled.to_ns, to_ns);
    }
}

/// docs/faults.md has a row for every key, with its unit and its range.
#[test]
fn the_document_lists_every_key() {
    let page = std::fs::read_to_string(DOCUMENT).unwrap();
    let rows: Vec<Vec<&str>> = page
        .lines()
        .filter_map(|line| line.strip_prefix("| ")?.strip_suffix(" |"))
        .map(|line| line.split('|').map(str::trim).collect())
        .filter(|cells: &Vec<&str>| cells.len() == 6)
        .collect();
    let mut rows = rows.iter().filter(|cells| cells[2].starts_with('`'));
    for kind in KINDS {
        for (index, key) in kind.keys.iter().enumerate() {
            let row = rows.next().unwrap();
            let name = if index == 0 { format!("`{}`", kind.name) } else { String::new() };
            let windowed = if kind.windowed { "yes" } else { "no" };
            assert_eq!(row[0], name, "{row:?}");
            assert_eq!(row[1], if index == 0 { windowed } else { "" }, "{row:?}");
            assert_eq!((row[2], row[3]), (format!("`{}`", key.name).as_str(), key.unit));
            let is_bool = key.unit == "bool";
            let range = if is_bool {
                "true or false".to_owned()
            } else {
                format!("{} to {}", key.min, key.max)
            };
            assert!(row[4].starts_with(&range), "{row:?}: {range}");
            assert_eq!(row[4].ends_with("if left out"), key.optional, "{row:?}");
        }
    }
    assert_eq!(rows.next(), None, "a row for a key that does not exist");
}

/// A device that plays 480 frames in two seconds.
fn device_with(script: &Script) -> FaultyDevice {
    let script = Arc::new(script.clone());
    let spec = JumpSpec { seconds: Some(2.0), ..JumpSpec::new(1, 240.0) };
    let settings =
        DeviceSettings { faults: Some(Arc::clone(&script)), ..DeviceSettings::default() };
    let device = Device::new(spec.generate().unwrap().motion, settings).unwrap();
    FaultyDevice::new(device, &script)
}

/// Sends all that the device has, in virtual time, until it has ended or `until_ns`. Returns the time.
fn send_all(device: &mut FaultyDevice, mut now_ns: u64, until_ns: u64) -> u64 {
    while now_ns < until_ns && !device.has_ended() {
        let wake_ns = device.poll(now_ns);
        let n = device.pending().len();
        device.sent(n);
        now_ns = wake_ns.clamp(now_ns + 1, now_ns + 10_000_000);
    }
    now_ns
}

/// Plays a device with faults in virtual time to a host that takes `chunk` bytes at a time and pings every `ping_ns`.
/// Returns the fates, and the counters of the frames that the host decoded.
fn play(script: &Script, chunk: usize, ping_ns: u64) -> (Vec<FrameFate>, Vec<u32>) {
    let mut device = device_with(script);
    device.keep_frame_log();
    let mut host = HostLink::new();
    let mut bytes = Vec::new();
    host.command(Command::Identify, &mut bytes);
    host.command(Command::Start { line_bytes_per_s: 0 }, &mut bytes);
    let mut now_ns = 1_000_000;
    device.on_bytes(&bytes, now_ns);
    let (mut seqs, mut next_ping_ns, mut ended) = (Vec::new(), ping_ns, false);
    while !ended {
        let wake_ns = device.poll(now_ns);
        while !device.pending().is_empty() {
            let n = device.pending().len().min(chunk);
            let taken = device.pending()[..n].to_vec();
            device.sent(n);
            host.push(&taken, &mut |event| match event {
                DeviceEvent::Frame(frame) => seqs.push(frame.seq),
                DeviceEvent::EndOfStream(_) => ended = true,
                _ => {}
            });
        }
        if now_ns >= next_ping_ns {
            next_ping_ns = now_ns + ping_ns;
            bytes.clear();
            host.command(Command::Ping { host_ns: 7 }, &mut bytes);
            device.on_bytes(&bytes, now_ns);
        }
        now_ns = wake_ns.min(next_ping_ns).max(now_ns + 1);
        assert!(ended || now_ns < 10_000_000_000, "no end");
    }
    device.close();
    (device.take_fates(), seqs)
}

#[test]
fn chunk_size_does_not_change_which_frames_are_hit() {
    for name in ["lost-frames", "late-frames", "doubled-frames", "bit-flips", "occlusion-storm"] {
        let text = std::fs::read_to_string(format!("{SHIPPED}/{name}.toml")).unwrap();
        let script = Script::parse(name, &text).unwrap();
        let hit = |(fates, _): &(Vec<FrameFate>, _)| -> Vec<_> {
            fates.iter().map(|f| (f.frame.seq, f.frame.present, f.fate, f.again)).collect()
        };
        let one = play(&script, usize::MAX, u64::MAX);
        assert_eq!(one.0.len(), 480);
        assert_eq!(hit(&one), hit(&play(&script, 7, u64::MAX)), "{name}");
        let other = Script { seed: script.seed + 100, ..script };
        assert_ne!(hit(&one), hit(&play(&other, usize::MAX, u64::MAX)), "{name}");
    }
}

/// The fates against a receiver that decodes the damaged bytes; the two share no code but the framing.
#[test]
fn fates_agree_with_a_receiver() {
    let mut hit = 0;
    for seed in 0..20 {
        let script = parse(&format!(
            "[[fault]]\nkind = 'bit-flips'\nrate = 1e-3\nto_s = 1.9\n\
             [[fault]]\nkind = 'dropped-bytes'\nrate = 1e-3\nto_s = 1.9\n\
             [[fault]]\nkind = 'doubled-bytes'\nrate = 1e-3\nto_s = 1.9\n\
             [[fault]]\nkind = 'doubled-frames'\nrate = 0.1\nto_s = 1.9\n\
             [[fault]]\nkind = 'late-frames'\nrate = 0.1\nby = {}\nto_s = 1.9\n\
             [[fault]]\nkind = 'lost-frames'\nrate = 0.01\nrun = 3\nto_s = 1.9",
            1 + seed * 3
        ));
        let script = Script { seed, ..script.unwrap() };
        let (fates, mut seqs) = play(&script, 100, 3_000_000);
        let mut expected: Vec<u32> = Vec::new();
        for fate in &fates {
            let times = u32::from(matches!(fate.fate, Fate::Whole | Fate::Late)) + fate.again;
            expected.extend(std::iter::repeat_n(fate.frame.seq, times as usize));
        }
        // Whole frames that are not late arrive in order.
        let mut last = None;
        for (seq, fate) in fates.iter().filter(|f| f.fate == Fate::Whole).map(|f| (f.frame.seq, f))
        {
            assert!(last < Some(seq) && seqs.contains(&seq), "{fate:?}");
            last = Some(seq);
        }
        seqs.sort_unstable();
        assert_eq!(seqs, expected, "seed {seed}");
        assert_eq!(fates.len(), 480);
        let damaged = fates.iter().filter(|f| f.fate == Fate::Damaged);
        hit += damaged.clone().count();
        assert!(damaged.into_iter().all(|f| !f.faults.is_empty()), "seed {seed}");
    }
    assert!(hit > 1000, "{hit} damaged frames");
}

/// Totals also count faults that harm no frame.
#[test]
fn totals_count_the_effects_of_each_kind() {
    for (name, kinds) in [
        ("lying-counter", &[(Kind::CounterJump, Some(3)), (Kind::CounterRepeat, None)][..]),
        ("clock-back", &[(Kind::ClockJump, Some(1))]),
        ("clock", &[(Kind::ClockDrift, Some(480)), (Kind::ClockJump, Some(1))]),
        ("bursts", &[(Kind::Bursts, None)]),
        ("garbage", &[(Kind::Garbage, Some(1))]),
        ("swaps-and-ghosts", &[(Kind::Swaps, None)]),
        ("doubled-frames", &[(Kind::DoubledFrames, None)]),
    ] {
        let text = std::fs::read_to_string(format!("{SHIPPED}/{name}.toml")).unwrap();
        let script = Script::parse(name, &text).unwrap();
        let totals = totals(&script);
        let summary = totals.summary();
        for (kind, times) in kinds {
            let did = totals.counts.of(*kind);
            assert!(did > 0 && times.is_none_or(|times| did == times), "{name}: {did}: {summary}");
            assert!(summary.contains(KINDS[*kind as usize].name), "{name}: {summary}");
        }
        if name != "swaps-and-ghosts" {
            assert_eq!((totals.of(Fate::Damaged), totals.of(Fate::Lost)), (0, 0), "{name}");
        }
    }
}

fn totals(script: &Script) -> FaultTotals {
    let mut device = device_with(script);
    let mut bytes = Vec::new();
    HostLink::new().command(Command::Identify, &mut bytes);
    HostLink::new().command(Command::Start { line_bytes_per_s: 0 }, &mut bytes);
    device.on_bytes(&bytes, 1_000_000);
    send_all(&mut device, 1_000_000, 20_000_000_000);
    assert!(device.has_ended(), "no end");
    device.close();
    device.log().faults.unwrap()
}

/// Plays a motion of two seconds on a device to which `commands` are sent, each at its time in seconds. Returns whether the
/// device had ended before the next command, for each of them, and the time at the end.
fn play_with(fault: &str, commands: &[(f64, Command)]) -> (Vec<bool>, u64) {
    let script = parse(&format!("[[fault]]\n{fault}\nat_s = 0.5\nfor_s = 0.5")).unwrap();
    let mut device = device_with(&script);
    let (mut now_ns, mut ended) = (1_000_000, Vec::new());
    let ends = commands.iter().skip(1).map(|(at_s, _)| *at_s).chain([10.0]);
    for ((_, command), until_s) in commands.iter().zip(ends) {
        let mut bytes = Vec::new();
        HostLink::new().command(*command, &mut bytes);
        device.on_bytes(&bytes, now_ns);
        now_ns = send_all(&mut device, now_ns, (until_s * 1e9) as u64);
        ended.push(device.has_ended());
    }
    (ended, now_ns)
}

/// A host that comes back stops the device, identifies it and starts it: the Stop alone is no end, however late the rest
/// comes.
#[test]
fn the_first_stop_after_an_outage_is_no_end() {
    let start = Command::Start { line_bytes_per_s: 0 };
    let commands = [(0.0, start), (1.2, Command::Stop), (1.3, Command::Identify), (1.3, start)];
    for fault in ["kind = 'power-loss'", "kind = 'unplug'"] {
        let (ended, at_ns) = play_with(fault, &commands);
        assert_eq!(ended, [false, false, false, true], "{fault}");
        assert!((3_200_000_000..3_600_000_000).contains(&at_ns), "{fault}: ended at {at_ns} ns");
    }
}

/// A device that played on while its cable was out ends as if nothing had been.
#[test]
fn a_motion_that_ends_by_itself_after_an_outage_is_an_end() {
    let commands =
        [(0.0, Command::Start { line_bytes_per_s: 0 }), (1.2, Command::Ping { host_ns: 7 })];
    let (ended, at_ns) = play_with("kind = 'unplug'", &commands);
    assert_eq!(ended, [false, true]);
    assert!((1_900_000_000..2_300_000_000).contains(&at_ns), "ended at {at_ns} ns");
}
