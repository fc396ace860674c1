//! Raw logs: what `record --raw` keeps, and what a recording of its replay comes to.

use std::{fs, path::PathBuf, sync::Arc};

use mocapd_acquire::files::{FileError, NameTaken};
use mocapd_drivers::{
    raw_log::{Entry, Record, put_head, put_record, records},
    transport::TransportError,
};
use mocapd_simulator::{
    device::{Device, DeviceSettings},
    faults::FaultyDevice,
    generator::JumpSpec,
    logged::{LogDevice, LogDeviceError},
    ndi::{NdiDevice, NdiSettings},
};
use serde_json::{Value, json};

use super::{
    Folder, Ran,
    devices::Simulated,
    faults::{self, played::record_from},
};
use crate::support::{assert_tells, jump};

const LOGS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/logs");

/// The logs that are kept, each of a script that ships.
const KEPT: &[&str] = &["garbage", "mixed-noise", "stall", "lying-counter", "unplug"];

/// Small enough to keep.
const KEPT_BYTES_MAX: usize = 100_000;

/// What a recording of a script comes to, without what is of its own time: arrivals, and the line through them. What is said
/// in words is what the script expects.
fn outcome(folder: &Folder, take: &str, ran: &Ran, script: &str) -> Value {
    let mut ledger = ran.json()["ledger"].clone();
    ledger.as_object_mut().unwrap().remove("clock");
    let info = folder.run(&["info", take, "--json"]).json();
    faults::words_agree(&ledger, &info, &faults::script(script).expect.unwrap());
    let contradictions = ledger["contradictions"].as_array_mut().unwrap();
    contradictions.iter_mut().for_each(|told| *told = counts(told));
    let events = info["events"].as_array().unwrap().iter();
    let events = events.map(|event| json!([event["kind"], counts(&event["text"])]));
    json!({ "exit": ran.code, "ledger": ledger, "events": events.collect::<Vec<_>>() })
}

/// The whole numbers of a text. Those with a point are times.
fn counts(text: &Value) -> Value {
    let numbers = text.as_str().unwrap().split(|c: char| !c.is_ascii_digit() && c != '.');
    numbers.filter(|number| number.parse::<u64>().is_ok()).collect()
}

/// Twelve markers at 60 Hz for two seconds, under a script that ships: a recording with a log of it.
fn recorded(folder: &Folder, name: &str) -> Value {
    let script = Arc::new(faults::script(name));
    let spec = JumpSpec { seconds: Some(2.0), n_markers: 12, ..JumpSpec::new(script.seed, 60.0) };
    let settings =
        DeviceSettings { faults: Some(Arc::clone(&script)), ..DeviceSettings::default() };
    let device = Device::new(spec.generate().unwrap().motion, settings).unwrap();
    let device = FaultyDevice::new(device, &script);
    let (ran, _) =
        record_from(folder, device, None, &["-o", "first.take", "--raw", "first.rawlog"]);
    outcome(folder, "first.take", &ran, name)
}

fn replayed(folder: &Folder, log: &[u8], options: &[&str], script: &str) -> Value {
    let device = LogDevice::new(log, 1.0).unwrap();
    assert!(device.problems().is_empty(), "{:?}", device.problems());
    let (ran, _) = record_from(folder, device, None, &[&["-o", "again.take"], options].concat());
    outcome(folder, "again.take", &ran, script)
}

#[test]
fn a_replayed_log_comes_to_the_same() {
    for script in ["mixed-noise", "unplug"] {
        let folder = Folder::new();
        let first = recorded(&folder, script);
        assert_eq!(first["ledger"]["frame_balance"], 0, "{first:#}");
        let log = folder.read("first.rawlog");
        let again = replayed(&folder, &log, &["--raw", "again.rawlog"], script);
        assert_eq!(again, first, "{script}: {again:#} {first:#}");
        // And a log of the replay has what the first one has, but for the pongs' times.
        assert_eq!(said(&log).len(), said(&folder.read("again.rawlog")).len(), "{script}");
    }
}

/// Everything that the device said.
fn said(log: &[u8]) -> Vec<u8> {
    let mut said = Vec::new();
    for record in records(log).unwrap() {
        if let Ok(Record { entry: Entry::FromDevice(bytes), .. }) = record {
            said.extend_from_slice(bytes);
        }
    }
    said
}

#[test]
fn a_log_has_every_byte_in_order_and_an_end() {
    let folder = Folder::new();
    let outcome = recorded(&folder, "garbage");
    let log = folder.read("first.rawlog");
    let all: Vec<Record<'_>> = records(&log).unwrap().map(Result::unwrap).collect();
    assert!(
        matches!(all[0].entry, Entry::Opened(words) if words.starts_with("dvmc ")),
        "{:?}",
        all[0]
    );
    assert!(matches!(all[1].entry, Entry::ToDevice(_)), "{:?}", all[1]);
    let [.., closed, end] = &all[..] else { panic!("{all:?}") };
    assert_eq!((closed.entry, end.entry), (Entry::Closed, Entry::End));
    assert!(all.is_sorted_by_key(|record| record.time_ns));
    assert!((1_900_000_000..20_000_000_000).contains(&end.time_ns), "{} ns", end.time_ns);
    assert_eq!(outcome["ledger"]["link_bytes"], said(&log).len());
}

#[test]
fn an_ndi_system_is_logged_and_its_replay_refused() {
    let folder = Folder::new();
    let device = NdiDevice::new(jump(5, 60.0, 0.5), NdiSettings::default()).unwrap();
    let device = Simulated::serve(device, None);
    let uri = format!("{}?driver=ndi", device.uri());
    let ran = folder.run(&["record", "-d", &uri, "-o", "a.take", "--raw", "a.rawlog", "--json"]);
    let log = folder.read("a.rawlog");
    let all: Vec<Record<'_>> = records(&log).unwrap().map(Result::unwrap).collect();
    assert!(
        matches!(all[0].entry, Entry::Opened(words) if words.starts_with("ndi ")),
        "{:?}",
        all[0]
    );
    let said = |name: &[u8]| {
        let is_it = |record: &&Record<'_>| matches!(record.entry, Entry::ToDevice(bytes) if bytes.starts_with(name));
        all.iter().filter(is_it).count() as u64
    };
    assert!(said(b"INIT") > 0 && said(b"TSTART") == 1, "not as it is spoken");
    assert!(said(b"BX2") >= ran.json()["frames"].as_u64().unwrap());
    let refused = LogDevice::new(&log, 1.0).unwrap_err();
    assert!(matches!(&refused, LogDeviceError::Driver { driver } if driver == "ndi"), "{refused}");
}

/// Of a recorder that was killed, and of a cable that was pulled for good: what there is, once, and nothing made of it.
#[test]
fn a_log_without_an_end_is_recorded_once() {
    let log = fs::read(format!("{LOGS}/stall.rawlog")).unwrap();
    let all: Vec<Record<'_>> = records(&log).unwrap().map(Result::unwrap).collect();
    let kept = &all[..all.len() - 4];
    let mut cut = Vec::new();
    put_head(&mut cut);
    kept.iter().for_each(|record| put_record(record, &mut cut));
    let mut unplugged = cut.clone();
    for (entry, after_ns) in [(Entry::Closed, 50_000_000), (Entry::End, 900_000_000)] {
        let time_ns = kept[kept.len() - 1].time_ns + after_ns;
        put_record(&Record { time_ns, entry }, &mut unplugged);
    }
    for log in [&cut, &unplugged] {
        let folder = Folder::new();
        let device = LogDevice::new(log, 1.0).unwrap();
        // Long enough for a device that begins again to be recorded a second time.
        let options = ["-o", "again.take", "--reconnect", "3s"];
        let (ran, sent) = record_from(&folder, device, None, &options);
        assert_eq!((ran.code, sent.starts), (Some(3), 1), "{}", ran.stderr);
        let report = ran.json();
        assert_eq!(report["ending"], "disconnected");
        assert_eq!(report["ledger"]["link_bytes"], said(log).len(), "{report:#}");
        assert!(report["frames"].as_u64().unwrap() > 20, "{report:#}");
    }
}

#[test]
fn the_logs_that_are_kept_come_to_what_stands_beside_them() {
    let mut found: Vec<PathBuf> = fs::read_dir(LOGS).unwrap().map(|e| e.unwrap().path()).collect();
    found.retain(|path| path.extension().is_some_and(|ending| ending == "rawlog"));
    assert_eq!(found.len(), KEPT.len());
    // Each takes as long as its recording did: beside each other.
    std::thread::scope(|scope| {
        for path in &found {
            scope.spawn(move || {
                let log = fs::read(path).unwrap();
                assert!(log.len() < KEPT_BYTES_MAX, "{}: {} bytes", path.display(), log.len());
                let expected = fs::read_to_string(path.with_extension("json")).unwrap();
                let expected: Value = serde_json::from_str(&expected).unwrap();
                let script = path.file_stem().unwrap().to_str().unwrap();
                let again = replayed(&Folder::new(), &log, &[], script);
                assert_eq!(again, expected, "{}: {again:#}", path.display());
            });
        }
    });
}

/// Run by name when the logs have to be made anew, which a change of the link protocol alone should need.
#[test]
#[ignore = "writes tests/logs"]
fn write_the_logs_that_are_kept() {
    for script in KEPT {
        let folder = Folder::new();
        let outcome = recorded(&folder, script);
        let path = PathBuf::from(LOGS).join(script);
        fs::write(path.with_extension("rawlog"), nameless(&folder.read("first.rawlog"))).unwrap();
        fs::write(path.with_extension("json"), format!("{outcome:#}\n")).unwrap();
    }
}

/// Without the names of the ptys that it was written from.
fn nameless(log: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    put_head(&mut out);
    for record in records(log).unwrap() {
        let mut record = record.unwrap();
        if let Entry::Opened(_) = record.entry {
            record.entry = Entry::Opened("dvmc a simulated device");
        }
        put_record(&record, &mut out);
    }
    out
}

#[test]
fn a_log_is_never_overwritten_and_none_is_left_of_nothing() {
    let folder = Folder::new();
    folder.write("taken", "");
    let record = |raw| ["record", "-d", "serial:/dev/mocapd-none", "-o", "a.take", "--raw", raw];
    let exists = NameTaken { path: "taken".into() }.to_string();
    assert_eq!(folder.refuses(&record("taken"), 1), exists);
    std::os::unix::fs::symlink(".", folder.path("here")).unwrap();
    let whole = folder.path("a.take");
    for same in ["a.take", "./a.take", "here/a.take", whole.to_str().unwrap()] {
        assert_tells(&folder.refuses(&record(same), 2), &["--raw", "--output"]);
    }
    let no_folder = FileError::NoFolder("nowhere".into()).to_string();
    assert_eq!(folder.refuses(&record("nowhere/a.rawlog"), 1), no_folder);
    let absent = TransportError::NotFound { device: "/dev/mocapd-none".to_owned() }.to_string();
    assert_eq!(folder.refuses(&record("a.rawlog"), 1), absent);
    // Much is said, and no frame comes.
    let settings = DeviceSettings { line_bytes_per_s: 960, ..DeviceSettings::default() };
    let slow = Simulated::start(jump(1, 120.0, 1.0), settings, Some(9600));
    let line =
        folder.refuses(&["record", "-d", &slow.uri(), "-o", "a.take", "--raw", "a.rawlog"], 1);
    assert_tells(&line, &["120 Hz", "960"]);
}

#[test]
fn a_log_is_told_with_its_size() {
    let folder = Folder::new();
    let device = Simulated::of(jump(1, 120.0, 1.0));
    let args = ["record", "-d", &device.uri(), "-o", "a.take", "--raw", "a.rawlog"];
    let ran = folder.run(&args).with_code(0);
    assert_tells(&ran.stdout, &["a.rawlog"]);
    let args = ["record", "-d", &device.uri(), "-o", "b.take", "--raw", "b.rawlog", "--json"];
    let report = folder.run(&args).with_code(0).json();
    let log = folder.read("b.rawlog");
    let both: usize = records(&log)
        .unwrap()
        .map(|record| match record.unwrap().entry {
            Entry::FromDevice(bytes) | Entry::ToDevice(bytes) => bytes.len(),
            _ => 0,
        })
        .sum();
    let expected = json!({
        "log": "b.rawlog", "file_bytes": log.len(), "line_bytes": both, "missing_bytes": 0, "error": null
    });
    assert_eq!(report["raw_log"], expected);
}
