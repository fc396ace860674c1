//! An NDI system: found, recorded, and held against what it sent.

use mocapd_simulator::ndi::{NdiDevice, NdiSettings};
use mocapd_take::motion::Motion;

use super::{Folder, devices::Simulated};
use crate::support::jump;

/// How often a recording may miss a frame before that is no accident: such a system keeps one frame, and
/// a machine that is busy with other tests may wake the host one frame late.
const TRIES: usize = 5;

fn system(motion: &Motion, tools: &[&str]) -> NdiSettings {
    assert!(motion.info.markers.len() >= tools.len());
    let tools = tools.iter().map(|label| (*label).to_owned()).collect();
    NdiSettings { tools, ..NdiSettings::default() }
}

#[test]
fn a_recording_is_what_was_sent() {
    let folder = Folder::new();
    let motion = jump(5, 60.0, 3.0);
    folder.write_motion("sent.csv", &motion);
    for (bx2, name) in [(true, "bx2.take"), (false, "bx.take")] {
        for attempt in 1.. {
            let settings = NdiSettings { bx2, ..system(&motion, &["head", "pelvis"]) };
            let device = Simulated::serve(NdiDevice::new(motion.clone(), settings).unwrap(), None);
            let uri = format!("{}?driver=ndi", device.uri());
            let record = ["record", "-d", &uri, "-o", name, "--lossless", "--json"];
            let ran = folder.run(&record);
            let sent = device.unplug();
            let report = ran.json();
            // Whatever was missed is on the account, and the system's own log says the same.
            assert_eq!(report["ledger"]["closes"], true, "{report}");
            assert_eq!(report["ledger"]["frames_sent"], sent.run.frames_produced);
            assert_eq!(report["ledger"]["dropped_by_device"], sent.run.frames_dropped, "{report}");
            assert_eq!(report["ledger"]["lost_on_link"], 0, "{report}");
            assert_eq!(report["samples"], sent.run.samples);
            if sent.run.frames_dropped > 0 && attempt < TRIES {
                std::fs::remove_file(folder.path(name)).unwrap();
                continue;
            }
            ran.with_code(0);
            assert_eq!(report["ending"], "end of stream");
            assert_eq!(report["frames"], 180);
            assert_eq!(report["rate_hz"], 60.0);
            break;
        }
        let info = folder.run(&["info", name, "--json"]).with_code(0).json();
        assert_eq!(info["device"]["driver"], "ndi");
        assert_eq!(info["device"]["serial"], "SIM0001");
        let channels = info["channels"].as_array().unwrap();
        assert_eq!(
            (&channels[0]["label"], &channels[1]["label"]),
            (&"head".into(), &"pelvis".into())
        );
        // A stray may change its number where it was hidden; none may be lost.
        folder.run(&["export", name, "-o", "out.csv"]).with_code(0);
        let samples: Vec<_> =
            ["sent.csv", "out.csv"].map(|file| samples_by_row(&folder.text(file))).into();
        assert_eq!(samples[0], samples[1]);
        std::fs::remove_file(folder.path("out.csv")).unwrap();
    }
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

/// On a line that carries a fourth of the frames, to the end of the motion and stopped before it.
#[test]
fn what_a_slow_line_misses_is_on_both_accounts_the_same() {
    let folder = Folder::new();
    let motion = jump(5, 60.0, 4.0);
    for (looping, bx2, name) in [(false, true, "a"), (false, false, "b"), (true, true, "c")] {
        let tools: &[&str] = if bx2 { &[] } else { &["head"] };
        let settings = NdiSettings { bx2, looping, ..system(&motion, tools) };
        let device = Simulated::serve(NdiDevice::new(motion.clone(), settings).unwrap(), None);
        let uri = format!("{}@57600?driver=NDI", device.uri());
        let (take, words) = (format!("{name}.take"), format!("{name}-words.take"));
        let mut record = vec!["record", "-d", &uri, "-o", &take, "--json"];
        if looping {
            record.extend(["--seconds", "2s"]);
        }
        let ran = folder.run(&record).with_code(3);
        assert!(ran.stderr.contains("the line is too slow for every frame"), "{}", ran.stderr);
        assert!(ran.stderr.contains("behind the port in the device's URI"), "{}", ran.stderr);
        let report = ran.json();
        if !looping {
            // A run of its own, for people: the first one is over.
            let record = ["record", "-d", &uri, "-o", &words];
            let said = folder.run(&record).with_code(3).stdout;
            assert!(said.contains("announced and") && said.contains("as they appeared"), "{said}");
        }
        let log = device.unplug();
        // Of the last run, or of the only one.
        let take = if looping { &take } else { &words };
        let info = folder.run(&["info", take, "--json"]).json();
        let ledger = &info["ledger"];
        let run = log.run;
        assert_eq!(ledger["closes"], true, "{ledger}");
        assert_eq!(ledger["frames_sent"], run.frames_produced - run.frames_unasked, "{run:?}");
        assert_eq!(ledger["dropped_by_device"], run.frames_dropped, "{ledger} {run:?}");
        assert_eq!((&ledger["lost_on_link"], &ledger["duplicates"]), (&0.into(), &0.into()));
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
    }
}

#[test]
fn what_it_refuses_is_said_with_what_to_do() {
    let folder = Folder::new();
    let motion = jump(5, 60.0, 1.0);
    let settings = NdiSettings { bx2: false, ..system(&motion, &[]) };
    let device = Simulated::serve(NdiDevice::new(motion, settings).unwrap(), None);
    let uri = format!("{}?driver=ndi", device.uri());
    let line = folder.refuses(&["record", "-d", &uri, "-o", "a.take"], 1);
    assert!(line.contains("plug one in"), "{line}");
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
    assert!(line.contains("the line is too slow for the NDI system: 4 tools"), "{line}");
    assert!(line.contains("write @230400 behind the port") && !line.contains("USB"), "{line}");
    let uri = format!("{}?driver=ndi", device.uri());
    let line = folder.refuses(&["record", "-d", &uri, "-o", "a.take", "--rate", "120"], 1);
    assert!(line.contains("it runs at 60 Hz and no other rate"), "{line}");
}

#[test]
fn the_time_is_up_and_the_next_host_finds_it_as_this_one_did() {
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
        folder.run(&["verify", name]).with_code(0);
    }
    assert_eq!(device.unplug().starts, 2);
}
