//! Invalid input files: the error says what is wrong and where, and nothing is written.

use mocapd_acquire::files::FileError;
use mocapd_take::{NotATake, TakeError};

use super::{Folder, unprivileged};
use crate::support::{assert_mentions, jump};

#[test]
fn missing_files_and_folders_are_refused() {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("folder.csv")).unwrap();
    std::fs::create_dir(folder.path("folder.take")).unwrap();
    let csv = |name| ["import", name, "-o", "new.take"];
    let absent = |name: &str| FileError::NotFound(name.into()).to_string();
    assert_eq!(folder.refuses(&csv("none.csv"), 1), absent("none.csv"));
    assert_mentions(&folder.refuses(&csv("folder.csv"), 2), &["folder.csv", ".c3d", "--recursive"]);
    for args in [&["info"][..], &["info", "--json"], &["verify"], &["export", "-o", "new.csv"]] {
        let refuses = |name, code| folder.refuses(&[args, &[name][..]].concat(), code);
        assert_eq!(refuses("none.take", 1), absent("none.take"));
        assert_mentions(&refuses("folder.take", 2), &["folder.take"]);
    }
    folder.write_motion("jump.csv", &jump(1, 60.0, 0.5));
    folder.run(&csv("jump.csv")).with_code(0);
    let against = |file| ["verify", "new.take", "--against", file];
    assert_eq!(folder.refuses(&against("none.csv"), 1), absent("none.csv"));
    assert_eq!(folder.refuses(&against("none.take"), 1), absent("none.take"));
    assert_mentions(&folder.refuses(&against("folder.csv"), 1), &["folder.csv/new", ".c3d"]);
}

#[test]
fn files_without_permission_are_refused() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(1, 60.0, 0.5));
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    let Some(user) = unprivileged::command_in(&folder) else { return };
    for file in ["jump.csv", "jump.take"] {
        unprivileged::forbid(&folder.path(file));
    }
    let line = folder.refused(user(&["info", "jump.take"]), 1);
    assert_eq!(line, FileError::NotReadable("jump.take".into()).to_string());
    let line = folder.refused(user(&["import", "jump.csv", "-o", "new.take"]), 1);
    assert_eq!(line, FileError::NotReadable("jump.csv".into()).to_string());
}

#[test]
fn other_files_than_takes_are_refused() {
    let folder = Folder::new();
    folder.write("empty.take", "");
    folder.write("short.take", b"\x89TAK");
    folder.write("text.take", "time,head_x,head_y,head_z\n0,1,2,3\n");
    folder.write("sent_as_text.take", b"\x89TAK\n\x1a\n and more");
    folder.write("magic_only.take", b"\x89TAK\r\n\x1a\n");
    for (file, why) in [
        ("empty.take", NotATake::Short),
        ("short.take", NotATake::Short),
        ("text.take", NotATake::OtherMagic),
        ("sent_as_text.take", NotATake::SentAsText),
        ("magic_only.take", NotATake::HeaderCut),
    ] {
        let why = TakeError::NotATake(why).to_string();
        for args in [&["info", file][..], &["verify", file], &["export", file, "-o", "new.csv"]] {
            assert_mentions(&folder.refuses(args, 1), &[file, &why]);
        }
    }
}

#[test]
fn files_of_another_format_are_refused() {
    let folder = Folder::new();
    let motion = jump(1, 60.0, 1.0);
    folder.write_motion("jump.c3d", &motion);
    let c3d = folder.read("jump.c3d");
    folder.write("header_only.c3d", &c3d[..512]);
    folder.write("half_a_header.c3d", &c3d[..100]);
    for ending in ["c3d", "trc", "tsv", "csv"] {
        folder.write(&format!("empty.{ending}"), "");
        folder.write(&format!("noise.{ending}"), [0xA5; 3000]);
    }
    for (file, facts) in [
        ("empty.c3d", &["c3d byte 0"][..]),
        ("empty.trc", &["trc line"]),
        ("empty.tsv", &["tsv line"]),
        ("empty.csv", &["csv line 1"]),
        ("noise.c3d", &["c3d byte 1", "a5"]),
        ("noise.trc", &["trc line"]),
        ("noise.tsv", &["tsv line"]),
        ("noise.csv", &["csv line 1"]),
        ("header_only.c3d", &["c3d byte 16", "block"]),
        ("half_a_header.c3d", &["c3d byte 0", "512", "100"]),
    ] {
        let line = folder.refuses(&["import", file, "-o", "new.take"], 1);
        assert_mentions(&line, &[&[file], facts].concat());
    }
}

#[test]
fn empty_motions_are_refused() {
    let folder = Folder::new();
    folder.write("no_markers.csv", "time_s\n0\n0.01\n");
    folder.write("no_frames.csv", "# rate=60\ntime_s,head.x,head.y,head.z\n");
    let trc = "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tNumFrames\tNumMarkers\tUnits\n60\t0\t1\tmm\n\
               Frame#\tTime\thead\n\t\tX1\tY1\tZ1\n";
    folder.write("no_frames.trc", trc);
    for (file, what) in
        [("no_markers.csv", "markers"), ("no_frames.csv", "frames"), ("no_frames.trc", "frames")]
    {
        assert_mentions(&folder.refuses(&["import", file, "-o", "new.take"], 1), &[file, what]);
    }
}

#[test]
fn invalid_rates() {
    let folder = Folder::new();
    let rows = "head_x,head_y,head_z\n1,2,3\n4,5,6\n";
    for rate in ["0", "nan", "-60", "fast"] {
        folder.write("a.csv", format!("# rate={rate}\n{rows}"));
        let line = folder.refuses(&["import", "a.csv", "-o", "new.take"], 1);
        assert_mentions(&line, &["a.csv", "csv line 2", "# rate=120"]);
    }
    for rate in ["1e9", "1e300", "1e-9"] {
        folder.write("a.csv", format!("# rate={rate}\n{rows}"));
        let line = folder.refuses(&["import", "a.csv", "-o", "new.take"], 1);
        assert_mentions(&line, &["a.csv", &format!("{rate} Hz"), "0.001", "1000000"]);
    }
    folder.write(
        "a.trc",
        "DataRate\tUnits\n0\tmm\nFrame#\tTime\thead\n\t\tX1\tY1\tZ1\n1\t0\t1\t2\t3\n",
    );
    let line = folder.refuses(&["import", "a.trc", "-o", "new.take"], 1);
    assert_mentions(&line, &["a.trc", "trc line 3", "DataRate"]);
}

#[test]
fn coordinates_that_are_not_numbers_become_gaps_and_are_reported() {
    let folder = Folder::new();
    let rows = [["1", "2", "3"], ["nan", "2", "3"], ["1", "inf", "3"], ["1", "2", "-1e60"]];
    let csv: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
    folder.write("a.csv", format!("# rate=60\nhead_x,head_y,head_z\n{}\n", csv.join("\n")));
    let numbered = rows.iter().enumerate();
    let trc: Vec<String> = numbered.map(|(i, row)| format!("{i}\t0\t{}", row.join("\t"))).collect();
    folder.write(
        "a.trc",
        format!(
            "DataRate\tNumFrames\tNumMarkers\tUnits\n60\t4\t1\tmm\nFrame#\tTime\thead\n\t\tX1\tY1\tZ1\n{}\n",
            trc.join("\n")
        ),
    );
    for file in ["a.csv", "a.trc"] {
        let take = format!("{file}.take");
        let ran = folder.run(&["import", file, "-o", &take, "--json"]).with_code(0);
        assert_eq!(ran.json()["samples"], 1, "{file}");
        assert_eq!(ran.json()["samples_missing"], 3, "{file}");
        assert_mentions(&ran.stderr, &[file, "3"]);
        let info = folder.run(&["info", &take, "--json"]).with_code(0).json();
        assert_eq!(info["channels"][0]["samples"], 1, "{file}");
        assert_eq!(info["channels"][0]["gaps"], 1, "{file}");
    }
}

#[test]
fn a_file_of_gaps_is_imported_with_a_warning() {
    let folder = Folder::new();
    folder.write("gaps.csv", "# rate=60\nhead_x,head_y,head_z\n,,\n,,\n");
    let ran = folder.run(&["import", "gaps.csv", "-o", "gaps.take"]).with_code(0);
    assert_eq!(ran.stderr.lines().count(), 1, "{}", ran.stderr);
    assert_mentions(&ran.stderr, &["gaps.csv"]);
    let info = folder.run(&["info", "gaps.take", "--json"]).with_code(0).json();
    assert_eq!((&info["samples"], &info["channels"][0]["gaps"]), (&0.into(), &1.into()));
    let printed = folder.run(&["info", "gaps.take"]).with_code(0).stdout;
    assert_mentions(&printed, &["0 of 2", "1 gap"]);
}

#[test]
fn a_truncated_c3d_is_imported_to_its_end() {
    let folder = Folder::new();
    let motion = jump(1, 60.0, 2.0);
    folder.write_motion("whole.c3d", &motion);
    let bytes = folder.read("whole.c3d");
    // Rows are 15 markers of four floats; one of them is left incomplete.
    let cut = bytes.len() - 512 - 40 * 15 * 16 - 8;
    folder.write("cut.c3d", &bytes[..cut]);
    let ran = folder.run(&["import", "cut.c3d", "-o", "cut.take", "--json"]).with_code(3);
    let report = ran.json();
    let (frames, missing) = (&report["frames"], &report["frames_missing"]);
    assert_eq!(frames.as_u64().unwrap() + missing.as_u64().unwrap(), 120);
    assert!(missing.as_u64().unwrap() > 40, "{missing}");
    assert_eq!(ran.stderr.lines().count(), 1, "{}", ran.stderr);
    let counts = ["120", &frames.to_string()];
    assert_mentions(&ran.stderr, &["cut.c3d", counts[0], counts[1]]);
    // The take is intact, and has the warning.
    let info = folder.run(&["info", "cut.take", "--json"]).with_code(0).json();
    let warning = info["source"]["warnings"][0].as_str().unwrap();
    assert_mentions(warning, &counts);
    assert_mentions(&folder.run(&["info", "cut.take"]).with_code(0).stdout, &[warning]);
}
