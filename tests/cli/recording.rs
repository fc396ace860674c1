//! Recordings of a simulated device: whole ones, and ones that end early.

use std::sync::Arc;

use mocapd_acquire::files::NameTaken;
use mocapd_simulator::{
    device::{Device, DeviceSettings},
    faults::{FaultyDevice, Script},
};
use mocapd_take::{damage::Problem, motion::UpAxis};
use rustix::process::Signal;
use serde_json::Value;

use super::{
    Folder,
    devices::{Recorder, Simulated, frames_in},
};
use crate::support::{assert_mentions, jump};

#[test]
fn a_recording_equals_what_was_sent() {
    let folder = Folder::new();
    let motion = jump(5, 120.0, 2.0);
    folder.write_motion("sent.csv", &motion);
    for codec in [&["--tolerance", "1mm"][..], &["--resampler", "fast"], &["--lossless"]] {
        // Played at four times its speed.
        let settings = DeviceSettings { speed: 4.0, ..DeviceSettings::default() };
        let device = Simulated::start(motion.clone(), settings, None);
        let uri = device.uri();
        let record = [&["record", "-d", &uri, "-o", "new.take", "--json"], codec].concat();
        let ran = folder.run(&record).with_code(0);
        let report = ran.json();
        let sent = device.unplug();
        assert_eq!(report["ending"], "end of stream");
        assert_eq!(report["rate_hz"], 480.0);
        assert_eq!(report["ledger"]["closes"], true, "{report}");
        assert_eq!(report["ledger"]["frames_sent"], sent.run.frames_produced);
        assert_eq!(report["samples"], sent.run.samples);
        assert_eq!(ran.stderr, "");
        let verify = ["verify", "new.take", "--against", "sent.csv", "--json"];
        let verified = folder.run(&verify).with_code(0).json();
        assert_eq!(verified["intact"], true);
        assert_eq!(verified["against"]["within_tolerance"], true);
        assert_eq!(verified["against"]["frames"], 240);
        assert_eq!(verified["against"]["samples"], sent.run.samples);
        let info = folder.run(&["info", "new.take", "--json"]).with_code(0).json();
        assert_eq!(info["device"]["serial"], "SIM0001");
        assert_eq!(info["resampler"], report["resampler"]);
        std::fs::remove_file(folder.path("new.take")).unwrap();
    }
}

#[test]
fn the_text_has_the_figures_of_the_report() {
    let folder = Folder::new();
    let device = Simulated::of(jump(6, 240.0, 0.5));
    let ran = folder.run(&["record", "-d", &device.uri(), "-o", "a.take"]).with_code(0);
    assert_mentions(
        &ran.stdout,
        &["a.take", "120 frames", "15 markers", "240 Hz", "ledger closes"],
    );
    assert_eq!(ran.stderr, "");
}

#[test]
fn the_up_axis_is_stated_where_the_device_states_none() {
    let folder = Folder::new();
    let mut motion = jump(4, 120.0, 0.5);
    motion.info.up = UpAxis::Unknown;
    for (up, of_device, stored, notes) in [
        (None, UpAxis::Unknown, Value::Null, ""),
        (Some("y"), UpAxis::Unknown, "y".into(), ""),
        (Some("y"), UpAxis::Z, "z".into(), "the device states that z points up"),
    ] {
        motion.info.up = of_device;
        let device = Simulated::of(motion.clone());
        let uri = device.uri();
        let mut record = vec!["record", "-d", &uri, "-o", "a.take"];
        record.extend(up.iter().flat_map(|axis| ["--up", axis]));
        let ran = folder.run(&record).with_code(0);
        assert_eq!(ran.stderr.is_empty(), notes.is_empty());
        assert_mentions(&ran.stderr, &[notes]);
        assert_eq!(
            folder.run(&["info", "a.take", "--json"]).with_code(0).json()["up_axis"],
            stored
        );
        std::fs::remove_file(folder.path("a.take")).unwrap();
    }
}

#[test]
fn a_recording_stops_when_its_time_is_up() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 2.0));
    let record = ["record", "-d", &device.uri(), "-o", "a.take", "--seconds", "500ms", "--json"];
    let report = folder.run(&record).with_code(0).json();
    assert_eq!(report["ending"], "stopped");
    assert_eq!(report["ledger"]["closes"], true);
    let frames = report["frames"].as_u64().unwrap();
    assert!(frames >= 60, "{frames}");
    folder.run(&["verify", "a.take"]).with_code(0);
}

#[test]
fn a_signal_finishes_the_take() {
    for signal in [Signal::INT, Signal::TERM] {
        let folder = Folder::new();
        let device = Simulated::endless(jump(1, 120.0, 2.0));
        let mut recorder = Recorder::start(&folder, &device, "a.take", &["--json"]);
        recorder.signal(signal);
        let ran = recorder.wait().with_code(0);
        assert_eq!(ran.stderr, "");
        let report = ran.json();
        assert_eq!(report["ending"], "stopped");
        assert_eq!(report["ledger"]["closes"], true);
        assert_eq!(report["ledger"]["finished"], true);
        let info = folder.run(&["info", "a.take", "--json"]).with_code(0).json();
        assert_eq!(info["finished"], true);
        assert_eq!(info["frames"], report["frames"]);
    }
}

/// `timeout` signals the process and then its group. The device does not confirm the stop, for which the recorder waits
/// 2 s.
#[test]
fn a_doubled_signal_counts_once_and_a_later_one_ends_the_program_at_once() {
    let script = "seed = 1\n[[fault]]\nkind = 'stall'\nat_s = 1\nfor_s = 100";
    let script = Arc::new(Script::parse("stall", script).unwrap());
    for (pause_ms, code) in [(100, 0), (900, 1)] {
        let folder = Folder::new();
        let settings = DeviceSettings {
            looping: true,
            faults: Some(Arc::clone(&script)),
            ..DeviceSettings::default()
        };
        let device = Device::new(jump(1, 120.0, 2.0), settings).unwrap();
        let device = Simulated::serve(FaultyDevice::new(device, &script), None);
        let mut recorder = Recorder::start(&folder, &device, "a.take", &["--json"]);
        std::thread::sleep(std::time::Duration::from_millis(1500));
        recorder.signal(Signal::INT);
        std::thread::sleep(std::time::Duration::from_millis(pause_ms));
        recorder.signal(Signal::INT);
        let ran = recorder.wait().with_code(code);
        assert_eq!(ran.stdout.is_empty(), code == 1, "{pause_ms} ms: {}", ran.stderr);
        let info = folder.run(&["info", "a.take", "--json"]).json();
        assert_eq!(info["finished"], code == 0, "{pause_ms} ms");
    }
}

#[test]
fn a_pulled_plug_leaves_a_readable_take() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 2.0));
    let options = ["--json", "--reconnect", "0s"];
    let mut recorder = Recorder::start(&folder, &device, "a.take", &options);
    let sent = device.unplug();
    let ran = recorder.wait().with_code(3);
    assert_ne!(ran.stderr, "");
    let report = ran.json();
    assert_eq!(report["ending"], "disconnected");
    assert_eq!(report["ledger"]["closes"], true, "{report}");
    let recorded = report["frames"].as_u64().unwrap();
    assert!(recorded > 0 && recorded <= sent.run.frames_produced, "{recorded} of {sent:?}");
    // The take is intact, and states how it ended.
    let info = folder.run(&["info", "a.take", "--json"]).json();
    assert_eq!(info["finished"], true);
    // Frames that were due before the disconnection was noticed are rows, too.
    assert_eq!(info["ledger"], report["ledger"]);
    assert_eq!(info["frames"], report["ledger"]["frames_sent"]);
    assert_eq!(info["events"][0]["kind"], "host");
    let event = info["events"][0]["text"].as_str().unwrap();
    assert_mentions(&folder.run(&["info", "a.take"]).stdout, &[event]);
    folder.run(&["export", "a.take", "-o", "a.csv"]).with_code(0);
    assert_eq!(folder.text("a.csv").lines().count() as u64, 1 + info["frames"].as_u64().unwrap());
}

#[test]
fn a_device_that_comes_back_is_recorded_again() {
    let folder = Folder::new();
    let link = folder.path("rig");
    let motion = jump(1, 120.0, 2.0);
    let device = Simulated::endless_at(&link, "SIM0001", motion.clone());
    let mut recorder = Recorder::start(&folder, &device, "a.take", &["--json"]);
    device.unplug();
    recorder.wait_for_message("60 s");
    // Another device at the same path is not mistaken for it.
    let other = Simulated::endless_at(&link, "SIM0002", motion.clone());
    recorder.wait_for_message("SIM0002, but the take needs");
    let sent = other.unplug();
    assert_eq!(sent.starts, 0, "the other device was started");
    let device = Simulated::endless_at(&link, "SIM0001", motion);
    let before = frames_in(&folder.path("a.take"));
    recorder.wait_for_frames(&folder.path("a.take"), before);
    std::thread::sleep(std::time::Duration::from_millis(300));
    recorder.signal(Signal::INT);
    let report = recorder.wait().with_code(3).json();
    assert_eq!(report["ending"], "stopped");
    assert_eq!(report["ledger"]["closes"], true, "{report}");
    assert_eq!(report["ledger"]["contradictions"], serde_json::json!([]));
    assert_eq!(device.unplug().starts, 1);
    let info = folder.run(&["info", "a.take", "--json"]).json();
    assert_eq!(info["frames"], report["ledger"]["frames_sent"]);
    assert_eq!(info["seconds"], report["seconds"]);
    let verified = folder.run(&["verify", "a.take", "--json"]).json();
    assert_eq!(verified["contradictions"], serde_json::json!([]), "{verified}");
    assert_eq!(verified["intact"], true, "{verified}");
    // The counter restarted, so the host's clock measures the outage.
    let outages = &report["outages"];
    assert_eq!((&outages["count"], &info["outages"]), (&serde_json::json!(1), outages));
    assert_eq!(outages["frames"], report["ledger"]["unknown_after_disconnect"]);
    let away_s = outages["seconds"].as_f64().unwrap();
    assert!((0.1..60.0).contains(&away_s), "{outages}");
    let [gone, back] = &info["events"].as_array().unwrap()[..] else { panic!("{info}") };
    assert_eq!((&gone["kind"], &back["kind"]), (&"host".into(), &"host".into()));
    assert_mentions(back["text"].as_str().unwrap(), &[&outages["frames"].to_string()]);
}

#[test]
fn a_killed_recording_is_a_take_with_a_ledger() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 2.0));
    let mut recorder = Recorder::start(&folder, &device, "a.take", &[]);
    recorder.signal(Signal::KILL);
    assert_eq!(recorder.wait().code, None);
    let info = folder.run(&["info", "a.take", "--json"]).with_code(3).json();
    assert_eq!(info["finished"], false);
    assert!(info["frames"].as_u64().unwrap() > 0);
    let printed = folder.run(&["info", "a.take"]).with_code(3);
    assert_mentions(&printed.stderr, &["a.take", &Problem::CutOff.to_string()]);
    // The port is free again, but the take exists.
    let record = ["record", "-d", &device.uri(), "-o", "a.take"];
    let exists = NameTaken { path: "a.take".into() }.to_string();
    assert_eq!(folder.refuses(&record, 1), exists);
}
