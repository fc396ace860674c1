//! Invalid arguments: exit code 2, and one line that says what to type.

use super::Folder;
use crate::support::{assert_mentions, jump};

/// A folder with `jump.csv` and `jump.take`, so that only the argument under test is wrong.
fn folder() -> Folder {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(1, 60.0, 0.5));
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    folder
}

#[track_caller]
fn refused_with(folder: &Folder, args: &[&str], facts: &[&str]) {
    assert_mentions(&folder.refuses(args, 2), facts);
}

/// Asserts that a value of an option is refused, in a message with both and with these facts.
#[track_caller]
fn value_refused(folder: &Folder, command: &[&str], option: &str, value: &str, facts: &[&str]) {
    let args = [command, &[option, value]].concat();
    refused_with(folder, &args, &[&[option, value], facts].concat());
}

#[test]
fn tolerances() {
    let folder = folder();
    for (tolerance, facts) in [
        ("0", &["--lossless"][..]),
        ("0mm", &["--lossless"]),
        ("-1mm", &["0.5mm"]),
        ("-1", &["0.5mm"]),
        ("nan", &[]),
        ("inf", &[]),
        ("1e999mm", &[]),
        ("mm", &[]),
        ("1furlong", &["furlong", "um", "mm", "cm", "m"]),
        ("1s", &["s", "um", "mm", "cm", "m"]),
        ("1e-9mm", &["0.0001 mm", "1000 m", "--lossless"]),
        ("2000m", &["0.0001 mm", "1000 m", "--lossless"]),
        ("", &[]),
    ] {
        for command in [
            &["import", "jump.csv", "-o", "new.take"][..],
            &["record", "-d", "serial:/dev/null", "-o", "new.take"],
            &["demo", "--out", "new"],
        ] {
            value_refused(&folder, command, "--tolerance", tolerance, facts);
        }
    }
    // Numbers without a unit are in millimetres.
    folder.run(&["import", "jump.csv", "-o", "new.take", "--tolerance", "5"]).with_code(0);
    assert_eq!(folder.run(&["info", "new.take", "--json"]).json()["tolerance_mm"], 5.0);
}

#[test]
fn distances_of_keys() {
    let folder = folder();
    let import = ["import", "jump.csv", "-o", "new.take"];
    for distance in ["49ms", "1ms"] {
        value_refused(&folder, &import, "--keys", distance, &["50ms or more", "none"]);
    }
    for distance in ["0", "-1s", "soon", "3mm"] {
        value_refused(&folder, &import, "--keys", distance, &[]);
    }
    let whole = [&import[..], &["--resampler", "spline", "--keys", "1s"]].concat();
    refused_with(&folder, &whole, &["--keys", "spline", "one stretch"]);
    // The written take has the interval, and the next run finds it.
    let again = [&import[..3], &["new", "--keys", "250ms"]].concat();
    std::fs::create_dir(folder.path("new")).unwrap();
    folder.run(&again).with_code(0);
    assert_mentions(&folder.run(&again).with_code(0).stdout, &["unchanged"]);
}

#[test]
fn rates_and_lengths() {
    let folder = folder();
    let record = ["record", "-d", "serial:/dev/null", "-o", "new.take"];
    let commands = [&record[..], &["demo", "--out", "new"], &["bench", "pipeline"]];
    for (rate, facts) in [
        ("0", &["1", "10000"][..]),
        ("1e9", &["1", "10000"]),
        ("-60", &["1", "10000"]),
        ("nan", &[]),
        ("60fps", &["fps", "Hz", "kHz"]),
    ] {
        for command in commands {
            value_refused(&folder, command, "--rate", rate, facts);
        }
    }
    for (time, facts) in [
        ("0", &["10s"][..]),
        ("0ms", &["10s"]),
        ("-1", &["10s"]),
        ("1e9h", &["10s"]),
        ("soon", &[]),
        ("1 fortnight", &["fortnight", "ms", "s", "min", "h"]),
    ] {
        for command in commands {
            value_refused(&folder, command, "--seconds", time, facts);
        }
    }
    for (split, facts) in [
        ("10", &["10s", "500MB"][..]),
        ("999ms", &["1s"]),
        ("0s", &["1s"]),
        ("999kB", &["1MB"]),
        ("-1s", &["10s"]),
        ("-1MB", &["2GiB"]),
        ("1 floppy", &["floppy", "ms", "s", "min", "h", "MB", "GiB"]),
    ] {
        value_refused(&folder, &record, "--split", split, facts);
    }
    let stretch = [&record[..], &["--split", "2s", "--stretch", "2500ms"]].concat();
    refused_with(&folder, &stretch, &["--split", "2s", "--stretch", "2.5s"]);
    for output in ["-", "."] {
        let args = ["record", "-d", "serial:/dev/null", "-o", output, "--split", "10s"];
        refused_with(&folder, &args, &["--split", "--output", output]);
    }
    let export = ["export", "jump.take", "-o", "new.csv"];
    value_refused(&folder, &export, "--from", "-1s", &["10s"]);
    let demo = ["demo", "--out", "new", "--seconds", "8000h"];
    refused_with(&folder, &demo, &["28800000", "0.0001", "1000000"]);
    let bench = ["bench", "pipeline", "--seconds", "8000h"];
    refused_with(&folder, &bench, &["200", "1000 Hz", "28800000", "100000000"]);
}

#[test]
fn resamplers() {
    let folder = folder();
    let import = ["import", "jump.csv", "-o", "new.take"];
    let with = |more: &[&'static str]| [&import[..], more].concat();
    let all = ["dense", "fast", "lossless", "spline", "sync"];
    value_refused(&folder, &import, "--resampler", "zip", &all);
    refused_with(
        &folder,
        &with(&["--lossless", "--tolerance", "1mm"]),
        &["--tolerance", "--lossless"],
    );
    refused_with(
        &folder,
        &with(&["--lossless", "--resampler", "fast"]),
        &["--lossless", "--resampler"],
    );
    refused_with(
        &folder,
        &with(&["--resampler", "lossless", "--tolerance", "1mm"]),
        &["lossless", "--tolerance"],
    );
    value_refused(&folder, &import, "--threads", "0", &["1", "256"]);
    for offline in ["spline", "spline:exhaustive", "sync", "sync:exhaustive"] {
        let record = ["record", "-d", "serial:/dev/null", "-o", "new.take", "--resampler", offline];
        refused_with(&folder, &record, &[offline, "dense", "fast", "lossless"]);
    }
}

#[test]
fn file_extensions() {
    let folder = folder();
    folder.write("jump.xyz", "x");
    folder.write("jump", "x");
    for file in ["jump.xyz", "jump", "jump.take"] {
        let facts = [file, ".c3d", ".trc", ".tsv", ".csv"];
        refused_with(&folder, &["import", file, "-o", "new.take"], &facts);
    }
    let verify = ["verify", "jump.take", "--against", "jump.xyz"];
    refused_with(&folder, &verify, &["jump.xyz", ".c3d", ".trc", ".tsv", ".csv"]);
    for file in ["new.xyz", "new", "new.take"] {
        refused_with(
            &folder,
            &["export", "jump.take", "-o", file],
            &[file, ".c3d", ".trc", ".tsv", ".csv", ".npz", ".xdf", ".parquet", ".mcap"],
        );
    }
    for file in ["new.csv", "new.C3D"] {
        let facts = [file, ".take", "mocapd export"];
        refused_with(&folder, &["import", "jump.csv", "-o", file], &facts);
        refused_with(&folder, &["record", "-d", "serial:/dev/null", "-o", file], &facts);
    }
}

#[test]
fn invalid_devices() {
    let folder = Folder::new();
    // The message has the invalid part and the whole argument.
    for (device, part) in [
        ("/dev/ttyUSB0", "serial:/dev/ttyUSB0"),
        ("ttyUSB0", "ttyUSB0"),
        ("tcp:host:1", "'tcp'"),
        ("serial:", "serial:"),
        ("serial:/dev/ttyUSB0@fast", "'fast'"),
        ("serial:/dev/ttyUSB0?baud=9600", "'baud=9600'"),
        ("usb:1:2", "'1'"),
    ] {
        let facts = [
            device,
            part,
            "serial:PATH[@BAUD]",
            "usb:VID:PID[:SERIAL]",
            "qtm:HOST[:PORT]",
            "?driver=NAME",
        ];
        refused_with(&folder, &["record", "-d", device, "-o", "new.take"], &facts);
    }
    let unknown = ["record", "-d", "serial:/dev/null?driver=vicon", "-o", "new.take"];
    refused_with(&folder, &unknown, &["vicon", "dvmc", "ndi", "qtm"]);
}

#[test]
fn errors_of_clap_are_one_line() {
    let folder = folder();
    refused_with(&folder, &["frob"], &["frob", "--help"]);
    refused_with(&folder, &["import"], &["<FILE>", "--help"]);
    refused_with(&folder, &["info", "jump.take", "--jsn"], &["--jsn", "--json"]);
    refused_with(&folder, &["devices", "again.take"], &["again.take"]);
    // Without arguments the program prints its usage.
    for args in [&[][..], &["bench"]] {
        assert!(folder.run(args).with_code(2).stderr.contains("Usage: mocapd"), "{args:?}");
    }
}

#[test]
fn a_take_is_named_take() {
    let folder = folder();
    for name in ["new.foo", "new", "new.take.bak"] {
        for command in [
            &["import", "jump.csv"][..],
            &["recover", "jump.take"],
            &["record", "-d", "serial:/dev/null"],
        ] {
            refused_with(&folder, &[command, &["-o", name]].concat(), &[name, "use .take"]);
        }
    }
}

#[test]
fn a_device_is_named_and_never_selected() {
    let record = ["record", "-d", "auto", "-o", "new.take"];
    refused_with(&folder(), &record, &["auto", "mocapd devices", "serial:/dev/ttyUSB0"]);
}
