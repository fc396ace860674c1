//! `cut`, `concat` and `diff`: parts of takes, takes joined from parts, and differences.

use mocapd_acquire::files::NameTaken;

use super::Folder;
use crate::support::{
    assert_mentions, c3d_file::C3dFile, config, crowd, dense, fast, jump, record,
};

/// A recording of 25 s at 60 Hz, in which some frames were lost.
fn recorded(folder: &Folder, name: &str) {
    let motion = jump(3, 60.0, 25.0);
    let lost = |seq: &usize| (300..320).contains(seq) || *seq == 900;
    let wanted = (0..1500).filter(|seq| !lost(seq));
    let (_, take, _) = record(&motion, &config(&motion, dense(0.5)), wanted);
    folder.write(name, take);
}

#[test]
fn a_part_of_a_recording_is_a_whole_take_with_the_same_samples() {
    let folder = Folder::new();
    recorded(&folder, "whole.take");
    let cut = &["cut", "whole.take", "-o", "part.take", "--from", "4s", "--to", "21s"];
    let ran = folder.run(cut).with_code(0);
    assert_mentions(&ran.stdout, &["part.take", "frames 240 to 1 259 of 1 500", "15 markers"]);
    assert_eq!(ran.stderr, "");
    // Frames were lost while it was recorded: intact, and lossy.
    let verified = folder.run(&["verify", "part.take", "--json"]).with_code(3).json();
    assert_eq!((&verified["intact"], &verified["health"]), (&true.into(), &"lossy".into()));
    let info = folder.run(&["info", "part.take", "--json"]).with_code(3).json();
    assert_eq!((&info["frames"], &info["ledger"]["closes"]), (&1020.into(), &true.into()));
    assert_eq!(info["ledger"]["lost_on_link"], 21);
    assert_eq!(info["ending"], "length");
    // A part without a lost frame is complete.
    folder.run(&["cut", "whole.take", "-o", "clean.take", "--frames", "400..800"]).with_code(0);
    let verified = folder.run(&["verify", "clean.take", "--json"]).with_code(0).json();
    assert_eq!(verified["health"], "complete");
    for (take, from, to) in [("part.take", "4s", "21s"), ("clean.take", "6.6666s", "13.3333s")] {
        for (name, args) in [
            ("part.csv", &["export", take][..]),
            ("same.csv", &["export", "whole.take", "--from", from, "--to", to]),
        ] {
            folder.run(&[args, &["-o", name]].concat()).with_code(0);
        }
        // A recording counts its frames from 1, a part of an export from the first of the take.
        let positions = |name: &str| -> Vec<String> {
            let text = folder.text(name);
            text.lines().map(|row| row.split_once(',').unwrap().1.to_owned()).collect()
        };
        assert!(positions("part.csv") == positions("same.csv"), "{take}");
        for name in ["part.csv", "same.csv"] {
            std::fs::remove_file(folder.path(name)).unwrap();
        }
    }
}

#[test]
fn joined_parts_are_the_take_that_they_were_cut_from() {
    let folder = Folder::new();
    recorded(&folder, "whole.take");
    let mut parts = Vec::new();
    for (name, range) in [("a.take", "..310"), ("b.take", "310..1001"), ("c.take", "1001..")] {
        folder.run(&["cut", "whole.take", "-o", name, "--frames", range]).with_code(0);
        parts.push(name);
    }
    let concat = [&["concat", "-o", "all.take"], &parts[..]].concat();
    let ran = folder.run(&concat).with_code(0);
    assert_mentions(&ran.stdout, &["all.take", "1 500 frames", "a.take", "b.take", "c.take"]);
    let diff = folder.run(&["diff", "whole.take", "all.take", "--motion"]).with_code(0);
    assert_mentions(&diff.stdout, &["no difference"]);
    // Only the header says that it was joined.
    let found = folder.run(&["diff", "whole.take", "all.take", "--json"]).with_code(1).json();
    let names = |list: &serde_json::Value| -> Vec<String> {
        let fields = list.as_array().unwrap().iter();
        fields.map(|field| field["field"].as_str().unwrap().to_owned()).collect()
    };
    let content = &found["content"];
    assert_eq!(names(&content["header"]), ["take_id"]);
    assert_eq!(names(&content["settings"]), ["concat"]);
    for list in ["subject", "events", "foreign"] {
        assert_eq!(content[list], serde_json::json!([]), "{list}");
    }
    assert_eq!(found["times"]["first_frame"], serde_json::Value::Null, "{}", found["times"]);
    assert_eq!((&found["equal"], &found["motion"]["equal"]), (&false.into(), &true.into()));
    let verified = folder.run(&["verify", "all.take", "--json"]).with_code(3).json();
    assert_eq!(
        (&verified["intact"], &verified["contradictions"]),
        (&true.into(), &serde_json::json!([]))
    );
    // Without the part in the middle, its frames are lost ones.
    let ran = folder.run(&["concat", "a.take", "c.take", "-o", "gap.take"]).with_code(0);
    assert_mentions(&ran.stdout, &["691 frames", "c.take"]);
    let info = folder.run(&["info", "gap.take", "--json"]).with_code(3).json();
    assert_eq!((&info["frames"], &info["outages"]["frames"]), (&1500.into(), &691.into()));
    assert_eq!(info["ledger"]["closes"], true);
    // The second take of another recording follows at once, with an event.
    recorded(&folder, "other.take");
    folder.run(&["concat", "other.take", "a.take", "-o", "both.take"]).with_code(0);
    let info = folder.run(&["info", "both.take", "--json"]).with_code(3).json();
    assert_eq!((&info["frames"], &info["events"][0]["frame"]), (&1810.into(), &1500.into()));
}

#[test]
fn a_part_of_more_markers_than_a_block_holds() {
    let folder = Folder::new();
    let motion = crowd(4, 60.0, 12.0);
    let (_, take, _) = record(&motion, &config(&motion, fast(1.0)), 0..720);
    folder.write("whole.take", take);
    folder.run(&["cut", "whole.take", "-o", "a.take", "--to", "5.5s"]).with_code(0);
    folder.run(&["cut", "whole.take", "-o", "b.take", "--from", "5.5s"]).with_code(0);
    for part in ["a.take", "b.take"] {
        folder.run(&["verify", part]).with_code(0);
    }
    folder.run(&["concat", "a.take", "b.take", "-o", "all.take"]).with_code(0);
    folder.run(&["diff", "--motion", "whole.take", "all.take"]).with_code(0);
}

#[test]
fn whole_stretches_are_copied_and_the_frames_added_are_stated() {
    let folder = Folder::new();
    recorded(&folder, "whole.take");
    let cut = |name: &str, args: &[&str]| {
        let args =
            [&["cut", "whole.take", "-o", name, "--from", "12s", "--to", "14s", "--json"], args];
        folder.run(&args.concat()).with_code(0)
    };
    let (exact, whole) = (cut("exact.take", &[]), cut("wide.take", &["--whole-stretches"]));
    assert_eq!(exact.json()["frames"], 120);
    assert_eq!(exact.stderr, "");
    let report = whole.json();
    assert_eq!(report["frames_stored_exactly"], 0);
    let more = report["frames"].as_u64().unwrap() - 120;
    assert!((1..660).contains(&more), "{report}");
    assert_mentions(&whole.stderr, &["whole.take", &format!("{more} frames")]);
    assert!(report["file_bytes"].as_u64() < exact.json()["file_bytes"].as_u64());
    for take in ["exact.take", "wide.take"] {
        folder.run(&["verify", take]).with_code(0);
    }
}

/// A C3D file with analog samples, residuals and a model output in each frame.
fn c3d() -> Vec<u8> {
    let frame = |i: usize| {
        let t = i as f32;
        let mut words = vec![t, 2.0 * t, 100.0 + t, 0.25 * (i % 9) as f32];
        words.extend([500.0 - t, t * t / 50.0, 3.0, if i % 7 == 3 { -1.0 } else { 1.5 }]);
        words.extend([10.0 * t, 20.0, -t, 0.0]);
        words.extend((0..6).map(|k| 1000.0 * t + k as f32));
        words
    };
    let mut file = C3dFile::new(3, (0..1200).map(frame).collect());
    file.analog = (2, 3);
    file.first_last = (41, 1240);
    file.texts(1, "LABELS", &["knee", "toe", "angle"]);
    file.texts(1, "ANGLES", &["angle"]);
    let analog = file.group(2, "ANALOG");
    file.records.extend(analog);
    file.words(2, "USED", &[2]);
    file.floats(2, "RATE", &[300.0]);
    file.floats(2, "GEN_SCALE", &[1.0]);
    file.floats(2, "SCALE", &[0.5, 2.0]);
    file.words(2, "OFFSET", &[0, 0]);
    file.texts(2, "LABELS", &["Fz", "EMG"]);
    file.bytes()
}

#[test]
fn an_export_of_a_part_is_the_part_of_an_export() {
    let folder = Folder::new();
    folder.write("walk.c3d", c3d());
    folder.run(&["import", "walk.c3d", "-o", "walk.take", "--tolerance", "1mm"]).with_code(0);
    let parts = ["c3d/analog", "c3d/residuals", "c3d/model-outputs"];
    let info = folder.run(&["info", "walk.take"]).with_code(0).stdout;
    assert_mentions(&info, &parts);
    for (i, (from, to)) in [("0", "3s"), ("3s", "10.5s"), ("10.5s", "12s")].into_iter().enumerate()
    {
        let part = format!("part{i}.take");
        folder.run(&["cut", "walk.take", "-o", &part, "--from", from, "--to", to]).with_code(0);
        let (cut, whole) = (format!("cut{i}.c3d"), format!("whole{i}.c3d"));
        folder.run(&["export", &part, "-o", &cut]).with_code(0);
        folder.run(&["export", "walk.take", "-o", &whole, "--from", from, "--to", to]).with_code(0);
        assert!(folder.read(&cut) == folder.read(&whole), "{part}");
        folder.run(&["verify", &part, "--against", "walk.c3d"]).with_code(1);
        let against = folder.run(&["verify", &part, "--against", "walk.c3d", "--json"]).json();
        // The frames of the part are compared with those of their numbers.
        assert_eq!(against["against"]["gaps_differing"], 0);
        assert_eq!(against["against"]["beyond_stated"], 0);
        assert!(against["against"]["max_error_mm"].as_f64().unwrap() <= 1.0);
        folder.run(&["verify", &part]).with_code(0);
    }
    let concat = ["concat", "part0.take", "part1.take", "part2.take", "-o", "all.take"];
    let joined = folder.run(&concat).with_code(0);
    assert_eq!(joined.stderr, "", "nothing is left out");
    folder.run(&["export", "all.take", "-o", "all.c3d"]).with_code(0);
    folder.run(&["export", "walk.take", "-o", "again.c3d"]).with_code(0);
    assert!(folder.read("all.c3d") == folder.read("again.c3d"));
    folder.run(&["verify", "all.take", "--against", "walk.c3d"]).with_code(0);
    let found = folder.run(&["diff", "walk.take", "all.take", "--json"]).with_code(1).json();
    assert_eq!(found["content"]["foreign"], serde_json::json!([]));
    // In another order the samples follow their frames; the parameters of both are kept.
    folder.run(&["concat", "part1.take", "part0.take", "-o", "swapped.take"]).with_code(0);
    folder.run(&["verify", "swapped.take"]).with_code(0);
}

#[test]
fn cuts_that_cannot_be_made_are_refused() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(2, 60.0, 2.0));
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    let cut = |args: &[&str], code| {
        folder.refuses(&[&["cut", "jump.take", "-o", "part.take"], args].concat(), code)
    };
    assert_mentions(&cut(&[], 2), &["--from", "--to", "--frames"]);
    assert_mentions(&cut(&["--frames", "3"], 2), &["1200..2400", "'3'"]);
    assert_mentions(&cut(&["--frames", "3..9", "--from", "1s"], 2), &["--frames", "--from"]);
    for empty in
        [&["--from", "2s"][..], &["--frames", "7..7"], &["--frames", "120.."], &["--to", "0"]]
    {
        assert_mentions(&cut(empty, 2), &["jump.take", "120 frames", "2.000 s"]);
    }
    let backwards = cut(&["--from", "1.2s", "--to", "0.5s"], 2);
    assert_mentions(&backwards, &["120 frames", "ends before it begins"]);
    let refuses = |args: &[&str], code| folder.refuses(args, code);
    let range = ["--to", "1s"];
    let line = refuses(&[&["cut", "jump.take", "-o", "jump.take"], &range[..]].concat(), 1);
    assert_eq!(line, NameTaken { path: "jump.take".into() }.to_string());
    let line = refuses(&[&["cut", "jump.take", "-o", "part.csv"], &range[..]].concat(), 2);
    assert_mentions(&line, &["part.csv", ".take"]);
    refuses(&[&["cut", "jump.csv", "-o", "part.take"], &range[..]].concat(), 1);
    let take = folder.read("jump.take");
    folder.write("short.take", &take[..take.len() - 9]);
    let line = refuses(&[&["cut", "short.take", "-o", "part.take"], &range[..]].concat(), 1);
    assert_mentions(&line, &["short.take", "mocapd recover"]);
    let line = refuses(&["concat", "jump.take", "short.take", "-o", "all.take"], 1);
    assert_mentions(&line, &["short.take", "mocapd recover"]);
}

#[test]
fn takes_that_do_not_fit_together_are_refused() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(2, 60.0, 1.0));
    let text = folder.text("jump.csv");
    folder.write("other.csv", text.replace("head", "crown"));
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    folder.run(&["import", "other.csv", "-o", "other.take"]).with_code(0);
    folder.run(&["import", "jump.csv", "-o", "coarse.take", "--tolerance", "2mm"]).with_code(0);
    let line = folder.refuses(&["concat", "jump.take", "other.take", "-o", "all.take"], 1);
    assert_mentions(&line, &["other.take", "jump.take", "`crown`", "`head`"]);
    let line = folder.refuses(&["concat", "jump.take", "coarse.take", "-o", "all.take"], 1);
    assert_mentions(&line, &["coarse.take", "2 mm", "0.5 mm"]);
    let line = folder.refuses(&["concat", "jump.take", "-o", "all.take"], 2);
    assert_mentions(&line, &["two"]);
}

#[test]
fn differences_are_named_and_decide_the_exit_code() {
    let folder = Folder::new();
    let motion = jump(2, 60.0, 2.0);
    folder.write_motion("jump.csv", &motion);
    for (name, args) in [
        ("jump.take", &[][..]),
        ("same.take", &[]),
        ("coarse.take", &["--tolerance", "2mm"]),
        ("anna.take", &["--subject", "Anna"]),
    ] {
        folder.run(&[&["import", "jump.csv", "-o", name], args].concat()).with_code(0);
    }
    let equal = folder.run(&["diff", "jump.take", "same.take"]).with_code(0);
    assert_eq!(equal.stderr, "");
    assert_mentions(&equal.stdout, &["no difference", "120 frames"]);
    let ran = folder.run(&["diff", "jump.take", "coarse.take"]).with_code(1);
    assert_mentions(&ran.stderr, &["jump.take", "coarse.take"]);
    assert_mentions(
        &ran.stdout,
        &["samples differ", "tolerance_mm: 0.5", "tolerance_mm: 2", "first difference"],
    );
    let ran = folder.run(&["diff", "jump.take", "anna.take"]).with_code(1);
    assert_mentions(&ran.stdout, &["subject", "name: Anna", "no difference"]);
    folder.run(&["diff", "jump.take", "anna.take", "--motion"]).with_code(0);
    // A motion file: of a lossless take no sample differs, of a lossy one some do.
    folder.run(&["import", "jump.csv", "-o", "exact.take", "--lossless"]).with_code(0);
    folder.run(&["diff", "exact.take", "jump.csv"]).with_code(0);
    let ran = folder.run(&["diff", "jump.take", "jump.csv"]).with_code(1);
    assert_mentions(&ran.stdout, &["samples differ"]);
    // One sample more than the other, and another label.
    let mut changed = motion;
    changed.positions_mm[7 * 15 + 3] = [1.0, 2.0, 3.0];
    changed.info.markers[14].label = "big toe".to_owned();
    folder.write_motion("changed.csv", &changed);
    folder.run(&["import", "changed.csv", "-o", "changed.take", "--lossless"]).with_code(0);
    let found = folder.run(&["diff", "exact.take", "changed.take", "--json"]).with_code(1).json();
    assert_eq!(found["motion"]["first"]["frame"], 7);
    assert_eq!(found["motion"]["markers_differing"], serde_json::json!(["big toe"]));
    let n = |name: &str| found["motion"][name].as_u64().unwrap();
    assert_eq!(n("samples_differing") + n("gaps_differing"), 1);
    // Damage: what is left is compared, and the exit code says that something is missing.
    let take = folder.read("same.take");
    folder.write("short.take", &take[..take.len() - 9]);
    let ran = folder.run(&["diff", "jump.take", "short.take"]).with_code(3);
    assert_mentions(&ran.stderr, &["short.take"]);
    let line = folder.refuses(&["diff", "jump.csv", "jump.take"], 2);
    assert_mentions(&line, &["jump.csv", ".take"]);
    let line = folder.refuses(&["diff", "jump.take", "jump.xyz"], 2);
    assert_mentions(&line, &["jump.xyz", ".c3d"]);
}

#[test]
fn a_lossless_take_is_repacked_and_another_needs_its_source() {
    let folder = Folder::new();
    folder.run(&["demo", "--seconds", "2s", "--out", "demo"]).with_code(0);
    let import = ["import", "demo/jump-001.csv", "-o", "exact.take", "--resampler", "lossless"];
    folder.run(&import).with_code(0);
    let ran = folder.run(&["repack", "exact.take", "-o", "smaller.take"]).with_code(0);
    assert_mentions(
        &ran.stdout,
        &["smaller.take", "in place of", "compared with the old take: no sample differs"],
    );
    assert!(folder.read("smaller.take").len() < folder.read("exact.take").len());
    folder.run(&["diff", "exact.take", "smaller.take", "--motion"]).with_code(0);
    // Within a tolerance, and verified against the file.
    let within =
        ["repack", "smaller.take", "-o", "within.take", "--tolerance", "1mm", "--effort", "2"];
    folder.run(&within).with_code(0);
    folder.run(&["verify", "within.take", "--against", "demo/jump-001.csv"]).with_code(0);
    let info = folder.run(&["info", "within.take", "--json"]).with_code(0).json();
    assert_eq!((&info["tolerance_mm"], &info["resampler"]), (&1.0.into(), &"dense".into()));
    // What has been quantised is not quantised again.
    for option in [["--tolerance", "2mm"], ["--keys", "2s"], ["--resampler", "lossless"]] {
        let again = [&["repack", "within.take", "-o", "again.take"][..], &option].concat();
        let refused = folder.run(&again).with_code(1);
        assert_mentions(&refused.stderr, &["within.take", "the source or a lossless take"]);
        assert!(!folder.path("again.take").exists());
    }
    for (options, fact) in [
        (&["--tolerance", "1mm", "--resampler", "lossless"][..], "omit --tolerance"),
        (&["--resampler", "fast"], "give --tolerance"),
        (&["--effort", "5"], "--effort is for lossless takes"),
        (&["--effort", "5", "--resampler", "fast", "--tolerance", "1mm"], "omit it with fast"),
        (&["--resampler", "spline", "--tolerance", "1mm"], "needs the whole take"),
    ] {
        let args = [&["repack", "exact.take", "-o", "again.take"][..], options].concat();
        assert_mentions(&folder.run(&args).with_code(2).stderr, &[fact]);
    }
}

#[test]
fn a_take_that_cannot_be_smaller_is_written_only_on_request() {
    let folder = Folder::new();
    folder.run(&["demo", "--seconds", "2s", "--out", "demo"]).with_code(0);
    folder.run(&["import", "demo/jump-001.csv", "-o", "a.take"]).with_code(0);
    let ran = folder.run(&["repack", "a.take", "-o", "b.take"]).with_code(0);
    assert_mentions(&ran.stdout, &["a.take", "cannot be made smaller", "--copy"]);
    assert!(!folder.path("b.take").exists());
    let copied = folder.run(&["repack", "a.take", "-o", "b.take", "--copy", "--json"]);
    let report = copied.with_code(0).json();
    assert_eq!((&report["written"], &report["repacked"]), (&true.into(), &false.into()));
    assert_eq!(folder.read("a.take"), folder.read("b.take"));
    // Standard output and folders have every take.
    let piped = folder.command(&["repack", "a.take", "-o", "-"]).output().unwrap();
    assert_eq!((piped.status.code(), piped.stdout), (Some(0), folder.read("a.take")));
    std::fs::create_dir(folder.path("takes")).unwrap();
    for name in ["takes/a.take", "takes/b.take"] {
        std::fs::copy(folder.path("a.take"), folder.path(name)).unwrap();
    }
    let ran = folder.run(&["repack", "takes", "-o", "out"]).with_code(0);
    assert_mentions(&ran.stdout, &["copied to out/a.take", "copied to out/b.take"]);
    for name in ["out/a.take", "out/b.take"] {
        assert_eq!(folder.read(name), folder.read("a.take"), "{name}");
    }
    // Nothing is overwritten, and damaged takes are refused.
    folder.run(&["repack", "a.take", "-o", "b.take", "--copy"]).with_code(1);
    let bytes = folder.read("a.take");
    folder.write("short.take", &bytes[..bytes.len() - 9]);
    let refused = folder.run(&["repack", "short.take", "-o", "c.take"]).with_code(1);
    assert_mentions(&refused.stderr, &["short.take", "mocapd recover"]);
}

#[test]
fn joined_parts_return_to_the_bytes_of_the_whole_and_folders_are_repacked() {
    let folder = Folder::new();
    folder.run(&["demo", "--seconds", "3s", "--out", "demo"]).with_code(0);
    let import = ["import", "demo/jump-001.csv", "-o", "whole.take", "--tolerance", "1mm"];
    folder.run(&import).with_code(0);
    for (name, range) in [("a.take", "..100"), ("b.take", "100..")] {
        folder.run(&["cut", "whole.take", "-o", name, "--frames", range]).with_code(0);
    }
    std::fs::create_dir(folder.path("joined")).unwrap();
    folder.run(&["concat", "a.take", "b.take", "-o", "joined/one.take"]).with_code(0);
    let ran = folder.run(&["repack", "joined", "-o", "out"]).with_code(0);
    assert_mentions(&ran.stdout, &["out/one.take", "1 in place of 3 stretches"]);
    folder.run(&["diff", "joined/one.take", "out/one.take"]).with_code(0);
    let (whole, joined) = (folder.read("whole.take").len(), folder.read("joined/one.take").len());
    let repacked = folder.read("out/one.take").len();
    assert!(repacked < whole + 200 && repacked * 2 < joined, "{repacked} {whole} {joined}");
}

#[test]
fn keys_that_are_far_apart_are_a_version_of_their_own() {
    let folder = Folder::new();
    let motion = jump(3, 60.0, 25.0);
    folder.write_motion("jump.csv", &motion);
    let import = |name: &str, keys: &str| {
        folder.run(&["import", "jump.csv", "-o", name, "--keys", keys]).with_code(0);
        folder.read(name).len()
    };
    let (ten, none) = (import("ten.take", "10s"), import("none.take", "none"));
    assert!(none < ten, "{none} and {ten} bytes");
    let info = folder.run(&["info", "none.take"]).with_code(0).stdout;
    assert_mentions(&info, &["the first stretch only", "format version 7"]);
    for take in ["ten.take", "none.take"] {
        folder.run(&["verify", take, "--against", "jump.csv"]).with_code(0);
    }
    let export = ["export", "none.take", "-o", "part.csv", "--from", "20s", "--to", "21s"];
    folder.run(&export).with_code(0);
}
