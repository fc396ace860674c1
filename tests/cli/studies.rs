//! `study`, and the derivative errors of `verify`.

use mocapd_acquire::files::{FileError, NameTaken};
use mocapd_report::phases::NoJump;
use mocapd_simulator::generator::JumpSpec;
use serde_json::Value;

use super::Folder;
use crate::support::{assert_mentions, jump};

/// One generated trial at 60 Hz, without gaps.
fn folder() -> Folder {
    let folder = Folder::new();
    folder.write_motion("jump.c3d", &JumpSpec::new(1, 60.0).generate().unwrap().motion);
    folder
}

fn cell<'a>(study: &'a Value, piece: &str, resampler: &str, tolerance_mm: f64) -> &'a Value {
    let mut cells = study["cells"].as_array().unwrap().iter();
    let found = cells.find(|cell| {
        cell["piece"] == piece
            && cell["resampler"] == resampler
            && cell["tolerance_mm"] == tolerance_mm
    });
    found.unwrap_or_else(|| panic!("no cell of {piece}, {resampler}, {tolerance_mm} mm"))
}

#[test]
fn the_figures_are_those_of_info() {
    let folder = folder();
    let study = |more: &[&str]| {
        folder.run(&[&["study", "jump.c3d", "--json"], more].concat()).with_code(0).json()
    };
    // The exhaustive search is slow where many samples are kept.
    let exhaustive = study(&["--tolerances", "20mm"]);
    let study = study(&["--exhaustive", "0"]);
    // A study takes `dense` as recordings do, without looking ahead.
    for (resampler, tolerance, more) in
        [("spline:worst-sample", "10mm", &[][..]), ("dense", "1mm", &["--effort", "1"][..])]
    {
        let import = ["import", "jump.c3d", "-o", "jump.take", "--drop-foreign"];
        let settings = ["--resampler", resampler, "--tolerance", tolerance];
        folder.run(&[&import[..], &settings, more].concat()).with_code(0);
        let info = folder.run(&["info", "jump.take", "--json"]).with_code(0).json();
        let mm = tolerance.trim_end_matches("mm").parse().unwrap();
        let whole = cell(&study, "whole", resampler, mm);
        for name in ["sr1", "sr2"] {
            assert_eq!(whole[name], info[name], "{resampler}: {name}");
        }
        let knots: u64 =
            info["channels"].as_array().unwrap().iter().map(|c| c["knots"].as_u64().unwrap()).sum();
        assert_eq!(whole["kept"], knots);
        // An import also stores the name of its file, its warnings and its id.
        let (here, there) =
            (whole["file_bytes"].as_u64().unwrap(), info["file_bytes"].as_u64().unwrap());
        assert!(here.abs_diff(there) < 200, "{here} {there}");
        std::fs::remove_file(folder.path("jump.take")).unwrap();
    }
    assert_eq!(cell(&study, "take-off", "spline:worst-sample", 1.0)["paper_sr2"], 2.01);
    assert_eq!(cell(&study, "first 350", "spline:worst-sample", 10.0)["paper_sr2"], 4.6);
    // The exhaustive reading was tried, and the take-off compresses least.
    assert!(
        cell(&exhaustive, "settling", "spline:exhaustive", 20.0)["kept"].as_u64().unwrap() >= 30
    );
    assert_eq!(study["claims"][0]["holds"], true, "{}", study["claims"]);
    assert_eq!(study["claims"][2]["holds"], true, "{}", study["claims"]);
}

#[test]
fn its_folder_has_tables_figures_and_reusable_phases() {
    let folder = folder();
    let args = ["study", "jump.c3d", "--tolerances", "10mm", "--exhaustive", "0"];
    let printed = folder.run(&[&args[..], &["--out", "out"]].concat()).with_code(0).stdout;
    assert_eq!(folder.text("out/study.md"), printed);
    for name in
        ["study.csv", "trials.csv", "sr2-by-phase.svg", "figure-2-take-off.svg", "figure-3.svg"]
    {
        assert!(folder.read(&format!("out/{name}")).len() > 500, "{name}");
    }
    let with = [&args[..], &["--phases", "out/phases.csv", "--threads", "2"]].concat();
    assert_eq!(folder.run(&with).with_code(0).stdout, printed, "the same phases, the same tables");
    let exists = NameTaken { path: "out".into() }.to_string();
    assert_eq!(folder.refuses(&[&args[..], &["--out", "out"]].concat(), 1), exists);

    folder.write("few.csv", "file,phase,first_frame\njump.c3d,walking,300\n");
    let few = [&args[..], &["--phases", "few.csv", "--json"]].concat();
    let few = folder.run(&few).with_code(0).json();
    assert_eq!(few["takes"][0]["phases"][0]["first_frame"], 300);
    assert_eq!(few["claims"][0]["holds"], Value::Null, "undecided without a take-off");
}

#[test]
fn invalid_studies_are_refused() {
    let folder = folder();
    folder.write("bad.csv", "file,phase,first_frame\nother.c3d,walking,3\n");
    let refused = folder.refuses(&["study", "jump.c3d", "--phases", "bad.csv"], 2);
    assert_mentions(&refused, &["other.c3d"]);
    folder.write("bad.csv", "file,phase,first_frame\njump.c3d,diving,3\n");
    let refused = folder.refuses(&["study", "jump.c3d", "--phases", "bad.csv"], 2);
    assert_mentions(&refused, &["bad.csv", "line 2", "diving", "walking"]);
    let absent = FileError::NotFound("none.c3d".into()).to_string();
    assert_eq!(folder.refuses(&["study", "none.c3d"], 1), absent);
    let refused = folder.refuses(&["study", "jump.c3d", "--cutoff", "0"], 2);
    assert_mentions(&refused, &["--cutoff", "0", "6Hz"]);
    let refused = folder.refuses(&["study", "jump.c3d", "--tolerances", "1mm,0"], 2);
    assert_mentions(&refused, &["--tolerances", "0", "--lossless"]);
    // Without a jump the take is studied as a whole, with a warning.
    folder.write_motion("still.csv", &jump(1, 60.0, 0.8));
    let still = folder.run(&["study", "still.csv", "--tolerances", "10mm"]).with_code(0);
    assert_mentions(&still.stderr, &["still.csv", &NoJump::NeverInFlight.to_string()]);
    assert!(still.stdout.contains("| 10 mm |"), "{}", still.stdout);
}

#[test]
fn verify_reports_the_errors_of_derivatives() {
    let folder = folder();
    let rms = |tolerance: &str| {
        let take = format!("{tolerance}.take");
        folder.run(&["import", "jump.c3d", "-o", &take, "--tolerance", tolerance]).with_code(0);
        let verify = ["verify", &take, "--against", "jump.c3d", "--cutoff", "6", "--json"];
        let found = folder.run(&verify).with_code(0).json();
        assert_eq!(found["derivatives"]["markers"].as_array().unwrap().len(), 15);
        let all = &found["derivatives"]["all"];
        // The velocity of the original is independent of the tolerance.
        assert!(
            (3000.0..15000.0).contains(&all["original_velocity_max_mm_s"].as_f64().unwrap()),
            "{all}"
        );
        ["velocity_rms_mm_s", "acceleration_rms_mm_s2"].map(|name| all[name].as_f64().unwrap())
    };
    let [fine, coarse] = [rms("0.1mm"), rms("5mm")];
    assert!(fine[0] > 0.0 && fine[0] < 2.0 && coarse[0] > 5.0 * fine[0], "{fine:?} {coarse:?}");
    assert!(coarse[1] > 5.0 * fine[1], "{fine:?} {coarse:?}");
    let printed = folder.run(&["verify", "5mm.take", "--against", "jump.c3d", "--cutoff", "6Hz"]);
    assert_mentions(&printed.with_code(0).stdout, &["mm/s^2"]);
    let refused =
        folder.refuses(&["verify", "5mm.take", "--against", "jump.c3d", "--cutoff", "30Hz"], 2);
    assert_mentions(&refused, &["30 Hz", "60 Hz"]);
    let refused = folder.refuses(&["verify", "5mm.take", "--cutoff", "6Hz"], 2);
    assert_mentions(&refused, &["--against"]);
}
