//! Files that are not what they should be: what is wrong, where, and nothing written.

use super::{Folder, unprivileged};
use crate::support::jump;

#[test]
fn what_is_not_there_or_is_a_folder() {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("folder.csv")).unwrap();
    std::fs::create_dir(folder.path("folder.take")).unwrap();
    let csv = |name| ["import", name, "-o", "new.take"];
    assert_eq!(folder.refuses(&csv("none.csv"), 1), "none.csv does not exist");
    assert_eq!(folder.refuses(&csv("folder.csv"), 1), "folder.csv is a folder, not a file");
    for (file, line) in [
        ("none.take", "none.take does not exist"),
        ("folder.take", "folder.take is a folder, not a file"),
    ] {
        assert_eq!(folder.refuses(&["info", file], 1), line);
        assert_eq!(folder.refuses(&["info", file, "--json"], 1), line);
        assert_eq!(folder.refuses(&["verify", file], 1), line);
        assert_eq!(folder.refuses(&["export", file, "-o", "new.csv"], 1), line);
    }
    folder.write_motion("jump.csv", &jump(1, 60.0, 0.5));
    folder.run(&csv("jump.csv")).with_code(0);
    let against = |file| ["verify", "new.take", "--against", file];
    assert_eq!(folder.refuses(&against("none.csv"), 1), "none.csv does not exist");
    assert_eq!(folder.refuses(&against("none.take"), 1), "none.take does not exist");
    assert_eq!(folder.refuses(&against("folder.csv"), 1), "folder.csv is a folder, not a file");
    assert_eq!(folder.refuses(&against("folder.take"), 1), "folder.take is a folder, not a file");
}

#[test]
fn what_may_not_be_read() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(1, 60.0, 0.5));
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    let Some(user) = unprivileged::command_in(&folder) else { return };
    for file in ["jump.csv", "jump.take"] {
        unprivileged::forbid(&folder.path(file));
    }
    let line = folder.refused(user(&["info", "jump.take"]), 1);
    assert!(line.contains("no permission to read jump.take"), "{line}");
    let line = folder.refused(user(&["import", "jump.csv", "-o", "new.take"]), 1);
    assert!(line.contains("no permission to read jump.csv"), "{line}");
}

#[test]
fn what_is_no_take() {
    let folder = Folder::new();
    folder.write("empty.take", "");
    folder.write("short.take", b"\x89TAK");
    folder.write("text.take", "time,head_x,head_y,head_z\n0,1,2,3\n");
    folder.write("sent_as_text.take", b"\x89TAK\n\x1a\n and more");
    folder.write("magic_only.take", b"\x89TAK\r\n\x1a\n");
    for (file, words) in [
        ("empty.take", "shorter than a take's eight bytes"),
        ("short.take", "shorter than a take's eight bytes"),
        ("text.take", "does not begin with a take's eight bytes"),
        ("sent_as_text.take", "copy it again in binary mode"),
        ("magic_only.take", "the file ends inside its header"),
    ] {
        for args in [&["info", file][..], &["verify", file], &["export", file, "-o", "new.csv"]] {
            let line = folder.refuses(args, 1);
            assert!(line.starts_with(&format!("cannot read {file}: not a take: ")), "{line}");
            assert!(line.contains(words), "{line}");
        }
    }
}

#[test]
fn what_is_not_its_format() {
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
    for (file, place) in [
        ("empty.c3d", "c3d byte 0"),
        ("empty.trc", "trc line"),
        ("empty.tsv", "tsv line"),
        ("empty.csv", "csv line 1"),
        ("noise.c3d", "c3d byte"),
        ("noise.trc", "trc line"),
        ("noise.tsv", "tsv line"),
        ("noise.csv", "csv line 1"),
        ("header_only.c3d", "cut off before its data"),
        ("half_a_header.c3d", "c3d byte"),
    ] {
        let line = folder.refuses(&["import", file, "-o", "new.take"], 1);
        assert!(line.starts_with(&format!("cannot read {file}: ")), "{line}");
        assert!(line.contains(place), "{line}");
    }
}

#[test]
fn what_is_empty() {
    let folder = Folder::new();
    folder.write("no_markers.csv", "time_s\n0\n0.01\n");
    folder.write("no_frames.csv", "# rate=60\ntime_s,head.x,head.y,head.z\n");
    let trc = "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tNumFrames\tNumMarkers\tUnits\n60\t0\t1\tmm\n\
               Frame#\tTime\thead\n\t\tX1\tY1\tZ1\n";
    folder.write("no_frames.trc", trc);
    for (file, what) in
        [("no_markers.csv", "markers"), ("no_frames.csv", "frames"), ("no_frames.trc", "frames")]
    {
        let line = folder.refuses(&["import", file, "-o", "new.take"], 1);
        let expected = format!("{file} holds no {what}: there is nothing to make a take of");
        assert_eq!(line, expected);
    }
}

#[test]
fn rates_that_are_none() {
    let folder = Folder::new();
    let rows = "head_x,head_y,head_z\n1,2,3\n4,5,6\n";
    for rate in ["0", "nan", "-60", "fast"] {
        folder.write("a.csv", format!("# rate={rate}\n{rows}"));
        let line = folder.refuses(&["import", "a.csv", "-o", "new.take"], 1);
        assert!(line.contains("the rate is not known: add a line `# rate=120`"), "{line}");
    }
    for rate in ["1e9", "1e300", "1e-9"] {
        folder.write("a.csv", format!("# rate={rate}\n{rows}"));
        let line = folder.refuses(&["import", "a.csv", "-o", "new.take"], 1);
        assert!(
            line.contains(&format!("a rate of {rate} Hz, expected 0.001 to 1000000")),
            "{line}"
        );
    }
    folder.write(
        "a.trc",
        "DataRate\tUnits\n0\tmm\nFrame#\tTime\thead\n\t\tX1\tY1\tZ1\n1\t0\t1\t2\t3\n",
    );
    let line = folder.refuses(&["import", "a.trc", "-o", "new.take"], 1);
    assert!(line.contains("trc line 3: expected the rate under `DataRate`"), "{line}");
}

#[test]
fn coordinates_that_are_no_numbers_become_gaps_and_are_told() {
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
        assert!(ran.stderr.contains("3 samples are not finite"), "{file}: {}", ran.stderr);
        let info = folder.run(&["info", &take, "--json"]).with_code(0).json();
        assert_eq!(info["channels"][0]["samples"], 1, "{file}");
        assert_eq!(info["channels"][0]["gaps"], 1, "{file}");
    }
}

#[test]
fn a_file_of_gaps_is_a_take_that_says_so() {
    let folder = Folder::new();
    folder.write("gaps.csv", "# rate=60\nhead_x,head_y,head_z\n,,\n,,\n");
    let ran = folder.run(&["import", "gaps.csv", "-o", "gaps.take"]).with_code(0);
    assert_eq!(ran.stderr, "mocapd: gaps.csv: every sample is missing: the take holds gaps only\n");
    let info = folder.run(&["info", "gaps.take"]).with_code(0).stdout;
    assert!(info.contains("0 of 2 present, 1 gap\n"), "{info}");
}

#[test]
fn a_cut_c3d_is_imported_as_far_as_it_goes() {
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
    let expected = format!("mocapd: cut.c3d: 120 frames announced, {frames} present.\n");
    assert_eq!(ran.stderr, expected);
    // The take itself is whole, and remembers.
    let info = folder.run(&["info", "cut.take"]).with_code(0).stdout;
    assert!(info.contains(&format!("note       120 frames announced, {frames} present")), "{info}");
}
