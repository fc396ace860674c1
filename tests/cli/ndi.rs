//! An NDI system: detected, recorded, and compared with what it sent.

use mocapd_simulator::{
    device::SentCounters,
    ndi::{NdiDevice, NdiSettings},
};
use mocapd_take::motion::Motion;

use super::{Folder, devices::Simulated};
use crate::support::{assert_mentions, jump, mentions};

/// How many late answers are tolerated: a busy machine may wake
/// the simulated system late.
const TRIES: usize = 5;

fn system(motion: &Motion, tools: &[&str]) -> NdiSettings {
    assert!(motion.info.markers.len() >= tools.len());
    let tools = tools.iter().map(|label| (*label).to_owned()).collect();
    NdiSettings { tools, ..NdiSettings::default() }
}

#[test]
fn a_recording_equals_what_was_sent() {
    let folder = Folder::new();
    let motion = jump(5, 60.0, 3.0);
    folder.write_motion("sent.csv", &motion);
    for (bx2, name) in [(true, "bx2.take"), (false, "bx.take")] {
        let settings = NdiSettings { bx2, ..system(&motion, &["head", "pelvis"]) };
        let device = Simulated::serve(NdiDevice::new(motion.clone(), settings).unwrap(), None);
        let uri = format!("{}?driver=ndi", device.uri());
        let ran = folder.run(&["record", "-d", &uri, "-o", name, "--lossless", "--json"]);
        let sent = device.unplug();
        let report = ran.json();
        // Missed frames are on the ledger, in agreement with the system's own log.
        let was_late = agree(&report["ledger"], &sent.run);
        assert!(was_late || report["samples"] == sent.run.samples, "{report}");
        let recorded = report["frames"].as_u64().unwrap();
        ran.with_code(if recorded == 180 { 0 } else { 3 });
        assert_eq!(report["ending"], "end of stream");
        assert_eq!(report["ledger"]["frames_sent"], 180);
        assert_eq!(report["rate_hz"], 60.0);
        let info = folder.run(&["info", name, "--json"]).json();
        assert_eq!(info["device"]["driver"], "ndi");
        assert_eq!(info["device"]["serial"], "SIM0001");
        let channels = info["channels"].as_array().unwrap();
        assert_eq!(
            (&channels[0]["label"], &channels[1]["label"]),
            (&"head".into(), &"pelvis".into())
        );
        // A stray marker may change its number after an occlusion, but none may be lost. Such a system keeps one frame,
        // and on a busy machine some are missed: those are rows without a position.
        folder.run(&["export", name, "-o", "out.csv"]);
        let [sent, found] = ["sent.csv", "out.csv"].map(|file| samples_by_row(&folder.text(file)));
        assert_eq!(found.len(), sent.len());
        let mut n_missed = 0;
        for (row, (found, sent)) in found.iter().zip(&sent).enumerate() {
            n_missed += u64::from(found.is_empty());
            assert!(found.is_empty() || found == sent, "{row}: {found:?} {sent:?}");
        }
        assert_eq!(n_missed, 180 - recorded);
        assert!(recorded > 60, "{recorded} of 180 frames");
        for file in ["out.csv", "out.poses.csv"] {
            std::fs::remove_file(folder.path(file)).unwrap();
        }
    }
}

/// The ledger of a take agrees with the system's own log. If a machine is so busy that an answer arrives
/// late, the host cannot distinguish missed frames from lost ones: `true`.
#[track_caller]
fn agree(ledger: &serde_json::Value, sent: &SentCounters) -> bool {
    let of = |name: &str| ledger[name].as_u64().unwrap();
    assert_eq!(ledger["closes"], true, "{ledger}");
    assert_eq!(of("frames_sent"), sent.frames_produced - sent.frames_unasked, "{ledger} {sent:?}");
    let (dropped, lost) = (of("dropped_by_device"), of("lost_on_link"));
    let sure = dropped..=dropped + lost;
    assert!(sure.contains(&sent.frames_dropped), "{ledger} {sent:?}");
    lost > 0
}

/// Every position of every row, in any order.
fn samples_by_row(table: &str) -> Vec<Vec<[String; 3]>> {
    let rows = table.lines().skip_while(|line| !line.starts_with("frame,")).skip(1);
    let row = |line: &str| {
        let cells: Vec<_> = line.split(',').skip(2).collect();
        let positions = cells.chunks_exact(3).filter(|cells| !cells[0].is_empty());
        let mut row: Vec<_> =
            positions.map(|cells| [cells[0], cells[1], cells[2]].map(str::to_owned)).collect();
        row.sort();
        row
    };
    rows.map(row).collect()
}

/// On a line that carries a quarter of the frames, to the end of the motion and stopped before it.
#[test]
fn frames_missed_on_a_slow_line_agree_in_both_accounts() {
    let folder = Folder::new();
    let motion = jump(5, 60.0, 4.0);
    for (looping, bx2) in [(false, true), (false, false), (true, true)] {
        let is_sure =
            (0..TRIES).any(|attempt| slow_line(&folder, &motion, (looping, bx2), attempt));
        assert!(is_sure, "this machine is too busy to tell");
    }
}

/// `false` if this machine was too busy to decide.
fn slow_line(
    folder: &Folder,
    motion: &Motion,
    (looping, bx2): (bool, bool),
    attempt: usize,
) -> bool {
    let name = format!("{looping}-{bx2}-{attempt}");
    let tools: &[&str] = if bx2 { &[] } else { &["head"] };
    let settings = NdiSettings { bx2, looping, ..system(motion, tools) };
    let device = Simulated::serve(NdiDevice::new(motion.clone(), settings).unwrap(), None);
    let uri = format!("{}@57600?driver=NDI", device.uri());
    let (take, words) = (format!("{name}.take"), format!("{name}-words.take"));
    let mut record = vec!["record", "-d", &uri, "-o", &take, "--json"];
    if looping {
        record.extend(["--seconds", "2s"]);
    }
    let ran = folder.run(&record).with_code(3);
    assert_mentions(&ran.stderr, &["57600", "60 Hz", "@230400"]);
    let report = ran.json();
    if !looping {
        // A second run, with text output.
        let record = ["record", "-d", &uri, "-o", &words];
        let printed = folder.run(&record).with_code(3).stdout;
        let info = folder.run(&["info", &words, "--json"]).json();
        let appeared = info["channels"].as_array().unwrap().len() - tools.len();
        assert_mentions(&printed, &[&tools.len().to_string(), &appeared.to_string()]);
    }
    let log = device.unplug();
    // The take of the last run, or of the only one.
    let take = if looping { &take } else { &words };
    let info = folder.run(&["info", take, "--json"]).json();
    let ledger = &info["ledger"];
    let run = log.run;
    // Nothing is damaged on this line: an answer came when the next one was expected.
    if ledger["link_messages_damaged"] != 0 {
        return false;
    }
    let was_late = agree(ledger, &run);
    let first_was_late = report["ledger"]["lost_on_link"] != 0;
    if was_late || first_was_late {
        return false;
    }
    assert_eq!(ledger["duplicates"], 0);
    assert_eq!(info["samples"], run.samples);
    assert!(run.frames_dropped > run.frames_produced / 4, "{run:?}");
    if !looping {
        assert_eq!((run.frames_produced, run.frames_unasked), (240, 0));
        let recorded = [&report["ledger"], ledger].map(|run| run["recorded"].as_u64().unwrap());
        assert_eq!(log.frames_sent, recorded.iter().sum::<u64>(), "{log:?}");
        assert_eq!(log.total.frames_produced, log.frames_sent + log.total.frames_dropped);
    }
    let notes: Vec<_> = info["events"].as_array().unwrap().iter().collect();
    assert!(notes.iter().any(|note| note["kind"] == "device"), "{notes:?}");
    true
}

#[test]
fn refusals_say_what_to_do() {
    let folder = Folder::new();
    let motion = jump(5, 60.0, 1.0);
    let settings = NdiSettings { bx2: false, ..system(&motion, &[]) };
    let device = Simulated::serve(NdiDevice::new(motion, settings).unwrap(), None);
    let uri = format!("{}?driver=ndi", device.uri());
    let line = folder.refuses(&["record", "-d", &uri, "-o", "a.take"], 1);
    assert_mentions(&line, &["NDI", "tool"]);
}

#[test]
fn a_line_too_slow_for_its_tools_is_refused_and_a_rate_cannot_be_set() {
    let folder = Folder::new();
    let motion = jump(5, 60.0, 1.0);
    let tools = ["head", "throat", "pelvis", "l_shoulder"];
    let device =
        Simulated::serve(NdiDevice::new(motion.clone(), system(&motion, &tools)).unwrap(), None);
    let slow = format!("{}@9600?driver=ndi", device.uri());
    let line = folder.refuses(&["record", "-d", &slow, "-o", "a.take"], 1);
    assert_mentions(&line, &["4 tools", "9600", "60 Hz", "@230400"]);
    assert!(!mentions(&line, "USB"), "{line}");
    let uri = format!("{}?driver=ndi", device.uri());
    let line = folder.refuses(&["record", "-d", &uri, "-o", "a.take", "--rate", "120"], 1);
    assert_mentions(&line, &["120 Hz", "60 Hz", "--rate"]);
}

#[test]
fn a_timed_recording_leaves_the_system_ready_for_the_next_host() {
    let folder = Folder::new();
    let motion = jump(5, 60.0, 1.0);
    let settings = NdiSettings { looping: true, ..system(&motion, &["head"]) };
    let device = Simulated::serve(NdiDevice::new(motion, settings).unwrap(), None);
    let uri = format!("{}?driver=ndi", device.uri());
    for name in ["a.take", "b.take"] {
        let record = ["record", "-d", &uri, "-o", name, "--seconds", "500ms", "--json"];
        let report = folder.run(&record).json();
        assert_eq!(report["ending"], "stopped");
        assert_eq!(report["ledger"]["closes"], true, "{report}");
        let has_all = report["ledger"]["recorded"] == report["ledger"]["frames_sent"];
        folder.run(&["verify", name]).with_code(if has_all { 0 } else { 3 });
    }
    assert_eq!(device.unplug().starts, 2);
}
