//! Every resampler through import, info and verify; round trips of every format.

use mocapd_take::{
    TakeEvent,
    chunk::types,
    motion::{Motion, is_gap},
    reader::read_events,
    record::Header,
};
use serde_json::Value;

use super::Folder;
use crate::support::{assert_mentions, c3d_file::C3dFile, chunks, crowd, jump, places};

fn samples(motion: &Motion) -> u64 {
    motion.positions_mm.iter().filter(|&&position| !is_gap(position)).count() as u64
}

fn header(take: &[u8]) -> Header {
    let mut found = None;
    let read = read_events(take, |event| {
        if let TakeEvent::Header(header) = event {
            found = Some(*header);
        }
        Ok(())
    });
    read.unwrap();
    found.unwrap()
}

#[test]
fn lossless_imports_are_predicted_and_give_back_every_bit() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(7, 60.0, 2.0));
    let import = |take: &str, how: &[&str]| {
        let import = [&["import", "jump.csv", "-o", take, "--json"], how].concat();
        folder.run(&import).with_code(0).json()
    };
    let predicted = import("predicted.take", &["--lossless"]);
    assert_eq!(predicted["resampler"], "lossless:predictive");
    let packed = import("packed.take", &["--resampler", "lossless"]);
    let bytes = |report: &Value| report["file_bytes"].as_u64().unwrap();
    assert!(bytes(&predicted) < bytes(&packed), "{predicted} {packed}");
    let differences = folder.run(&["diff", "predicted.take", "packed.take"]).with_code(1);
    assert_mentions(&differences.stdout, &["no difference", "resampler: lossless"]);
    let again = ["import", "jump.csv", "-o", "again.take", "--lossless", "--threads", "1"];
    folder.run(&again).with_code(0);
    assert_eq!(folder.read("again.take").len() as u64, bytes(&predicted));
}

#[test]
fn every_resampler_respects_its_bound_and_reports_its_results() {
    let folder = Folder::new();
    let motion = jump(7, 60.0, 2.0);
    let n_samples = samples(&motion);
    folder.write_motion("jump.csv", &motion);
    for resampler in [
        "dense",
        "fast",
        "lossless",
        "lossless:predictive",
        "spline:worst-sample",
        "spline:exhaustive",
        "sync:worst-sample",
        "sync:exhaustive",
    ] {
        let take = format!("{}.take", resampler.replace(':', "-"));
        let tolerance_mm = if resampler.starts_with("lossless") { 0.0 } else { 2.0 };
        let mut import =
            vec!["import", "jump.csv", "-o", &take, "--json", "--resampler", resampler];
        if tolerance_mm > 0.0 {
            import.extend(["--tolerance", "0.2cm"]);
        }
        let imported = folder.run(&import).with_code(0).json();
        let info = folder.run(&["info", &take, "--json"]).with_code(0).json();
        let verify = ["verify", &take, "--against", "jump.csv", "--json"];
        let verified = folder.run(&verify).with_code(0).json();
        for report in [&imported, &info] {
            assert_eq!(report["resampler"], resampler);
            assert_eq!(report["tolerance_mm"], tolerance_mm, "{resampler}");
            assert_eq!(report["frames"], 120, "{resampler}");
            assert_eq!(report["samples"], n_samples, "{resampler}");
            assert_eq!(report["raw_bytes"], 12 * n_samples, "{resampler}");
            assert_eq!(report["file_bytes"], folder.read(&take).len(), "{resampler}");
        }
        let against = &verified["against"];
        assert_eq!(against["samples"], n_samples, "{resampler}");
        assert_eq!(against["gaps_differing"], 0, "{resampler}");
        let error = |value: &Value| value.as_f64().unwrap();
        assert!(error(&against["max_error_mm"]) <= error(&info["max_error_mm"]), "{resampler}");
        assert!(error(&info["max_error_mm"]) <= tolerance_mm, "{resampler}");
        let channels = info["channels"].as_array().unwrap();
        let sum = |name: &str| channels.iter().map(|c| c[name].as_u64().unwrap()).sum::<u64>();
        assert_eq!(sum("samples"), n_samples, "{resampler}");
        assert!(sum("gaps") > 10, "{resampler}");
        // SR2 counts kept samples, by its definition.
        let sr2 = (n_samples + 120) as f64 / (2 * sum("knots")) as f64;
        assert!((error(&info["sr2"]) - sr2).abs() < 1e-9, "{resampler}");
        assert!((error(&info["sr1"]) >= 1.0) && (sum("knots") <= n_samples), "{resampler}");
    }
}

#[test]
fn the_bytes_are_the_same_for_any_number_of_threads() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &crowd(8, 60.0, 42.0));
    let take = |threads: &str| {
        let take = format!("{threads}.take");
        let import = ["import", "jump.csv", "-o", &take, "--threads", threads];
        folder.run(&import).with_code(0);
        folder.read(&take)
    };
    let one = take("1");
    let found = chunks(&one);
    assert!(found.finished && found.keys.len() == 5, "{:?}", found.keys);
    assert_eq!(found.blocks.len(), 5 * 3, "150 markers");
    assert!(one == take("2") && one == take("7"), "whole files, header and all");
}

/// A C3D file of a marker at 100 Hz with `n_channels` analog channels of integers, two samples in each of `n_frames`.
pub(super) fn analog_file(n_channels: usize, n_frames: usize) -> Vec<u8> {
    let frame = |i: usize| {
        let point = [i as f32, 200.0, 300.0, 0.0];
        let sample = |k: usize| ((i * (k % 7 + 1) + k * k) % 611) as f32 - 300.0;
        point.into_iter().chain((0..2 * n_channels).map(sample)).collect()
    };
    let mut file = C3dFile::new(1, (0..n_frames).map(frame).collect());
    file.analog = (n_channels, 2);
    file.scale = 0.1;
    file.texts(1, "LABELS", &["head"]);
    file.records.extend(file.group(2, "ANALOG"));
    file.words(2, "USED", &[n_channels as u16]);
    file.floats(2, "RATE", &[200.0]);
    file.floats(2, "GEN_SCALE", &[0.5]);
    file.floats(2, "SCALE", &vec![0.25; n_channels]);
    file.words(2, "OFFSET", &vec![3; n_channels]);
    file.texts(2, "LABELS", &["Fz", "EMG"]);
    file.texts(2, "UNITS", &["N"]);
    file.bytes()
}

#[test]
fn analog_samples_become_sampled_channels() {
    let folder = Folder::new();
    // 21 seconds, so that the last of three blocks is short.
    folder.write("walk.c3d", analog_file(70, 2100));
    for threads in ["1", "2", "7"] {
        let take = format!("{threads}.take");
        folder.run(&["import", "walk.c3d", "-o", &take, "--threads", threads]).with_code(0);
        assert!(folder.read("1.take") == folder.read(&take), "{threads} threads");
    }
    folder.run(&["verify", "1.take"]).with_code(0);
    let report = folder.run(&["info", "1.take", "--json"]).with_code(0).json();
    let groups = report["sampled_groups"].as_array().unwrap();
    let sizes: Vec<_> =
        groups.iter().map(|group| group["channels"].as_array().unwrap().len()).collect();
    assert_eq!(sizes, [64, 6]);
    let [first, ..] = &groups[..] else { panic!("{report}") };
    assert_eq!((&first["form"], &first["rate_hz"]), (&"int16".into(), &200.0.into()));
    assert_eq!((&first["samples"], &first["samples_lost"]), (&4200.into(), &0.into()));
    assert_eq!(
        first["channels"][0],
        serde_json::json!({ "name": "Fz", "unit": "N", "scale": 0.125, "offset": 3.0, "max_error": 0.0 })
    );
    assert_eq!(first["channels"][2]["name"], "A3");
    let info = folder.run(&["info", "1.take", "--markers"]).with_code(0).stdout;
    assert_mentions(&info, &["c3d/analog", "70 channels at 200 Hz", "4 200 samples", "EMG"]);

    // An export has the samples of the file, also of the file that an import of the export gives.
    folder.run(&["export", "1.take", "-o", "whole.c3d"]).with_code(0);
    folder.run(&["import", "whole.c3d", "-o", "again.take"]).with_code(0);
    folder.run(&["export", "again.take", "-o", "again.c3d"]).with_code(0);
    assert!(folder.read("whole.c3d") == folder.read("again.c3d"));

    // A damaged block: its samples are reported and are NaN in an export; everything else is unchanged.
    let mut take = folder.read("1.take");
    let blocks = places(&take).into_iter().filter(|(kind, _)| *kind == types::SAMPLES);
    let second = blocks.clone().nth(1).unwrap().1;
    assert_eq!(blocks.count(), 6);
    take[(second.start + second.end) / 2] ^= 1;
    folder.write("damaged.take", &take);
    let lost = "samples 2000 to 3999 of c3d/analog, channels 1 to 64, are lost";
    for command in [&["info", "damaged.take"][..], &["verify", "damaged.take"]] {
        let ran = folder.run(command);
        assert_mentions(&ran.stderr, &[lost, "NaN"]);
    }
    let info = folder.run(&["info", "damaged.take", "--json"]).with_code(3).json();
    assert_eq!(info["sampled_groups"][0]["samples_lost"], 2000);
    let ran = folder.run(&["export", "damaged.take", "-o", "damaged.c3d"]).with_code(3);
    assert_mentions(&ran.stderr, &[lost]);
    let (whole, damaged) = (folder.read("whole.c3d"), folder.read("damaged.c3d"));
    assert_eq!(whole.len(), damaged.len());
    let nan = f32::NAN.to_le_bytes();
    let words = whole.as_chunks::<4>().0.iter().zip(damaged.as_chunks::<4>().0);
    let changed: Vec<_> = words.filter(|(a, b)| a != b).collect();
    // Samples that happen to have the bits of NaN do not occur.
    assert_eq!(changed.len(), 64 * 2000);
    assert!(changed.iter().all(|(_, found)| **found == nan));
    folder.run(&["recover", "damaged.take", "-o", "recovered.take"]).with_code(3);
    folder.run(&["export", "recovered.take", "-o", "recovered.c3d"]).with_code(3);
    // It has the same samples, and an event that states which are lost.
    let n_nan = |file: &[u8]| file.as_chunks::<4>().0.iter().filter(|word| **word == nan).count();
    assert_eq!(n_nan(&folder.read("recovered.c3d")), n_nan(&damaged));
    let info = folder.run(&["info", "recovered.take"]).stdout;
    assert_mentions(&info, &["2 000 samples of each lost", "were damaged in the file"]);
}

#[test]
fn another_file_or_setting_is_another_take_and_the_same_is_the_same() {
    let folder = Folder::new();
    let motion = jump(12, 60.0, 1.0);
    folder.write_motion("jump.c3d", &motion);
    folder.write("same.c3d", folder.read("jump.c3d"));
    // The samples are the same; the extra byte is not read.
    folder.write("longer.c3d", [folder.read("jump.c3d"), vec![0]].concat());
    folder.write_motion("jump.csv", &motion);
    let mut n_takes = 0;
    let mut import = |file: &str, more: &[&str]| {
        n_takes += 1;
        let take = format!("{n_takes}.take");
        folder.run(&[&["import", file, "-o", &take][..], more].concat()).with_code(0);
        folder.read(&take)
    };
    let plain = import("jump.c3d", &[]);
    assert!(plain == import("jump.c3d", &["--tolerance", "0.5mm", "--resampler", "dense"]));
    assert!(plain == import("jump.c3d", &["--effort", "3"]), "the default");
    let id = |take: &[u8]| header(take).take_id;
    let mut ids = vec![id(&plain)];
    for (file, more) in [
        ("jump.csv", &[][..]),
        ("same.c3d", &[]),
        ("longer.c3d", &[]),
        ("jump.c3d", &["--tolerance", "0.6mm"]),
        ("jump.c3d", &["--resampler", "fast"]),
        ("jump.c3d", &["--lossless"]),
        ("jump.c3d", &["--drop-foreign"]),
        ("jump.c3d", &["--effort", "1"]),
        ("jump.c3d", &["--effort", "5"]),
        ("jump.c3d", &["--keys", "10s"]),
        ("jump.c3d", &["--keys", "250ms"]),
    ] {
        let other = id(&import(file, more));
        assert!(!ids.contains(&other), "{file} {more:?}");
        ids.push(other);
    }
    // A UUID of version 8, without any time of the import or of the file.
    assert!(ids.iter().all(|id| id[6] >> 4 == 8 && id[8] >> 6 == 2));
    assert_eq!(header(&plain).created_unix_ms, 0);
    assert_eq!(folder.run(&["info", "1.take", "--json"]).json()["created"], Value::Null);
    let printed = folder.run(&["info", "1.take"]).with_code(0).stdout;
    assert_mentions(&printed, &[concat!("mocapd ", env!("CARGO_PKG_VERSION"))]);
}

/// An encoder that tries other orders of the markers writes takes whose channel table is not in the order of the file.
#[test]
fn the_benchmark_compares_markers_that_were_coded_in_another_order() {
    let folder = Folder::new();
    // Markers of four limbs, those of a limb far apart.
    let mut motion = jump(12, 60.0, 2.5);
    for (place, position) in motion.positions_mm.iter_mut().enumerate() {
        let (row, marker) = (place / 12, place % 12);
        let (limb, radius, time) = (marker % 4, marker % 4 + marker / 4, row as f32 / 20.0);
        let swing =
            [time.sin(), (1.3 * time + limb as f32).cos(), (0.7 * time * limb as f32).sin()];
        *position = swing.map(|swing| swing * 90.0 * radius as f32);
    }
    folder.write_motion("jump.csv", &motion);
    let setting = ["--resampler", "dense", "--tolerance", "0.5mm", "--effort", "9"];
    folder.run(&[&["import", "jump.csv", "-o", "9.take"][..], &setting].concat()).with_code(0);
    let mut is_reordered = false;
    let read = read_events(&folder.read("9.take")[..], |event| {
        is_reordered |= matches!(event, TakeEvent::Order(order) if !order.is_identity());
        Ok(())
    });
    read.unwrap();
    assert!(is_reordered);
    let bench =
        [&["bench", "codec", "jump.csv", "--repeats", "1", "--json"][..], &setting].concat();
    let result = folder.run(&bench).with_code(0).json()["files"][0]["results"][0].clone();
    let error_mm = result["max_error_mm"].as_f64().unwrap();
    assert!((0.1..=0.5).contains(&error_mm), "{error_mm}");
}

#[test]
fn every_format_comes_back_to_the_bit() {
    let folder = Folder::new();
    folder.write_motion("original.csv", &jump(9, 120.0, 2.0));
    folder.run(&["import", "original.csv", "-o", "original.take", "--lossless"]).with_code(0);
    for format in ["c3d", "trc", "csv"] {
        let (file, take, back) =
            (format!("a.{format}"), format!("{format}.take"), format!("{format}.back.csv"));
        folder.run(&["export", "original.take", "-o", &file]).with_code(0);
        folder.run(&["import", &file, "-o", &take, "--lossless"]).with_code(0);
        folder.run(&["verify", &take, "--against", &file]).with_code(0);
        folder.run(&["verify", &take, "--against", "original.take"]).with_code(0);
        folder.run(&["export", &take, "-o", &back]).with_code(0);
        assert!(folder.text(&back) == folder.text("original.csv"), "{format}");
    }
    // A second round trip: a file written by mocapd is reproduced byte for byte.
    for (file, take, again) in [("a.c3d", "c3d.take", "b.c3d"), ("a.trc", "trc.take", "b.trc")] {
        folder.run(&["export", take, "-o", again]).with_code(0);
        assert!(folder.read(again) == folder.read(file), "{file}");
    }
}

#[test]
fn a_take_that_differs_fails_and_says_where() {
    let folder = Folder::new();
    let mut motion = jump(10, 60.0, 1.0);
    folder.write_motion("a.csv", &motion);
    folder.run(&["import", "a.csv", "-o", "a.take"]).with_code(0);
    let stride = motion.info.markers.len();
    let marker = (0..stride).find(|&m| !is_gap(motion.frame(31)[m])).unwrap();
    motion.positions_mm[31 * stride + marker][2] += 50.0;
    motion.info.markers[0].label = "crown".to_owned();
    folder.write_motion("b.csv", &motion);
    let ran = folder.run(&["verify", "a.take", "--against", "b.csv", "--json"]).with_code(1);
    assert_eq!(ran.stderr.lines().count(), 1, "{}", ran.stderr);
    assert_mentions(&ran.stderr, &["a.take", "b.csv"]);
    let against = &ran.json()["against"];
    assert_eq!(against["within_tolerance"], false);
    assert_eq!((&against["worst_frame"], &against["worst_marker"]), (&31.into(), &marker.into()));
    let error = against["max_error_mm"].as_f64().unwrap();
    assert!((error - 50.0).abs() < 0.6, "{error}");
    assert_eq!(against["labels_differing"][0], "crown");
    let printed = folder.run(&["verify", "a.take", "--against", "b.csv"]).with_code(1).stdout;
    assert_mentions(&printed, &["0.5 mm", "crown"]);
}

#[test]
fn foreign_parts_are_kept_reported_and_dropped_on_request() {
    let folder = Folder::new();
    folder.write_motion("a.c3d", &jump(11, 60.0, 0.5));
    folder.run(&["import", "a.c3d", "-o", "kept.take"]).with_code(0);
    let info = folder.run(&["info", "kept.take"]).with_code(0).stdout;
    assert_mentions(&info, &["c3d/parameters"]);
    let ran = folder.run(&["import", "a.c3d", "-o", "bare.take", "--drop-foreign", "--json"]);
    let ran = ran.with_code(0);
    assert_eq!(ran.stderr.lines().count(), 1, "{}", ran.stderr);
    assert_mentions(&ran.stderr, &["a.c3d", "c3d/parameters"]);
    assert_eq!(ran.json()["foreign_dropped"], serde_json::json!(["c3d/parameters"]));
    let info = folder.run(&["info", "bare.take", "--json"]).with_code(0).json();
    assert_eq!(info["foreign_parts"], serde_json::json!([]));
    // Nothing was left out, so there is no message.
    folder.write("b.csv", "time_s,head.x,head.y,head.z\n0,1,2,3\n0.01,1,2,3\n");
    let ran = folder.run(&["import", "b.csv", "-o", "b.take", "--drop-foreign"]).with_code(0);
    assert_eq!(ran.stderr, "");
    // Another format cannot store them, and the export reports it.
    let ran = folder.run(&["export", "kept.take", "-o", "kept.csv"]).with_code(0);
    assert_eq!(ran.stderr.lines().count(), 1, "{}", ran.stderr);
    assert_mentions(&ran.stderr, &["kept.csv", "c3d/parameters", "z"]);
    assert_eq!(folder.run(&["export", "kept.take", "-o", "kept.c3d"]).with_code(0).stderr, "");
}

/// A C3D file of 16-bit integers with the analog channels Fz, a force plate in N with exact zeros, and EMG, noise in V.
fn plate_file() -> Vec<u8> {
    let mut state = 7_u32;
    let mut noise = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 22) as f32 - 512.0
    };
    let mut frame = |i: usize| {
        let mut samples = vec![i as f32, 200.0, 300.0, 0.0];
        for sample in 2 * i..2 * i + 2 {
            let force = if sample % 400 < 150 { 0.0 } else { 700.0 + (noise() / 20.0).round() };
            samples.extend([force, noise()]);
        }
        samples
    };
    let mut file = C3dFile::new(1, (0..1500).map(&mut frame).collect());
    file.analog = (2, 2);
    file.scale = 0.1;
    file.texts(1, "LABELS", &["head"]);
    file.records.extend(file.group(2, "ANALOG"));
    file.words(2, "USED", &[2]);
    file.floats(2, "RATE", &[200.0]);
    file.floats(2, "GEN_SCALE", &[1.0]);
    file.floats(2, "SCALE", &[0.5, 1.0 / 1024.0]);
    file.words(2, "OFFSET", &[0, 0]);
    file.texts(2, "LABELS", &["Fz", "EMG"]);
    file.texts(2, "UNITS", &["N", "V"]);
    file.bytes()
}

#[test]
fn analog_channels_are_within_a_tolerance_if_one_is_given() {
    let folder = Folder::new();
    folder.write("walk.c3d", plate_file());
    let import = |take: &str, tolerances: &[&str]| {
        let given = tolerances.iter().flat_map(|tolerance| ["--analog-tolerance", tolerance]);
        let all: Vec<&str> = ["import", "walk.c3d", "-o", take].into_iter().chain(given).collect();
        folder.run(&all)
    };
    import("exact.take", &[]).with_code(0);
    let zero = import("zero.take", &["0"]).with_code(0);
    assert_mentions(
        &zero.stderr,
        &["--analog-tolerance 0 changes nothing", "every analog sample is exact"],
    );
    let ran = import("both.take", &["1%", "F?*=2N", "EMG=3count"]).with_code(0);
    assert_mentions(&ran.stdout, &["2 analog channels within 1%, F?*=2N, EMG=3count, not exact"]);
    let [exact, both] = ["exact.take", "both.take"].map(|take| folder.read(take).len());
    assert!(both * 5 < exact * 4, "{both} of {exact} bytes");
    let errors = |take: &str| -> Vec<f64> {
        let report = folder.run(&["info", take, "--json"]).with_code(0).json();
        let channels = report["sampled_groups"][0]["channels"].as_array().unwrap().clone();
        channels.iter().map(|channel| channel["max_error"].as_f64().unwrap()).collect()
    };
    assert_eq!(errors("exact.take"), [0.0, 0.0]);
    assert_eq!(errors("zero.take"), [0.0, 0.0]);
    assert_eq!(errors("both.take"), [2.0, 3.0 / 1024.0]);
    let text = folder.run(&["info", "both.take", "--markers"]).with_code(0).stdout;
    assert_mentions(&text, &["max error", "2.000e0", "2.930e-3"]);

    // Every sample is compared with the source, and with the exact take.
    for original in ["walk.c3d", "exact.take"] {
        let report = folder.run(&["verify", "both.take", "--against", original, "--json"]);
        let analog = report.with_code(0).json()["against"]["analog"].clone();
        assert_eq!((&analog["samples"], &analog["beyond_stated"]), (&6000.into(), &0.into()));
        assert_eq!(analog["channels"][0]["max_error"], 2.0);
        assert!(analog["samples_differing"].as_u64().unwrap() > 3000, "{analog}");
    }
    // The exact take does not state an error, so that of the other one is too large for it.
    folder.run(&["export", "both.take", "-o", "both.c3d"]).with_code(0);
    let ran = folder.run(&["verify", "exact.take", "--against", "both.c3d"]).with_code(1);
    assert_mentions(&ran.stdout, &["ERROR ABOVE the one that the channel states"]);

    // Exports say so, and have the samples of the take; edited takes state the bounds, and replace nothing again.
    for output in ["again.c3d", "again.npz"] {
        let ran = folder.run(&["export", "both.take", "-o", output]).with_code(0);
        assert_mentions(
            &ran.stderr,
            &["within a tolerance: Fz within 2.000e0 N, EMG within 2.930e-3 V"],
        );
    }
    folder.run(&["verify", "both.take", "--against", "again.c3d"]).with_code(0);
    folder.run(&["cut", "both.take", "--from", "1s", "--to", "9s", "-o", "cut.take"]).with_code(0);
    assert_eq!(errors("cut.take"), [2.0, 3.0 / 1024.0]);
    let ran = folder.run(&["verify", "cut.take", "--against", "walk.c3d", "--json"]);
    // The source has more frames; of those that both have, every sample is within the bounds.
    let analog = ran.with_code(1).json()["against"]["analog"].clone();
    assert_eq!((&analog["samples"], &analog["beyond_stated"]), (&3200.into(), &0.into()));

    // The same import is done already, one with another tolerance is another take, and mistakes list the channels.
    std::fs::create_dir(folder.path("takes")).unwrap();
    let unchanged = |tolerance: &str| {
        let tolerances = ["--analog-tolerance", tolerance, "--json"];
        let all = [&["import", "walk.c3d", "-o", "takes/"][..], &tolerances].concat();
        folder.run(&all).json()["unchanged"] == true
    };
    assert!(!unchanged("1count"));
    assert!(unchanged("1count"));
    for (wrong, code, why) in [
        ("EKG*=1", 1, "Fz (N), EMG (V)"),
        ("0.5N", 1, "EMG is in `V`, not in `N`"),
        ("much", 2, "expected [PATTERN=]VALUE"),
    ] {
        let ran = import("wrong.take", &[wrong]).with_code(code);
        assert_mentions(&ran.stderr, &[why]);
    }
}

/// A take that has lost the parameters of its file states names, units and scales of analog channels nevertheless.
#[test]
fn analog_samples_keep_their_units_without_the_parameters() {
    let folder = Folder::new();
    folder.write("walk.c3d", plate_file());
    folder.run(&["import", "walk.c3d", "-o", "walk.take"]).with_code(0);
    let mut take = folder.read("walk.take");
    let parameters = places(&take).into_iter().find(|(kind, _)| *kind == types::FOREIGN).unwrap().1;
    take[(parameters.start + parameters.end) / 2] ^= 1;
    folder.write("damaged.take", &take);
    folder.run(&["recover", "damaged.take", "-o", "recovered.take"]).with_code(3);
    for damaged in ["damaged.take", "recovered.take"] {
        let output = damaged.replace("take", "c3d");
        let ran = folder.run(&["export", damaged, "-o", &output]).with_code(3);
        assert_mentions(&ran.stderr, &["the parameters of the C3D file are missing"]);
        let again = damaged.replace(".take", "-again.take");
        folder.run(&["import", &output, "-o", &again]).with_code(0);
        let channels = |take: &str| {
            let report = folder.run(&["info", take, "--json"]).with_code(0).json();
            report["sampled_groups"][0]["channels"].clone()
        };
        assert_eq!(channels(&again), channels("walk.take"));
        // So do takes that are made from it.
        if damaged == "recovered.take" {
            let part = ["cut", damaged, "--from", "1s", "--to", "9s", "-o", "part.take"];
            folder.run(&part).with_code(0);
            folder.run(&["repack", damaged, "-o", "repacked/"]).with_code(0);
            folder.run(&["concat", "part.take", "part.take", "-o", "joined.take"]).with_code(0);
            for made in ["part.take", "repacked/recovered.take", "joined.take"] {
                assert_eq!(channels(made), channels("walk.take"), "{made}");
            }
        }
    }
}
