//! `plot`: pictures of good takes and of odd ones.

use mocapd_simulator::generator::JumpSpec;
use mocapd_take::motion::{GAP, Marker, Motion, MotionInfo};

use super::Folder;

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &JumpSpec::new(1, 60.0).generate().unwrap().motion);
    folder.run(&["import", "jump.csv", "-o", "jump.take", "--tolerance", "5mm"]).with_code(0);
    folder
}

/// A take of a motion that is made here.
fn take_of(
    folder: &Folder,
    name: &str,
    n_frames: usize,
    n_markers: usize,
    at: impl Fn(usize, usize) -> [f32; 3],
) {
    let markers = (0..n_markers).map(|i| Marker { label: format!("m<{i}>&"), labelled: true });
    let info = MotionInfo {
        rate_hz: 100.0,
        n_frames: n_frames as u64,
        markers: markers.collect(),
        ..Default::default()
    };
    let rows = (0..n_frames).flat_map(|row| (0..n_markers).map(move |marker| (row, marker)));
    let positions_mm = rows.map(|(row, marker)| at(row, marker)).collect();
    // The times of a CSV tell its rate where there are two of them.
    let file = if n_frames > 1 { "made.csv" } else { "made.trc" };
    folder.write_motion(file, &Motion { info, positions_mm });
    folder.run(&["import", file, "-o", name]).with_code(0);
}

/// Draws it, and gives the SVG: well formed, with numbers only.
fn drawn(folder: &Folder, args: &[&str]) -> String {
    let args = [&["plot"], args, &["-o", "new.svg"]].concat();
    let ran = folder.run(&args).with_code(0);
    assert_eq!((ran.stdout.as_str(), ran.stderr.as_str()), ("", ""), "{args:?}");
    let svg = folder.text("new.svg");
    std::fs::remove_file(folder.path("new.svg")).unwrap();
    let document = roxmltree::Document::parse(&svg).unwrap_or_else(|e| panic!("{args:?}: {e}"));
    assert_eq!(document.root_element().tag_name().name(), "svg");
    assert!(!svg.contains("NaN") && !svg.contains("inf\"") && svg.len() < 8 << 20, "{args:?}");
    svg
}

#[test]
fn every_picture_in_both_formats() {
    let folder = folder();
    for args in [
        &[
            "trajectory",
            "jump.take",
            "--against",
            "jump.csv",
            "--marker",
            "r_wrist",
            "--from",
            "1s",
            "--to",
            "5s",
        ][..],
        &["trajectory", "jump.take"],
        &["pose", "jump.take", "--against", "jump.csv"],
        &["pose", "jump.take", "--at", "0.5s,4s"],
        &["quality", "jump.take", "--against", "jump.csv"],
        &["sizes", "jump.csv", "jump.take", "--tolerances", "1mm,10mm"],
    ] {
        let svg = drawn(&folder, args);
        assert!(svg.matches("<text").count() > 4, "{args:?}");
        let png = [&["plot"], args, &["-o", "new.png"]].concat();
        folder.run(&png).with_code(0);
        assert!(folder.read("new.png").starts_with(b"\x89PNG\r\n"), "{args:?}");
        std::fs::remove_file(folder.path("new.png")).unwrap();
    }
}

#[test]
fn a_trajectory_has_its_samples_and_its_tolerance() {
    let folder = folder();
    let args =
        ["trajectory", "jump.take", "--marker", "r_wrist", "--against", "jump.csv", "--to", "2s"];
    let svg = drawn(&folder, &args);
    // Each of 120 samples in space and against three axes, and one in the legend.
    let circles = |start: &str| {
        svg.match_indices("<circle")
            .filter(|(at, _)| svg[*at..].split("/>").next().unwrap().contains(start))
            .count()
    };
    assert_eq!(circles("fill=\"none\""), 4 * 120 + 1);
    let kept = circles("fill=\"#D55E00\"");
    assert!(kept > 4 * 3 && kept % 4 == 1, "{kept}");
    for words in
        ["time (s)", "x (mm)", "z (mm)", "error (mm)", "tolerance 5 mm", "r_wrist of jump.take"]
    {
        assert!(svg.contains(words), "{words}");
    }
    assert!(
        !drawn(&folder, &args[..4]).contains("error (mm)"),
        "without an original there is no error"
    );
}

#[test]
fn odd_takes_give_pictures_or_reasons() {
    let folder = Folder::new();
    take_of(&folder, "one.take", 1, 1, |_, _| [1.0, 2.0, 3.0]);
    take_of(&folder, "still.take", 50, 3, |_, _| [0.0; 3]);
    take_of(&folder, "gaps.take", 50, 2, |_, _| GAP);
    take_of(&folder, "half.take", 300, 2, |row, marker| {
        if marker == 0 || row % 7 == 0 { GAP } else { [row as f32, 0.0, -1e5] }
    });
    for take in ["one.take", "still.take", "half.take"] {
        for picture in ["pose", "quality"] {
            drawn(&folder, &[picture, take]);
        }
        drawn(&folder, &["sizes", take, "--tolerances", "1mm"]);
        drawn(&folder, &["trajectory", take]);
    }
    let refuses = |args: &[&str], code: i32| {
        folder.refuses(&[&["plot"], args, &["-o", "new.svg"]].concat(), code)
    };
    drawn(&folder, &["quality", "gaps.take"]);
    assert!(refuses(&["trajectory", "gaps.take"], 1).contains("nothing to draw"));
    assert!(refuses(&["pose", "gaps.take"], 1).contains("no marker was seen"));
    assert!(
        refuses(&["trajectory", "half.take", "--marker", "m<9>&"], 2).contains("did you mean 'm<")
    );
    assert!(refuses(&["trajectory", "half.take", "--from", "9s"], 2).contains("3.000 s"));
    assert!(refuses(&["pose", "half.take", "--at", "1h"], 2).contains("earlier moment"));
    let thirteen = vec!["1s"; 13].join(",");
    assert!(refuses(&["pose", "half.take", "--at", &thirteen], 1).contains("1 to 12"));
    assert!(refuses(&["sizes", "a", "b", "c", "d", "e", "f", "g"], 2).contains("six"));
    assert!(refuses(&["quality", "none.take"], 1).contains("does not exist"));
    assert!(
        folder.refuses(&["plot", "quality", "one.take", "-o", "q.gif"], 2).contains(".svg or .png")
    );
    folder.write("there.svg", "mine");
    assert!(
        folder
            .refuses(&["plot", "quality", "one.take", "-o", "there.svg"], 1)
            .contains("not overwritten")
    );
}

#[test]
fn ten_thousand_markers_are_a_picture_too() {
    let folder = Folder::new();
    take_of(&folder, "many.take", 4, 10_000, |row, marker| {
        [marker as f32, row as f32, (marker % 97) as f32]
    });
    for picture in ["pose", "quality", "trajectory"] {
        drawn(&folder, &[picture, "many.take"]);
    }
    assert!(drawn(&folder, &["pose", "many.take"]).contains("the first 500 of 10000 markers"));
    assert!(drawn(&folder, &["quality", "many.take"]).contains("the 60 with most gaps"));
}

#[test]
fn a_skeleton_file_says_which_markers_are_joined() {
    let folder = Folder::new();
    take_of(&folder, "m.take", 10, 3, |row, marker| [marker as f32 * 100.0, row as f32, 50.0]);
    let lines = |args: &[&str]| drawn(&folder, args).matches("<polyline").count();
    let none = lines(&["pose", "m.take", "--at", "0s"]);
    folder.write("bones.csv", "m<0>&,m<1>&\nm<1>&,m<2>&\n");
    assert_eq!(lines(&["pose", "m.take", "--at", "0s", "--skeleton", "bones.csv"]), none + 2);
    folder.write("bones.csv", "m<0>&,toe\n");
    let args = ["plot", "pose", "m.take", "-o", "new.svg", "--skeleton", "bones.csv"];
    assert!(folder.refuses(&args, 2).contains("no marker is called 'toe'"));
}
