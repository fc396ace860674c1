//! `gaps`: the summary, the CSV, and the causes of a recording's gaps.

use mocapd_simulator::{device::DeviceSettings, faults::Script};
use mocapd_take::motion::GAP;

use super::{Folder, devices::Simulated};
use crate::support::{assert_mentions, jump};

/// A jump of 15 markers over 100 frames with three gaps; its first frame is number 1.
fn folder() -> Folder {
    let folder = Folder::new();
    let mut motion = jump(1, 100.0, 1.0);
    for (column, rows) in [(0, 10..20), (0, 99..100), (3, 0..50)] {
        for row in rows {
            motion.positions_mm[row * 15 + column] = GAP;
        }
    }
    motion.info.markers[3].label = "a,b".to_owned();
    folder.write_motion("jump.trc", &motion);
    folder.run(&["import", "jump.trc", "-o", "jump.take"]).with_code(0);
    folder
}

#[test]
fn each_gap_is_a_row() {
    let folder = folder();
    let printed = folder.run(&["gaps", "jump.take", "-o", "gaps.csv"]).with_code(0);
    let labels = jump(1, 100.0, 1.0).info.labels();
    let expected = format!(
        "marker,first_frame,frames,start_s,seconds,cause\n\
         {head},11,10,0.100000,0.100000,occluded\n\
         \"a,b\",1,50,0.000000,0.500000,occluded\n\
         {head},100,1,0.990000,0.010000,occluded\n",
        head = labels[0]
    );
    assert_eq!(folder.text("gaps.csv"), expected);
    assert_mentions(&printed.stdout, &["100 frames", "3 gaps", "61", "occluded", "89.00", "a,b"]);
    let table = folder.run(&["gaps", "jump.take", "-o", "-"]).with_code(0);
    assert_eq!((table.stdout, table.stderr), (expected, String::new()));
    let document = folder.run(&["gaps", "jump.take", "--json"]).with_code(0).json();
    assert_eq!((&document["gaps"], &document["samples_missing"]), (&3.into(), &61.into()));
    let marker = &document["markers"][0];
    assert_eq!((&marker["longest"]["from_frame"], &marker["gaps"]), (&10.into(), &2.into()));
    let info = folder.run(&["info", "jump.take", "--json"]).with_code(0).json();
    for (of, marker) in
        info["channels"].as_array().unwrap().iter().zip(document["markers"].as_array().unwrap())
    {
        assert_eq!((&of["gaps"], &of["samples"]), (&marker["gaps"], &marker["samples"]));
    }
}

#[test]
fn outputs_are_checked_first() {
    let folder = folder();
    folder.write("there.csv", "mine");
    assert_mentions(&folder.refuses(&["gaps", "jump.take", "-o", "there.csv"], 1), &["there.csv"]);
    assert_mentions(&folder.refuses(&["gaps", "jump.take", "-o", "a.txt"], 2), &["a.txt", ".csv"]);
    folder.refuses(&["gaps", "jump.take", "-o", "-", "--json"], 2);
    folder.refuses(&["gaps", "none.take", "-o", "a.csv"], 1);
}

#[test]
fn lost_and_damaged_frames_have_their_causes() {
    let folder = Folder::new();
    let script = "seed = 5\n[[fault]]\nkind = \"lost-frames\"\nrate = 0.03\n";
    let script = std::sync::Arc::new(Script::parse("lost", script).unwrap());
    let settings = DeviceSettings { faults: Some(script), ..DeviceSettings::default() };
    let device = Simulated::start(jump(8, 120.0, 3.0), settings, None);
    folder.run(&["record", "-d", &device.uri(), "-o", "live.take"]).with_code(3);
    let info = folder.run(&["info", "live.take", "--json"]).json();
    let lost = info["frames"].as_u64().unwrap() - info["ledger"]["recorded"].as_u64().unwrap();
    assert!(lost > 0, "{info}");
    let document = folder.run(&["gaps", "live.take", "--json"]).with_code(0).json();
    let causes = document["causes"].as_array().unwrap();
    let of = |name: &str| {
        let found = causes.iter().find(|cause| cause["cause"] == name);
        found.map_or(0, |cause| cause["samples"].as_u64().unwrap())
    };
    assert_eq!(of("lost on link"), 15 * lost, "{causes:?}");
    let gaps = folder.run(&["gaps", "live.take", "-o", "-"]).with_code(0).stdout;
    assert!(gaps.contains("lost on link"), "{gaps}");
    // A byte in the middle: its stretch is lost.
    let mut bytes = folder.read("live.take");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0xff;
    folder.write("hurt.take", bytes);
    let ran = folder.run(&["gaps", "hurt.take", "--json"]).with_code(3);
    assert_mentions(&ran.stdout, &["damaged"]);
    let all = ran.json();
    let n = |name: &str| all[name].as_u64().unwrap();
    assert_eq!(n("samples") + n("samples_missing"), 15 * n("frames"));
}
