//! An unknown unit is not taken for millimetres if that would destroy the motion.

use mocapd_take::{
    interchange::{Format, LengthUnit, ReadOptions},
    motion::{Ambiguity, Motion, UpAxis},
};

use crate::{
    cli::Folder,
    support::{c3d_file::C3dFile, mentions},
};

/// Three markers of a body that is 1.8 m tall, in a unit of `mm` millimetres.
fn file(unit: &'static str, mm: f32) -> Vec<u8> {
    let frames = (0..50)
        .map(|frame| {
            let x = 10.0 * frame as f32;
            let at = [[x, 0.0, 0.0], [x, 150.0, 900.0], [x + 40.0, 100.0, 1800.0]];
            at.iter().flat_map(|&[x, y, z]| [x / mm, y / mm, z / mm, 0.0]).collect()
        })
        .collect();
    let mut file = C3dFile { unit, ..C3dFile::new(3, frames) };
    file.texts(1, "LABELS", &["foot", "hip", "head"]);
    file.bytes()
}

/// The height of the head in the first frame.
fn head_mm(motion: &Motion) -> f32 {
    motion.frame(0)[2][2]
}

#[test]
fn odd_spellings_are_known() {
    for (unit, mm) in [
        ("mete", 1000.0),
        ("METRES\0\0", 1000.0),
        ("m\0\0\0", 1000.0),
        ("centimet", 10.0),
        ("Cm. ", 10.0),
        ("inch", 25.4),
        ("ft", 304.8),
        ("milli", 1.0),
        ("MM", 1.0),
    ] {
        let motion = Format::C3d.read(&file(unit, mm)).unwrap();
        assert!((head_mm(&motion) - 1800.0).abs() < 0.01, "{unit}: {}", head_mm(&motion));
        assert_eq!(motion.info.source.ambiguities, [], "{unit}");
    }
}

#[test]
fn an_unknown_unit_is_checked_against_the_size_of_the_motion() {
    let folder = Folder::new();
    for (unit, mm, is_refused) in [
        ("furlong", 1000.0, true),
        ("", 1000.0, true),
        ("furlong", 10.0, true),
        ("", 25.4, true),
        ("furlong", 1.0, false),
        ("", 1.0, false),
    ] {
        folder.write("a.c3d", file(unit, mm));
        if is_refused {
            let line = folder.refuses(&["import", "a.c3d", "-o", "a.take"], 2);
            assert!(line.contains("--unit"), "{line}");
        } else {
            folder.run(&["import", "a.c3d", "-o", "a.take"]).with_code(0);
            std::fs::remove_file(folder.path("a.take")).unwrap();
        }
        // Every bit is kept: it can be read again when the unit is known.
        folder.run(&["import", "a.c3d", "-o", "a.take", "--lossless"]).with_code(0);
        let verify = ["verify", "a.take", "--against", "a.c3d", "--json"];
        let against = folder.run(&verify).with_code(0).json()["against"].clone();
        assert_eq!(against["ambiguities"][0]["kind"], "unit", "{unit} {mm}");
        std::fs::remove_file(folder.path("a.take")).unwrap();
    }
}

#[test]
fn a_given_unit_is_used_stored_and_used_again() {
    let folder = Folder::new();
    folder.write("a.c3d", file("furlong", 1000.0));
    folder.run(&["import", "a.c3d", "-o", "a.take", "--unit", "m"]).with_code(0);
    let source = folder.run(&["info", "a.take", "--json"]).with_code(0).json()["source"].clone();
    assert_eq!((&source["unit"], &source["unit_given"]), (&"furlong".into(), &"m".into()));
    assert_eq!(source["factor_to_mm"], 1000.0);
    let verify = ["verify", "a.take", "--against", "a.c3d", "--json"];
    let against = folder.run(&verify).with_code(0).json()["against"].clone();
    assert_eq!((&against["within_tolerance"], &against["samples"]), (&true.into(), &150.into()));
    assert_eq!(against["ambiguities"], serde_json::json!([]));
    // Another unit gives another take.
    folder.run(&["import", "a.c3d", "-o", "b.take", "--unit", "cm"]).with_code(0);
    assert!(folder.read("a.take") != folder.read("b.take"));
    folder.refuses(&["import", "a.c3d", "-o", "c.take", "--unit", "furlong"], 2);
    // A CSV file without a unit means millimetres, unless its motion is too small for them.
    let row = |i: usize, mm: f32| {
        format!("{},0,0,{},0,0,{}\n", i as f32 / 100.0, 0.01 * (i + 1) as f32 / mm, 1800.0 / mm)
    };
    for (mm, code) in [(1.0, 0), (1000.0, 2)] {
        let rows: String = (0..20).map(|i| row(i, mm)).collect();
        folder.write("a.csv", format!("time,a_x,a_y,a_z,b_x,b_y,b_z\n{rows}"));
        let ran =
            folder.run(&["import", "a.csv", "-o", &format!("csv{code}.take")]).with_code(code);
        assert_eq!(ran.stderr.lines().count(), usize::from(code > 0), "{}", ran.stderr);
    }
}

#[test]
fn a_given_unit_and_axis_override_those_of_the_file() {
    let options = ReadOptions { unit: Some(LengthUnit::Centimetre), up: "-z".parse().ok() };
    let motion = Format::C3d.read_with(&file("mm", 10.0), &options).unwrap();
    assert!((head_mm(&motion) + 1800.0).abs() < 0.01, "{}", head_mm(&motion));
    assert_eq!((motion.info.up, motion.info.source.factor), (UpAxis::Z, 10.0));
    let warnings = &motion.info.source.warnings;
    let is_warned = |facts: [&str; 2]| {
        warnings.iter().any(|warning| facts.iter().all(|fact| mentions(warning, fact)))
    };
    // The unit of the file, the requested one, and the axis.
    assert!(is_warned(["mm", "cm"]) && is_warned(["z", "up"]), "{warnings:?}");
    let unit = Ambiguity::Unit { stated: String::new(), span: 1.8 };
    assert!(unit.is_destroyed_by(0.5) && !unit.is_destroyed_by(0.0));
}
