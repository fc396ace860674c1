//! Arguments that cannot be meant: exit code 2, and a line that says what to type.

use super::Folder;
use crate::support::jump;

/// A folder with `jump.csv` and `jump.take`, so that only the argument under test is wrong.
fn folder() -> Folder {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(1, 60.0, 0.5));
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    folder
}

#[track_caller]
fn refused_with(folder: &Folder, args: &[&str], words: &[&str]) {
    let line = folder.refuses(args, 2);
    for word in words {
        assert!(line.contains(word), "{args:?}: '{word}' is not in: {line}");
    }
}

#[test]
fn tolerances() {
    let folder = folder();
    for (tolerance, words) in [
        ("0", &["--lossless"][..]),
        ("0mm", &["--lossless"]),
        ("-1mm", &["cannot be negative", "0.5mm"]),
        ("-1", &["cannot be negative"]),
        ("nan", &["'nan' does not begin with a number"]),
        ("inf", &["'inf' does not begin with a number"]),
        ("1e999mm", &["not a finite number"]),
        ("mm", &["does not begin with a number"]),
        ("1furlong", &["'furlong' is no unit of length", "um, mm, cm or m"]),
        ("1s", &["'s' is no unit of length"]),
        ("1e-9mm", &["outside 0.0001 mm", "--lossless"]),
        ("2000m", &["outside 0.0001 mm"]),
        ("", &["--tolerance"]),
    ] {
        for command in [
            &["import", "jump.csv", "-o", "new.take"][..],
            &["record", "-d", "serial:/dev/null", "-o", "new.take"],
            &["demo", "--out", "new"],
        ] {
            refused_with(&folder, &[command, &["--tolerance", tolerance]].concat(), words);
        }
    }
    // A bare number is millimetres.
    folder.run(&["import", "jump.csv", "-o", "new.take", "--tolerance", "5"]).with_code(0);
    assert_eq!(folder.run(&["info", "new.take", "--json"]).json()["tolerance_mm"], 5.0);
}

#[test]
fn rates_and_lengths() {
    let folder = folder();
    let record = ["record", "-d", "serial:/dev/null", "-o", "new.take"];
    for (rate, word) in [
        ("0", "use 1 to 10000"),
        ("1e9", "use 1 to 10000"),
        ("-60", "use 1 to 10000"),
        ("nan", "does not begin with a number"),
        ("60fps", "use Hz or kHz"),
    ] {
        refused_with(&folder, &[&record[..], &["--rate", rate]].concat(), &[word]);
        refused_with(&folder, &["demo", "--out", "new", "--rate", rate], &[word]);
        refused_with(&folder, &["bench", "pipeline", "--rate", rate], &[word]);
    }
    for (time, word) in [
        ("0", "give something like 10s"),
        ("0ms", "give something like 10s"),
        ("-1", "give something like 10s"),
        ("1e9h", "give something like 10s"),
        ("soon", "does not begin with a number"),
        ("1 fortnight", "use ms, s, min or h"),
    ] {
        refused_with(&folder, &[&record[..], &["--seconds", time]].concat(), &[word]);
        refused_with(&folder, &["demo", "--out", "new", "--seconds", time], &[word]);
        refused_with(&folder, &["bench", "pipeline", "--seconds", time], &[word]);
    }
    refused_with(&folder, &["export", "jump.take", "-o", "new.csv", "--from", "-1s"], &["10s"]);
    refused_with(&folder, &["demo", "--out", "new", "--seconds", "8000h"], &["expected 0.0001 to"]);
    refused_with(&folder, &["bench", "pipeline", "--seconds", "8000h"], &["ask for less time"]);
}

#[test]
fn resamplers() {
    let folder = folder();
    let import = ["import", "jump.csv", "-o", "new.take"];
    let with = |more: &[&'static str]| [&import[..], more].concat();
    refused_with(&folder, &with(&["--resampler", "zip"]), &["'zip'", "dense, fast, lossless"]);
    refused_with(
        &folder,
        &with(&["--lossless", "--tolerance", "1mm"]),
        &["--tolerance", "--lossless"],
    );
    refused_with(&folder, &with(&["--lossless", "--resampler", "fast"]), &["--lossless"]);
    refused_with(
        &folder,
        &with(&["--resampler", "lossless", "--tolerance", "1mm"]),
        &["leave --tolerance out"],
    );
    refused_with(&folder, &with(&["--threads", "0"]), &["1..=256"]);
    for offline in ["spline", "spline:exhaustive", "sync", "sync:exhaustive"] {
        let record = ["record", "-d", "serial:/dev/null", "-o", "new.take", "--resampler", offline];
        refused_with(&folder, &record, &["works on whole takes", "dense, fast or lossless"]);
    }
}

#[test]
fn endings() {
    let folder = folder();
    folder.write("jump.xyz", "x");
    folder.write("jump", "x");
    for file in ["jump.xyz", "jump", "jump.take"] {
        let words = [file, "use .c3d, .trc, .tsv or .csv"];
        refused_with(&folder, &["import", file, "-o", "new.take"], &words);
    }
    refused_with(&folder, &["verify", "jump.take", "--against", "jump.xyz"], &["jump.xyz", ".c3d"]);
    for file in ["new.xyz", "new", "new.take"] {
        refused_with(
            &folder,
            &["export", "jump.take", "-o", file],
            &[file, "use .c3d, .trc, .tsv, .csv, .npz, .xdf, .parquet or .mcap"],
        );
    }
    for file in ["new.csv", "new.C3D"] {
        let words = [file, "call it .take"];
        refused_with(&folder, &["import", "jump.csv", "-o", file], &words);
        refused_with(&folder, &["record", "-d", "serial:/dev/null", "-o", file], &words);
    }
}

#[test]
fn devices_that_are_none() {
    let folder = Folder::new();
    for (device, word) in [
        ("/dev/ttyUSB0", "serial:/dev/ttyUSB0"),
        ("ttyUSB0", "no scheme"),
        ("tcp:host:1", "'tcp'"),
        ("serial:", "path is missing"),
        ("serial:/dev/ttyUSB0@fast", "no baud rate"),
        ("serial:/dev/ttyUSB0?baud=9600", "driver=NAME"),
        ("usb:1:2", "four hexadecimal digits"),
        ("serial:/dev/null?driver=vicon", "no driver is called 'vicon': use one of dvmc"),
    ] {
        refused_with(&folder, &["record", "-d", device, "-o", "new.take"], &[word]);
    }
}

#[test]
fn what_clap_refuses_is_one_line_too() {
    let folder = folder();
    refused_with(&folder, &["frob"], &["'frob'", "try --help"]);
    refused_with(&folder, &["import"], &["--output <TAKE>", "<FILE>", "try --help"]);
    refused_with(&folder, &["info", "jump.take", "--jsn"], &["'--jsn'", "--json"]);
    refused_with(&folder, &["info", "jump.take", "again.take"], &["again.take"]);
    // Nothing at all is a question, not an error.
    for args in [&[][..], &["bench"]] {
        assert!(folder.run(args).with_code(2).stderr.contains("Usage: mocapd"), "{args:?}");
    }
}
