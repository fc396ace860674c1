//! TRC with zeros for gaps, TRC separated by spaces and commas, Motive's CSV, and a CSV of one frame.

use mocapd_take::{
    interchange::Format,
    motion::{Ambiguity, Motion, is_gap},
};

use crate::cli::Folder;

fn labels(motion: &Motion) -> Vec<&str> {
    motion.info.markers.iter().map(|marker| marker.label.as_str()).collect()
}

/// A TRC file of two markers and four frames, with something between its cells.
fn trc(between: &str) -> String {
    let head = "PathFileType 4 (X/Y/Z) walk.trc\n\
        DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame OrigNumFrames\n\
        100 100 4 2 mm 100 1 4\n";
    let empty = if between == " " { "" } else { &between.repeat(2) };
    let rows = (0..4).map(|i| format!("{} 0.0{i} {i}.5 100 1700 {} 200 900\n", i + 1, 300 + i));
    let body = format!("Frame# Time HEAD{empty} KNEE{empty}\n")
        + if between == " " { "" } else { "  " }
        + "X1 Y1 Z1 X2 Y2 Z2\n\n"
        + &rows.collect::<String>();
    (head.to_owned() + &body).replace(' ', between)
}

#[test]
fn zeros_in_a_trc_are_gaps_while_other_markers_move() {
    let text = trc("\t")
        .replace("301\t200\t900", "0\t0\t0")
        .replace("302\t200\t900", "0.000\t0.000\t0.000");
    let motion = Format::Trc.read(text.as_bytes()).unwrap();
    let gaps: Vec<bool> = (0..4).map(|frame| is_gap(motion.frame(frame)[1])).collect();
    assert_eq!(gaps, [false, true, true, false]);
    assert_eq!(motion.info.source.ambiguities, [Ambiguity::Origin { samples: 2, gaps: true }]);
    assert_eq!(motion.frame(3), [[3.5, 100.0, 1700.0], [303.0, 200.0, 900.0]]);
}

#[test]
fn trc_separated_by_spaces_or_commas_reads_like_trc_with_tabs() {
    let expected = Format::Trc.read(trc("\t").as_bytes()).unwrap();
    assert_eq!(labels(&expected), ["HEAD", "KNEE"]);
    assert_eq!(expected.info.source.warnings, [""; 0]);
    for between in [",", ";", " ", "   "] {
        let text =
            if between.trim().is_empty() { trc(" ").replace(' ', between) } else { trc(between) };
        let found = Format::Trc.read(text.as_bytes()).unwrap();
        assert_eq!(found.info.source.warnings, [""; 0], "{text}");
        assert_eq!(labels(&found), labels(&expected), "{text}");
        assert_eq!(found.positions_mm, expected.positions_mm, "{text}");
        assert_eq!(found.info.rate_hz, 100.0, "{text}");
    }
}

#[test]
fn a_space_separated_row_that_lacks_a_marker_is_a_gap() {
    // HEAD is not seen in the third frame: it has no cells, and those of KNEE would be taken for them.
    let text = trc(" ").replace("2.5 100 1700 302", "   302");
    let motion = Format::Trc.read(text.as_bytes()).unwrap();
    assert_eq!(labels(&motion), ["HEAD", "KNEE"]);
    let gaps: Vec<bool> = motion.positions_mm.iter().map(|&at| is_gap(at)).collect();
    assert_eq!(gaps, [false, false, false, false, true, true, false, false]);
    assert_eq!(motion.info.source.warnings.len(), 1, "{:?}", motion.info.source.warnings);
    // Where the figures disagree, the rows decide; if no row has the cells of all markers, nothing can.
    for markers in ["3", "0"] {
        let text = text.replace("100 100 4 2 mm", &format!("100 100 4 {markers} mm"));
        let found = Format::Trc.read(text.as_bytes()).unwrap();
        assert_eq!(found.frame(3), motion.frame(3));
        assert!(is_gap(found.frame(2)[0]));
    }
    let short = (0..4).fold(trc(" "), |text, i| text.replace(&format!(" {i}.5 100 1700"), "   "));
    Format::Trc.read(short.as_bytes()).unwrap_err();
    // A label that contains a space does not shift the others to wrong markers.
    let named = Format::Trc.read(trc(" ").replace("HEAD", "L HEAD").as_bytes()).unwrap();
    assert_eq!(labels(&named), ["u001", "u002"]);
    assert_eq!(named.frame(3), motion.frame(3));
}

#[test]
fn a_line_with_another_separator_is_a_gap() {
    for between in ["\t", ",", ";"] {
        let row = |i: usize| format!("{} 0.0{i} {i}.5 100 1700 {} 200 900", i + 1, 300 + i);
        let text = trc(between).replace(&row(2).replace(' ', between), "3 0.02 302 200 900");
        let motion = Format::Trc.read(text.as_bytes()).unwrap();
        let gaps: Vec<bool> = motion.positions_mm.iter().map(|&at| is_gap(at)).collect();
        assert_eq!(gaps, [false, false, false, false, true, true, false, false], "{between}");
        assert_eq!(motion.info.source.warnings.len(), 1, "{:?}", motion.info.source.warnings);
    }
    // All rows between spaces below labels between tabs are a file that is consistent in itself.
    let expected = Format::Trc.read(trc("\t").as_bytes()).unwrap();
    let (head, rows) =
        trc("\t").split_once("\n1\t").map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
    let text = head + "\n1 " + &rows.replace('\t', " ");
    let found = Format::Trc.read(text.as_bytes()).unwrap();
    assert_eq!(found.positions_mm, expected.positions_mm);
}

/// Motive's export, whose header rows have titles or not.
fn motive(is_named: bool, columns: &[[&str; 4]], rows: &[&str]) -> String {
    let line = |lead: &str, field: usize| {
        let cells: Vec<&str> = columns.iter().map(|column| column[field]).collect();
        format!("{lead}{}\n", cells.join(","))
    };
    let lead = |name: &str| if is_named { format!(",{name},") } else { ",,".to_owned() };
    "\u{FEFF}Format Version,1.23,Take Name,\"A, take\",Take Notes,,Capture Frame Rate,240.000000,Export Frame Rate,120.000000,\
     Capture Start Time,2020-02-02 02.02.02.222 PM,Capture Start Frame,0,Total Frames in Take,3,Total Exported Frames,3,\
     Rotation Type,Quaternion,Length Units,Meters,Coordinate Space,Global\r\n\r\n"
        .to_owned()
        + &line(&lead("Type"), 0)
        + &line(&lead("Name"), 1)
        + &line(&lead("ID"), 2).replace("R1", "\"1F,2\"")
        + &if is_named { line(",Parent,", 2) } else { String::new() }
        + &line(",,", 3)
        + &line("Frame,Time (Seconds),", 3)
            .replace("Rotation,Rotation,Rotation,Rotation", "X,Y,Z,W")
            .replace("Position,Position,Position", "X,Y,Z")
            .replace("Mean Marker Error", "")
            .replace("Marker Quality", "")
        + &rows.iter().map(|row| format!("{row}\r\n")).collect::<String>()
}

#[test]
fn motive_exports_are_read() {
    let three =
        |kind: &'static str, name: &'static str| [[kind, name, "M1", "Position"]; 3].to_vec();
    let mut columns = [["Rigid Body", "Wand", "R1", "Rotation"]; 4].to_vec();
    columns.extend([["Rigid Body", "Wand", "R1", "Position"]; 3]);
    columns.push(["Rigid Body", "Wand", "R1", "Mean Marker Error"]);
    columns.extend(three("Rigid Body Marker", "Wand:Marker1"));
    columns.push(["Rigid Body Marker", "Wand:Marker1", "M1", "Marker Quality"]);
    columns.extend(three("Marker", "Wand:Marker1"));
    columns.extend(three("Marker", "Unlabeled 1189"));
    let rows = [
        "7,0.000000,0,0,0,1,0.1,0.2,0.3,0.001,9,9,9,1,1.5,0.25,-0.5,,,",
        "8,0.008333,0,0,0,1,0.1,0.2,0.3,0.001,9,9,9,1,,,,0.5,0.5,0.5",
        "9,0.016667,,,,,,,,,,,,,1.6,0.25,-0.5,0.5,0.5,0.5",
    ];
    for is_named in [true, false] {
        let motion = Format::Csv.read(motive(is_named, &columns, &rows).as_bytes()).unwrap();
        assert_eq!(labels(&motion), ["Wand", "Wand:Marker1", "Unlabeled 1189"], "{is_named}");
        let labelled: Vec<bool> = motion.info.markers.iter().map(|m| m.labelled).collect();
        assert_eq!(labelled, [true, true, false]);
        assert_eq!((motion.info.rate_hz, motion.n_frames()), (120.0, 3));
        let source = &motion.info.source;
        assert_eq!(
            (source.unit.as_str(), source.factor, source.first_frame),
            ("Meters", 1000.0, 7)
        );
        assert_eq!(motion.frame(0)[..2], [[100.0, 200.0, 300.0], [1500.0, 250.0, -500.0]]);
        let gaps: Vec<bool> = motion.positions_mm.iter().map(|&at| is_gap(at)).collect();
        assert_eq!(gaps, [false, false, true, false, true, false, true, false, false]);
        // Duplicates, a rigid body's position and omitted columns each get a warning.
        let has_warning =
            |start: &str| source.warnings.iter().any(|warning| warning.starts_with(start));
        assert_eq!(source.warnings.len(), 3, "{:?}", source.warnings);
        assert!(has_warning("1 marker") && has_warning("6 columns"), "{:?}", source.warnings);
    }
    let folder = Folder::new();
    folder.write("motive.csv", motive(true, &columns, &rows));
    folder.run(&["import", "motive.csv", "-o", "motive.take"]).with_code(0);
    folder.run(&["verify", "motive.take", "--against", "motive.csv"]).with_code(0);
}

#[test]
fn a_csv_of_one_frame_of_our_own_is_read() {
    let folder = Folder::new();
    folder.write("two.csv", "# rate=100\nframe,time_s,a.x,a.y,a.z\n4,0,1,2,3\n5,0.01,4,5,6\n");
    folder.run(&["import", "two.csv", "-o", "two.take", "--lossless"]).with_code(0);
    for layout in ["wide", "long"] {
        let (csv, take) = (format!("{layout}.csv"), format!("{layout}.take"));
        let export = ["export", "two.take", "-o", &csv, "--layout", layout, "--to", "0.01s"];
        folder.run(&export).with_code(0);
        folder.run(&["import", &csv, "-o", &take, "--lossless"]).with_code(0);
        let info = folder.run(&["info", &take, "--json"]).with_code(0).json();
        assert_eq!((&info["frames"], &info["source"]["first_frame"]), (&1.into(), &4.into()));
        folder.run(&["verify", &take, "--against", &csv]).with_code(0);
    }
}

#[test]
fn samples_of_a_long_csv_before_the_first_and_after_the_last_time_are_kept() {
    let head = "frame,time_s,label,x_mm,y_mm,z_mm\n";
    let rows =
        "2,,a,2,0,0\n3,,a,3,0,0\n4,0.04,a,4,0,0\n5,0.05,a,5,0,0\n6,0.06,a,6,0,0\n8,,a,8,0,0\n";
    let read = |rows: &str| Format::Csv.read(format!("{head}{rows}").as_bytes());
    let motion = read(rows).unwrap();
    assert_eq!((motion.n_frames(), motion.info.source.first_frame), (7, 2));
    assert_eq!((motion.info.rate_hz, motion.info.n_frames), (100.0, 7));
    let x: Vec<f32> = motion.positions_mm.iter().map(|at| at[0]).filter(|x| !x.is_nan()).collect();
    assert_eq!(x, [2.0, 3.0, 4.0, 5.0, 6.0, 8.0]);
    // A single time among several frames gives no rate; a single frame needs none.
    read("4,0.04,a,4,0,0\n5,,a,5,0,0\n").unwrap_err();
    assert_eq!(read("4,,a,4,0,0\n").unwrap().n_frames(), 1);
    read("").unwrap_err();
}

#[test]
fn a_csv_with_zeros_for_missing_markers_gets_a_warning() {
    let rows: String = (0..20)
        .map(|i| {
            let a = if i % 7 == 3 { "0,0,0".to_owned() } else { format!("{},500,900", 100 + i) };
            format!("{i},{},{a},{},2,3\n", f64::from(i) / 100.0, 50 + i)
        })
        .collect();
    let csv = format!("frame,time_s,a.x,a.y,a.z,b.x,b.y,b.z\n{rows}");
    let motion = Format::Csv.read(csv.as_bytes()).unwrap();
    assert_eq!(
        motion.info.source.ambiguities,
        [Ambiguity::Origin { samples: 3, gaps: false }],
        "{:?}",
        motion.info.source.warnings
    );
    // They are kept: our own format marks gaps otherwise.
    assert_eq!(motion.frame(3)[0], [0.0; 3]);
}

/// A QTM export of two markers and three frames.
fn tsv() -> String {
    let head = "NO_OF_FRAMES\t3\nNO_OF_MARKERS\t2\nFREQUENCY\t59.94\nDESCRIPTION\t1,5 m, wall to wall\n\
        DATA_INCLUDED\t3D\nMARKER_NAMES\tHEAD\tKNEE 1,2\n";
    let row = |i: i32| format!("{i}.125\t-200.5\t1700.250\t{}\t0.5\t900.000\n", 300 + i);
    head.to_owned() + &(0..3).map(row).collect::<String>()
}

#[test]
fn decimal_commas_between_tabs_read_like_points() {
    let with_commas = |text: &str| -> String {
        let is_digit = |c: Option<&u8>| c.is_some_and(u8::is_ascii_digit);
        let bytes = text.as_bytes();
        let at = |i: usize| match bytes[i] {
            b'.' if is_digit(bytes.get(i.wrapping_sub(1))) && is_digit(bytes.get(i + 1)) => b',',
            byte => byte,
        };
        String::from_utf8((0..bytes.len()).map(at).collect()).unwrap()
    };
    for (format, text) in [(Format::Tsv, tsv()), (Format::Trc, trc("\t"))] {
        let expected = format.read(text.as_bytes()).unwrap();
        let found = format.read(with_commas(&text).as_bytes()).unwrap();
        assert_eq!(found.positions_mm, expected.positions_mm, "{text}");
        assert_eq!(labels(&found), labels(&expected));
        assert_eq!(found.info.rate_hz, expected.info.rate_hz);
        assert_eq!(found.info.source.warnings, [""; 0]);
    }
    // Beside a number with a point, commas separate thousands, which are not supported.
    let mixed = tsv().replace("-200.5", "-1,200");
    let motion = Format::Tsv.read(mixed.as_bytes()).unwrap();
    assert!((0..3).all(|frame| is_gap(motion.frame(frame)[0])));
}

#[test]
fn rows_that_are_no_numbers_are_named() {
    let text = tsv().replace(".125\t", "x125\t");
    let error = Format::Tsv.read(text.as_bytes()).unwrap_err().to_string();
    assert!(error.starts_with("tsv line 7: expected a row of numbers, found `0x125`"), "{error}");
}

#[test]
fn a_file_of_another_format_is_recognised() {
    let c3d = [&[2, 0x50][..], &[0; 600]].concat();
    let utf_16: Vec<u8> =
        "\u{feff}NO_OF_FRAMES".encode_utf16().flat_map(u16::to_le_bytes).collect();
    for (format, bytes, expected) in [
        (Format::Csv, &c3d[..], "looks like c3d: name it .c3d, or give --format c3d"),
        (Format::Tsv, &utf_16, "looks like text in UTF-16: save it as UTF-8"),
        (Format::C3d, tsv().as_bytes(), "looks like tsv"),
        (Format::Trc, tsv().as_bytes(), "looks like tsv"),
        (Format::Tsv, trc("\t").as_bytes(), "looks like trc"),
        (Format::Trc, b"PK\x03\x04\x14\0\0\0", "looks like a ZIP archive"),
        (Format::Csv, b"\x89TAK\r\n\x1a\n", "looks like a take"),
        (Format::Trc, b"a\0b", "looks like binary data"),
    ] {
        let error = format.read(bytes).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert!(error.len() < 300, "{error}");
    }
}

#[test]
fn format_names_the_format_of_a_file_with_another_extension() {
    let folder = Folder::new();
    folder.write("walk.txt", tsv());
    let refused = folder.refuses(&["import", "walk.txt"], 2);
    assert!(refused.contains("unknown file extension"), "{refused}");
    let imported = folder.run(&["import", "walk.txt", "--format", "tsv", "-o", "walk.take"]);
    assert_eq!(imported.code, Some(0), "{}", imported.stderr);
    folder.write("walk.trc", trc("\t"));
    let refused = folder.refuses(&["export", "walk.trc", "-o", "walk.html"], 2);
    assert!(refused.contains("import it first: mocapd import walk.trc"), "{refused}");
}
