//! Subjects: stored in takes, shown, plotted, and compared with the recording.

use std::fmt::Write;

use mocapd_acquire::files::FileError;
use mocapd_simulator::{
    device::DeviceSettings,
    faults::Script,
    generator::{BONES, JumpSpec, Rng, SITES},
};
use mocapd_take::{chunk::types, motion::Motion};
use mocapd_testkit::recorded::RecordedData;
use serde_json::Value;

use super::{Folder, devices::Simulated};
use crate::support::{assert_mentions, jump, mentions, places};

pub(super) const FACE: &str = r#"{"format":"mocapd-face","version":1,"method":"default","source":{"name":"a.jpg","sha256":"7f"},"vertices_mm":[[0,0,0],[9,0,0],[0,9,0]],
"lines":[[0,1],[1,2]],"features":{"nose":0}}"#;

/// The mapping of markers to the face.
pub(super) const MARKERS: &str = r#"{"format":"mocapd-face-mapping","version":1,"markers":[{"label":"head","at":"nose"},{"label":"throat","at":2}]}"#;

fn distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    (0..3).map(|axis| f64::from(a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

/// The skeleton of a motion of 15 sites as a scan would give it: median bone lengths, each with an error of a few per
/// cent.
pub(crate) fn skeleton(motion: &Motion) -> String {
    let mut joints = String::new();
    for site in SITES {
        let at = if joints.is_empty() { "" } else { "," };
        write!(joints, r#"{at}{{"name":"{site}","position_mm":[0,0,0],"uncertainty_mm":9}}"#)
            .unwrap();
    }
    let mut bones = String::new();
    for (i, (parent, child)) in BONES.into_iter().enumerate() {
        let length = |row: usize| distance(motion.frame(row)[parent], motion.frame(row)[child]);
        let mut all: Vec<f64> =
            (0..motion.n_frames()).map(length).filter(|mm| mm.is_finite()).collect();
        all.sort_by(f64::total_cmp);
        let scan_mm = all[all.len() / 2] * (1.0 + 0.03 * (i as f64).sin());
        let (at, name) = (if i == 0 { "" } else { "," }, SITES[child]);
        write!(
            bones,
            r#"{at}{{"name":"to_{name}","parent":"{}","child":"{name}","length_mm":{scan_mm:.1},"uncertainty_mm":12,"spread_mm":null,"scans":1}}"#,
            SITES[parent]
        )
        .unwrap();
    }
    format!(
        r#"{{"format":"mocapd-skeleton","version":1,"method":"default","sources":[{{"name":"scan.obj","sha256":"00ab","unit":"m","unit_inferred":true}}],"stature_mm":1712.5,"sides_told":true,"joints":[{joints}],"bones":[{bones}],"notes":[]}}"#
    )
}

/// A folder with a jump, its skeleton and a face.
fn folder(motion: &Motion) -> Folder {
    let folder = Folder::new();
    folder.write_motion("jump.csv", motion);
    folder.write("s.json", skeleton(motion));
    folder.write("f.json", FACE);
    folder
}

const SUBJECT: [&str; 6] = ["--subject", "S 01", "--skeleton", "s.json", "--face", "f.json"];

fn import(folder: &Folder, take: &str, more: &[&str]) {
    let args = [&["import", "jump.csv", "-o", take], more].concat();
    folder.run(&args).with_code(0);
}

#[test]
fn imports_store_the_subject_and_info_shows_it() {
    let folder = folder(&jump(2, 60.0, 2.0));
    import(&folder, "with.take", &SUBJECT);
    import(&folder, "again.take", &SUBJECT);
    import(&folder, "without.take", &[]);
    assert!(folder.read("with.take") == folder.read("again.take"), "the same import");
    let with = folder.read("with.take");
    let kinds: Vec<u8> = places(&with).into_iter().map(|place| place.0).take(2).collect();
    assert_eq!(kinds, [types::HEADER, types::SUBJECT]);
    let without = folder.read("without.take");
    assert!(places(&without).iter().all(|place| place.0 != types::SUBJECT));
    // Another subject makes it another import, with another id in the first 60 bytes.
    assert!(with[..60] != without[..60]);
    // The motion is the same.
    folder.run(&["verify", "with.take", "--against", "without.take"]).with_code(0);

    let info = folder.run(&["info", "with.take", "--json"]).with_code(0).json();
    let subject = &info["subject"];
    assert_eq!((&subject["name"], &subject["problems"]), (&"S 01".into(), &Value::Array(vec![])));
    assert_eq!(subject["skeleton"]["stature_mm"], 1712.5);
    assert_eq!(subject["skeleton"]["sources"][0]["sha256"], "00ab");
    assert_eq!(subject["skeleton"]["bones"].as_array().unwrap().len(), 14);
    assert_eq!(subject["face"]["vertices"], 3);
    assert_eq!(subject["documents"][1]["bytes"], FACE.len());
    assert!(info["bytes"]["subject"].as_u64().unwrap() > 300);
    let printed = folder.run(&["info", "with.take"]).with_code(0).stdout;
    let facts = ["S 01", "1712 mm", "15 joints", "14 bones", "SHA-256 00ab", "3 vertices"];
    assert_mentions(&printed, &facts);
    assert_eq!(folder.run(&["info", "without.take", "--json"]).json()["subject"], Value::Null);

    // The subject survives damage elsewhere in the take.
    let mut hurt = with.clone();
    let last = hurt.len() - 60;
    hurt[last] ^= 1;
    folder.write("hurt.take", &hurt);
    folder.run(&["recover", "hurt.take", "-o", "recovered.take"]);
    let recovered = folder.run(&["info", "recovered.take", "--json"]).json();
    assert_eq!(recovered["subject"], *subject);
}

#[test]
fn invalid_documents_are_refused_before_anything_is_written() {
    let folder = folder(&jump(2, 60.0, 1.0));
    folder.write("large.json", vec![b' '; (1 << 20) + 1]);
    let refused = |more: &[&str]| {
        folder.refuses(&[&["import", "jump.csv", "-o", "new.take"], more].concat(), 1)
    };
    let absent = FileError::NotFound("none.json".into()).to_string();
    assert_eq!(refused(&["--skeleton", "none.json"]), absent);
    let no_skeleton = ["f.json", "mocapd-skeleton", "mocapd subject body -o"];
    assert_mentions(&refused(&["--skeleton", "f.json"]), &no_skeleton);
    let facts = ["jump.csv", "JSON", "mocapd-face", "mocapd subject face -o", "line 1"];
    assert_mentions(&refused(&["--face", "jump.csv"]), &facts);
    let facts = ["jump.csv", "line 1", "mocapd-face-mapping", "singing-face-mapping.json"];
    assert_mentions(&refused(&["--face", "f.json", "--face-markers", "jump.csv"]), &facts);
    folder.run(&["import", "jump.csv", "-o", "a.take"]).with_code(0);
    folder.write("scan.ply", b"ply\nformat binary_little_endian 1.0\n\xff\xfe");
    let drawn = |with: &str| {
        let args = ["plot", "pose", "a.take", "-o", "p.svg", "--skeleton", with];
        let why = folder.run(&args).stderr;
        assert!(!folder.path("p.svg").exists());
        assert_mentions(&why, &[with, "mocapd subject body -o"]);
    };
    ["f.json", "scan.ply", "jump.csv"].into_iter().for_each(drawn);
    assert_mentions(&refused(&["--face", "large.json"]), &["large.json", "1048576 bytes"]);
    let long = "S".repeat(129);
    folder.refuses(&["import", "jump.csv", "-o", "new.take", "--subject", &long], 2);
    // No device is opened either.
    let args = ["record", "-d", "serial:/dev/none", "-o", "new.take", "--skeleton", "f.json"];
    assert_mentions(&folder.refuses(&args, 1), &no_skeleton);
}

#[test]
fn recordings_store_the_subject() {
    let folder = folder(&jump(3, 120.0, 2.0));
    let device = Simulated::of(jump(3, 120.0, 1.0));
    let uri = device.uri();
    let args = [&["record", "-d", &uri, "-o", "live.take"], &SUBJECT[..]].concat();
    folder.run(&args).with_code(0);
    let kinds: Vec<u8> =
        places(&folder.read("live.take")).into_iter().map(|place| place.0).take(2).collect();
    assert_eq!(kinds, [types::HEADER, types::SUBJECT]);
    let info = folder.run(&["info", "live.take", "--json"]).with_code(0).json();
    assert_eq!(info["subject"]["skeleton"]["bones"].as_array().unwrap().len(), 14);
    let verify = ["verify", "live.take", "--skeleton", "--json"];
    let limbs = &folder.run(&verify).with_code(0).json()["limbs"];
    assert_eq!(limbs["swaps"], Value::Array(vec![]), "{limbs}");
}

#[test]
fn recordings_of_other_markers_begin_with_a_warning() {
    let motion = jump(3, 120.0, 0.5);
    let folder = folder(&motion);
    let of = |motion: Motion, take: &str| {
        let device = Simulated::of(motion);
        let args = ["record", "-d", &device.uri(), "-o", take, "--skeleton", "s.json"];
        folder.run(&args).with_code(0).stderr
    };
    assert_eq!(of(motion.clone(), "same.take"), "");
    let mut other = motion;
    other.info.markers.iter_mut().enumerate().for_each(|(i, m)| m.label = format!("m{i}"));
    assert_mentions(&of(other, "other.take"), &["skeleton"]);
}

#[test]
fn a_pose_has_the_skeletons_bones_and_their_lengths() {
    let motion = jump(4, 60.0, 3.0);
    let folder = folder(&motion);
    import(&folder, "with.take", &SUBJECT);
    import(&folder, "without.take", &[]);
    let drawn = |args: &[&str]| {
        let args = [&["plot", "pose"], args, &["-o", "new.svg", "--at", "1s,2s"]].concat();
        let ran = folder.run(&args).with_code(0);
        let svg = folder.text("new.svg");
        std::fs::remove_file(folder.path("new.svg")).unwrap();
        roxmltree::Document::parse(&svg).unwrap();
        (svg, ran.stderr)
    };
    let (own, _) = drawn(&["with.take"]);
    let (by_file, _) = drawn(&["without.take", "--skeleton", "s.json"]);
    let (plain, message) = drawn(&["without.take"]);
    assert!(!message.contains("face"), "{message}");
    // A face without a mapping cannot be drawn: the message says how to give one.
    let (_, message) = drawn(&["with.take"]);
    assert_mentions(&message, &["--face-markers", "singing-face-mapping.json"]);
    let lines = |svg: &str| svg.matches("<polyline").count() + svg.matches("<line").count();
    assert_eq!(lines(&own), lines(&by_file));
    for name in ["to_l_elbow", "to_r_ankle", "to_head"] {
        assert!(own.contains(name) && by_file.contains(name) && !plain.contains(name), "{name}");
    }
    // With the skeleton of another person every bone and every row of the table is red.
    let grown = skeleton(&motion).replace("\"length_mm\":", "\"length_mm\":9");
    folder.write("grown.json", grown);
    let red = |svg: &str| svg.matches("#D55E00").count();
    let (other, _) = drawn(&["with.take", "--skeleton", "grown.json"]);
    assert!(red(&other) >= 14 * 3 && red(&own) < 14, "{} and {}", red(&other), red(&own));
}

#[test]
fn a_pose_shows_the_face_from_the_front() {
    // The face looks along -y of the take, whose x points to its right; the up axis is unknown.
    let folder = Folder::new();
    folder.write(
        "f.json",
        r#"{"format":"mocapd-face","version":1,"vertices_mm":[[40,0,0],[-40,0,0],[0,60,0],[0,0,30]],
"lines":[[0,1],[1,2],[2,0],[3,2]],"features":{}}"#,
    );
    folder.write(
        "m.json",
        r#"{"format":"mocapd-face-mapping","version":1,"markers":[{"label":"left","at":0},
{"label":"right","at":1},{"label":"top","at":2},{"label":"nose","at":3}]}"#,
    );
    let mut csv = "frame,time_s".to_owned();
    for marker in ["left", "right", "top", "nose"] {
        write!(csv, ",{marker}.x,{marker}.y,{marker}.z").unwrap();
    }
    for frame in 0..60 {
        write!(csv, "\n{frame},{},-40,0,5,40,0,5,0,0,65,0,-30,5", f64::from(frame) / 60.0).unwrap();
    }
    folder.write("a.csv", csv);
    let subject = ["--face", "f.json", "--face-markers", "m.json"];
    folder.run(&[&["import", "a.csv", "-o", "a.take"], &subject[..]].concat()).with_code(0);
    folder.run(&["plot", "pose", "a.take", "-o", "a.svg", "--at", "0.5s"]).with_code(0);
    let svg = folder.text("a.svg");
    folder.write(
        "few.json",
        r#"{"format":"mocapd-face-mapping","version":1,"markers":[{"label":"left","at":0}]}"#,
    );
    let subject = ["--face", "f.json", "--face-markers", "few.json"];
    folder.run(&[&["import", "a.csv", "-o", "few.take"], &subject[..]].concat()).with_code(0);
    let ran = folder.run(&["plot", "pose", "few.take", "-o", "few.svg"]).with_code(0);
    assert_mentions(&ran.stderr, &["face", "--face-markers"]);
    let exported = folder.run(&["export", "a.take", "-o", "a.trc"]).with_code(0);
    assert_mentions(&exported.stderr, &["a.trc", "face", "face-markers"]);
    folder.write("five.json", folder.text("m.json").replace("]}", r#",{"label":"chin","at":3}]}"#));
    let subject = ["--face", "f.json", "--face-markers", "five.json"];
    let ran = folder.run(&[&["import", "a.csv", "-o", "five.take"], &subject[..]].concat());
    assert_mentions(&ran.with_code(0).stderr, &["a.csv", "4", "5"]);
    folder.write("nowhere.json", folder.text("m.json").replace("\"at\":3", "\"at\":\"snout\""));
    let subject = ["--face", "f.json", "--face-markers", "nowhere.json"];
    let ran = folder.run(&[&["import", "a.csv", "-o", "no.take"], &subject[..]].concat());
    let why = &ran.with_code(1).stderr;
    assert_mentions(why, &["nowhere.json", "nose", "snout"]);
    let svg = roxmltree::Document::parse(&svg).unwrap();
    let lines = svg.descendants().filter(|node| node.has_tag_name("polyline")).count();
    assert!(lines >= 5, "four of the face and the floor: {lines}");
    let circles = svg.descendants().filter(|node| node.has_tag_name("circle"));
    let places: Vec<[i32; 2]> = circles
        .map(|node| ["cx", "cy"].map(|name| node.attribute(name).unwrap().parse().unwrap()))
        .collect();
    let [left, right, top, nose] = places[..] else { panic!("{places:?}") };
    assert!(left[0] > nose[0] && nose[0] > right[0], "its left is on the right: {places:?}");
    assert!(top[1] < nose[1] && left[1] == right[1], "{places:?}");
}

#[test]
fn without_a_skeleton_or_joints_verify_says_what_to_do() {
    let folder = folder(&jump(4, 60.0, 1.0));
    import(&folder, "without.take", &[]);
    let why = folder.refuses(&["verify", "without.take", "--skeleton"], 2);
    assert_mentions(&why, &["without.take", "--skeleton"]);
    let mut motion = jump(4, 60.0, 1.0);
    motion.info.markers.iter_mut().enumerate().for_each(|(i, m)| m.label = format!("m{i}"));
    folder.write_motion("unnamed.csv", &motion);
    folder.run(&["import", "unnamed.csv", "-o", "unnamed.take"]).with_code(0);
    let why = folder.refuses(&["verify", "unnamed.take", "--skeleton", "s.json"], 1);
    assert_mentions(&why, &SITES);
}

/// Jumps of many styles at typical rates, with walking and swinging arms: no frame is a swap.
#[test]
fn generated_jumps_have_no_swaps() {
    let folder = Folder::new();
    for (seed, rate_hz) in [(1, 120.0), (2, 60.0), (3, 240.0), (4, 100.0), (5, 60.0), (6, 120.0)] {
        let spec = JumpSpec { seconds: Some(12.0), ..JumpSpec::new(seed, rate_hz) };
        let motion = spec.generate().unwrap().motion;
        folder.write("s.json", skeleton(&motion));
        folder.write_motion("jump.csv", &motion);
        let take = format!("{seed}.take");
        folder.run(&["import", "jump.csv", "-o", &take]).with_code(0);
        let found = folder.run(&["verify", &take, "--skeleton", "s.json", "--json"]).with_code(0);
        let limbs = &found.json()["limbs"];
        assert_eq!(limbs["swaps"], Value::Array(vec![]), "{seed}: {limbs}");
        assert_eq!(limbs["bones"].as_array().unwrap().len(), 14);
    }
}

#[test]
fn swaps_in_a_take_are_reported_with_their_markers_and_times() {
    let (rate_hz, n_swaps) = (120.0, 20);
    let spec = JumpSpec { seconds: Some(24.0), ..JumpSpec::new(7, rate_hz) };
    let clean = spec.generate().unwrap().motion;
    let mut swapped = clean.clone();
    let mut rng = Rng::new(5);
    let n = SITES.len();
    let mut truth = Vec::new();
    for i in 0..n_swaps {
        let one = (rng.unit() * n as f64) as usize;
        let other = (one + 1 + (rng.unit() * (n - 1) as f64) as usize) % n;
        let from = 60 + i * 130;
        let rows = from..from + 5 + (rng.unit() * 80.0) as usize;
        for row in rows.clone() {
            swapped.positions_mm.swap(row * n + one, row * n + other);
        }
        truth.push(([one.min(other), one.max(other)].map(|site| SITES[site]), rows));
    }
    let folder = folder(&swapped);
    folder.write("s.json", skeleton(&clean));
    import(&folder, "swapped.take", &["--skeleton", "s.json"]);
    let ran = folder.run(&["verify", "swapped.take", "--skeleton", "--json"]).with_code(3);
    let document = ran.json();
    assert_eq!(
        (&document["intact"], &document["contradictions"]),
        (&true.into(), &Value::Array(vec![]))
    );
    let found = document["limbs"]["swaps"].as_array().unwrap();
    let mut exact = 0;
    for swap in found {
        let number = |name: &str| swap[name].as_u64().unwrap() as usize;
        let (from, to) = (number("from_frame"), number("to_frame"));
        let pair = [0, 1].map(|i| swap["markers"][i].as_str().unwrap());
        let of = truth.iter().find(|(truth, rows)| *truth == pair && rows.contains(&from));
        let (_, rows) = of.unwrap_or_else(|| panic!("{swap} was never made"));
        assert!(rows.contains(&to), "{swap} was {rows:?}");
        exact += usize::from((from, to) == (rows.start, rows.end - 1));
        let from_s = swap["from_s"].as_f64().unwrap();
        assert!((from_s - from as f64 / rate_hz).abs() < 1e-6, "{swap}");
    }
    eprintln!("{} of {n_swaps} swaps found, {exact} to the frame", found.len());
    // The hips of a standing body are equally far from both knees: no limb reveals such a swap.
    assert!(found.len() >= n_swaps - 3 && exact >= n_swaps - 5, "{found:#?}");
    let printed = folder.run(&["verify", "swapped.take", "--skeleton"]).with_code(3).stdout;
    assert_eq!(printed.matches("SWAPPED: ").count(), found.len(), "{printed}");
}

#[test]
fn bones_that_do_not_fit_are_exit_code_3() {
    let motion = jump(7, 120.0, 6.0);
    let folder = folder(&motion);
    import(&folder, "fits.take", &["--skeleton", "s.json"]);
    let fits = folder.run(&["verify", "fits.take", "--skeleton"]).with_code(0);
    assert_eq!(fits.stderr, "");
    // The skeleton of another person: each bone is half as long again.
    let mut grown: Value = serde_json::from_str(&skeleton(&motion)).unwrap();
    for bone in grown["bones"].as_array_mut().unwrap() {
        bone["length_mm"] = (bone["length_mm"].as_f64().unwrap() * 1.5).into();
    }
    folder.write("grown.json", grown.to_string());
    let other = ["verify", "fits.take", "--skeleton", "grown.json", "--json"];
    let ran = folder.run(&other).with_code(3);
    assert_mentions(&ran.stderr, &["fits.take", "14 of 14 bones", "do not fit", "to_l_knee"]);
    let limbs = &ran.json()["limbs"];
    assert!(limbs["bones"].as_array().unwrap().iter().all(|bone| bone["off"] == true), "{limbs}");
    assert_eq!(ran.json()["intact"], true);
    // A marker that fell off for a second: only the bones at it.
    let mut fallen = motion;
    let knee = SITES.iter().position(|&site| site == "l_knee").unwrap();
    for row in 300..420 {
        fallen.positions_mm[row * SITES.len() + knee][0] += 900.0;
    }
    folder.write_motion("fallen.csv", &fallen);
    folder.run(&["import", "fallen.csv", "-o", "fallen.take"]).with_code(0);
    let args = ["verify", "fallen.take", "--skeleton", "s.json"];
    let ran = folder.run(&args).with_code(3);
    assert_mentions(&ran.stderr, &["implausible lengths", "to_l_knee"]);
    assert!(
        !ran.stderr.contains("do not fit") && !ran.stderr.contains("swapped"),
        "{}",
        ran.stderr
    );
    assert_mentions(&ran.stdout, &["implausible length", "to_l_knee"]);
}

/// The simulator's fault `swaps`, recorded over a line.
#[test]
fn swaps_of_a_device_are_found() {
    let script = "seed = 3\n[[fault]]\nkind = \"swaps\"\nevery_s = 0.5\nfor_s = 0.2\n";
    let script = std::sync::Arc::new(Script::parse("swaps", script).unwrap());
    let motion = jump(8, 120.0, 4.0);
    let folder = folder(&motion);
    let settings = DeviceSettings { faults: Some(script), ..DeviceSettings::default() };
    let device = Simulated::start(motion, settings, None);
    let args = ["record", "-d", &device.uri(), "-o", "live.take", "--skeleton", "s.json"];
    folder.run(&args).with_code(0);
    let ran = folder.run(&["verify", "live.take", "--skeleton", "--json"]).with_code(3);
    let n = ran.json()["limbs"]["swaps"].as_array().unwrap().len();
    // The script made eight swaps of any two markers.
    assert!((5..=8).contains(&n), "{n}: {}", ran.stdout);
}

/// Recorded jumps, if available: real bodies bend and bounce without looking like swaps.
#[test]
fn recorded_jumps_have_no_swaps() {
    let Some(takes) = RecordedData::Takes.folder() else { return };
    let folder = Folder::new();
    let mut n = 0;
    for entry in std::fs::read_dir(takes).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        if !name.starts_with("cmu_") || path.extension().is_none_or(|ending| ending != "csv") {
            continue;
        }
        let bytes = std::fs::read(&path).unwrap();
        let motion = mocapd_take::interchange::Format::Csv.read(&bytes).unwrap();
        let take = format!("{name}.take");
        // These files call the throat neck, and have another marker order.
        folder.write("s.json", skeleton(&in_order(&motion)));
        folder.run(&["import", path.to_str().unwrap(), "-o", &take]).with_code(0);
        let ran = folder.run(&["verify", &take, "--skeleton", "s.json", "--json"]);
        let limbs = &ran.json()["limbs"];
        assert_eq!(limbs["swaps"], Value::Array(vec![]), "{name}: {limbs}");
        let outside = limbs["outside"].as_array().unwrap().len();
        // Shoulders that rise far leave the band of a collar bone.
        ran.with_code(if outside == 0 { 0 } else { 3 });
        eprintln!("{name}: no swaps, {outside} times a limb out of its band");
        n += 1;
    }
    assert!(n > 0, "MOCAPD_TAKES has no cmu_*.csv");
}

/// The motion with its markers in the order of [`SITES`].
fn in_order(motion: &Motion) -> Motion {
    let column = |site: &&str| {
        let name = if *site == "throat" { "neck" } else { site };
        motion.info.markers.iter().position(|marker| marker.label == name).unwrap()
    };
    let columns: Vec<usize> = SITES.iter().map(column).collect();
    let rows = 0..motion.n_frames();
    let positions_mm = rows.flat_map(|row| columns.iter().map(move |&c| motion.frame(row)[c]));
    let mut info = motion.info.clone();
    info.markers = columns.iter().map(|&column| motion.info.markers[column].clone()).collect();
    Motion { positions_mm: positions_mm.collect(), info }
}

#[test]
fn a_skeleton_and_a_face_of_other_markers_get_a_warning() {
    let folder = Folder::new();
    let motion = jump(1, 60.0, 0.5);
    folder.write("s.json", skeleton(&motion));
    folder.write("f.json", FACE);
    folder.write("m.json", MARKERS.replace("head", "brow"));
    folder.write_motion("jump.csv", &motion);
    let with = ["--skeleton", "s.json", "--face", "f.json", "--face-markers", "m.json"];
    let ran =
        folder.run(&[&["import", "jump.csv", "-o", "a.take"], &with[..]].concat()).with_code(0);
    assert!(!mentions(&ran.stderr, "skeleton"), "{}", ran.stderr);
    assert_mentions(&ran.stderr, &["jump.csv", "face", "1", "2", "4"]);

    let text = String::from_utf8(folder.read("jump.csv")).unwrap();
    let strange =
        SITES.iter().fold(text, |text, site| text.replace(site, &format!("x{}", site.len())));
    folder.write("strange.csv", strange);
    let ran = folder.run(&["import", "strange.csv", "-o", "b.take", "--skeleton", "s.json"]);
    assert_mentions(&ran.with_code(0).stderr, &["strange.csv", "skeleton"]);
}
