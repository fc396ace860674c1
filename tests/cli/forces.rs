//! `export` of force plates to `OpenSim`'s `.mot`.

use std::{collections::HashSet, path::PathBuf};

use rustix::process::{Pid, Signal, kill_process};

use super::Folder;
use crate::support::{
    assert_mentions,
    c3d_file::{C3dFile, Order},
};

/// A level plate of 400 x 600 mm whose z axis points down, its centre at 1000, 500, 0 mm. For 20 frames of five analog
/// samples a force of 700 N at 100 mm from the centre along the laboratory's x axis, with a drift of 5 N; no force in
/// the first ten frames. z is up.
pub(super) fn plate(zero: [u16; 2]) -> Vec<u8> {
    plate_of(zero, (20, 5))
}

/// A [`plate`] file with another number of frames and of samples per frame.
fn plate_of(zero: [u16; 2], (n_frames, ratio): (usize, usize)) -> Vec<u8> {
    let frames = (0..n_frames).map(|frame| {
        // Along the plate's axes: x of the plate is y of the laboratory, y is x, z points down.
        let loaded = [0.0, 0.0, -695.0, -70_000.0, 0.0, 0.0];
        let empty = [0.0, 0.0, 5.0, 0.0, 0.0, 0.0];
        let sample = if frame < 10 { empty } else { loaded };
        [&[100.0, 200.0, 300.0 + frame as f32, 0.0][..], &sample.repeat(ratio)].concat()
    });
    let frames = frames.collect();
    let mut file = C3dFile { order: Order::Intel, analog: (6, ratio), ..C3dFile::new(1, frames) };
    file.texts(1, "LABELS", &["head"]);
    file.texts(1, "Y_SCREEN", &["+Z"]);
    file.records.extend(file.group(2, "ANALOG"));
    file.words(2, "USED", &[6]);
    file.floats(2, "RATE", &[100.0 * ratio as f32]);
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

/// The cells of a CSV file: its column names, and its rows as numbers; an empty cell is NaN.
fn table(text: &str) -> (Vec<&str>, Vec<Vec<f64>>) {
    let mut lines = text.lines();
    let names = lines.next().unwrap().split(',').collect();
    let number = |cell: &str| if cell.is_empty() { f64::NAN } else { cell.parse().unwrap() };
    (names, lines.map(|line| line.split(',').map(number).collect()).collect())
}

/// The loads of a row: force, moment, centre of pressure, free moment.
fn assert_loads(row: &[f64], force_n: [f64; 3], cop_mm: Option<[f64; 3]>) {
    assert_near(&row[..3], &force_n);
    match cop_mm {
        Some(cop_mm) => assert_near(&row[6..12], &[&cop_mm[..], &[0.0; 3]].concat()),
        None => assert!(row[6..12].iter().all(|value| value.is_nan()), "{row:?}"),
    }
}

#[test]
fn a_csv_export_has_side_files_of_analog_channels_and_force_plates() {
    let folder = folder([0, 0]);
    let ran = folder.run(&["export", "walk.take", "-o", "walk.csv", "--json"]).with_code(0);
    let report = ran.json();
    let beside = ["walk.analog.csv", "walk.force_plates.csv"];
    assert_eq!(report["sampled_files"], serde_json::json!(beside));
    let bytes: u64 = [&["walk.csv"], &beside[..]]
        .concat()
        .iter()
        .map(|name| folder.path(name).metadata().unwrap().len())
        .sum();
    assert_eq!(report["output_bytes"], bytes);
    let left_out = report["not_supported"].to_string();
    assert!(!left_out.contains("c3d/analog"), "{left_out}");
    assert!(left_out.contains("c3d/parameters"), "{left_out}");

    let (analog, plates) = (folder.text(beside[0]), folder.text(beside[1]));
    let (names, rows) = table(&analog);
    assert_eq!(names, ["time_s", "A1 (N)", "A2 (N)", "A3 (N)", "A4 (Nmm)", "A5 (Nmm)", "A6 (Nmm)"]);
    assert_eq!(rows.len(), 100);
    assert_eq!(rows[0], [0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0]);
    assert_eq!(rows[99], [0.198, 0.0, 0.0, -695.0, -70_000.0, 0.0, 0.0]);

    let (names, rows) = table(&plates);
    assert_eq!((names.len(), rows.len()), (13, 100));
    assert_eq!(names[3], "force_plate_1.force_z_n");
    assert_eq!(names[7..9], ["force_plate_1.cop_x_mm", "force_plate_1.cop_y_mm"]);
    assert_loads(&rows[0][1..], [0.0, 0.0, -5.0], None);
    let arm_mm = 1000.0 + 70_000.0 / 695.0;
    assert_loads(&rows[99][1..], [0.0, 0.0, 695.0], Some([arm_mm, 500.0, 0.0]));

    // A part, rotated: its first sample is at time 0.
    let part = ["export", "walk.take", "-o", "part.csv", "--from", "0.15s", "--up", "y"];
    folder.run(&part).with_code(0);
    let text = folder.text("part.force_plates.csv");
    let (_, rows) = table(&text);
    assert_eq!((rows.len(), rows[0][0]), (25, 0.0));
    assert_loads(&rows[0][1..], [0.0, 695.0, 0.0], Some([arm_mm, 0.0, -500.0]));
}

#[test]
fn side_files_are_written_with_their_output_or_not_at_all() {
    let folder = folder([0, 0]);
    for format in ["csv", "parquet"] {
        let [walk, analog, plates] =
            ["walk", "walk.analog", "walk.force_plates"].map(|stem| format!("{stem}.{format}"));
        folder.write(&plates, "mine");
        let before = folder.content();
        let line = folder.refuses(&["export", "walk.take", "-o", &walk], 1);
        assert_mentions(&line, &[&plates, "exists"]);
        assert!(folder.content() == before, "{:?}", folder.content().keys());
        std::fs::remove_file(folder.path(&plates)).unwrap();
        let ran = folder.run(&["export", "walk.take", "-o", &walk, "--json"]).with_code(0);
        assert_eq!(ran.json()["sampled_files"], serde_json::json!([analog, plates]));
        [walk, analog, plates].iter().for_each(|name| {
            std::fs::remove_file(folder.path(name)).unwrap();
        });
    }
    // Standard output has the positions, and a message says what it lacks.
    let ran = folder.run(&["export", "walk.take", "-o", "-", "--to", "csv"]).with_code(0);
    assert_eq!(ran.stdout.lines().count(), 21);
    assert_mentions(&ran.stderr, &["analog channels", "force plates", "-o FILE"]);
    // A second run changes nothing, and a folder of exports is imported without them.
    for unchanged in [false, true] {
        let args = ["export", "walk.take", "--to", "csv", "-o", "out/", "--json"];
        assert_eq!(folder.run(&args).with_code(0).json()["unchanged"], unchanged);
    }
    assert!(folder.path("out/walk.analog.csv").exists());
    folder.run(&["import", "out", "-o", "again/"]).with_code(0);
    assert_eq!(std::fs::read_dir(folder.path("again")).unwrap().count(), 1);
}

/// Interrupted while the last of the files is written: the others are complete, but none has its final name yet.
#[test]
fn an_interrupted_export_leaves_no_side_file() {
    let folder = Folder::new();
    // 300 000 samples: seconds of work.
    folder.write("walk.c3d", plate_of([0, 0], (6000, 50)));
    folder.run(&["import", "walk.c3d", "-o", "walk.take"]).with_code(0);
    for output in ["walk.csv", "walk.parquet"] {
        let before = folder.content();
        let mut child = folder.command(&["export", "walk.take", "-o", output]).spawn().unwrap();
        while n_written(&folder, child.id()) < 3 {
            assert!(child.try_wait().unwrap().is_none(), "{output}: it ended");
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
        assert_eq!(child.wait().unwrap().code(), None);
        assert!(folder.content() == before, "{output}: {:?}", folder.content().keys());
    }
}

/// Number of files in the folder that a process has open, besides the take that it reads.
fn n_written(folder: &Folder, process: u32) -> usize {
    let open = std::fs::read_dir(format!("/proc/{process}/fd")).into_iter().flatten();
    let open = open.filter_map(|entry| std::fs::read_link(entry.ok()?.path()).ok());
    let here: HashSet<PathBuf> = open.filter(|path| path.starts_with(folder.path(""))).collect();
    here.iter().filter(|path| **path != folder.path("walk.take")).count()
}

#[test]
fn names_that_look_like_formulas_are_escaped_in_side_files() {
    let folder = Folder::new();
    let frames = (0..3).map(|_| vec![1.0, 2.0, 3.0, 0.0, 7.0]).collect();
    let mut file = C3dFile { order: Order::Intel, analog: (1, 1), ..C3dFile::new(1, frames) };
    file.texts(1, "LABELS", &["head"]);
    file.records.extend(file.group(2, "ANALOG"));
    file.texts(2, "LABELS", &["=1+1"]);
    folder.write("a.c3d", file.bytes());
    folder.run(&["import", "a.c3d", "-o", "a.take"]).with_code(0);
    folder.run(&["export", "a.take", "-o", "a.csv", "--for-spreadsheet"]).with_code(0);
    assert!(folder.text("a.analog.csv").starts_with("time_s,'=1+1\n0,7\n"));
}

#[test]
fn a_data_set_has_analog_channels_and_force_plates_as_continuous_recordings() {
    let folder = folder([0, 0]);
    let args = ["export", "walk.take", "-o", "study", "--to", "bids", "--task", "walk"];
    folder.run(&args).with_code(0);
    let stem = "study/sub-01/motion/sub-01_task-walk_tracksys-optical_recording-";
    for (recording, n_columns, name, unit) in
        [("analog", 6, "A4", "Nmm"), ("forceplates", 12, "force_plate_1.cop_x_mm", "mm")]
    {
        let document = folder.text(&format!("{stem}{recording}_physio.json"));
        let document: serde_json::Value = serde_json::from_str(&document).unwrap();
        assert_eq!(document["SamplingFrequency"], 500);
        assert_eq!(document["StartTime"], 0);
        assert_eq!(document["Columns"].as_array().unwrap().len(), n_columns);
        assert_eq!(document[name]["Units"], unit);
        let packed = folder.path(&format!("{stem}{recording}_physio.tsv.gz"));
        assert_eq!(std::fs::read(&packed).unwrap()[4..8], [0; 4], "no date");
        let unpacked = std::process::Command::new("gzip").arg("-dc").arg(&packed).output().unwrap();
        let text = String::from_utf8(unpacked.stdout).unwrap();
        assert_eq!(text.lines().count(), 100);
        assert!(text.lines().all(|line| line.split('\t').count() == n_columns));
        assert_eq!(text.lines().next().unwrap().contains("n/a"), recording == "forceplates");
    }
}

#[test]
fn plots_show_analog_channels_and_force_plates() {
    let folder = folder([0, 0]);
    for source in ["walk.take", "walk.c3d"] {
        let name = format!("{source}.svg");
        let plot = ["plot", "analog", source, "-o", &name, "--channels", "A4,3", "--from", "50ms"];
        folder.run(&plot).with_code(0);
        let svg = folder.text(&name);
        assert_mentions(&svg, &["2 of 6 channels, 500 Hz", "A4 (Nmm)", "A3 (N)", "time (s)"]);
        let name = format!("{source}.forces.svg");
        folder.run(&["plot", "forces", source, "-o", &name, "--plates", "1"]).with_code(0);
        let svg = folder.text(&name);
        assert_mentions(
            &svg,
            &[
                "1 of 1 plates",
                "force 1 (N)",
                "centre of pressure 1 (mm)",
                "head z (mm)",
                "from above",
            ],
        );
    }
    let line = folder.refuses(&["plot", "analog", "walk.take", "--channels", "EMG"], 2);
    assert_mentions(&line, &["EMG", "A1, A2"]);
    let line = folder.refuses(&["plot", "forces", "walk.take", "--plates", "2"], 1);
    assert_mentions(&line, &["force plate 2", "it has 1"]);
    folder.run(&["import", "walk.c3d", "-o", "bare.take", "--drop-foreign"]).with_code(0);
    for plot in ["analog", "forces"] {
        let line = folder.refuses(&["plot", plot, "bare.take", "-o", "none.svg"], 1);
        assert_mentions(&line, &["--drop-foreign"]);
    }
}

#[test]
fn sizes_include_the_analog_channels() {
    let folder = folder([0, 0]);
    let bench = |file: &str| {
        let args = ["bench", "codec", file, "--resampler", "fast", "--tolerance", "1mm", "--json"];
        folder.run(&args).with_code(0).json()["files"][0].clone()
    };
    let (raw, take) = (bench("walk.c3d"), bench("walk.take"));
    let analog = |file: &serde_json::Value| {
        let mut parts = file["sampled"].as_array().unwrap().iter();
        let part = parts.rfind(|part| part["kind"] == "c3d/analog").unwrap().clone();
        (part["channels"].clone(), part["samples"].clone(), part["bytes"].clone())
    };
    assert_eq!(analog(&raw), analog(&take));
    assert_eq!((analog(&raw).0, analog(&raw).1), (6.into(), 100.into()));
    // The difference between the sizes of two imports.
    for (name, option) in [("all.take", None), ("bare.take", Some("--drop-foreign"))] {
        let args = ["import", "walk.c3d", "-o", name, "--resampler", "fast", "--tolerance", "1mm"];
        folder.run(&[&args[..], option.as_slice()].concat()).with_code(0);
    }
    let size = |name: &str| folder.path(name).metadata().unwrap().len();
    let difference = size("all.take") - size("bare.take");
    let stated = analog(&raw).2.as_u64().unwrap();
    // The remaining bytes are the file's parameters.
    assert!(stated < difference && difference < stated + 4096, "{stated} of {difference}");
    folder.run(&["plot", "sizes", "walk.c3d", "--tolerances", "1mm", "-o", "s.svg"]).with_code(0);
    assert_mentions(&folder.text("s.svg"), &["analog", "600 analog samples"]);
}
