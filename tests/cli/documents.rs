//! docs/json.md compared with the program's output: every field is documented with its type, every example has
//! the keys of real output.

use std::{
    collections::{BTreeMap, BTreeSet},
    os::unix::fs::PermissionsExt,
    sync::Arc,
};

use mocapd_simulator::{
    device::{Device, DeviceSettings},
    generator::{JumpSpec, RigidBodies},
    sampled::SampledSource,
};
use mocapd_take::{
    chunk::{self, ChunkParse, types},
    index::Footer,
    motion::MotionEvent,
    record::{EventKind, Record, Subject},
};
use serde_json::Value;

use super::{
    Folder,
    devices::{Recorder, Simulated},
    imports::analog_file,
};
use crate::support::{assert_mentions, dense, jump};

const DOCUMENT: &str = include_str!("../../docs/json.md");

/// The text under a heading.
fn section(heading: &str) -> &'static str {
    let found = DOCUMENT.split("\n## ").find(|text| text.lines().next() == Some(heading));
    found.unwrap_or_else(|| panic!("docs/json.md has no section {heading}"))
}

/// The documented fields of a section: path and type.
fn fields(heading: &str) -> BTreeMap<&'static str, &'static str> {
    let rows = section(heading).lines().filter_map(|line| {
        let mut cells = line.split('|').map(str::trim).skip(1);
        let path = cells.next()?.strip_prefix('`')?.strip_suffix('`')?;
        Some((path, cells.next()?))
    });
    rows.collect()
}

/// The example of a section.
fn example(heading: &str) -> Value {
    let text = section(heading).split("```json\n").nth(1).and_then(|rest| rest.split("```").next());
    let text = text.unwrap_or_else(|| panic!("{heading} has no example"));
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{heading}: {error}"))
}

/// Every path in a document with the types that it has there: `a.b`, and `a[]` for a list's items.
fn paths(value: &Value, path: &str, found: &mut BTreeMap<String, BTreeSet<&'static str>>) {
    let kind = match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(number) if number.is_f64() => "number",
        Value::Number(_) => "integer",
        Value::String(_) => "string",
        Value::Array(_) => "list",
        Value::Object(_) => "object",
    };
    if !path.is_empty() {
        found.entry(path.to_owned()).or_default().insert(kind);
    }
    match value {
        Value::Array(items) => {
            for item in items {
                paths(item, &format!("{path}[]"), found);
            }
        }
        Value::Object(members) => {
            let separator = if path.is_empty() { "" } else { "." };
            for (key, member) in members {
                paths(member, &format!("{path}{separator}{key}"), found);
            }
        }
        _ => {}
    }
}

fn paths_of(document: &Value) -> BTreeMap<String, BTreeSet<&'static str>> {
    let mut found = BTreeMap::new();
    paths(document, "", &mut found);
    found
}

/// The example has the keys of `real`, the first document; all of `real` together have the documented fields,
/// each of a documented type, and no other.
fn check(heading: &str, real: &[Value]) {
    let shown: Vec<_> = paths_of(&example(heading)).into_keys().collect();
    // A take has an event if the machine stood still meanwhile.
    let is_event =
        |path: &String| path.starts_with("events[]") || path.starts_with("content.events[]");
    let shows_events = shown.iter().any(is_event);
    let keys = paths_of(&real[0]).into_keys();
    let expected: Vec<_> = keys.filter(|path| shows_events || !is_event(path)).collect();
    assert_eq!(shown, expected, "{heading}: the example has other keys");

    let mut documented = fields(heading);
    if documented.contains_key("ledger") {
        documented.extend(fields("The ledger"));
    }
    if real.iter().any(|document| document["sample_ledger"].is_object()) {
        documented.extend(fields("The ledger of sampled channels"));
    }
    let mut found: BTreeMap<String, BTreeSet<&'static str>> = BTreeMap::new();
    for (path, kinds) in real.iter().flat_map(paths_of) {
        found.entry(path).or_default().extend(kinds);
    }
    for (path, kinds) in &found {
        let Some(types) = documented.remove(path.as_str()) else {
            assert!(path.ends_with("[]"), "{heading}: `{path}` is not in docs/json.md");
            assert!(kinds.contains("object"), "{heading}: `{path}` is not in docs/json.md");
            continue;
        };
        for kind in kinds {
            let known = types.split(" or ").any(|known| known == *kind);
            assert!(known, "{heading}: `{path}` is {kind}, docs/json.md says {types}");
        }
    }
    // Lists that stay empty on a healthy machine.
    documented.retain(|path, _| !(path.ends_with("contradictions[]")));
    assert!(documented.is_empty(), "{heading}: no real document has {:?}", documented.keys());
}

#[test]
fn info_and_verify() {
    let folder = Folder::new();
    folder.run(&["demo", "--seconds", "1s", "--out", "demo"]).with_code(0);
    let take = "demo/jump-001.take";
    let info = |take: &str| folder.run(&["info", take, "--json"]).json();
    let mut infos = vec![info(take)];

    // A recording that was cut off by a pulled plug has an event.
    let device = Simulated::endless(jump(1, 120.0, 1.0));
    let mut recorder = Recorder::start(&folder, &device, "unplugged.take", &["--reconnect", "0s"]);
    device.unplug();
    recorder.wait().with_code(3);
    infos.push(info("unplugged.take"));

    // One of rigid bodies has poses.
    let bodies = RigidBodies::new(&JumpSpec::new(1, 120.0), 2).unwrap();
    let settings = DeviceSettings { bodies: Some(Arc::new(bodies)), ..DeviceSettings::default() };
    let device = Device::new(jump(1, 120.0, 1.0), settings).unwrap();
    let device = Simulated::serve(device, None);
    folder.run(&["record", "-d", &device.uri(), "-o", "poses.take"]).with_code(0);
    infos.push(info("poses.take"));

    // One of electrodes has sampled channels.
    let electrodes = SampledSource::electrodes(1, "5@2kHz".parse().unwrap(), 9).unwrap();
    let settings = DeviceSettings { sampled: vec![electrodes], ..DeviceSettings::default() };
    let device = Device::new(jump(1, 120.0, 1.0), settings).unwrap();
    let device = Simulated::serve(device, None);
    folder.run(&["record", "-d", &device.uri(), "-o", "sampled.take"]).with_code(0);
    infos.push(info("sampled.take"));

    // An import has a source, foreign parts, and here a warning.
    let c3d = folder.read("demo/jump-001.c3d");
    folder.write("cut.c3d", &c3d[..c3d.len() / 2]);
    folder.run(&["import", "cut.c3d", "-o", "cut.take"]).with_code(3);
    infos.push(info("cut.take"));
    folder.write("walk.c3d", analog_file(2, 30));
    folder.run(&["import", "walk.c3d", "-o", "walk.take"]).with_code(0);
    infos.push(info("walk.take"));

    // A damaged take has problems.
    let bytes = folder.read("cut.take");
    folder.write("damaged.take", &bytes[..bytes.len() - 1]);
    infos.push(info("damaged.take"));
    // One of a recording has lost frames.
    let mut bytes = folder.read(take);
    let mut at = chunk::MAGIC.len();
    let mut last = 0;
    while let ChunkParse::Whole { kind, len, .. } = chunk::parse(&bytes[at..]) {
        last = if kind == types::STRETCH { at } else { last };
        at += len;
    }
    bytes[last + 8..last + 12].fill(0);
    folder.write("hurt.take", &bytes);
    infos.push(info("hurt.take"));
    folder.run(&["recover", "hurt.take", "-o", "recovered.take"]).with_code(3);
    infos.push(info("recovered.take"));
    // One with a subject, and one with an invalid skeleton.
    folder.write("s.json", super::subjects::skeleton(&jump(1, 120.0, 1.0)));
    folder.write("f.json", super::subjects::FACE);
    let csv = "demo/jump-001.csv";
    let subject = ["--subject", "S01", "--skeleton", "s.json", "--face", "f.json"];
    let args = [&["import", csv, "-o", "subject.take"], &subject[..]].concat();
    folder.run(&args).with_code(0);
    infos.push(info("subject.take"));
    let mut several = Subject::default();
    several.set(Subject::SKELETON, b"{}".to_vec());
    let bytes = folder.read("subject.take");
    folder.write(
        "no-skeleton.take",
        super::verify::changed(&bytes, types::SUBJECT, |_| several.to_payload().unwrap()),
    );
    infos.push(info("no-skeleton.take"));
    check("`mocapd info`", &infos);

    // Names that scripts rely on.
    for name in [
        "frames",
        "markers",
        "rate_hz",
        "raw_bytes",
        "file_bytes",
        "ratio",
        "max_error_mm",
        "ledger",
        "channels",
        "sr1",
        "sr2",
    ] {
        assert!(!infos[0][name].is_null(), "{name}");
    }
    for name in ["label", "samples", "gaps", "knots", "max_error_mm"] {
        assert!(!infos[0]["channels"][0][name].is_null(), "{name}");
    }

    folder.run(&["import", csv, "-o", "again.take", "--tolerance", "1mm"]).with_code(0);
    let verify = |args: &[&str]| folder.run(&[&["verify", "--json"], args].concat()).json();
    // A footer with wrong offsets and a valid checksum.
    let bytes = folder.read(take);
    let mut broken = bytes[..bytes.len() - Footer::CHUNK_BYTES].to_vec();
    let footer = Footer { index_offset: 8, ledger_offset: 8, n_rows: 120 };
    chunk::put(&mut broken, types::FOOTER, &footer.to_payload()).unwrap();
    folder.write("broken.take", broken);
    let other = folder.text(csv).replace("head", "crown");
    folder.write("other.csv", other);
    // Swapped labels, a limb outside its band, and a bone without markers.
    let mut swapped = jump(1, 120.0, 2.0);
    for row in 30..90 {
        swapped.positions_mm.swap(row * 15 + 5, row * 15 + 8);
    }
    for row in 150..170 {
        swapped.positions_mm[row * 15][2] += 300.0;
    }
    swapped.info.markers[14].label = "toe".to_owned();
    folder.write_motion("swapped.csv", &swapped);
    let args = ["import", "swapped.csv", "-o", "swapped.take", "--skeleton", "s.json"];
    folder.run(&args).with_code(0);
    // An ambiguous file.
    let head = "PathFileType\nDataRate\tNumFrames\tNumMarkers\tUnits\n100\t2\t2\tmm\nFrame#\tTime\ta\t\t\tb\n";
    folder.write("zeros.trc", format!("{head}1\t0\t1\t2\t3\t9\t9\t9\n2\t0.01\t2\t2\t3\t0\t0\t0\n"));
    folder.run(&["import", "zeros.trc", "-o", "zeros.take"]).with_code(0);
    // Logs of a device, of which the recording knows nothing.
    let head = "run,group,number,first,first_in_run,n,device_ticks,dropped,host_ns";
    folder.write("batches.csv", format!("{head}\n1,1,0,0,0,16,0,0,0\n1,3,0,0,0,16,0,0,0\n"));
    folder.write("frames.csv", "run,seq,device_ticks,present,dropped,host_ns,unasked\n");
    check(
        "`mocapd verify`",
        &[
            verify(&["again.take", "--against", csv, "--cutoff", "6Hz"]),
            verify(&["again.take", "--against", "other.csv"]),
            verify(&["damaged.take"]),
            verify(&[take]),
            verify(&["hurt.take"]),
            verify(&["broken.take"]),
            verify(&["subject.take", "--skeleton"]),
            verify(&["swapped.take", "--skeleton"]),
            verify(&["zeros.take", "--against", "zeros.trc"]),
            verify(&["walk.take", "--against", "walk.c3d"]),
            verify(&["sampled.take", "--against", "sampled.take"]),
            verify(&["poses.take", "--against", "poses.take"]),
            verify(&["sampled.take", "--against", "batches.csv"]),
            verify(&["sampled.take", "--against", "frames.csv"]),
        ],
    );

    let recover = |take: &str, to: &str| folder.run(&["recover", take, "-o", to, "--json"]).json();
    check(
        "`mocapd recover`",
        &[
            recover("hurt.take", "mended.take"),
            recover("cut.take", "whole.take"),
            recover(take, "again2.take"),
        ],
    );
}

#[test]
fn gaps() {
    let folder = Folder::new();
    // One gap, and later a damaged stretch.
    let mut motion = jump(1, 120.0, 30.0);
    for row in 30..42 {
        motion.positions_mm[row * 15] = mocapd_take::motion::GAP;
    }
    folder.write_motion("jump.csv", &motion);
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    let mut bytes = folder.read("jump.take");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0xff;
    folder.write("hurt.take", bytes);
    let gaps = |take: &str| folder.run(&["gaps", take, "--json"]).json();
    check("`mocapd gaps`", &[gaps("jump.take"), gaps("hurt.take")]);
}

#[test]
fn cut_concat_and_diff() {
    let folder = Folder::new();
    folder.run(&["demo", "--seconds", "2s", "--out", "demo"]).with_code(0);
    let (take, csv) = ("demo/jump-001.take", "demo/jump-001.csv");
    // The rows of a chunk of a later version are unknown.
    let bytes = folder.read(take);
    let mut strange = bytes[..chunk::MAGIC.len()].to_vec();
    let mut rest = &bytes[chunk::MAGIC.len()..];
    while let ChunkParse::Whole { kind, payload, len } = chunk::parse(rest) {
        chunk::put(&mut strange, kind, payload).unwrap();
        rest = &rest[len..];
        if kind == types::HEADER {
            chunk::put(&mut strange, 0xf1, b"later").unwrap();
        }
    }
    folder.write("strange.take", strange);
    let run = |args: &[&str], code| folder.run(args).with_code(code).json();
    let cut = |take: &str, to: &str, range: &[&str]| {
        run(&[&["cut", take, "-o", to, "--json"], range].concat(), 0)
    };
    let first = ["--from", "500ms", "--to", "1s"];
    check(
        "`mocapd cut`",
        &[cut(take, "part.take", &first), cut("strange.take", "other.take", &first)],
    );
    cut(take, "rest.take", &["--from", "1s"]);
    let concat = |takes: [&str; 2], to: &str| {
        run(&[&["concat", "-o", to, "--json"], &takes[..]].concat(), 0)
    };
    check(
        "`mocapd concat`",
        &[
            concat(["part.take", "rest.take"], "joined.take"),
            concat(["strange.take", "strange.take"], "twice.take"),
        ],
    );

    folder.run(&["import", csv, "-o", "exact.take", "--resampler", "lossless"]).with_code(0);
    let repack = |take: &str, to: &str| run(&["repack", take, "-o", to, "--json"], 0);
    check(
        "`mocapd repack`",
        &[repack("exact.take", "smaller.take"), repack("smaller.take", "smallest.take")],
    );

    folder.write("other.csv", folder.text(csv).replace("head", "crown"));
    for (file, to, options) in [
        (csv, "again.take", &["--tolerance", "1mm"][..]),
        (csv, "anna.take", &["--tolerance", "1mm", "--subject", "Anna", "--up", "z"]),
        ("other.csv", "renamed.take", &[]),
        ("demo/jump-001.c3d", "c3d.take", &[]),
    ] {
        folder.run(&[&["import", file, "-o", to], options].concat()).with_code(0);
    }
    cut("again.take", "excerpt.take", &["--from", "1s"]);
    let bytes = folder.read("again.take");
    folder.write("short.take", &bytes[..bytes.len() - 1]);
    let diff = |a: &str, b: &str, code| run(&["diff", a, b, "--json"], code);
    check(
        "`mocapd diff`",
        &[
            diff(take, "again.take", 1),
            diff(take, "joined.take", 1),
            diff(take, "twice.take", 1),
            diff(take, take, 0),
            diff("again.take", "anna.take", 1),
            diff("again.take", "renamed.take", 1),
            diff("again.take", "c3d.take", 1),
            diff("again.take", "excerpt.take", 1),
            diff("again.take", "short.take", 3),
            diff("again.take", csv, 1),
        ],
    );
}

#[test]
fn doctor() {
    let folder = Folder::new();
    let examined = folder.run(&["doctor", "--keep-free", "0", "--json"]);
    let known = ["good", "note", "warning", "failure"];
    for finding in examined.json().as_array().unwrap() {
        assert!(known.contains(&finding["verdict"].as_str().unwrap()), "{finding}");
        let wants = ["warning", "failure"].contains(&finding["verdict"].as_str().unwrap());
        assert_eq!(finding["remedy"].is_string(), wants, "{finding}");
    }
    let no_folder = folder.run(&["doctor", "--dir", "nowhere", "--json"]).with_code(1);
    let is_failure = |finding: &&Value| finding["verdict"] == "failure";
    let n_failures = no_folder.json().as_array().unwrap().iter().filter(is_failure).count();
    assert!(n_failures > 0, "{}", no_folder.stdout);
    assert_mentions(&no_folder.stderr, &[&n_failures.to_string()]);
    check("`mocapd doctor`", &[no_folder.json(), examined.json()]);
    assert_eq!(folder.path("").read_dir().unwrap().count(), 0);
}

#[test]
fn config_check() {
    let folder = Folder::new();
    // Every key that the page has, and one of each list.
    let all = "[device]\nrate_hz = 240\n[subject]\nname = 'S01'\nskeleton = 's.json'\nface = 'f.json'\nface_markers = 'm.json'\n\
               [take]\nangle_tolerance = '0.05deg'\nup_axis = 'y'\nmax_length = '1h'\n[archive]\nurl = 'file:///srv/archive/'\nremove_local_after = '168h'\n[http]\ntoken_file = 'token'\nallowed_hosts = ['rig.lab']\n\
               [trigger]\nlisten = '0.0.0.0:8989'\nsend_to = ['10.0.0.1:8989']\n";
    let publish = "[publish.qtm]\nallow_from = ['192.168.10.0/24']\ncontrol = true\npassword_file = 'token'\n";
    let natnet =
        "[publish.natnet]\nmulticast = '239.255.42.99:1511'\nallow_from = ['192.168.10.0/24']\n";
    let lsl = "[publish.lsl]\nallow_from = ['192.168.10.0/24']\n";
    let foxglove =
        "[publish.foxglove]\nallow_from = ['::1']\norigins = ['https://app.foxglove.dev']\n";
    let all = &format!("{publish}{natnet}{lsl}{foxglove}{all}");
    folder.write("left.toml", all);
    folder.write("token", "0123456789abcdef\n");
    folder.write("s.json", super::subjects::skeleton(&jump(1, 60.0, 1.0)));
    folder.write("f.json", super::subjects::FACE);
    folder.write("m.json", super::subjects::MARKERS);
    std::fs::set_permissions(folder.path("token"), std::fs::Permissions::from_mode(0o600)).unwrap();
    let checked = folder.run(&["config", "check", "left.toml", "--json"]).with_code(0);
    assert_eq!(checked.stderr, "");
    folder.write(
        "lossless.toml",
        all.replace("[archive]", "lossless = true\n[archive]")
            .replace("angle_tolerance = '0.05deg'\n", "")
            + "allow_from = ['::1']\n",
    );
    let lossless = folder.run(&["config", "check", "lossless.toml", "--json"]).with_code(0);
    folder.write("wrong.toml", "[arm]\npre_roll = 10\n[log]\nlevl = 1\n");
    let wrong = folder.run(&["config", "check", "wrong.toml", "--json"]).with_code(2);
    folder.write("my rig.toml", "");
    let unnamed = folder.run(&["config", "check", "my rig.toml", "--json"]).with_code(2);
    check(
        "`mocapd config check`",
        &[checked.json(), lossless.json(), wrong.json(), unnamed.json()],
    );
}

#[test]
fn record_and_import() {
    let folder = Folder::new();
    let motion = jump(1, 120.0, 1.0);
    let device = Simulated::of(motion.clone());
    let uri = device.uri();
    let record = |take: &str, more: &[&str]| {
        let args = [&["record", "-d", &uri, "-o", take, "--json"], more].concat();
        folder.run(&args).with_code(0).json()
    };
    let mut divided = record("parts.take", &["--split", "1s"]);
    // The ledger of a take has the fields of the recording's, which are documented once.
    let ledger_fields: Vec<_> = paths_of(&divided["ledger"]).into_keys().collect();
    for part in divided["parts"].as_array_mut().unwrap() {
        let ledger = std::mem::replace(&mut part["ledger"], Value::Object(serde_json::Map::new()));
        assert_eq!(paths_of(&ledger).into_keys().collect::<Vec<_>>(), ledger_fields);
    }
    let shown = section("`mocapd record`").split("```json\n").nth(2).unwrap();
    let shown: Value = serde_json::from_str(shown.split("```").next().unwrap()).unwrap();
    let real = serde_json::json!({ "split": divided["split"], "parts": divided["parts"] });
    assert!(paths_of(&shown).into_keys().eq(paths_of(&real).into_keys()), "{real:#}");
    check(
        "`mocapd record`",
        &[record("jump.take", &["--raw", "jump.rawlog"]), record("other.take", &[]), divided],
    );

    folder.write_motion("jump.csv", &motion);
    let import = ["import", "jump.csv", "-o", "again.take", "--tolerance", "1mm", "--json"];
    let mut imports = vec![folder.run(&import).with_code(0).json()];
    folder.write_motion("jump.c3d", &motion);
    let c3d = folder.read("jump.c3d");
    folder.write("cut.c3d", &c3d[..c3d.len() / 2]);
    let import = ["import", "cut.c3d", "-o", "cut.take", "--drop-foreign", "--json"];
    imports.push(folder.run(&import).with_code(3).json());
    check("`mocapd import`", &imports);
}

#[test]
fn bench_codec() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(1, 120.0, 1.0));
    let bench = ["bench", "codec", "jump.csv", "--repeats", "1", "--json"];
    let document = folder.run(&bench).with_code(0).json();
    // A file with sampled channels.
    folder.write("walk.c3d", analog_file(8, 50));
    let bench = ["bench", "codec", "walk.c3d", "--resampler", "fast", "--tolerance", "1mm"];
    let sampled = folder.run(&[&bench[..], &["--repeats", "1", "--json"]].concat()).json();
    check("`mocapd bench codec`", &[document.clone(), sampled.clone()]);
    let measured = &sampled["files"][0]["sampled"][0];
    assert_eq!((&measured["kind"], &measured["channels"]), (&"c3d/analog".into(), &8.into()));
    assert_eq!((&measured["samples"], &measured["raw_bytes"]), (&100.into(), &3200.into()));
    let results = document["files"][0]["results"].as_array().unwrap();
    assert_eq!(results.len(), 4 * 6 + 2, "six tolerances of every kind, and both lossless ones");
    for result in results {
        let [error_mm, tolerance_mm] =
            ["max_error_mm", "tolerance_mm"].map(|name| result[name].as_f64().unwrap());
        assert!(error_mm <= tolerance_mm, "{result}");
    }
}

#[test]
fn study() {
    let folder = Folder::new();
    folder.write_motion("jump.c3d", &jump(1, 60.0, 8.0));
    folder.write_motion("start.csv", &jump(1, 60.0, 1.0));
    let study = |file: &str| {
        let args = ["study", file, "--tolerances", "5mm,20mm", "--json"];
        folder.run(&args).with_code(0).json()
    };
    check("`mocapd study`", &[study("jump.c3d"), study("start.csv")]);
}

#[test]
fn devices() {
    // The attached devices depend on the machine; a unit test checks the fields.
    let example = example("`mocapd devices`");
    let real = Folder::new().run(&["devices", "--json"]).with_code(0).json();
    let real = real.as_array().unwrap();
    for device in real {
        let keys = |value: &Value| paths_of(value).into_keys().collect::<Vec<_>>();
        assert_eq!(keys(device), keys(&example[0]));
    }
    if real.is_empty() {
        eprintln!("skipped: no device is attached to compare the example with");
    }
}

#[test]
fn bench_pipeline() {
    let folder = Folder::new();
    let bench =
        ["bench", "pipeline", "--markers", "5", "--seconds", "500ms", "--runs", "1", "--json"];
    let bench = [&bench[..], &["--emg", "2@1kHz"]].concat();
    let ran = folder.run(&bench).with_code(0);
    assert_eq!(ran.stderr, "");
    check("`mocapd bench pipeline`", &[ran.json()]);
    assert!(folder.content().is_empty(), "its takes are removed");
}

#[test]
fn bench_network() {
    let folder = Folder::new();
    let bench =
        ["bench", "network", "--markers", "5", "--seconds", "500ms", "--runs", "1", "--json"];
    let ran = folder.run(&bench).with_code(0);
    assert_eq!(ran.stderr, "");
    let report = ran.json();
    check("`mocapd bench network`", std::slice::from_ref(&report));
    assert!(report["published"][0]["frames_received"].as_u64() > Some(60), "{report}");
    assert!(folder.content().is_empty(), "its takes are removed");
}

#[test]
fn the_exit_codes_are_those_of_the_help() {
    let help = Folder::new().run(&["--help"]).with_code(0).stdout;
    for code in ["0 done", "1 failed", "2 usage", "3 done but data was lost"] {
        assert!(help.contains(code), "{help}");
    }
    let codes = section("Exit codes").lines().filter_map(|line| {
        let mut cells = line.split('|').map(str::trim).skip(1);
        cells.next()?.parse::<u8>().ok()
    });
    assert_eq!(codes.collect::<Vec<_>>(), [0, 1, 2, 3]);
}

#[test]
fn motion_files_exports_plots_and_several_files() {
    let folder = Folder::new();
    folder.run(&["demo", "--seconds", "1s", "--out", "demo"]).with_code(0);
    let take = "demo/jump-001.take";
    let json = |args: &[&str]| folder.run(&[args, &["--json"][..]].concat()).json();
    let mut motion = jump(1, 60.0, 1.0);
    motion.info.events.push(MotionEvent {
        frame: 3,
        kind: EventKind::Mark,
        text: "start".to_owned(),
    });
    folder.write_motion("marked.c3d", &motion);
    let c3d = folder.read("demo/jump-001.c3d");
    folder.write("cut.c3d", &c3d[..c3d.len() / 2]);
    let files = ["demo/jump-001.trc", "marked.c3d", "cut.c3d"];
    check("`mocapd info` of a motion file", &files.map(|file| json(&["info", file])));
    check("`mocapd verify` of a motion file", &files.map(|file| json(&["verify", file])));

    let bytes = folder.read(take);
    folder.write("damaged.take", &bytes[..bytes.len() - 1]);
    folder.run(&["import", "marked.c3d", "-o", "marked.take"]).with_code(0);
    folder.write("plate.c3d", super::forces::plate([0, 0]));
    folder.run(&["import", "plate.c3d", "-o", "plate.take"]).with_code(0);
    folder.write("bodies.take", super::shared_pages::with_bodies(dense(0.5)));
    let exports = [
        json(&["export", take, "-o", "jump.tsv"]),
        json(&["export", "marked.take", "-o", "turned.c3d", "--up", "y"]),
        json(&["export", "damaged.take", "-o", "damaged.csv"]),
        json(&["export", "plate.take", "-o", "plate.csv"]),
        json(&["export", take, "-o", "jump.html"]),
        json(&["export", "bodies.take", "-o", "bodies.html"]),
    ];
    check("`mocapd export`", &exports);
    let plots = [
        json(&["plot", "quality", take, "-o", "jump.svg"]),
        json(&["plot", "pose", "damaged.take", "-o", "damaged.svg"]),
    ];
    check("`mocapd plot`", &plots);

    folder.write("broken.c3d", b"");
    let ran = folder.run(&["info", "broken.c3d", "marked.c3d", "--json"]).with_code(1);
    let lines: Vec<Value> =
        ran.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 2, "{}", ran.stdout);
    check("Several files", &lines[..1]);
    assert_eq!(lines[1], json(&["info", "marked.c3d"]));
}
