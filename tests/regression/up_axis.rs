//! Exports report a missing up axis and rotate on request; plots agree about the up axis.

use mocapd_take::interchange::{Format, ReadOptions};

use crate::{
    cli::Folder,
    support::{assert_mentions, c3d_file::C3dFile, jump, mentions},
};

/// The third column of coordinates of a CSV file's first marker.
fn column(csv: &str, axis: usize) -> Vec<f32> {
    let rows = csv.lines().skip(1);
    rows.filter_map(|row| row.split(',').nth(2 + axis)?.parse().ok()).collect()
}

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write_motion("jump.c3d", &jump(3, 60.0, 1.0));
    folder.run(&["import", "jump.c3d", "-o", "jump.take", "--lossless"]).with_code(0);
    folder
}

#[test]
fn omissions_are_reported_and_up_rotates() {
    let folder = folder();
    for ending in ["csv", "trc", "tsv", "xdf"] {
        let plain = ["export", "jump.take", "-o", &format!("plain.{ending}")];
        let message = folder.run(&plain).with_code(0).stderr;
        assert_mentions(&message, &["z"]);
        let turned = ["export", "jump.take", "-o", &format!("turned.{ending}"), "--up", "y"];
        let message = folder.run(&turned).with_code(0).stderr;
        assert!(!mentions(&message, "z"), "{ending}: {message}");
    }
    let (plain, turned) = (folder.text("plain.csv"), folder.text("turned.csv"));
    assert_eq!(column(&turned, 0), column(&plain, 0));
    assert_eq!(column(&turned, 1), column(&plain, 2), "up is y");
    let behind: Vec<f32> = column(&plain, 1).iter().map(|v| -v).collect();
    assert_eq!(column(&turned, 2), behind, "right-handed");
    // C3D stores the up axis, and rotating back restores the motion.
    folder.run(&["export", "jump.take", "-o", "y.c3d", "--up", "y"]).with_code(0);
    folder.run(&["import", "y.c3d", "-o", "y.take", "--lossless"]).with_code(0);
    assert_eq!(folder.run(&["info", "y.take", "--json"]).json()["up_axis"], "y");
    folder.run(&["export", "y.take", "-o", "z.csv", "--up", "z"]).with_code(0);
    assert_eq!(folder.text("z.csv"), plain);
    folder.refuses(&["export", "jump.take", "-o", "no.csv", "--up", "-y"], 2);
    folder.refuses(&["export", "jump.take", "-o", "no.csv", "--up", "w"], 2);
}

#[test]
fn the_up_axis_can_be_given_at_import() {
    let folder = folder();
    folder.run(&["export", "jump.take", "-o", "plain.csv"]).with_code(0);
    folder.run(&["import", "plain.csv", "-o", "none.take", "--lossless"]).with_code(0);
    folder.refuses(&["export", "none.take", "-o", "no.csv", "--up", "y"], 2);
    folder.run(&["import", "plain.csv", "-o", "z.take", "--lossless", "--up", "z"]).with_code(0);
    let info = folder.run(&["info", "z.take", "--json"]).with_code(0).json();
    assert_eq!((&info["up_axis"], &info["source"]["up_given"]), (&"z".into(), &"z".into()));
    // A downward axis rotates the take by 180 degrees, and the file is read with it again.
    folder
        .run(&["import", "plain.csv", "-o", "down.take", "--lossless", "--up", "-z"])
        .with_code(0);
    folder.run(&["verify", "down.take", "--against", "plain.csv"]).with_code(0);
    folder.run(&["export", "down.take", "-o", "down.csv"]).with_code(0);
    let plain = folder.text("plain.csv");
    let turned: Vec<f32> = column(&plain, 2).iter().map(|v| -v).collect();
    assert_eq!(column(&folder.text("down.csv"), 2), turned);
    assert_eq!(column(&folder.text("down.csv"), 0), column(&plain, 0));
}

#[test]
fn model_outputs_that_are_not_rotated_are_reported() {
    let warnings = |outputs: &[&str], up: &str| {
        let frames = vec![vec![1.0, 2.0, 3.0, 0.0, 4.0, 5.0, 6.0, 0.0]; 5];
        let mut file = C3dFile::new(2, frames);
        file.texts(1, "LABELS", &["HEAD", "Knee"]);
        file.texts(1, "ANGLES", outputs);
        let options = ReadOptions { up: up.parse().ok(), ..ReadOptions::default() };
        let motion = Format::C3d.read_with(&file.bytes(), &options).unwrap();
        motion.info.source.warnings
    };
    let has_warning =
        |warnings: &[String]| warnings.iter().any(|w| w.contains("c3d/model-outputs"));
    assert!(has_warning(&warnings(&["Knee"], "-z")));
    // Nothing is rotated, or there are no model outputs.
    assert!(!has_warning(&warnings(&["Knee"], "z")) && !has_warning(&warnings(&["None"], "-z")));
}

#[test]
fn plots_agree_about_the_up_axis() {
    // A body along y, without a stated up axis: two markers far apart, one of which moves along x.
    let folder = Folder::new();
    let rows = (0..40).map(|i| format!("{i},{},{},0,0,0,1700,100\n", i as f32 / 100.0, 3 * i));
    let head = "frame,time_s,a.x,a.y,a.z,b.x,b.y,b.z\n".to_owned();
    folder.write("tall.csv", head + &rows.collect::<String>());
    folder.run(&["import", "tall.csv", "-o", "tall.take", "--lossless"]).with_code(0);
    folder.run(&["import", "tall.csv", "-o", "given.take", "--lossless", "--up", "y"]).with_code(0);
    for picture in ["trajectory", "pose"] {
        let draw = |take: &str| {
            let svg = format!("{picture}-{take}.svg");
            folder.run(&["plot", picture, take, "-o", &svg]).with_code(0);
            folder.text(&svg).replace(take, "")
        };
        assert!(draw("tall.take") == draw("given.take"), "{picture}");
    }
}
