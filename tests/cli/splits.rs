//! `record --split`: a recording that is divided into numbered takes, compared with what the device sent.

use mocapd_acquire::{files::NameTaken, inspect::Summary};
use mocapd_simulator::device::{DeviceSettings, SentLog};
use mocapd_take::timeline::Timeline;
use rustix::process::Signal;
use serde_json::{Value, json};

use super::{
    Folder,
    devices::{Recorder, Simulated, frames_in},
};
use crate::support::{assert_mentions, chunks, crowd, jump};

/// The frames of a take by their rows in the recording, with their device times.
fn frames_of(folder: &Folder, part: &Value) -> Vec<(u64, u64)> {
    let bytes = folder.read(part["take"].as_str().unwrap());
    let first = part["first_frame"].as_u64().unwrap();
    let timelines = chunks(&bytes).timelines;
    let recorded = timelines.iter().flat_map(Timeline::recorded);
    recorded.map(|(row, time)| (first + row, time.device_ticks)).collect()
}

/// Asserts that each part is complete, that they follow each other, and that the totals are their sums. Returns their
/// frames.
fn check_parts(folder: &Folder, report: &Value) -> Vec<(u64, u64)> {
    let parts = report["parts"].as_array().unwrap();
    let mut frames = Vec::new();
    let mut next_frame = 0;
    let mut series = Value::Null;
    for (index, part) in parts.iter().enumerate() {
        let take = part["take"].as_str().unwrap();
        assert_eq!((&part["part"], &part["first_frame"]), (&json!(index + 1), &json!(next_frame)));
        assert_eq!((&part["file_state"], &part["file_path"]), (&json!("in_place"), &json!(take)));
        assert_eq!(part["ledger"]["closes"], true, "{part}");
        next_frame += part["ledger"]["frames_sent"].as_u64().unwrap();

        folder.run(&["verify", take]).with_code(0);
        let summary = Summary::read(&folder.read(take)[..]).unwrap();
        let header = summary.take.header;
        let setting = |key: &str| {
            let found = header.settings.iter().find(|setting| setting.0 == key);
            json!(found.unwrap_or_else(|| panic!("{key} is no setting of {take}")).1)
        };
        assert_eq!(setting("part"), json!((index + 1).to_string()));
        assert_eq!(setting("part_first_frame"), json!(part["first_frame"].to_string()));
        let id = json!(header.take_id_text());
        if index == 0 {
            series = id;
        } else {
            assert_ne!(id, series, "{take} has the id of the first");
        }
        assert_eq!(setting("series"), series);
        assert_eq!(setting("split"), report["split"]);
        if let Some(next) = parts.get(index + 1) {
            let ending = summary.take.ending.unwrap();
            assert_eq!((ending.kind.name(), &part["ending"]), ("length", &json!("length")));
            assert!(ending.detail.contains(next["take"].as_str().unwrap()), "{}", ending.detail);
        }
        frames.extend(frames_of(folder, part));
    }
    assert!(frames.is_sorted_by(|a, b| a < b), "a frame is in two takes");
    let sum = |field: &str| parts.iter().map(|part| part[field].as_u64().unwrap()).sum::<u64>();
    for field in ["frames", "samples", "file_bytes"] {
        assert_eq!(report[field], sum(field), "{field}");
    }
    assert_eq!(report["ledger"]["frames_sent"], next_frame);
    assert_eq!(report["ledger"]["closes"], true);
    assert_eq!(report["frames"], frames.len());
    frames
}

/// The device times of all frames of the last run.
fn sent(log: &SentLog) -> Vec<u64> {
    assert!(log.frames.iter().all(|frame| !frame.dropped), "the device dropped frames");
    let run = log.frames.iter().filter(|frame| frame.run == log.starts);
    run.map(|frame| frame.device_ticks).collect()
}

fn logged() -> DeviceSettings {
    DeviceSettings { log_frames: true, ..DeviceSettings::default() }
}

/// Asserts that `concat` joins the parts to the whole recording without a gap: its frames are `frames`, and its ledger
/// is the sum of the parts' ledgers.
fn check_joined(folder: &Folder, report: &Value, frames: &[(u64, u64)], code: i32) {
    let parts = report["parts"].as_array().unwrap();
    let takes: Vec<_> = parts.iter().map(|part| part["take"].as_str().unwrap()).collect();
    let concat = [&["concat", "-o", "joined.take", "--json"], &takes[..]].concat();
    let joined = folder.run(&concat).with_code(0).json();
    for (index, (take, part)) in joined["takes"].as_array().unwrap().iter().zip(parts).enumerate() {
        assert_eq!(take["follows"], if index == 0 { "first" } else { "continuous" }, "{take}");
        assert_eq!(take["first_frame"], part["first_frame"]);
        assert_eq!(take["frames_missing_before"], 0);
    }
    assert_eq!(joined["left_out"], json!([]));
    let found = frames_of(folder, &json!({"take": "joined.take", "first_frame": 0}));
    assert!(found == frames, "{} frames of {}", found.len(), frames.len());
    let counters = |ledger: &Value| {
        let counters = ledger.as_object().unwrap().iter().filter(|(_, value)| value.is_u64());
        counters.map(|(name, count)| (name.clone(), count.clone())).collect::<Vec<_>>()
    };
    assert!(counters(&joined["ledger"]).len() >= 18, "{}", joined["ledger"]);
    assert_eq!(counters(&joined["ledger"]), counters(&report["ledger"]));
    let verified = folder.run(&["verify", "joined.take", "--json"]).with_code(code).json();
    assert_eq!((&verified["intact"], &verified["contradictions"]), (&json!(true), &json!([])));
    let info = folder.run(&["info", "joined.take", "--json"]).with_code(code).json();
    assert_eq!(info["frames"], report["ledger"]["frames_sent"]);
    let texts = |take: &str| {
        let info = folder.run(&["info", take, "--json"]).json();
        let events = info["events"].as_array().unwrap().iter();
        events.map(|event| event["text"].clone()).collect::<Vec<_>>()
    };
    assert_eq!(texts("joined.take"), takes.iter().flat_map(|take| texts(take)).collect::<Vec<_>>());
    std::fs::remove_file(folder.path("joined.take")).unwrap();
}

#[test]
fn every_frame_is_in_exactly_one_take() {
    let folder = Folder::new();
    let device = Simulated::start(jump(5, 240.0, 4.5), logged(), None);
    let record = ["record", "-d", &device.uri(), "-o", "a.take", "--split", "1s", "--json"];
    let ran = folder.run(&[&record[..], &["--raw", "a.rawlog", "--subject", "S01"]].concat());
    let report = ran.with_code(0).json();
    let sent = sent(&device.unplug());
    let frames = check_parts(&folder, &report);
    assert_eq!(frames.iter().map(|frame| frame.1).collect::<Vec<_>>(), sent);
    assert_eq!(
        frames.iter().map(|frame| frame.0).collect::<Vec<_>>(),
        (0..1080).collect::<Vec<_>>()
    );
    let of = |field: &str| -> Vec<Value> {
        let parts = report["parts"].as_array().unwrap();
        parts.iter().map(|part| part[field].clone()).collect()
    };
    assert_eq!(of("frames"), [240, 240, 240, 240, 120]);
    let names = ["a-001.take", "a-002.take", "a-003.take", "a-004.take", "a-005.take"];
    assert_eq!(of("take"), names);
    assert_eq!(of("ending")[4], "device ended");
    assert_eq!((&report["take"], &report["ending"]), (&json!("a.take"), &json!("end of stream")));
    assert_eq!(report["raw_log"]["missing_bytes"], 0);
    let mut left: Vec<_> =
        names.iter().chain(&["a.rawlog"]).map(|name| folder.path(name)).collect();
    left.sort_unstable();
    assert_eq!(folder.content().into_keys().collect::<Vec<_>>(), left);
    let infos: Vec<Value> =
        names.map(|name| folder.run(&["info", name, "--json"]).with_code(0).json()).into();
    assert!(infos.iter().all(|info| info["subject"]["name"] == "S01"), "{}", infos[1]);
    assert!(infos.is_sorted_by(|a, b| a["created"].as_str() < b["created"].as_str()));
    check_joined(&folder, &report, &frames, 0);
    // A folder argument selects its takes.
    std::fs::create_dir(folder.path("parts")).unwrap();
    for name in names {
        std::fs::copy(folder.path(name), folder.path(&format!("parts/{name}"))).unwrap();
    }
    folder.run(&["concat", "parts", "-o", "folder.take"]).with_code(0);
    folder.run(&[&["concat", "-o", "named.take"], &names[..]].concat()).with_code(0);
    assert!(folder.read("folder.take") == folder.read("named.take"));
    // Without one in the middle, its frames are lost ones.
    let concat = ["concat", "a-001.take", "a-002.take", "a-004.take", "-o", "gap.take", "--json"];
    let ran = folder.run(&concat).with_code(0);
    assert_mentions(
        &ran.stderr,
        &["gap.take: 240 frames", "before a-004.take", "none of the takes"],
    );
    let joined = ran.json();
    assert_eq!(joined["takes"][2]["follows"], "frames missing");
    assert_eq!(
        (&joined["takes"][2]["frames_missing_before"], &joined["frames"]),
        (&json!(240), &json!(960))
    );
    assert_eq!(joined["ledger"]["unknown_after_disconnect"], 240);
}

#[test]
fn the_text_lists_the_takes() {
    let folder = Folder::new();
    let device = Simulated::of(jump(6, 240.0, 1.5));
    let record = ["record", "-d", &device.uri(), "-o", "a.take", "--split", "1s"];
    let ran = folder.run(&record).with_code(0);
    let facts = ["a-001.take", "a-002.take", "240 frames", "120 frames", "360 frames", "2 takes"];
    assert_mentions(&ran.stdout, &facts);
    assert_mentions(&ran.stdout, &["15 markers", "ledger closes"]);
    assert_eq!(ran.stderr, "");
}

#[test]
fn takes_end_at_their_size() {
    let folder = Folder::new();
    let device = Simulated::start(crowd(7, 1000.0, 3.0), logged(), None);
    let record = ["record", "-d", &device.uri(), "-o", "a.take", "--split", "1MB", "--lossless"];
    let report = folder.run(&[&record[..], &["--json"]].concat()).with_code(0).json();
    let sent = sent(&device.unplug());
    let frames = check_parts(&folder, &report);
    assert_eq!(frames.iter().map(|frame| frame.1).collect::<Vec<_>>(), sent);
    let parts = report["parts"].as_array().unwrap();
    assert!(parts.len() >= 2, "{report}");
    for part in &parts[..parts.len() - 1] {
        assert!(part["file_bytes"].as_u64().unwrap() >= 1_000_000, "{part}");
    }
}

#[test]
fn a_duration_that_is_a_multiple_leaves_no_short_take() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 2.0));
    let record =
        ["record", "-d", &device.uri(), "-o", "a.take", "--split", "1s", "--seconds", "2s"];
    let report = folder.run(&[&record[..], &["--json"]].concat()).with_code(0).json();
    check_parts(&folder, &report);
    assert_eq!(report["parts"].as_array().unwrap().len(), 2, "{report}");
    assert_eq!(report["parts"][0]["frames"], 120);
    assert!(report["parts"][1]["frames"].as_u64().unwrap() >= 120);
}

#[test]
fn a_first_name_that_is_taken_is_refused_and_a_later_one_is_skipped() {
    let folder = Folder::new();
    let motion = jump(8, 120.0, 2.5);
    let before = b"somebody's";
    folder.write("a-002.take", before);
    let device = Simulated::start(motion, logged(), None);
    let record = ["record", "-d", &device.uri(), "-o", "a.take", "--split", "1s", "--json"];
    let ran = folder.run(&record).with_code(0);
    assert_mentions(&ran.stderr, &["a-002.take", "a-003.take"]);
    assert_eq!(ran.stderr.lines().count(), 1, "{}", ran.stderr);
    let report = ran.json();
    let sent = sent(&device.unplug());
    let frames = check_parts(&folder, &report);
    assert_eq!(frames.iter().map(|frame| frame.1).collect::<Vec<_>>(), sent);
    let names: Vec<_> = report["parts"].as_array().unwrap().iter().map(|p| &p["take"]).collect();
    assert_eq!(names, ["a-001.take", "a-003.take", "a-004.take"]);
    assert_eq!(folder.read("a-002.take"), before);
    // There is no such device: the name is checked first.
    let record = ["record", "-d", "serial:no/device", "-o", "a.take", "--split", "10s"];
    let taken = NameTaken { path: "a-001.take".into() }.to_string();
    assert_eq!(folder.refuses(&record, 1), taken);
}

#[test]
fn a_signal_just_after_a_seam_leaves_no_empty_take() {
    let folder = Folder::new();
    let settings = DeviceSettings { looping: true, ..logged() };
    let device = Simulated::start(jump(1, 240.0, 2.0), settings, None);
    let options = ["--split", "1s", "--json"];
    let mut recorder = Recorder::start_series(&folder, &device, "a", &options);
    // The next take has its first frame, and hardly more.
    recorder.wait_for_frames(&folder.path("a-002.take"), 0);
    recorder.signal(Signal::INT);
    let ran = recorder.wait().with_code(0);
    assert_eq!(ran.stderr, "");
    let report = ran.json();
    let sent = sent(&device.unplug());
    let frames = check_parts(&folder, &report);
    assert_eq!(frames.iter().map(|frame| frame.1).collect::<Vec<_>>(), sent[..frames.len()]);
    let parts = report["parts"].as_array().unwrap();
    assert_eq!(parts[0]["frames"], 240);
    let last = parts.last().unwrap();
    assert_eq!(last["ending"], "stopped");
    assert_eq!(folder.content().len(), parts.len());
}

#[test]
fn an_outage_across_a_seam_is_divided_between_its_takes() {
    let folder = Folder::new();
    let link = folder.path("rig");
    let motion = jump(1, 120.0, 2.0);
    let device = Simulated::endless_at(&link, "SIM0001", motion.clone());
    let options = ["--split", "3s", "--json"];
    let mut recorder = Recorder::start_series(&folder, &device, "a", &options);
    recorder.wait_for_frames(&folder.path("a-001.take"), 60);
    device.unplug();
    recorder.wait_for_message("60 s");
    std::thread::sleep(std::time::Duration::from_secs(3));
    let device = Simulated::endless_at(&link, "SIM0001", motion);
    recorder.wait_for_frames(&folder.path("a-002.take"), 0);
    let before = frames_in(&folder.path("a-002.take"));
    recorder.wait_for_frames(&folder.path("a-002.take"), before);
    recorder.signal(Signal::INT);
    let report = recorder.wait().with_code(3).json();
    drop(device);
    let parts = report["parts"].as_array().unwrap();
    assert_eq!(parts[0]["ledger"]["frames_sent"], 360, "{report}");
    let lost = |part: &Value| part["ledger"]["unknown_after_disconnect"].as_u64().unwrap();
    assert!(lost(&parts[0]) > 0 && lost(&parts[1]) > 0, "{report}");
    let sum: u64 = parts.iter().map(lost).sum();
    assert_eq!(report["outages"]["frames"], sum);
    assert_eq!(report["ledger"]["unknown_after_disconnect"], sum);
    // The device lost its power, and its clock began again.
    let frames: Vec<_> = parts.iter().flat_map(|part| frames_of(&folder, part)).collect();
    assert!(frames.is_sorted_by(|a, b| a.0 < b.0));
    assert_eq!(report["frames"], frames.len());
    // The clocks do not show how the takes follow each other; their places in the recording do.
    check_joined(&folder, &report, &frames, 3);
    for part in parts {
        let verify = ["verify", part["take"].as_str().unwrap(), "--json"];
        let verified = folder.run(&verify).json();
        assert_eq!((&verified["intact"], &verified["contradictions"]), (&json!(true), &json!([])));
    }
}

/// The takes before the removed one are complete, and the recording continues in the next.
#[test]
fn a_take_that_is_removed_is_saved_and_the_next_one_begins() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 2.0));
    let options = ["--split", "1s", "--json"];
    let mut recorder = Recorder::start_series(&folder, &device, "a", &options);
    std::fs::remove_file(folder.path("a-001.take")).unwrap();
    recorder.wait_for_frames(&folder.path("a-002.take"), 0);
    recorder.signal(Signal::INT);
    let ran = recorder.wait().with_code(3);
    let report = ran.json();
    assert_eq!((&report["file_state"], &report["file_path"]), (&json!("removed"), &Value::Null));
    let first = &report["parts"][0];
    assert_eq!(first["file_path"], "a-001.saved.take");
    assert_eq!(first["frames"], 120);
    assert_mentions(&ran.stderr, &["a-001.take", "a-001.saved.take"]);
    folder.run(&["verify", "a-001.saved.take"]).with_code(0);
    assert_eq!(report["parts"][1]["file_state"], "in_place");
}
