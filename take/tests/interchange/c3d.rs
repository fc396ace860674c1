//! C3D files of every kind.

use mocapd_take::interchange::{Format, InterchangeError};
use mocapd_take::motion::{Motion, UpAxis, is_gap};

use crate::c3d_file::{C3dFile, Order};
use crate::{labels, numbers};

fn read(file: &C3dFile) -> Motion {
    Format::C3d.read(&file.bytes()).expect("a usable file")
}

/// Two points, three frames, the second point missing in the middle.
fn small() -> C3dFile {
    let mut file = C3dFile::new(
        2,
        vec![
            vec![1.0, 2.0, 3.0, 0.0, -4.0, 5.5, 6.0, 0.0],
            vec![1.5, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, -1.0],
            vec![2.0, 2.0, 3.0, 0.0, -5.0, 6.5, 7.0, 0.0],
        ],
    );
    file.texts(1, "LABELS", &["LASI", "RASI"]);
    file
}

#[test]
fn floats_of_all_three_processors_are_the_same_positions() {
    for order in [Order::Intel, Order::Dec, Order::Mips] {
        let mut file = C3dFile { order, records: Vec::new(), ..small() };
        file.texts(1, "LABELS", &["LASI", "RASI"]);
        file.texts(1, "Y_SCREEN", &["+Z"]);
        let motion = read(&file);
        assert_eq!(labels(&motion), ["LASI", "RASI"], "{order:?}");
        assert_eq!(motion.frame(2), [[2.0, 2.0, 3.0], [-5.0, 6.5, 7.0]], "{order:?}");
        assert!(is_gap(motion.frame(1)[1]) && !is_gap(motion.frame(1)[0]), "{order:?}");
        assert_eq!((motion.info.rate_hz, motion.info.up), (100.0, UpAxis::Z), "{order:?}");
        assert_eq!(motion.info.source.warnings, [""; 0], "{order:?}");
    }
}

#[test]
fn integers_are_scaled_in_f64_before_the_unit_counts() {
    for order in [Order::Intel, Order::Dec, Order::Mips] {
        let frames = vec![vec![-32768.0, 3.0, 32767.0, 0.0], vec![1.0, 1.0, 1.0, -1.0]];
        let file = C3dFile { order, scale: 0.1, unit: "cm", ..C3dFile::new(1, frames) };
        let motion = read(&file);
        let scale = f64::from(0.1f32);
        let expected = [-32768.0, 3.0, 32767.0].map(|v: f64| (v * scale * 10.0) as f32);
        assert_eq!(motion.frame(0), [expected], "{order:?}");
        assert!(is_gap(motion.frame(1)[0]), "{order:?}");
    }
}

#[test]
fn a_sample_is_missing_exactly_where_its_fourth_word_is_negative() {
    // 65535.0 is -1 as an unsigned number; 32767.0 is the largest word that is not negative.
    let fourth = [0.0, -1.0, -0.5, -0.0, 65535.0, f32::NAN, -32768.0, 32767.0, 65536.0];
    let frames = fourth.iter().map(|&w| vec![0.0, 0.0, 0.0, w]).collect();
    let motion = read(&C3dFile::new(1, frames));
    let gaps: Vec<bool> = motion.positions_mm.iter().map(|&p| is_gap(p)).collect();
    assert_eq!(gaps, [false, true, true, false, true, false, true, false, false]);
    assert!(
        motion.info.source.warnings.iter().any(|w| numbers(w).starts_with(&[5, 5])),
        "{:?}",
        motion.info.source.warnings
    );
}

#[test]
fn a_coordinate_that_is_not_finite_makes_a_gap() {
    let frames = vec![vec![f32::NAN, 0.0, 0.0, 0.0], vec![1.0, f32::INFINITY, 0.0, 0.0]];
    assert!(read(&C3dFile::new(1, frames)).positions_mm.iter().all(|&p| is_gap(p)));
}

#[test]
fn labels_continue_in_labels2_and_are_never_lost() {
    let names: Vec<String> = (0..300).map(|i| format!("m{i}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut file = C3dFile::new(300, vec![vec![0.5; 1200]]);
    file.texts(1, "LABELS", &names[..255]);
    file.texts(1, "LABELS2", &names[255..]);
    assert_eq!(labels(&read(&file)), names);
}

#[test]
fn unlabelled_points_keep_their_text() {
    let mut file = C3dFile::new(4, vec![vec![0.5; 16]]);
    file.texts(1, "LABELS", &["HEAD", "*115", ""]);
    let motion = read(&file);
    assert_eq!(labels(&motion), ["HEAD", "*115", "u003", "u004"]);
    let labelled: Vec<bool> = motion.info.markers.iter().map(|m| m.labelled).collect();
    assert_eq!(labelled, [true, false, false, false]);
    assert_eq!(motion.info.source.warnings.len(), 1, "{:?}", motion.info.source.warnings);
}

#[test]
fn model_outputs_are_not_markers_but_modelled_markers_are() {
    let mut file = C3dFile::new(5, vec![vec![0.5; 20]]);
    file.texts(1, "LABELS", &["HEAD", "KneeAngle", "CoM", "Odd", "Grf"]);
    file.texts(1, "ANGLES", &["KneeAngle"]);
    file.texts(1, "MODELED_MARKERS", &["CoM"]);
    file.texts(1, "ODDITIES", &["Odd"]);
    file.texts(1, "FORCES", &["Grf"]);
    file.texts(1, "TYPE_GROUPS", &["ODDITIES", "ODDITY", "MODELED_MARKERS", "MODELED_MARKER"]);
    assert_eq!(labels(&read(&file)), ["HEAD", "CoM"]);
}

#[test]
fn frames_beyond_16_bits_are_counted_by_their_own_parameters() {
    let n_frames = 70_000u32;
    let frames: Vec<Vec<f32>> = (0..n_frames).map(|i| vec![i as f32, 0.0, 1.0, 0.0]).collect();
    let mut by_trial = C3dFile::new(1, frames.clone());
    by_trial.words(1, "FRAMES", &[65535]);
    by_trial.records.extend(by_trial.group(2, "TRIAL"));
    by_trial.words(2, "ACTUAL_START_FIELD", &[11, 0]);
    by_trial.words(
        2,
        "ACTUAL_END_FIELD",
        &[(n_frames + 10) as u16, ((n_frames + 10) >> 16) as u16],
    );
    let mut by_long_frames = C3dFile::new(1, frames.clone());
    by_long_frames.floats(1, "LONG_FRAMES", &[n_frames as f32]);
    let mut by_float = C3dFile::new(1, frames.clone());
    by_float.floats(1, "FRAMES", &[n_frames as f32]);
    for (mut file, first) in [(by_trial, 11), (by_long_frames, 1), (by_float, 1)] {
        file.texts(1, "LABELS", &["HEAD"]);
        let motion = read(&file);
        assert_eq!((motion.n_frames(), motion.info.source.first_frame), (70_000, first));
        assert_eq!(motion.frame(69_999), [[69_999.0, 0.0, 1.0]]);
        assert_eq!(motion.info.source.warnings, [""; 0]);
    }
    let saturated = read(&C3dFile::new(1, frames));
    assert!(saturated.n_frames() > 69_900, "{}", saturated.n_frames());
    assert!(saturated.info.source.warnings.iter().any(|w| w.contains("16-bit")));
}

#[test]
fn a_place_of_poses_that_are_not_there_ends_no_points() {
    let frames: Vec<Vec<f32>> = (0..500).map(|i| vec![i as f32, 0.0, 1.0, 0.0]).collect();
    for (used, n_frames) in [(0, 500), (2, 32 * 5)] {
        let mut file = C3dFile::new(1, frames.clone());
        file.records.extend(file.group(3, "ROTATION"));
        file.words(3, "USED", &[used]);
        let start = file.bytes();
        // Five blocks of 32 frames behind the first of the points, which is at the same block with or without a value.
        let first = u16::from_le_bytes([start[16], start[17]]);
        file.words(3, "DATA_START", &[first + 5]);
        let motion = read(&file);
        assert_eq!(motion.n_frames(), n_frames, "{:?}", motion.info.source.warnings);
    }
}

#[test]
fn a_truncated_file_gives_its_complete_frames_and_counts_the_missing_ones() {
    let bytes = small().bytes();
    let motion = Format::C3d.read(&bytes[..bytes.len() - 5]).expect("two whole frames");
    assert_eq!(motion.n_frames(), 2);
    let warnings = &motion.info.source.warnings;
    assert!(warnings.len() == 1 && numbers(&warnings[0]) == [3, 2], "{warnings:?}");
}

#[test]
fn a_missing_description_byte_is_a_warning() {
    let mut file = small();
    file.records.clear();
    let mut record = file.record(1, "LABELS", -1, &[4, 2], b"LASIRASI");
    record.pop();
    record[8] -= 1;
    file.records.extend(record);
    file.words(1, "FRAMES", &[3]);
    let motion = read(&file);
    assert_eq!(labels(&motion), ["LASI", "RASI"]);
    let warnings = &motion.info.source.warnings;
    assert!(warnings.len() == 1 && warnings[0].contains("LABELS"), "{warnings:?}");
}

#[test]
fn units_and_disagreements_are_stated() {
    let motion = read(&C3dFile { unit: "furlong", ..small() });
    assert!(
        motion.info.source.warnings[0].contains("furlong"),
        "{:?}",
        motion.info.source.warnings
    );
    assert_eq!(read(&C3dFile { unit: "in", ..small() }).frame(0)[0], [25.4, 50.8, 76.2]);
    let mut bytes = small().bytes();
    bytes[20..24].copy_from_slice(&50f32.to_le_bytes());
    let motion = Format::C3d.read(&bytes).expect("a usable file");
    assert_eq!(motion.info.rate_hz, 100.0);
    assert!(
        ["50 Hz", "100 Hz"].iter().all(|rate| motion.info.source.warnings[0].contains(rate)),
        "{:?}",
        motion.info.source.warnings
    );
}

#[test]
fn other_files_are_refused_as_c3d() {
    for bytes in [&b""[..], b"\x02", b"PathFileType", &[2, 0x50], &small().bytes()[..600]] {
        let error = Format::C3d.read(bytes).expect_err("not usable");
        assert!(
            matches!(&error, InterchangeError::Malformed { format: "c3d", place, .. } if place.starts_with("byte ")),
            "{error:?}"
        );
    }
}
