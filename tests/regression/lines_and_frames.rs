//! Text files of spreadsheets: rounded times, missing lines, a truncated last number, decimal
//! commas, and a wrong unit.

use mocapd_take::{
    interchange::Format,
    motion::{Motion, is_gap},
};

use crate::{cli::Folder, support::mentions};

/// Two markers at 120 Hz, in a unit of `mm` millimetres.
fn csv(frames: impl Iterator<Item = usize>, mm: f64) -> String {
    let rows = frames.map(|i| {
        let (t, at) = (i as f64 / 120.0, (800.0 + i as f64) / mm);
        format!(
            "{t:.3},{at:.6},{:.6},{:.6},{at:.6},{:.6},{:.6}\n",
            0.4,
            1700.0 / mm,
            0.1,
            900.0 / mm
        )
    });
    format!("time,HEAD_x,HEAD_y,HEAD_z,KNEE_x,KNEE_y,KNEE_z\n{}", rows.collect::<String>())
}

fn read(format: Format, text: &str) -> Motion {
    format.read(text.as_bytes()).unwrap()
}

fn rows_with_gaps(motion: &Motion) -> Vec<usize> {
    let n = motion.info.markers.len();
    let rows = motion.positions_mm.chunks(n).enumerate();
    rows.filter(|(_, row)| row.iter().any(|&at| is_gap(at))).map(|(row, _)| row).collect()
}

#[test]
fn rounded_times_tell_the_rate_and_missing_lines_keep_their_time() {
    let whole = read(Format::Csv, &csv(0..600, 1.0));
    assert_eq!((whole.info.rate_hz, whole.info.n_frames), (120.0, 600));
    let is_there = |i: &usize| ![100, 101, 102, 300].contains(i);
    let text = csv((0..600).filter(is_there), 1.0);
    let motion = read(Format::Csv, &text);
    assert_eq!((motion.info.rate_hz, motion.info.n_frames), (120.0, 600));
    assert_eq!(rows_with_gaps(&motion), [100, 101, 102, 300]);
    assert_eq!(motion.frame(599), whole.frame(599));
    assert!(motion.info.source.warnings.iter().any(|warning| mentions(warning, "4 frames")));
}

#[test]
fn a_number_that_may_be_cut_off_is_not_a_coordinate() {
    let text = csv(0..20, 1.0);
    let whole = read(Format::Csv, &text);
    for n_cut in 1..40 {
        let motion = read(Format::Csv, &text[..text.len() - n_cut]);
        for (frame, row) in motion.positions_mm.chunks(2).enumerate() {
            for (marker, &at) in row.iter().enumerate() {
                let same = at == whole.frame(frame)[marker];
                assert!(
                    is_gap(at) || same,
                    "{n_cut} bytes: frame {frame}, marker {marker}: {at:?}"
                );
            }
        }
        // A line end alone is not a loss.
        let n_more = motion.info.source.warnings.len() - whole.info.source.warnings.len();
        assert!(n_cut > 4 || (n_more > 0) == (n_cut > 1), "{n_cut} bytes");
    }
    let long = "frame,time_s,label,x_mm,y_mm,z_mm\n0,0,A,1.25,2.25,3.25\n1,0.01,A,1.25,2.25,3.2";
    assert_eq!(rows_with_gaps(&read(Format::Csv, long)), [1]);
    let trc = "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n\
        100\t100\t3\t1\tmm\nFrame#\tTime\tA\t\t\n\t\tX1\tY1\tZ1\n1\t0.00\t1.25\t2.25\t903.25\n\
        3\t0.02\t1.25\t2.25\t903.25\n4\t0.03\t1.25\t2.25\t90";
    assert_eq!(rows_with_gaps(&read(Format::Trc, trc)), [1, 3]);
}

#[test]
fn spreadsheets_of_all_locales_are_read() {
    let expected = read(Format::Csv, &csv(0..10, 1.0));
    let commas = csv(0..10, 1.0);
    let quoted: String =
        commas.lines().map(|line| format!("\"{}\"\n", line.replace(',', "\",\""))).collect();
    for text in [
        commas.replace(',', ";").replace('.', ","),
        commas.replace(',', ";"),
        commas.replace(',', "\t"),
        commas.replace(',', "\t").replace('.', ","),
        quoted,
    ] {
        let found = read(Format::Csv, &text);
        assert_eq!(found.positions_mm, expected.positions_mm, "{text}");
        assert_eq!(found.info.markers, expected.info.markers);
        assert_eq!(
            (found.info.rate_hz, &found.info.source.warnings[..]),
            (120.0, &expected.info.source.warnings[..])
        );
    }
    // Commas between thousands are not decimal points.
    let text = "time;A_x;A_y;A_z\n0;1,234;2.5;3\n0.01;1,234;2.5;3\n";
    assert!(is_gap(read(Format::Csv, text).positions_mm[0]));
}

#[test]
fn a_unit_that_is_stated_and_wrong_does_not_destroy_the_motion() {
    let folder = Folder::new();
    folder.write("metres.csv", format!("# units=mm\n{}", csv(0..100, 1000.0)));
    let line = folder.refuses(&["import", "metres.csv", "-o", "a.take"], 2);
    assert!(line.contains("--unit"), "{line}");
    for more in [&["--unit", "m"][..], &["--unit", "mm"], &["--lossless"]] {
        let args = [&["import", "metres.csv", "-o", "a.take"], more].concat();
        folder.run(&args).with_code(0);
        std::fs::remove_file(folder.path("a.take")).unwrap();
    }
    // Millimetres stated as metres get a hint; real metres do not.
    folder.write("far.csv", format!("# units=m\n{}", csv(0..100, 1.0)));
    let ran = folder.run(&["import", "far.csv", "-o", "a.take"]).with_code(0);
    assert!(ran.stderr.contains("--unit"), "{}", ran.stderr);
    folder.write("right.csv", format!("# units=m\n{}", csv(0..100, 1000.0)));
    let ran = folder.run(&["import", "right.csv", "-o", "b.take"]).with_code(0);
    assert!(!ran.stderr.contains("--unit"), "{}", ran.stderr);
}
