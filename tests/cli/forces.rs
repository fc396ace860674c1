//! `export` of force plates to `OpenSim`'s `.mot`.

use super::Folder;
use crate::support::{
    assert_mentions,
    c3d_file::{C3dFile, Order},
};

/// A level plate of 400 x 600 mm whose z axis points down, its centre at 1000, 500, 0 mm. For 20 frames of five analog
/// samples a force of 700 N at 100 mm beside the centre along the laboratory's x axis, drifted by 5 N; no force in the
/// first ten frames. z is up.
fn plate(zero: [u16; 2]) -> Vec<u8> {
    let frames = (0..20).map(|frame| {
        // Along the plate's axes: x of the plate is y of the laboratory, y is x, z points down.
        let loaded = [0.0, 0.0, -695.0, -70_000.0, 0.0, 0.0];
        let empty = [0.0, 0.0, 5.0, 0.0, 0.0, 0.0];
        let sample = if frame < 10 { empty } else { loaded };
        [&[100.0, 200.0, 300.0 + frame as f32, 0.0][..], &sample.repeat(5)].concat()
    });
    let frames = frames.collect();
    let mut file = C3dFile { order: Order::Intel, analog: (6, 5), ..C3dFile::new(1, frames) };
    file.texts(1, "LABELS", &["head"]);
    file.texts(1, "Y_SCREEN", &["+Z"]);
    file.records.extend(file.group(2, "ANALOG"));
    file.words(2, "USED", &[6]);
    file.floats(2, "RATE", &[500.0]);
    file.floats(2, "SCALE", &[1.0; 6]);
    file.words(2, "OFFSET", &[0; 6]);
    file.texts(2, "UNITS", &["N", "N", "N", "Nmm", "Nmm", "Nmm"]);
    file.records.extend(file.group(3, "FORCE_PLATFORM"));
    file.words(3, "USED", &[1]);
    file.words(3, "TYPE", &[2]);
    file.words(3, "ZERO", &zero);
    let corners = [1200.0, 800.0, 0.0, 1200.0, 200.0, 0.0, 800.0, 200.0, 0.0, 800.0, 800.0, 0.0];
    file.floats(3, "CORNERS", &corners);
    file.floats(3, "ORIGIN", &[0.0, 0.0, -40.0]);
    file.words(3, "CHANNEL", &[1, 2, 3, 4, 5, 6]);
    file.bytes()
}

/// The rows of a `.mot`: numbers without the names.
fn rows(text: &str) -> Vec<Vec<f64>> {
    let table = text.split_once("\nendheader\n").unwrap().1;
    let numbers = |line: &str| line.split('\t').map(|cell| cell.parse().unwrap()).collect();
    table.lines().skip(1).map(numbers).collect()
}

fn assert_near(found: &[f64], wanted: &[f64]) {
    let is_near = found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-3 * b.abs().max(1.0));
    assert!(found.len() == wanted.len() && is_near, "{found:?} for {wanted:?}");
}

fn folder(zero: [u16; 2]) -> Folder {
    let folder = Folder::new();
    folder.write("walk.c3d", plate(zero));
    folder.run(&["import", "walk.c3d", "-o", "walk.take"]).with_code(0);
    folder
}

#[test]
fn a_mot_has_the_plates_in_opensims_axes() {
    let folder = folder([1, 10]);
    let ran = folder.run(&["export", "walk.take", "-o", "walk.mot"]).with_code(0);
    assert_mentions(&ran.stderr, &["walk.mot", "1 marker", "z", "y", "--up y"]);
    let text = folder.text("walk.mot");
    assert_mentions(&text, &["nRows=100", "nColumns=10", "ground_force_1_vy"]);
    let all = rows(&text);
    assert_eq!(all.len(), 100);
    assert!((all[99][0] - 0.198).abs() < 1e-9, "500 Hz");
    assert_near(&all[0][1..], &[0.0; 9]);
    // x, y, z becomes x, z, -y; the moment of 70 N m at 695 N is 100.7 mm.
    let arm = 1.0 + 70.0 / 695.0;
    assert_near(&all[99][1..], &[0.0, 695.0, 0.0, arm, 0.0, -0.5, 0.0, 0.0, 0.0]);

    // In the take's own axes, a part alone, without the drift.
    let args = ["export", "walk.take", "-o", "part.mot", "--up", "z", "--from", "0.1s"];
    let ran = folder.run(&[&args[..], &["--subtract-baseline"]].concat()).with_code(0);
    assert!(!ran.stderr.contains("rotated"), "{}", ran.stderr);
    let part = rows(&folder.text("part.mot"));
    assert_eq!((part.len(), part[0][0]), (50, 0.0));
    assert_near(&part[0][1..], &[0.0, 0.0, 700.0, 1.1, 0.5, 0.0, 0.0, 0.0, 0.0]);
}

#[test]
fn a_mot_needs_plates_and_frames_without_load() {
    let folder = folder([0, 0]);
    folder.run(&["import", "walk.c3d", "-o", "bare.take", "--drop-foreign"]).with_code(0);
    let line = folder.refuses(&["export", "bare.take", "-o", "bare.mot"], 1);
    assert_mentions(&line, &["bare.mot", "no force plates", "--drop-foreign"]);
    let baseline = ["export", "walk.take", "-o", "walk.mot", "--subtract-baseline"];
    assert_mentions(&folder.refuses(&baseline, 1), &["FORCE_PLATFORM:ZERO"]);
    let other = ["export", "walk.take", "-o", "walk.csv", "--subtract-baseline"];
    assert_mentions(&folder.refuses(&other, 2), &["--subtract-baseline", ".mot"]);
    folder.write("a.mot", "x");
    assert_mentions(&folder.refuses(&["import", "a.mot", "-o", "a.take"], 2), &["a.mot", ".c3d"]);
}
