//! Raw logs: what `record --raw` writes, and the recording of its replay.

use std::{fs, path::PathBuf, sync::Arc};

use mocapd_acquire::files::{FileError, NameTaken};
use mocapd_drivers::{
    raw_log::{Entry, Record, put_header, put_record, records},
    transport::TransportError,
};
use mocapd_simulator::{
    device::{Device, DeviceSettings},
    faults::FaultyDevice,
    generator::JumpSpec,
    log_device::{LogDevice, LogDeviceError},
    ndi::{NdiDevice, NdiSettings},
};
use serde_json::{Value, json};

use super::{
    Folder, Ran,
    devices::Simulated,
    faults::{self, played::record_from},
};
use crate::support::{assert_mentions, jump};

const LOGS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/logs");

/// The stored logs, each of a shipped script.
const KEPT: &[&str] = &["garbage", "mixed-noise", "stall", "lying-counter", "unplug"];

/// Limit on the size of a stored log, bytes.
const KEPT_BYTES_MAX: usize = 100_000;

/// The result of a recording of a script, without arrival times and the clock line. Its texts must agree with the
/// expectations of the script.
fn outcome(folder: &Folder, take: &str, ran: &Ran, script: &str) -> Value {
    let mut ledger = ran.json()["ledger"].clone();
    ledger.as_object_mut().unwrap().remove("clock");
    let info = folder.run(&["info", take, "--json"]).json();
    faults::texts_agree(&ledger, &info, &faults::script(script).expect.unwrap());
    let contradictions = ledger["contradictions"].as_array_mut().unwrap();
    contradictions.iter_mut().for_each(|text| *text = counts(text));
    let events = info["events"].as_array().unwrap().iter();
    let events = events.map(|event| json!([event["kind"], counts(&event["text"])]));
    json!({ "exit": ran.code, "ledger": ledger, "events": events.collect::<Vec<_>>() })
}

/// The integers in a text; numbers with a decimal point are times.
fn counts(text: &Value) -> Value {
    let numbers = text.as_str().unwrap().split(|c: char| !c.is_ascii_digit() && c != '.');
    numbers.filter(|number| number.parse::<u64>().is_ok()).collect()
}

/// Records twelve markers at 60 Hz for two seconds, with the faults of a shipped script and a raw log.
fn recorded(folder: &Folder, name: &str) -> Value {
    let script = Arc::new(faults::script(name));
    let spec = JumpSpec { seconds: Some(2.0), n_markers: 12, ..JumpSpec::new(script.seed, 60.0) };
    let settings =
        DeviceSettings { faults: Some(Arc::clone(&script)), ..DeviceSettings::default() };
    let device = Device::new(spec.generate().unwrap().motion, settings).unwrap();
    let device = FaultyDevice::new(device, &script);
    let (ran, _) =
        record_from(folder, device, [None, None], &["-o", "first.take", "--raw", "first.rawlog"]);
    outcome(folder, "first.take", &ran, name)
}

fn replayed(folder: &Folder, log: &[u8], options: &[&str], script: &str) -> Value {
    let device = LogDevice::new(log, 1.0).unwrap();
    assert!(device.problems().is_empty(), "{:?}", device.problems());
    let (ran, _) =
        record_from(folder, device, [None, None], &[&["-o", "again.take"], options].concat());
    outcome(folder, "again.take", &ran, script)
}

#[test]
fn a_replayed_log_gives_the_same_recording() {
    for script in ["mixed-noise", "unplug"] {
        let folder = Folder::new();
        let first = recorded(&folder, script);
        assert_eq!(first["ledger"]["frame_balance"], 0, "{first:#}");
        let log = folder.read("first.rawlog");
        let again = replayed(&folder, &log, &["--raw", "again.rawlog"], script);
        assert_eq!(again, first, "{script}: {again:#} {first:#}");
        // A log of the replay equals the first one, except for the times of pongs.
        let [first, again] = [log, folder.read("again.rawlog")].map(|log| device_bytes(&log).len());
        assert_eq!(first, again, "{script}");
    }
}

/// All bytes sent by the device.
fn device_bytes(log: &[u8]) -> Vec<u8> {
    let mut bytes_sent = Vec::new();
    for record in records(log).unwrap() {
        if let Ok(Record { entry: Entry::FromDevice(bytes), .. }) = record {
            bytes_sent.extend_from_slice(bytes);
        }
    }
    bytes_sent
}

#[test]
fn a_log_has_every_byte_in_order_and_an_end() {
    let folder = Folder::new();
    let outcome = recorded(&folder, "garbage");
    let log = folder.read("first.rawlog");
    let all: Vec<Record<'_>> = records(&log).unwrap().map(Result::unwrap).collect();
    assert!(
        matches!(all[0].entry, Entry::Opened(text) if text.starts_with("dvmc ")),
        "{:?}",
        all[0]
    );
    assert!(matches!(all[1].entry, Entry::ToDevice(_)), "{:?}", all[1]);
    let [.., closed, end] = &all[..] else { panic!("{all:?}") };
    assert_eq!((closed.entry, end.entry), (Entry::Closed, Entry::End));
    assert!(all.is_sorted_by_key(|record| record.time_ns));
    assert!((1_900_000_000..20_000_000_000).contains(&end.time_ns), "{} ns", end.time_ns);
    assert_eq!(outcome["ledger"]["link_bytes"], device_bytes(&log).len());
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
        matches!(all[0].entry, Entry::Opened(text) if text.starts_with("ndi ")),
        "{:?}",
        all[0]
    );
    let n_sent = |name: &[u8]| {
        let is_it = |record: &&Record<'_>| matches!(record.entry, Entry::ToDevice(bytes) if bytes.starts_with(name));
        all.iter().filter(is_it).count() as u64
    };
    assert!(n_sent(b"INIT") > 0 && n_sent(b"TSTART") == 1, "not as it is spoken");
    assert!(n_sent(b"BX2") >= ran.json()["frames"].as_u64().unwrap());
    let refused = LogDevice::new(&log, 1.0).unwrap_err();
    assert!(matches!(&refused, LogDeviceError::Driver { driver } if driver == "ndi"), "{refused}");
}

/// The log of a killed recorder or a pulled cable is replayed once, without inventing an end.
#[test]
fn a_log_without_an_end_is_recorded_once() {
    let log = fs::read(format!("{LOGS}/stall.rawlog")).unwrap();
    let all: Vec<Record<'_>> = records(&log).unwrap().map(Result::unwrap).collect();
    let kept = &all[..all.len() - 4];
    let mut cut = Vec::new();
    put_header(&mut cut);
    kept.iter().for_each(|record| put_record(record, &mut cut));
    let mut unplugged = cut.clone();
    for (entry, after_ns) in [(Entry::Closed, 50_000_000), (Entry::End, 900_000_000)] {
        let time_ns = kept[kept.len() - 1].time_ns + after_ns;
        put_record(&Record { time_ns, entry }, &mut unplugged);
    }
    for log in [&cut, &unplugged] {
        let folder = Folder::new();
        let device = LogDevice::new(log, 1.0).unwrap();
        // Long enough for a device that restarts to be recorded a second time.
        let options = ["-o", "again.take", "--reconnect", "3s"];
        let (ran, sent) = record_from(&folder, device, [None, None], &options);
        assert_eq!((ran.code, sent.starts), (Some(3), 1), "{}", ran.stderr);
        let report = ran.json();
        assert_eq!(report["ending"], "disconnected");
        assert_eq!(report["ledger"]["link_bytes"], device_bytes(log).len(), "{report:#}");
        assert!(report["frames"].as_u64().unwrap() > 20, "{report:#}");
    }
}

#[test]
fn the_stored_logs_give_the_stored_results() {
    let mut found: Vec<PathBuf> = fs::read_dir(LOGS).unwrap().map(|e| e.unwrap().path()).collect();
    found.retain(|path| path.extension().is_some_and(|ending| ending == "rawlog"));
    assert_eq!(found.len(), KEPT.len());
    // Replays run in parallel, because each takes as long as its recording.
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

/// To be run by name to write the logs again; only a change of the link protocol should require it.
#[test]
#[ignore = "writes tests/logs"]
fn write_the_stored_logs() {
    for script in KEPT {
        let folder = Folder::new();
        let outcome = recorded(&folder, script);
        let path = PathBuf::from(LOGS).join(script);
        fs::write(path.with_extension("rawlog"), nameless(&folder.read("first.rawlog"))).unwrap();
        fs::write(path.with_extension("json"), format!("{outcome:#}\n")).unwrap();
    }
}

/// A log without the names of its ptys.
fn nameless(log: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    put_header(&mut out);
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
fn a_log_is_never_overwritten_and_an_empty_one_is_removed() {
    let folder = Folder::new();
    folder.write("taken", "");
    let record = |raw| ["record", "-d", "serial:/dev/mocapd-none", "-o", "a.take", "--raw", raw];
    let exists = NameTaken { path: "taken".into() }.to_string();
    assert_eq!(folder.refuses(&record("taken"), 1), exists);
    std::os::unix::fs::symlink(".", folder.path("here")).unwrap();
    let whole = folder.path("a.take");
    for same in ["a.take", "./a.take", "here/a.take", whole.to_str().unwrap()] {
        assert_mentions(&folder.refuses(&record(same), 2), &["--raw", "--output"]);
    }
    let no_folder = FileError::NoFolder("nowhere".into()).to_string();
    assert_eq!(folder.refuses(&record("nowhere/a.rawlog"), 1), no_folder);
    let absent = TransportError::NotFound { device: "/dev/mocapd-none".to_owned() }.to_string();
    assert_eq!(folder.refuses(&record("a.rawlog"), 1), absent);
    // The device answers commands, but no frame arrives.
    let settings = DeviceSettings { line_bytes_per_s: 960, ..DeviceSettings::default() };
    let slow = Simulated::start(jump(1, 120.0, 1.0), settings, Some(9600));
    let line =
        folder.refuses(&["record", "-d", &slow.uri(), "-o", "a.take", "--raw", "a.rawlog"], 1);
    assert_mentions(&line, &["120 Hz", "960"]);
}

#[test]
fn a_log_is_reported_with_its_size() {
    let folder = Folder::new();
    let device = Simulated::of(jump(1, 120.0, 1.0));
    let args = ["record", "-d", &device.uri(), "-o", "a.take", "--raw", "a.rawlog"];
    let ran = folder.run(&args).with_code(0);
    assert_mentions(&ran.stdout, &["a.rawlog"]);
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
