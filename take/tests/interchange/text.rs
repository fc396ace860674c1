//! TRC, TSV and CSV in their dialects.

use std::collections::HashSet;

use mocapd_take::interchange::{Format, InterchangeError};
use mocapd_take::motion::{Motion, MotionFrames, UpAxis, is_gap};

use crate::{labels, numbers};

fn trc(text: &str) -> Motion {
    Format::Trc.read(text.as_bytes()).expect("a usable file")
}

const TRC_HEAD: &str = "PathFileType\t4\t(X/Y/Z)\twalk.trc\r\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\t\
    OrigDataRate\tOrigDataStartFrame\tOrigNumFrames\r\n200.00\t400\t2\t2\tm\t200\t9\t77\r\n";

#[test]
fn trc_with_labels_every_three_columns() {
    let rows = "Frame#\tTime\tHead\t\t\tToe L\t\t\r\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\r\n\r\n\
        5\t0.000\t1.5e-1\t-2\t3\t\t\t\t\r\n6\t0.005\t0.1\t0.2\t0.3\t4\t5\t6\t\r\n";
    let motion = trc(&format!("\u{FEFF}{TRC_HEAD}{rows}"));
    assert_eq!(labels(&motion), ["Head", "Toe L"]);
    assert_eq!(motion.frame(1), [[100.0, 200.0, 300.0], [4000.0, 5000.0, 6000.0]]);
    assert_eq!(motion.frame(0)[0], [150.0, -2000.0, 3000.0]);
    assert!(is_gap(motion.frame(0)[1]));
    assert_eq!((motion.info.rate_hz, motion.info.source.first_frame), (200.0, 5));
    assert_eq!(motion.info.source.warnings, [""; 0]);
    let mut written = Vec::new();
    Format::Trc.write(&mut MotionFrames::new(&motion), &mut written).expect("memory");
    let written = String::from_utf8(written).expect("text");
    assert!(written.starts_with("PathFileType\t4\t(X/Y/Z)\twalk.trc\nDataRate\t"), "{written}");
    assert!(written.contains("\n200\t400\t2\t2\tmm\t200\t9\t77\n"), "{written}");
    // As OpenSim writes it: a tab at the end of each line, so that a missing sample in the last column has its cells.
    let lines: Vec<&str> = written.lines().skip(3).collect();
    assert_eq!(
        lines[..3],
        ["Frame#\tTime\tHead\t\t\tToe L\t\t\t", "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\t", ""]
    );
    assert_eq!(lines[3], "5\t0\t150\t-2000\t3000\t\t\t\t");
    assert_eq!(lines[3].split('\t').count(), 2 + 6 + 1);
}

#[test]
fn trc_without_labels_is_as_wide_as_its_widest_row() {
    let head = TRC_HEAD.replace("\t2\t2\tm\t", "\t3\t0\tmm\t");
    let motion = trc(&format!(
        "{head}Frame#\tTime\t\r\n\t\t\r\n\r\n1\t0\t1\t2\t3\t\r\n2\t0\t\t\t\t4\t5\t6\t\t\t\r\n3\t0\t7\t8\t9\t1\t1\t1\t2\t2\t2\t\r\n"
    ));
    assert_eq!(labels(&motion), ["u001", "u002", "u003"]);
    assert!(motion.info.markers.iter().all(|m| !m.labelled));
    let gaps: Vec<bool> = motion.positions_mm.iter().map(|&p| is_gap(p)).collect();
    assert_eq!(gaps, [false, true, true, true, false, true, false, false, false]);
}

#[test]
fn contradictions_in_a_trc_are_warnings() {
    let motion = trc(&format!(
        "{TRC_HEAD}Frame#\tTime\tA\tB\nx\n1\t0\t1\t2\t3\t4\t5\t6\n3\t0\t1\tbad\t3\nrest\n"
    ));
    assert_eq!(labels(&motion), ["A", "B"]);
    // First in the line of the labels.
    let warnings = &motion.info.source.warnings;
    assert_eq!(warnings.len(), 5, "{warnings:?}");
    for fact in ["line 5", "1 sample", "1 frame", "2 frames"] {
        assert!(warnings.iter().any(|said| said.contains(fact)), "{fact}: {warnings:?}");
    }
    for (text, place) in [
        ("", "line 4"),
        (&TRC_HEAD.replace("200.00", "no")[..], "line 4"),
        ("a\nFrame#\n", "line 3"),
    ] {
        let error = Format::Trc.read(text.as_bytes()).expect_err("not usable");
        assert!(
            matches!(&error, InterchangeError::Malformed { format: "trc", place: found, .. } if found == place),
            "{error:?}"
        );
    }
}

const TSV_HEAD: &str = "NO_OF_FRAMES\t3\nNO_OF_MARKERS\t2\nFREQUENCY\t60\nDATA_INCLUDED\t3D\n\
    EVENT\tkick\t2\t0.02\nMARKER_NAMES\tHead\tToe\n";

#[test]
fn tsv_zeros_are_gaps_and_lead_columns_are_known() {
    let plain = "1.5\t2\t3\t0.000\t0.000\t0.000\n0.000\t0\t1\t\t\t\n1\t2\t3\t4\tNaN\t6\n";
    let with_columns = "Frame\tTime\tHead X\tHead Y\tHead Z\tToe X\tToe Y\tToe Z\n\
        11\t0.0\t1.5\t2\t3\t0.000\t0.000\t0.000\n12\t0.1\t0.000\t0\t1\t\t\t\n13\t0.2\t1\t2\t3\t4\tNaN\t6\n";
    for (rows, first) in [(plain, 1), (with_columns, 11)] {
        let motion =
            Format::Tsv.read(format!("{TSV_HEAD}{rows}").as_bytes()).expect("a usable file");
        assert_eq!(labels(&motion), ["Head", "Toe"]);
        let gaps: Vec<bool> = motion.positions_mm.iter().map(|&p| is_gap(p)).collect();
        assert_eq!(gaps, [false, true, false, true, false, true]);
        assert_eq!(motion.frame(0)[0], [1.5, 2.0, 3.0]);
        assert_eq!((motion.info.rate_hz, motion.info.source.first_frame), (60.0, first));
        let events: Vec<_> =
            motion.info.events.iter().map(|e| (e.frame, e.text.as_str())).collect();
        // Frame 2: the second of a file that begins with 1, and before one that begins with 11.
        assert_eq!(events, if first == 1 { vec![(1, "kick")] } else { vec![] });
        let warnings = &motion.info.source.warnings;
        assert!(warnings.len() == 1 && warnings[0].contains("1 sample"), "{warnings:?}");
    }
}

#[test]
fn tsv_column_names_stand_in_for_marker_names() {
    let head = TSV_HEAD.replace("MARKER_NAMES\tHead\tToe\n", "A_X\tA_Y\tA_Z\tB_X\tB_Y\tB_Z\n");
    let motion =
        Format::Tsv.read(format!("{head}1\t2\t3\t4\t5\t6\n").as_bytes()).expect("a usable file");
    assert_eq!(labels(&motion), ["A", "B"]);
    let warnings = &motion.info.source.warnings;
    assert!(warnings.len() == 1 && numbers(&warnings[0]) == [3, 1], "{warnings:?}");
    assert!(Format::Tsv.read(b"1\t2\t3\n").is_err());
    assert!(Format::Tsv.read(TSV_HEAD.replace("3D", "2D").as_bytes()).is_err());
}

#[test]
fn csv_in_the_dialect_with_keys() {
    let text = "# rate=59.94 units=cm up=Z frames=2\ntime,head_x,head_y,head_z,l_hip_x,l_hip_y,l_hip_z\r\n\
        0.0,1,2,3,4,5,6\r\n0.0167,1,2,3,,,\r\n";
    let motion = Format::Csv.read(text.as_bytes()).expect("a usable file");
    assert_eq!(labels(&motion), ["head", "l_hip"]);
    assert_eq!(motion.frame(0), [[10.0, 20.0, 30.0], [40.0, 50.0, 60.0]]);
    assert!(is_gap(motion.frame(1)[1]));
    assert_eq!((motion.info.rate_hz, motion.info.up), (59.94, UpAxis::Z));
    assert_eq!(motion.info.source.warnings, [""; 0]);
}

#[test]
fn csv_without_a_rate_takes_it_from_the_times() {
    let read = |times: &[&str]| {
        let rows: String = times.iter().map(|t| format!("{t},1,2,3\n")).collect();
        Format::Csv.read(format!("time,a_x,a_y,a_z\n{rows}").as_bytes())
    };
    assert_eq!(read(&["0.00", "0.01", "0.02", "0.03"]).expect("even times").info.rate_hz, 100.0);
    let gap = read(&["0.00", "0.01", "0.02", "0.05", "0.06"]).expect("a gap").info;
    assert_eq!((gap.rate_hz, gap.n_frames), (100.0, 7));
    let warnings = &gap.source.warnings;
    assert!(warnings.len() == 1 && warnings[0].contains("2 frames"), "{warnings:?}");
    let uneven = read(&["0.000", "0.010", "0.024", "0.030", "0.040"]).expect("uneven times").info;
    assert_eq!((uneven.rate_hz, uneven.n_frames), (100.0, 5));
    let warnings = &uneven.source.warnings;
    assert!(numbers(&warnings[0]).starts_with(&[2, 4]), "of the intervals: {warnings:?}");
    assert!(read(&["0", "0", "0"]).is_err());
    let one = read(&["0"]).expect("one frame").info;
    assert_eq!((one.rate_hz, one.source.warnings.len()), (100.0, 1));
    let mut reasons = HashSet::new();
    for (text, fact) in [("", ""), ("time,a_x,a_y\n0,1,2\n", "`a_x`, `a_y"), ("1,2\n", "")] {
        let error = Format::Csv.read(text.as_bytes()).expect_err("not usable");
        let InterchangeError::Malformed { format: "csv", message, .. } = error else {
            panic!("{error:?}");
        };
        assert!(message.contains(fact), "{message}");
        assert!(reasons.insert(message.clone()), "said of two files: {message}");
    }
}

#[test]
fn formats_are_recognised_by_extension() {
    for (name, format) in [
        ("a.C3D", Format::C3d),
        ("b.trc", Format::Trc),
        ("c.TSV", Format::Tsv),
        ("d.x.csv", Format::Csv),
    ] {
        assert_eq!(Format::from_extension(name.as_ref()), Some(format));
    }
    assert_eq!(Format::from_extension("c3d".as_ref()), None);
}

#[test]
fn a_motive_export_without_a_rate_gets_it_from_its_times() {
    let motive = |export: &str| {
        format!(
            "Format Version,1.23,Capture Frame Rate,240.000000{export},Length Units,Meters\n\n\
             ,,Marker,Marker,Marker\n,,A,A,A\n,,1,1,1\n,,Position,Position,Position\n\
             Frame,Time (Seconds),X,Y,Z\n0,0.000000,1,2,3\n1,0.010000,1,2,3\n2,0.020000,1,2,3\n"
        )
    };
    for (export, rate_hz, n_frames) in [
        (",Export Frame Rate,100.000000", 100.0, 3),
        // The file may have every other frame of the capture, so the capture's rate does not apply.
        (",Export Frame Rate,0", 100.0, 3),
        (",Export Frame Rate,-1.5", 100.0, 3),
    ] {
        let info = Format::Csv.read(motive(export).as_bytes()).expect("an export").info;
        assert_eq!((info.rate_hz, info.n_frames), (rate_hz, n_frames), "{export}");
    }
    // A file that does not name its rate has the capture's.
    for export in ["", ",Export Frame Rate,"] {
        let info = Format::Csv.read(motive(export).as_bytes()).expect("an export").info;
        assert_eq!(info.rate_hz, 240.0, "{export}");
    }
}
