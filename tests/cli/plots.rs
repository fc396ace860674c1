//! `plot`: plots of normal and unusual takes.

use std::sync::Arc;

use mocapd_acquire::files::{FileError, NameTaken};
use mocapd_simulator::{
    device::{Device, DeviceSettings},
    generator::JumpSpec,
};
use mocapd_take::motion::{GAP, Marker, Motion, MotionInfo};
use mocapd_testkit::font::font_with;

use super::{
    Folder, Ran,
    faults::played::{bodies, record_from},
};
use crate::support::{assert_mentions, jump, mentions};

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &JumpSpec::new(1, 60.0).generate().unwrap().motion);
    folder.run(&["import", "jump.csv", "-o", "jump.take", "--tolerance", "5mm"]).with_code(0);
    folder
}

/// Writes a take of a synthetic motion.
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
    // A CSV file needs two times to state its rate.
    let file = if n_frames > 1 { "made.csv" } else { "made.trc" };
    folder.write_motion(file, &Motion { info, positions_mm });
    folder.run(&["import", file, "-o", name]).with_code(0);
}

/// Draws a plot and returns the SVG: well-formed, and with finite numbers only.
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

/// The texts in a picture.
fn texts(svg: &str) -> Vec<String> {
    let document = roxmltree::Document::parse(svg).unwrap();
    let texts =
        document.descendants().filter(roxmltree::Node::is_text).filter_map(|node| node.text());
    texts.map(|text| text.trim().to_owned()).filter(|text| !text.is_empty()).collect()
}

#[test]
fn every_plot_in_both_formats() {
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

/// Labels in the private use of Unicode, where no font has a character: one that a test installs, and one that it does not.
const PRIVATE: [char; 2] = ['\u{10fffc}', '\u{10fffd}'];

#[test]
fn a_png_is_drawn_with_installed_fonts_and_names_what_none_has() {
    let folder = Folder::new();
    let markers = PRIVATE.map(|c| Marker { label: format!("knee {c}"), labelled: true });
    let info = MotionInfo { rate_hz: 100.0, markers: markers.into(), ..Default::default() };
    let positions_mm = (0..100).map(|n| [n as f32, 0.0, 1.0]).collect();
    folder.write_motion("made.csv", &Motion { info, positions_mm });
    folder.run(&["import", "made.csv", "-o", "made.take"]).with_code(0);
    let plot = |output: &str| {
        let mut command = folder.command(&["plot", "quality", "made.take", "-o", output]);
        let ran: Ran = command.env("HOME", folder.path("home")).output().unwrap().into();
        ran.with_code(0).stderr
    };
    let stated = |line: &str| {
        assert_eq!(line.lines().count(), 1, "{line}");
        PRIVATE.map(|c| line.contains(&format!("U+{:X}", u32::from(c))))
    };
    let boxes = plot("boxes.png");
    assert_mentions(&boxes, &["boxes.png", "fonts-noto-cjk", ".svg"]);
    assert_eq!(stated(&boxes), [true, true], "{boxes}");
    std::fs::create_dir_all(folder.path("home/.fonts")).unwrap();
    folder.write("home/.fonts/own.ttf", font_with("Own", PRIVATE[0]));
    let one = plot("one.png");
    assert_eq!(stated(&one), [false, true], "{one}");
    assert_ne!(folder.read("one.png"), folder.read("boxes.png"));
    folder.write("home/.fonts/other.ttf", font_with("Other", PRIVATE[1]));
    assert_eq!(plot("both.png"), "");
    // An SVG leaves it to the viewer, and names families that have other scripts.
    assert_eq!(plot("made.svg"), "");
    assert_mentions(&folder.text("made.svg"), &["DejaVu Sans", "Noto Sans CJK JP"]);
}

#[test]
fn a_trajectory_has_its_samples_and_its_tolerance() {
    let folder = folder();
    let args =
        ["trajectory", "jump.take", "--marker", "r_wrist", "--against", "jump.csv", "--to", "2s"];
    let svg = drawn(&folder, &args);
    // 120 samples in space and on each of three axes, and one circle in the legend.
    let circles = |start: &str| {
        svg.match_indices("<circle")
            .filter(|(at, _)| svg[*at..].split("/>").next().unwrap().contains(start))
            .count()
    };
    assert_eq!(circles("fill=\"none\""), 4 * 120 + 1);
    let kept = circles("fill=\"#D55E00\"");
    assert!(kept > 4 * 3 && kept % 4 == 1, "{kept}");
    assert_mentions(&svg, &["x (mm)", "z (mm)", "(s)", "5 mm", "r_wrist", "jump.take"]);
    // With an original there is an error axis.
    let axes = |svg: &str| svg.matches("(mm)").count();
    assert_eq!(axes(&svg), axes(&drawn(&folder, &args[..4])) + 1);
}

#[test]
fn unusual_takes_give_plots_or_reasons() {
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
    assert_mentions(&refuses(&["trajectory", "gaps.take"], 1), &["m<1>&"]);
    refuses(&["pose", "gaps.take"], 1);
    let thirteen = vec!["1s"; 13].join(",");
    for (args, code, facts) in [
        (&["trajectory", "half.take", "--marker", "m<9>&"][..], 2, &["m<9>&", "m<1>&"][..]),
        (&["trajectory", "half.take", "--from", "9s"], 2, &["--from", "--to", "300", "3.000 s"]),
        (&["pose", "half.take", "--at", "1h"], 2, &["3.000 s", "3600.000 s"]),
        (&["pose", "half.take", "--at", &thirteen], 2, &["13", "12"]),
    ] {
        assert_mentions(&refuses(args, code), facts);
    }
    let absent = FileError::NotFound("none.take".into()).to_string();
    assert_eq!(refuses(&["quality", "none.take"], 1), absent);
    let plot = |output: &'static str| ["plot", "quality", "one.take", "-o", output];
    assert_mentions(&folder.refuses(&plot("q.gif"), 2), &["q.gif", ".svg", ".png"]);
    folder.write("there.svg", "mine");
    let exists = NameTaken { path: "there.svg".into() }.to_string();
    assert_eq!(folder.refuses(&plot("there.svg"), 1), exists);
}

#[test]
fn ten_thousand_markers_can_be_plotted() {
    let folder = Folder::new();
    take_of(&folder, "many.take", 4, 10_000, |row, marker| {
        [marker as f32, row as f32, (marker % 97) as f32]
    });
    for picture in ["pose", "quality", "trajectory"] {
        drawn(&folder, &[picture, "many.take"]);
    }
    let pose = texts(&drawn(&folder, &["pose", "many.take"]));
    let quality = texts(&drawn(&folder, &["quality", "many.take"]));
    // The caption states how many markers are shown.
    for (picture, n_shown) in [(&pose, "500"), (&quality, "60")] {
        let is_stated = |text: &String| mentions(text, n_shown) && mentions(text, "10000");
        assert!(picture.iter().any(is_stated), "{picture:?}");
    }
    assert_eq!(quality.iter().filter(|text| text.starts_with("m<")).count(), 60, "{quality:?}");
}

#[test]
fn a_skeleton_file_defines_the_lines() {
    let folder = Folder::new();
    take_of(&folder, "m.take", 10, 3, |row, marker| [marker as f32 * 100.0, row as f32, 50.0]);
    let lines = |args: &[&str]| drawn(&folder, args).matches("<polyline").count();
    let none = lines(&["pose", "m.take", "--at", "0s"]);
    folder.write("bones.csv", "m<0>&,m<1>&\nm<1>&,m<2>&\n");
    assert_eq!(lines(&["pose", "m.take", "--at", "0s", "--skeleton", "bones.csv"]), none + 2);
    folder.write("bones.csv", "m<0>&,toe\n");
    let args = ["plot", "pose", "m.take", "-o", "new.svg", "--skeleton", "bones.csv"];
    assert_mentions(
        &folder.refuses(&args, 2),
        &["bones.csv", "line 1", "toe", "mocapd subject body"],
    );
}

#[test]
fn rigid_bodies_are_counted_and_plotted_under_a_trajectory() {
    let folder = folder();
    let queue_bytes = Some(64 << 20);
    let settings = DeviceSettings {
        queue_bytes,
        bodies: Some(Arc::new(bodies())),
        ..DeviceSettings::default()
    };
    let device = Device::new(jump(1, 240.0, 2.0), settings).unwrap();
    let (ran, _) = record_from(&folder, device, [None, None], &["-o", "bodies.take"]);
    ran.with_code(0);

    let info = folder.run(&["info", "bodies.take", "--json"]).with_code(0).json();
    let (found, n_frames) = (&info["poses"]["bodies"], info["poses"]["frames"].as_f64().unwrap());
    let names: Vec<&str> =
        found.as_array().unwrap().iter().map(|body| body["name"].as_str().unwrap()).collect();
    let shares: Vec<f64> = found
        .as_array()
        .unwrap()
        .iter()
        .map(|body| {
            let share = body["tracked_share"].as_f64().unwrap();
            assert_eq!(body["frames_tracked"].as_f64().unwrap(), (share * n_frames).round());
            share
        })
        .collect();
    // A tenth of the poses is missing, in gaps of a fifth of a second.
    let mean = shares.iter().sum::<f64>() / shares.len() as f64;
    assert!(shares.len() == 10 && (0.8..0.98).contains(&mean), "{shares:?}");
    let least = (0..10).min_by(|&a, &b| shares[a].total_cmp(&shares[b])).unwrap();
    let text = folder.run(&["info", "bodies.take", "--markers"]).with_code(0).stdout;
    let share = format!("least {}, in {:.1} % of the frames", names[least], 100.0 * shares[least]);
    assert_mentions(&text, &["10 of 10 bodies tracked", &share, "rigid body"]);

    let svg = drawn(&folder, &["bodies", "bodies.take", "--from", "200ms", "--to", "1.8s"]);
    let found = texts(&svg);
    assert!(found.iter().any(|text| text.starts_with("4 of 10 bodies, 240 Hz")), "{found:?}");
    assert_eq!(found.iter().filter(|text| text.starts_with("marker ")).count(), 1);
    for name in &names[..4] {
        let position = format!("position of {name} (mm), tracked in ");
        assert!(found.iter().any(|text| text.starts_with(&position)), "{name}: {found:?}");
        assert!(found.contains(&format!("rotation of {name} (degrees)")), "{name}: {found:?}");
    }
    // By name and by number; a marker may be chosen.
    let chosen = format!("{},3", names[9]);
    let svg =
        drawn(&folder, &["bodies", "bodies.take", "--bodies", &chosen, "--marker", "r_wrist"]);
    let rotations: Vec<String> =
        texts(&svg).into_iter().filter(|text| text.starts_with("rotation of")).collect();
    assert_eq!(rotations, [9, 2].map(|i| format!("rotation of {} (degrees)", names[i])));
    assert_mentions(&svg, &["marker r_wrist"]);
    for (args, code, facts) in [
        (&["--bodies", "nobody"][..], 2, &["nobody", names[0]][..]),
        (&["--bodies", "1,2,3,4,5,6,7"], 2, &["7", "6", "--bodies"]),
        (&["--from", "9s"], 2, &["--from"]),
        (&["--against", "jump.csv"], 2, &["--against"]),
    ] {
        let args = [&["plot", "bodies", "bodies.take", "-o", "new.svg"], args].concat();
        assert_mentions(&folder.refuses(&args, code), facts);
    }
    for file in ["jump.take", "jump.csv"] {
        let line = folder.refuses(&["plot", "bodies", file, "-o", "new.svg"], 1);
        assert_mentions(&line, &["no rigid bodies"]);
    }
}
