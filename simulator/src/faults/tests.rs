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

#[track_caller]
fn refused(rest: &str, line: usize, words: &str) {
    let error = parse(rest).unwrap_err();
    assert!(error.starts_with(&format!("a.toml line {line}: ")), "{error}");
    assert!(error.contains(words), "{error}");
    assert_eq!(error.lines().count(), 1, "{error}");
}

#[test]
fn what_cannot_be_meant_is_refused_with_its_line_and_what_to_write() {
    let flips = "[[fault]]\nkind = 'bit-flips'\n";
    refused(
        &format!("{flips}rat = 1e-4"),
        4,
        "unknown key 'rat' in a fault of kind 'bit-flips': did you mean 'rate'?",
    );
    refused(&format!("{flips}rate = 1e-4\nseconds = 3"), 5, "it has kind, rate, from_s, to_s");
    refused(flips, 2, "needs 'rate' (per byte)");
    refused(&format!("{flips}rate = 0.2"), 4, "rate is out of range: give 0 to 0.1 (per byte)");
    refused(&format!("{flips}rate = 'x'"), 4, "rate is a text, not a number: give 0 to 0.1");
    refused(&format!("{flips}rate = true"), 4, "rate is true or false, not a number: give 0 to");
    refused("[[fault]]\nkind = 3", 3, "kind is a number, not a text: it is one of bit-flips");
    refused("[[fault]]\nkind = ''", 3, "unknown kind of fault ''");
    refused(
        "[expect]\nexit = 'x'",
        3,
        "exit is a text, not a number: give a whole number from 0 to 255",
    );
    refused("[expect]\nexit = 300", 3, "exit is out of range");
    refused("[expect]\nevents = []", 2, "needs 'exit'");
    refused("[expect]\nexit = 0\nevents = 'x'", 4, "events is a list of texts");
    refused("[expect]\nexit = 0\nledger = 1", 4, "ledger is one of exact, by-host-clock");
    refused("expect = 3", 2, "write [expect]");
    refused(&format!("{flips}rate = nan"), 4, "give 0 to 0.1");
    refused(&format!("{flips}rate = 1e-4\nfrom_s = 3\nto_s = 2"), 2, "later than from_s");
    refused(
        "[[fault]]\nkind = 'bitflips'",
        3,
        "unknown kind of fault 'bitflips': did you mean 'bit-flips'?",
    );
    refused("[[fault]]\nkind = 'gremlins'", 3, "it is one of bit-flips, dropped-bytes");
    refused("[[fault]]\nrate = 1", 2, "without a kind");
    refused("[fault]\nkind = 'bit-flips'", 2, "double brackets");
    refused("fault = [3]", 2, "double brackets");
    refused("[[faults]]\nkind = 'stall'", 2, "did you mean 'fault'?");
    refused(
        "[[fault]]\nkind = 'ghosts'\ncount = 2.5",
        4,
        "a whole number from 1 to 1000 (markers)",
    );
    refused(
        "[[fault]]\nkind = 'power-loss'\nat_s = 1\nfor_s = 1\nkeeps_port = 1",
        6,
        "true or false",
    );
    refused("[[fault]]\nkind = 'stall'\nat_s = 1\nfor_s = 1\nto_s = 3", 6, "unknown key 'to_s'");
    refused("[expect]\nexit = 0\nevent = []", 4, "did you mean 'events'?");
    refused("seed = 2", 2, "duplicate key");
    refused("= ", 2, "");
    refused(&"[[fault]]\nkind = 'bursts'\nperiod_ms = 2\n".repeat(65), 2, "at most 64 faults");
    refused(&"#".repeat(SCRIPT_BYTES_MAX), 1, "at most 262144 bytes");
    let error = Script::parse("b.toml", "[expect]\nexit = 0").unwrap_err().to_string();
    assert_eq!(
        error,
        "b.toml line 1: no seed: write `seed = 1` in front, so that it can be repeated"
    );
    for (seed, said) in [
        ("'x'", "seed is a text, not a number: give a whole number from 0 to 9223372036854775807"),
        ("-1", "seed is out of range: give a whole number from 0 to 9223372036854775807"),
        ("1.5", "seed is out of range: give a whole number from 0"),
    ] {
        let error = Script::parse("b.toml", &format!("seed = {seed}")).unwrap_err().to_string();
        assert!(error.starts_with("b.toml line 1: ") && error.contains(said), "{error}");
    }
}

/// Every kind with all of its keys, each at its least.
fn all_kinds() -> String {
    let mut text = String::new();
    for kind in KINDS {
        text.push_str(&format!("[[fault]]\nkind = '{}'\n", kind.name));
        for Key { name, unit, min, .. } in kind.keys {
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
fn every_kind_is_read_with_all_its_keys() {
    let script = parse(&all_kinds()).unwrap();
    assert_eq!(script.faults.len(), KINDS.len());
    for (windowed, keys) in script.faults.iter().zip(KINDS) {
        assert_eq!(windowed.fault.kind(), keys.kind);
        let to_ns = if keys.windowed { 2_500_000_000 } else { u64::MAX };
        assert_eq!(windowed.to_ns, to_ns);
    }
}

/// The page has a row for every key, with its unit and its range.
#[test]
fn the_page_says_what_the_program_reads() {
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
    assert_eq!(rows.next(), None, "a row for a key that is none");
}

/// A device with faults in virtual time, and a host at the other end that takes `chunk` bytes at a time. Pings come
/// every `ping_ns`. Gives the fates, and the numbers of the frames that came through.
fn played(script: &Script, chunk: usize, ping_ns: u64) -> (Vec<FrameFate>, Vec<u32>) {
    let script = Arc::new(script.clone());
    let spec = JumpSpec { seconds: Some(2.0), ..JumpSpec::new(1, 240.0) };
    let settings =
        DeviceSettings { faults: Some(Arc::clone(&script)), ..DeviceSettings::default() };
    let device = Device::new(spec.generate().unwrap().motion, settings).unwrap();
    let mut device = FaultyDevice::new(device, &script);
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
fn a_script_hits_the_same_frames_however_the_line_takes_them() {
    for name in ["lost-frames", "late-frames", "doubled-frames", "bit-flips", "occlusion-storm"] {
        let text = std::fs::read_to_string(format!("{SHIPPED}/{name}.toml")).unwrap();
        let script = Script::parse(name, &text).unwrap();
        let hit = |(fates, _): &(Vec<FrameFate>, _)| -> Vec<_> {
            fates.iter().map(|f| (f.frame.seq, f.frame.present, f.fate, f.again)).collect()
        };
        let one = played(&script, usize::MAX, u64::MAX);
        assert_eq!(one.0.len(), 480);
        assert_eq!(hit(&one), hit(&played(&script, 7, u64::MAX)), "{name}");
        let other = Script { seed: script.seed + 100, ..script };
        assert_ne!(hit(&one), hit(&played(&other, usize::MAX, u64::MAX)), "{name}");
    }
}

/// The account against a receiver that decodes what left: they share no code but the envelope.
#[test]
fn the_account_is_what_a_receiver_finds() {
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
        let (fates, mut seqs) = played(&script, 100, 3_000_000);
        let mut accounted: Vec<u32> = Vec::new();
        for fate in &fates {
            let times = u32::from(matches!(fate.fate, Fate::Whole | Fate::Late)) + fate.again;
            accounted.extend(std::iter::repeat_n(fate.frame.seq, times as usize));
        }
        // In order: those that are whole and not late.
        let mut last = None;
        for (seq, fate) in fates.iter().filter(|f| f.fate == Fate::Whole).map(|f| (f.frame.seq, f))
        {
            assert!(last < Some(seq) && seqs.contains(&seq), "{fate:?}");
            last = Some(seq);
        }
        seqs.sort_unstable();
        assert_eq!(seqs, accounted, "seed {seed}");
        assert_eq!(fates.len(), 480);
        let damaged = fates.iter().filter(|f| f.fate == Fate::Damaged);
        hit += damaged.clone().count();
        assert!(damaged.into_iter().all(|f| !f.faults.is_empty()), "seed {seed}");
    }
    assert!(hit > 1000, "{hit} damaged frames");
}

/// What harms no frame is told as well.
#[test]
fn the_totals_say_what_each_kind_did() {
    for (name, said) in [
        (
            "lying-counter",
            "0 damaged and 0 lost; what happened: counter-jump 3 times, counter-repeat in ",
        ),
        ("clock-back", "0 damaged and 0 lost; what happened: clock-jump once"),
        ("clock", "0 lost; what happened: clock-drift in 480 frames, clock-jump once"),
        ("bursts", "0 lost; what happened: bursts in "),
        ("garbage", "0 lost; what happened: garbage once"),
        ("swaps-and-ghosts", "what happened: swaps in "),
        ("doubled-frames", "what happened: doubled-frames in "),
    ] {
        let text = std::fs::read_to_string(format!("{SHIPPED}/{name}.toml")).unwrap();
        let script = Script::parse(name, &text).unwrap();
        let words = totals(&script).words();
        assert!(words.contains(said), "{name}: {words}");
    }
}

fn totals(script: &Script) -> FaultTotals {
    let script = Arc::new(script.clone());
    let spec = JumpSpec { seconds: Some(2.0), ..JumpSpec::new(1, 240.0) };
    let settings =
        DeviceSettings { faults: Some(Arc::clone(&script)), ..DeviceSettings::default() };
    let device = Device::new(spec.generate().unwrap().motion, settings).unwrap();
    let mut device = FaultyDevice::new(device, &script);
    let mut bytes = Vec::new();
    HostLink::new().command(Command::Identify, &mut bytes);
    HostLink::new().command(Command::Start { line_bytes_per_s: 0 }, &mut bytes);
    let mut now_ns = 1_000_000;
    device.on_bytes(&bytes, now_ns);
    while !device.has_ended() {
        let wake_ns = device.poll(now_ns);
        let n = device.pending().len();
        device.sent(n);
        now_ns = wake_ns.clamp(now_ns + 1, now_ns + 10_000_000);
        assert!(now_ns < 20_000_000_000, "no end");
    }
    device.close();
    device.log().faults.unwrap()
}
