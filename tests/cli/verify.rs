//! `verify` of intact takes with wrong statements in their records.

use mocapd_take::{
    chunk::{self, ChunkParse, types},
    index::{Footer, parse_index},
    record::{Clock, Ledger, Record},
};

use super::{Folder, devices::Simulated};
use crate::support::{assert_mentions, jump, mentions};

/// A copy of a take with the payload of the last chunk of `kind` changed, and valid checksums.
pub(super) fn changed(take: &[u8], kind: u8, change: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let mut chunks = Vec::new();
    let mut rest = &take[chunk::MAGIC.len()..];
    while let ChunkParse::Whole { kind, payload, len } = chunk::parse(rest) {
        chunks.push((kind, payload));
        rest = &rest[len..];
    }
    assert!(rest.is_empty());
    let last = chunks.iter().rposition(|chunk| chunk.0 == kind).expect("a chunk of that type");
    let mut out = chunk::MAGIC.to_vec();
    for (i, (kind, payload)) in chunks.into_iter().enumerate() {
        let new = if i == last { change(payload) } else { payload.to_vec() };
        chunk::put(&mut out, kind, &new).unwrap();
    }
    out
}

fn recorded(folder: &Folder) -> Vec<u8> {
    let device = Simulated::of(jump(5, 120.0, 1.5));
    folder.run(&["record", "-d", &device.uri(), "-o", "good.take"]).with_code(0);
    folder.read("good.take")
}

#[test]
fn a_take_that_contradicts_itself_fails() {
    let folder = Folder::new();
    let good = recorded(&folder);
    let ok = folder.run(&["verify", "good.take", "--json"]).with_code(0).json();
    assert_eq!(ok["contradictions"], serde_json::json!([]));
    assert_eq!(ok["clock"]["agrees"], true, "{ok}");

    let ledger = |change: fn(&mut Ledger)| {
        changed(&good, types::LEDGER, |payload| {
            let mut ledger = Ledger::from_payload(payload, 0).unwrap();
            change(&mut ledger);
            ledger.to_payload().unwrap()
        })
    };
    let clock = |change: fn(&mut Clock)| {
        changed(&good, types::CLOCK, |payload| {
            let mut clock = Clock::from_payload(payload, 0).unwrap();
            change(&mut clock);
            clock.to_payload().unwrap()
        })
    };
    let footer = changed(&good, types::FOOTER, |payload| {
        let footer = Footer::from_payload(payload, 0).unwrap();
        Footer { ledger_offset: footer.ledger_offset - 1, ..footer }.to_payload()
    });
    let index = changed(&good, types::INDEX, |payload| {
        let mut entries = parse_index(payload, 0).unwrap();
        entries[0].offset += 1;
        mocapd_take::index::index_payload(&entries)
    });
    let present = ok["samples"].as_u64().unwrap();
    let (present_stated, present) = ((present + 7).to_string(), present.to_string());
    for (take, facts) in [
        // These ledgers still close; only the contents of the take reveal them.
        (
            ledger(|ledger| {
                ledger.recorded -= 1;
                ledger.lost_on_link += 1;
            }),
            ["179", "180"],
        ),
        (
            ledger(|ledger| {
                ledger.samples_present += 7;
                ledger.samples_occluded -= 7;
            }),
            [present_stated.as_str(), present.as_str()],
        ),
        (
            ledger(|ledger| {
                ledger.samples_announced += 3;
                ledger.samples_occluded += 3;
            }),
            ["2703", "2700"],
        ),
        (clock(|clock| clock.line.as_mut().unwrap().host_ns += 5_000_000), ["us", "ppm"]),
        (clock(|clock| clock.line.as_mut().unwrap().drift_ppb += 900_000), ["us", "ppm"]),
        (clock(|clock| clock.points.iter_mut().for_each(|p| p.host_us -= 50_000)), ["us", "ppm"]),
        (index, ["index", "key"]),
        (footer, ["footer", "index"]),
    ] {
        folder.write("bad.take", &take);
        let ran = folder.run(&["verify", "bad.take", "--json"]).with_code(1);
        let report = ran.json();
        assert_eq!(report["intact"], true, "{report}");
        let is_of_clocks = facts == ["us", "ppm"];
        assert_eq!(report["clock"]["agrees"], !is_of_clocks, "{report}");
        let found: Vec<String> = serde_json::from_value(report["contradictions"].clone()).unwrap();
        let tells_all = |found: &String| facts.iter().all(|fact| mentions(found, fact));
        assert!(found.iter().any(tells_all), "{facts:?}: {found:?}");
        assert_mentions(&ran.stderr, &["bad.take", &found[0]]);
    }
}

#[test]
fn lost_frames_are_not_a_difference_but_wrong_samples_are() {
    let folder = Folder::new();
    let motion = jump(1, 30.0, 30.0);
    folder.write_motion("jump.csv", &motion);
    folder.run(&["import", "jump.csv", "-o", "jump.take", "--tolerance", "1mm"]).with_code(0);
    let take = folder.read("jump.take");

    // Without one stretch of ten seconds, or without the end: data is missing, but the rest is correct.
    let mut hurt = take.clone();
    hurt[take.len() / 2] ^= 1;
    folder.write("hurt.take", &hurt);
    folder.write("cut.take", &take[..take.len() * 3 / 4]);
    for name in ["hurt.take", "cut.take"] {
        let verify = ["verify", name, "--against", "jump.csv", "--json"];
        let report = folder.run(&verify).with_code(3).json();
        assert_eq!(report["against"]["within_tolerance"], true, "{report}");
        assert_eq!(report["against"]["frames_lost"], 300, "{report}");
        assert_eq!(report["against"]["frames"], 600, "{report}");
        assert_eq!(report["against"]["beyond_stated"], 0, "{report}");
    }
    // The takes recovered from them are correct as well.
    for (name, lost) in [("hurt.take", 300), ("cut.take", 0)] {
        folder.run(&["recover", name, "-o", "new.take"]).with_code(3);
        let report = folder.run(&["verify", "new.take", "--json"]).json();
        assert_eq!(report["intact"], true, "{report}");
        assert_eq!(report["markers"][0]["frames_damaged"], lost, "{report}");
        std::fs::remove_file(folder.path("new.take")).unwrap();
    }
    // An original that is displaced within the tolerance, but beyond the bounds stated by the blocks.
    let mut moved = motion;
    for position in &mut moved.positions_mm {
        position[0] += 0.9;
    }
    folder.write_motion("moved.csv", &moved);
    let ran = folder.run(&["verify", "jump.take", "--against", "moved.csv", "--json"]).with_code(1);
    let against = &ran.json()["against"];
    assert!(against["beyond_stated"].as_u64().unwrap() > 0, "{against}");
    // A lossy original does not allow this check.
    folder.run(&["import", "jump.csv", "-o", "other.take", "--tolerance", "2mm"]).with_code(0);
    let verify = ["verify", "jump.take", "--against", "other.take", "--json"];
    let other = folder.run(&verify).json();
    assert!(other["against"]["beyond_stated"].is_null(), "{other}");
}
