//! `export`: ranges of time, formats, events, and incompatible options.

use mocapd_take::{interchange::Format, motion::MotionEvent, record::EventKind};

use super::Folder;
use crate::support::{assert_mentions, jump};

fn folder() -> (Folder, Vec<String>) {
    let folder = Folder::new();
    folder.write_motion("jump.trc", &jump(1, 100.0, 1.0));
    folder.run(&["import", "jump.trc", "-o", "jump.take", "--lossless"]).with_code(0);
    folder.run(&["export", "jump.take", "-o", "whole.csv"]);
    let rows = folder.text("whole.csv").lines().skip(1).map(str::to_owned).collect();
    (folder, rows)
}

/// A row without its time, which begins at 0 in each export.
fn untimed(row: &str) -> (&str, &str) {
    let mut cells = row.splitn(3, ',');
    let frame = cells.next().unwrap();
    cells.next().unwrap();
    (frame, cells.next().unwrap())
}

#[test]
fn a_part_has_the_frames_between_two_times() {
    let (folder, whole) = folder();
    assert_eq!(whole.len(), 100);
    for (times, range) in [
        (&["--from", "70ms", "--to", "0.13s"][..], 7..13),
        (&["--from", "0"], 0..100),
        (&["--to", "70ms"], 0..7),
        (&["--from", "0.985s"], 99..100),
        (&["--from", "0.5", "--to", "1h"], 50..100),
    ] {
        folder.run(&[&["export", "jump.take", "-o", "part.csv"], times].concat()).with_code(0);
        let text = folder.text("part.csv");
        let part: Vec<_> = text.lines().skip(1).map(untimed).collect();
        let expected: Vec<_> = whole[range].iter().map(|row| untimed(row)).collect();
        assert_eq!(part, expected, "{times:?}");
        std::fs::remove_file(folder.path("part.csv")).unwrap();
    }
}

#[test]
fn an_empty_part_is_refused() {
    let (folder, _) = folder();
    for times in [
        &["--from", "1s"][..],
        &["--from", "2min"],
        &["--from", "0.5", "--to", "0.5"],
        &["--from", "0.6", "--to", "0.5"],
        &["--to", "0"],
    ] {
        let line = folder.refuses(&[&["export", "jump.take", "-o", "a.csv"], times].concat(), 2);
        assert_mentions(&line, &["jump.take", "1.000 s", "--from", "--to"]);
    }
}

/// An excerpt contains the foreign data as well.
#[test]
fn a_part_contains_foreign_data() {
    let folder = Folder::new();
    folder.write_motion("jump.trc", &jump(1, 100.0, 1.0));
    let trc = folder.text("jump.trc").replacen("mocapd.trc", "session 7.trc", 1);
    folder.write("mine.trc", trc);
    folder.run(&["import", "mine.trc", "-o", "mine.take"]).with_code(0);
    let part = ["export", "mine.take", "-o", "part.trc", "--from", "0.25s", "--to", "0.5s"];
    assert_eq!(folder.run(&part).with_code(0).stderr, "");
    let text = folder.text("part.trc");
    assert!(text.starts_with("PathFileType\t4\t(X/Y/Z)\tsession 7.trc\n"), "{text}");
    folder.run(&["import", "part.trc", "-o", "part.take"]).with_code(0);
    let info = folder.run(&["info", "part.take", "--json"]).with_code(0).json();
    assert_eq!((&info["frames"], &info["source"]["first_frame"]), (&25.into(), &26.into()));
}

/// A build without the feature says how to get it, and leaves no file.
#[test]
fn parquet_and_mcap_are_built_in_or_the_error_says_how_to_get_them() {
    let (folder, _) = folder();
    for (output, more) in [("a.parquet", &[][..]), ("wide.parquet", &["--wide"]), ("a.mcap", &[])] {
        let export = [&["export", "jump.take", "-o", output], more].concat();
        if Format::Parquet.check_built().is_ok() {
            folder.run(&export).with_code(0);
            assert!(folder.path(output).metadata().unwrap().len() > 1000);
        } else {
            let line = folder.refuses(&export, 1);
            assert_mentions(&line, &["cargo build --release --features full"]);
            assert!(!folder.path(output).exists());
        }
    }
    for output in ["a.csv", "b.mcap"] {
        let line = folder.refuses(&["export", "jump.take", "-o", output, "--wide"], 2);
        assert_mentions(&line, &["--wide", ".parquet"]);
    }
    folder.write("t.parquet", "PAR1");
    let line = folder.refuses(&["import", "t.parquet", "-o", "t.take"], 2);
    assert_mentions(&line, &["t.parquet", ".c3d", ".trc", ".tsv", ".csv"]);
}

/// Events stay with their frames: from a file to the take, to another file, and those of an excerpt to the excerpt.
#[test]
fn events_stay_with_their_frames() {
    let folder = Folder::new();
    let mut motion = jump(1, 100.0, 1.0);
    let event = |frame: u64, kind: EventKind, text: &str| MotionEvent {
        frame,
        kind,
        text: text.to_owned(),
    };
    motion.info.events =
        vec![event(10, EventKind::Mark, "ready"), event(60, EventKind::Trigger, "input 1")];
    folder.write_motion("jump.c3d", &motion);
    folder.run(&["import", "jump.c3d", "-o", "jump.take"]).with_code(0);
    let events_of = |take: &str| {
        let info = folder.run(&["info", take, "--json"]).with_code(0).json();
        let events = info["events"].as_array().unwrap().clone();
        let fields =
            |e: &serde_json::Value| (e["kind"].clone(), e["frame"].clone(), e["text"].clone());
        events.iter().map(fields).collect::<Vec<_>>()
    };
    let trigger = |frame: u64| ("trigger".into(), frame.into(), "input 1".into());
    assert_eq!(events_of("jump.take"), [("mark".into(), 10.into(), "ready".into()), trigger(60)]);
    let part = ["export", "jump.take", "-o", "part.c3d", "--from", "0.5s"];
    assert_eq!(folder.run(&part).with_code(0).stderr, "");
    folder.run(&["import", "part.c3d", "-o", "part.take"]).with_code(0);
    assert_eq!(events_of("part.take"), [trigger(10)]);
    let line = folder.run(&["export", "jump.take", "-o", "jump.csv"]).with_code(0).stderr;
    assert_mentions(&line, &["jump.csv", "2 events"]);
}

/// Formats chosen by name, and a folder that is created atomically.
#[test]
fn formats_by_name() {
    let (folder, _) = folder();
    folder.run(&["export", "jump.take", "-o", "data", "--format", "npz"]).with_code(0);
    assert!(folder.read("data").starts_with(b"PK\x03\x04"));
    folder.run(&["export", "jump.take", "-o", "jump.xdf"]).with_code(0);
    assert!(folder.read("jump.xdf").starts_with(b"XDF:"));
    folder.run(&["export", "jump.take", "-o", "long.csv", "--layout", "long"]).with_code(0);
    assert!(folder.text("long.csv").starts_with("frame,time_s,label,x_mm,y_mm,z_mm\n1,0,"));
    let bids = ["export", "jump.take", "-o", "set", "--format", "bids", "--subject", "7"];
    folder.run(&bids).with_code(0);
    let motion = folder.text("set/sub-7/motion/sub-7_task-jump_tracksys-optical_motion.tsv");
    assert_eq!(motion.lines().count(), 100);
    assert_mentions(&folder.refuses(&bids, 1), &["set/sub-7/motion", "--run", "--session"]);
    let names: Vec<_> = folder.content().into_keys().collect();
    assert!(names.iter().all(|name| !name.to_string_lossy().contains(".part")), "{names:?}");
}

#[test]
fn incompatible_options_are_refused() {
    let (folder, _) = folder();
    for (args, facts) in [
        (&["-o", "a.c3d", "--layout", "long"][..], ["--layout long", "csv"]),
        (&["-o", "a.c3d", "--subject", "1"], ["--subject", "--format bids"]),
        (&["-o", "a", "--format", "bids", "--task", "a b"], ["a b", "BIDS"]),
        (&["-o", "a"], [".c3d", "--format"]),
        (&["-o", "a.c3d", "--format", "hdf5"], ["hdf5", "--format"]),
    ] {
        assert_mentions(&folder.refuses(&[&["export", "jump.take"], args].concat(), 2), &facts);
    }
}
