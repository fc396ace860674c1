//! `gaps`: the summary, the CSV, and the causes of a recording's gaps.

use std::sync::Arc;

use mocapd_simulator::{
    device::{Device, DeviceSettings},
    faults::{FaultyDevice, Script},
};
use mocapd_take::motion::{GAP, Motion, is_gap};

use super::{Folder, devices::Simulated};
use crate::support::{assert_mentions, jump};

/// A jump of 15 markers over 100 frames with gaps at both ends; its first frame is number 1.
fn folder() -> (Folder, Motion) {
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
    (folder, motion)
}

/// The gaps of each marker: first frame and number of frames.
fn gaps_of(motion: &Motion, column: usize) -> Vec<(usize, usize)> {
    let mut gaps: Vec<(usize, usize)> = Vec::new();
    for row in 0..motion.n_frames() {
        match gaps.last_mut() {
            _ if !is_gap(motion.frame(row)[column]) => {}
            Some((first, n)) if *first + *n == row => *n += 1,
            _ => gaps.push((row, 1)),
        }
    }
    gaps
}

#[test]
fn each_gap_is_a_row() {
    let (folder, motion) = folder();
    let mut rows = Vec::new();
    for (column, label) in motion.info.labels().iter().enumerate() {
        let label = if label == "a,b" { "\"a,b\"" } else { label };
        for (first, n) in gaps_of(&motion, column) {
            let (start_s, seconds) = (first as f64 / 100.0, n as f64 / 100.0);
            let row = format!("{label},{},{n},{start_s:.6},{seconds:.6},occluded\n", first + 1);
            rows.push(((first + n, column), row));
        }
    }
    rows.sort();
    assert!(rows.len() > 5, "{rows:?}");
    let expected = rows
        .iter()
        .fold("marker,first_frame,frames,start_s,seconds,cause\n".to_owned(), |all, (_, row)| {
            all + row
        });
    let printed = folder.run(&["gaps", "jump.take", "-o", "gaps.csv"]).with_code(0);
    assert_eq!(folder.text("gaps.csv"), expected);
    let n_gaps = format!("{} gaps", rows.len());
    assert_mentions(&printed.stdout, &["100 frames", &n_gaps, "occluded", "89.00", "a,b"]);
    let table = folder.run(&["gaps", "jump.take", "-o", "-"]).with_code(0);
    assert_eq!((table.stdout, table.stderr), (expected, String::new()));
    let document = folder.run(&["gaps", "jump.take", "--json"]).with_code(0).json();
    assert_eq!(document["gaps"], rows.len());
    let marker = &document["markers"][0];
    assert_eq!(
        (&marker["longest"]["from_frame"], &marker["longest"]["frames"]),
        (&10.into(), &10.into())
    );
    assert_eq!(marker["seen_percent"], 89.0);
    let info = folder.run(&["info", "jump.take", "--json"]).with_code(0).json();
    let (channels, markers) = (&info["channels"], &document["markers"]);
    for (of, marker) in channels.as_array().unwrap().iter().zip(markers.as_array().unwrap()) {
        assert_eq!((&of["gaps"], &of["samples"]), (&marker["gaps"], &marker["samples"]));
    }
}

#[test]
fn outputs_are_checked_first() {
    let (folder, _) = folder();
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
    let script = Arc::new(Script::parse("lost", script).unwrap());
    let settings =
        DeviceSettings { faults: Some(Arc::clone(&script)), ..DeviceSettings::default() };
    let device = Device::new(jump(8, 120.0, 3.0), settings).unwrap();
    let device = Simulated::serve(FaultyDevice::new(device, &script), None);
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

#[test]
fn many_files_are_one_table_with_their_names() {
    let (folder, motion) = folder();
    folder.write_motion("b.trc", &motion);
    let one = folder.run(&["gaps", "jump.take", "-o", "-"]).with_code(0).stdout;
    // A motion file has the gaps of its take.
    let raw = folder.run(&["gaps", "jump.trc", "-o", "-"]).with_code(0).stdout;
    assert_eq!(raw, one);
    let expected = |name: &str| -> String {
        one.lines().skip(1).map(|line| format!("{name},{line}\n")).collect()
    };
    let both = format!(
        "file,{}\n{}{}",
        one.lines().next().unwrap(),
        expected("b.trc"),
        expected("jump.take")
    );
    let args = ["gaps", "b.trc", "jump.take"];
    let ran = folder.run(&[&args[..], &["-o", "all.csv"]].concat()).with_code(0);
    assert_eq!(folder.text("all.csv"), both);
    assert_mentions(&ran.stdout, &["b.trc: ", "jump.take: ", "gaps", "read"]);
    let ran = folder.run(&[&args[..], &["-o", "-"]].concat()).with_code(0);
    assert_eq!(ran.stdout, both, "nothing but the table");
    let ran = folder.run(&[&args[..], &["--json"]].concat()).with_code(0);
    let lines: Vec<serde_json::Value> =
        ran.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((lines.len(), &lines[0]["gaps"]), (2, &lines[1]["gaps"]));
    // A broken file among them: the others are read.
    std::fs::remove_file(folder.path("all.csv")).unwrap();
    folder.write("c.take", "none");
    let ran = folder.run(&["gaps", ".", "--json"]);
    assert_eq!(ran.code, Some(1), "{}", ran.stderr);
    assert_eq!(ran.stdout.lines().count(), 4, "b.trc, c.take, jump.take, jump.trc");
}
