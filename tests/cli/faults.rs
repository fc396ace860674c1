//! Every shipped fault script, recorded over a pty: the ledger must equal the device's own log.

pub(super) mod expected;
pub(super) mod played;
mod poses;
mod sampled;

use std::{fs, io::Cursor};

use mocapd_acquire::inspect::Finding;
use mocapd_simulator::faults::{ExpectedRecording, Fate, LedgerMatch, Script};
use mocapd_take::{
    TakeMap,
    sampled::{RESIDUAL_GROUPS, Recording},
};
use serde_json::Value;

use self::{
    expected::expected,
    played::{Played, play, sent_frames},
};
use super::Folder;
use crate::support::{assert_mentions, chunks, mentions, rows};

const SCRIPTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/simulator/faults");

/// What a recording says after a second or more without a frame.
const SILENCE: &str = "no frame came for ";

/// By how many seconds the first frame after an outage may come late on a machine that stands still: beyond them the recorder
/// was too slow to connect again.
pub(super) const LATE_S_MAX: f64 = 3.0;

/// One test per script, so that they run in parallel.
macro_rules! scripts {
    ($($test:ident $name:literal)*) => {
        const NAMES: &[&str] = &[$($name),*];
        $(#[test] fn $test() { agrees($name); })*
    };
}

scripts! {
    bit_flips "bit-flips"
    dropped_bytes "dropped-bytes"
    doubled_bytes "doubled-bytes"
    lost_frames "lost-frames"
    doubled_frames "doubled-frames"
    late_frames "late-frames"
    bursts "bursts"
    stall "stall"
    clock "clock"
    clock_back "clock-back"
    unplug "unplug"
    power_loss "power-loss"
    power_loss_behind_adapter "power-loss-behind-adapter"
    swaps_and_ghosts "swaps-and-ghosts"
    occlusion_storm "occlusion-storm"
    lying_counter "lying-counter"
    garbage "garbage"
    mixed_noise "mixed-noise"
    mixed_bad_day "mixed-bad-day"
}

#[test]
fn every_script_that_ships_is_tried() {
    let mut found: Vec<String> = fs::read_dir(SCRIPTS)
        .unwrap()
        .map(|entry| entry.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    found.sort();
    let mut tried = NAMES.to_vec();
    tried.sort_unstable();
    assert_eq!(found, tried);
}

pub(super) fn script(name: &str) -> Script {
    let text = fs::read_to_string(format!("{SCRIPTS}/{name}.toml")).unwrap();
    Script::parse(name, &text).unwrap()
}

fn agrees(name: &str) {
    let script = script(name);
    let expect = script.expect.clone().expect("a script that ships says what it comes to");
    let folder = Folder::new();
    let played = play(&folder, &script);
    let output = format!("{:#}\n{}", played.report["ledger"], played.ran.stderr);
    assert_eq!(played.ran.code, Some(i32::from(expect.exit)), "{output}");
    ledger_agrees(&folder, &played, &expect, &output);
    // The totals show the fault, with or without an effect on frames.
    let totals = played.sent.faults.as_ref().unwrap();
    for windowed in &script.faults {
        let kind = windowed.fault.kind();
        assert!(totals.counts.of(kind) > 0, "{}: {}", kind.name(), totals.summary());
    }
    texts_agree(&played.report["ledger"], &played.info, &expect);
    take_holds_what_was_sent(&folder, &script, &played);
    sampled::take_holds_what_was_sent(&folder, &played);
    poses::take_holds_what_was_sent(&folder, &script, &played);
    residuals_are_those_of_the_frames(&folder, &script, &played);
    contradictions_are_reported(&folder, &played, &expect);
    logs_account_for_the_take(&folder, &played, name == "lying-counter");
}

/// `verify --against` the device's logs finds every frame, sample and pose in the take, or stated as lost.
fn logs_account_for_the_take(folder: &Folder, played: &Played, counter_lies: bool) {
    let ledgers = played.report["sample_ledger"]["groups"].as_array().unwrap();
    for (name, log) in ["frames.csv", "batches.csv"].into_iter().zip(&played.logs) {
        folder.write(name, log.as_bytes());
        let ran = folder.run(&["verify", "a.take", "--against", name, "--json"]);
        let sent = &ran.json()["sent"];
        // Numbers that were wrong when they were sent tell nothing.
        if name == "frames.csv" && counter_lies {
            assert_eq!(sent["complete"], false, "{name}: {sent:#}");
            continue;
        }
        assert_eq!(sent["complete"], true, "{name}: {sent:#}");
        for account in sent["accounts"].as_array().unwrap() {
            let recorded = match account["group"].as_u64() {
                None => &played.report["ledger"]["recorded"],
                Some(group) => &ledgers.iter().find(|of| of["group"] == group).unwrap()["stored"],
            };
            assert_eq!(&account["recorded"], recorded, "{name}: {account:#}");
        }
    }
    // A part of it has times of its own where it begins and ends, within batches.
    folder.run(&["cut", "a.take", "-o", "part.take", "--from", "0.3123s", "--to", "0.8456s"]);
    let ran = folder.run(&["verify", "part.take", "--against", "batches.csv", "--json"]);
    assert_eq!(ran.json()["sent"]["complete"], true, "{:#}", ran.json()["sent"]);
    // The log of another recording, whose times are others.
    let rows = played.logs[0].lines().map(|row| {
        let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
        if let Ok(ticks) = cells[2].parse::<u64>() {
            cells[2] = (ticks * 1000 + 7).to_string();
        }
        cells.join(",") + "\n"
    });
    folder.write("other.csv", rows.collect::<String>().as_bytes());
    let ran = folder.run(&["verify", "a.take", "--against", "other.csv"]).with_code(1);
    assert_mentions(&ran.stdout, &["NO TIME IN COMMON"]);
}

/// Every recorded row has the residuals of its frame, but for markers that the motion does not have, and those of all others
/// are lost.
fn residuals_are_those_of_the_frames(folder: &Folder, script: &Script, played: &Played) {
    let take = folder.read("a.take");
    let map = TakeMap::scan(&mut Cursor::new(&take)).unwrap();
    let recording = Recording::open(&map, Cursor::new(take.clone())).unwrap().unwrap();
    let (n_rows, n_markers) = (map.n_rows, map.channels.len());
    let mut rows = recording.residuals(&(0..n_rows), n_markers).unwrap();
    let found: Vec<Vec<u8>> = (0..n_rows).map(|_| rows.next_row().unwrap().to_vec()).collect();
    let (timelines, sent) = (chunks(&take).timelines, sent_frames(script, played));
    let whole = played.fates.iter().zip(&sent).filter(|(fate, _)| fate.fate == Fate::Whole);
    let mut wanted = vec![vec![0; n_markers]; n_rows as usize];
    let recorded = timelines.iter().flat_map(mocapd_take::timeline::Timeline::recorded);
    for ((row, _), (_, markers)) in recorded.zip(whole) {
        for marker in markers.iter().filter(|marker| !marker.occluded) {
            wanted[row as usize][usize::from(marker.id)] = marker.residual_10um;
        }
    }
    let n_reported = wanted.iter().flatten().filter(|count| **count > 0).count();
    assert!(n_reported > 1000, "{n_reported}");
    for (row, (found, wanted)) in found.iter().zip(&wanted).enumerate() {
        assert_eq!(found, wanted, "row {row}");
    }
    let ledgers = played.report["sample_ledger"]["groups"].as_array().unwrap();
    // Those behind it are of markers that appeared later, such as ghosts.
    let ledger = ledgers.iter().find(|ledger| ledger["group"] == RESIDUAL_GROUPS.start).unwrap();
    let frames = &played.report["ledger"];
    assert_eq!((&ledger["taken"], &ledger["stored"]), (&n_rows.into(), &frames["recorded"]));
}

/// `record` and the commands that read the take explain an exit code of 3; a ledger that closes causes no such
/// message.
fn contradictions_are_reported(folder: &Folder, played: &Played, expect: &ExpectedRecording) {
    let (verify, info) = (folder.run(&["verify", "a.take"]), folder.run(&["info", "a.take"]));
    let open = Finding::LedgerOpen.to_string();
    for output in [&played.ran.stderr, &verify.stderr, &info.stderr] {
        assert_eq!(mentions(output, &open), !expect.contradictions.is_empty(), "{output}");
    }
    for contradiction in contradictions(&played.report["ledger"]) {
        assert_mentions(&played.ran.stderr, &[&contradiction]);
        assert_mentions(&verify.stderr, &["a.take", &contradiction]);
        assert_mentions(&info.stdout, &[&contradiction]);
    }
}

fn contradictions(ledger: &Value) -> Vec<String> {
    serde_json::from_value(ledger["contradictions"].clone()).unwrap()
}

fn ledger_agrees(folder: &Folder, played: &Played, expect: &ExpectedRecording, output: &str) {
    let ledger = &played.report["ledger"];
    let expected = expected(&played.fates);
    assert_eq!(ledger["frame_balance"], 0, "{output}");
    // A ledger with a contradiction is balanced, but does not close.
    assert_eq!(ledger["closes"], expect.contradictions.is_empty(), "{output}");
    assert_eq!(ledger["finished"], true, "{output}");
    let count = |key: &str| ledger[key].as_u64().unwrap();
    assert_eq!(count("recorded"), expected.recorded, "recorded: {output}");
    assert_eq!(count("duplicates"), expected.duplicates, "duplicates: {output}");
    assert_eq!(count("dropped_by_device"), expected.dropped, "dropped: {output}");
    assert_eq!(count("lost_on_link"), expected.lost_on_link, "lost: {output}");
    match expect.ledger {
        LedgerMatch::Exact => {
            assert_eq!(count("unknown_after_disconnect"), expected.unknown, "unknown: {output}");
            assert_eq!(count("frames_sent"), played.fates.len() as u64, "sent: {output}");
            assert_eq!(count("frames_sent"), played.sent.total.frames_produced);
        }
        LedgerMatch::ByHostClock => {
            // The frames due by the host's clock: by the device's log, or on a machine that stood still by the times at
            // which frames arrived, to half a second.
            let unknown = count("unknown_after_disconnect") as f64 / played::RATE_HZ;
            let away = [expected.away_s, away_by_arrival_s(&folder.read("a.take"))];
            assert!(away.iter().any(|s| (unknown - s).abs() < 0.5), "{unknown} s: {output}");
            assert!(away[1] < away[0] + LATE_S_MAX, "{away:?} s: {output}");
        }
    }
    let missing = count("frames_sent") - count("recorded") + count("duplicates");
    assert!(missing >= expect.at_least, "{missing} frames: {output}");
    // The totals agree with the lines.
    let totals = played.sent.faults.as_ref().unwrap();
    let with = |fate| played.fates.iter().filter(|f| f.fate == fate).count() as u64;
    for fate in [Fate::Whole, Fate::Late, Fate::Damaged, Fate::Lost] {
        assert_eq!(totals.of(fate), with(fate), "{}", fate.name());
    }
    assert_eq!(with(Fate::Waiting), 0);
    let unexplained = played.fates.iter().filter(|f| {
        matches!(f.fate, Fate::Damaged | Fate::Lost | Fate::Late) && f.faults.is_empty()
    });
    assert_eq!(unexplained.count(), 0, "damaged by nothing");
}

/// The time from the arrival of the last frame before the longest outage to that of the first one after it.
pub(super) fn away_by_arrival_s(take: &[u8]) -> f64 {
    let found = chunks(take);
    let recorded: Vec<_> =
        found.timelines.iter().flat_map(mocapd_take::timeline::Timeline::recorded).collect();
    let pairs = recorded.windows(2);
    let outage = pairs.max_by_key(|pair| pair[1].0 - pair[0].0).unwrap();
    (outage[1].1.arrival_10us - outage[0].1.arrival_10us) as f64 * 1e-5
}

/// The texts of a recording contain those that its script expects, in order.
pub(super) fn texts_agree(ledger: &Value, info: &Value, expect: &ExpectedRecording) {
    let events = info["events"].as_array().unwrap().iter();
    let mut events: Vec<_> =
        events.map(|event| event["text"].as_str().unwrap().to_owned()).collect();
    // A machine that stands still for a second stops the simulator, too, and the recording truthfully says so.
    if !expect.events.iter().any(|words| words.contains(SILENCE)) {
        events.retain(|text| !text.contains(SILENCE));
    }
    // Of markers that a script adds, where residuals are recorded.
    events.retain(|text| !text.contains("whose residuals are not recorded"));
    for (what, found, wanted) in [
        ("contradictions", contradictions(ledger), &expect.contradictions),
        ("events", events, &expect.events),
    ] {
        assert_eq!(found.len(), wanted.len(), "{what} {found:?}: {ledger:#}");
        for (found, words) in found.iter().zip(wanted) {
            assert!(found.contains(words), "{what}: '{words}' is not in: {found}");
        }
    }
}

/// Every recorded row has the ticks and, bit for bit, the positions of the intact frame of its turn.
fn take_holds_what_was_sent(folder: &Folder, script: &Script, played: &Played) {
    let take = folder.read("a.take");
    let found = chunks(&take);
    let (rows, problems) = rows(&take);
    assert_eq!(problems, []);
    let recorded: Vec<_> =
        found.timelines.iter().flat_map(mocapd_take::timeline::Timeline::recorded).collect();
    let whole: Vec<_> =
        played.fates.iter().enumerate().filter(|(_, f)| f.fate == Fate::Whole).collect();
    assert_eq!(recorded.len(), whole.len());
    let sent = sent_frames(script, played);
    for ((row, time), (index, fate)) in recorded.into_iter().zip(whole) {
        assert_eq!(time.device_ticks, fate.frame.device_ticks, "row {row}");
        let row = &rows[row as usize];
        let sent = &sent[index];
        for (id, got) in row.iter().enumerate() {
            let wanted =
                sent.iter().find(|sample| usize::from(sample.id) == id && !sample.occluded);
            match wanted {
                Some(sample) => assert_eq!(*got, sample.position_mm, "frame {index} marker {id}"),
                None => assert!(mocapd_take::motion::is_gap(*got), "frame {index} marker {id}"),
            }
        }
        let sent_ids = sent.iter().map(|sample| usize::from(sample.id));
        assert!(sent_ids.max().unwrap_or(0) < found.labels.len(), "a marker without a channel");
    }
}
