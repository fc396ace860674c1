//! Preparing a subject: a skeleton from scans, a face from a photograph.

use std::fmt::Write;

use mocapd_body::{Joint, Joints, Mesh, Side, skeleton::Skeleton};
use mocapd_face::{fit::NoFace, fitted::FittedFace};
use mocapd_testkit::{
    photograph::Scene,
    synthetic_body::{BodyOptions, Pose, body},
};

use super::Folder;
use crate::support::{assert_mentions, mentions};

fn obj(mesh: &Mesh) -> String {
    let mut text = String::new();
    for [x, y, z] in &mesh.positions {
        writeln!(text, "v {x} {y} {z}").unwrap();
    }
    for corners in &mesh.triangles {
        let [a, b, c] = corners.map(|corner| corner + 1);
        writeln!(text, "f {a} {b} {c}").unwrap();
    }
    text
}

fn length_mm(joints: &Joints, from: Joint, to: Joint) -> f64 {
    let at = |joint| joints.estimates[&joint].position;
    let (a, b) = (at(from), at(to));
    1000.0 * (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn scans_of_one_person_give_a_skeleton_and_a_picture() {
    let folder = Folder::new();
    let options = BodyOptions { n_faces: 6000, turned: true };
    let (mesh, truth) = body(7, Pose::A, options);
    folder.write("a.obj", obj(&mesh));
    folder.write("walk.obj", obj(&body(7, Pose::Walk, options).0));
    let args = ["subject", "body", "a.obj", "walk.obj", "-o", "s.json", "--picture", "p.svg"];
    let ran = folder.run(&args).with_code(0);
    assert_mentions(&ran.stdout, &["l_upper_arm", "2 scans"]);
    let skeleton = Skeleton::from_json(&folder.read("s.json")).unwrap();
    assert_eq!(skeleton.sources.len(), 2);
    assert!(skeleton.sources.iter().all(|source| source.unit.as_deref() == Some("m") && source.unit_inferred == Some(true)));
    // The method was not trained on bodies of capsules, so errors of up to a quarter are accepted.
    let thigh_mm = length_mm(&truth, Joint::Hip(Side::Left), Joint::Knee(Side::Left));
    let [left_mm, right_mm] = ["l_thigh", "r_thigh"]
        .map(|name| skeleton.bones.iter().find(|bone| bone.name == name).unwrap().length_mm);
    let found_mm = f64::midpoint(left_mm, right_mm);
    assert!((found_mm / thigh_mm - 1.0).abs() < 0.25, "{found_mm} of {thigh_mm} mm");
    // Nothing is written if no bone has a plausible length, or two outputs are the same file.
    let ran =
        folder.run(&["subject", "body", "a.obj", "--unit", "mm", "-o", "mm.json"]).with_code(1);
    assert_mentions(&ran.stderr, &["a.obj", "2 mm", "--unit"]);
    assert!(!folder.path("mm.json").exists());
    folder.run(&["subject", "body", "a.obj", "-o", "x.svg", "--picture", "x.svg"]).with_code(2);
    let picture = String::from_utf8(folder.read("p.svg")).unwrap();
    assert!(picture.starts_with("<svg"), "{picture}");
    assert_mentions(&picture, &["knee"]);

    // With -, stdout has only the skeleton, stderr the table, and no file is called -.
    let ran = folder.run(&["subject", "body", "a.obj", "walk.obj", "-o", "-"]).with_code(0);
    assert_eq!(ran.stdout.as_bytes(), folder.read("s.json"));
    assert!(ran.stderr.contains("l_upper_arm") && !folder.path("-").exists(), "{}", ran.stderr);
    let refused = ["subject", "body", "a.obj", "--picture", "-"];
    folder.run(&refused).with_code(2);

    // The take contains the skeleton that was written.
    folder.write_motion("jump.csv", &crate::support::jump(1, 60.0, 1.0));
    let import = ["import", "jump.csv", "-o", "t.take", "--skeleton", "s.json"];
    folder.run(&import).with_code(0);
    assert!(folder.run(&["info", "t.take"]).with_code(0).stdout.contains("l_thigh"));
}

#[test]
fn other_meshes_than_bodies_are_refused_with_a_reason() {
    let folder = Folder::new();
    folder.write("empty.obj", "");
    folder.write("words.ply", "ply\nformat ascii 1.0\nelement vertex many\n");
    let tetrahedron = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    folder.write("solid.obj", tetrahedron);
    folder.write("nan.obj", tetrahedron.replace("v 1 0 0", "v nan 0 0"));
    folder.write("short.stl", [0; 83]);
    // A scan up to the waist.
    let mut half = body(7, Pose::A, BodyOptions { n_faces: 3000, turned: false }).0;
    let is_low = |corner: &u32| half.positions[*corner as usize][1] < 0.9;
    half.triangles = half.triangles.iter().copied().filter(|t| t.iter().all(is_low)).collect();
    folder.write("half.obj", obj(&half));
    for (name, facts) in [
        ("empty.obj", &[][..]),
        ("words.ply", &["line 3", "element vertex many"]),
        ("solid.obj", &["too-few-ends"]),
        ("nan.obj", &["1 of 4"]),
        ("short.stl", &["byte 80", "0 triangles"]),
        ("half.obj", &["%"]),
    ] {
        let ran = folder.run(&["subject", "body", name, "-o", "s.json"]).with_code(1);
        assert_mentions(&ran.stderr, &[&[name], facts].concat());
        assert!(!folder.path("s.json").exists());
    }
}

#[test]
fn a_photograph_gives_a_face() {
    let folder = Folder::new();
    let picture = Scene::portrait(3, 90.0, 0.0).render().unwrap();
    let mut ppm =
        format!("P6\n{} {}\n255\n", picture.image.width(), picture.image.height()).into_bytes();
    ppm.extend_from_slice(picture.image.as_raw());
    folder.write("a.ppm", ppm);
    let args = ["subject", "face", "a.ppm", "--largest", "-o", "f.json", "--obj", "f.obj"];
    let ran = folder.run(&[&args[..], &["--overlay", "o.png", "--views", "v.svg"]].concat());
    let ran = ran.with_code(0);
    assert_mentions(&ran.stdout, &["1 face", "of 53"]);
    let face = FittedFace::from_json(&folder.read("f.json")).unwrap();
    let truth = &picture.faces[0];
    let off = |point: &mocapd_face::model::Landmark| {
        let [x, y] = truth.at(point.id);
        (point.xy_px[0] - x).hypot(point.xy_px[1] - y) / 90.0
    };
    let mut off: Vec<f64> = face.points.iter().map(off).collect();
    off.sort_by(f64::total_cmp);
    assert!(off[off.len() / 2] < 0.1, "{off:?}");
    // The hairline is wider than the distance of the eyes.
    let hairline = face.points.iter().filter(|point| point.id.is_hairline());
    let hairline: Vec<f64> = hairline.map(|point| point.xy_px[0]).collect();
    assert!(hairline[1] - hairline[0] > 90.0, "{hairline:?}");
    assert_eq!(folder.read("o.png")[..4], *b"\x89PNG");
    assert!(folder.read("v.svg").starts_with(b"<svg"));
    assert!(folder.read("f.obj").starts_with(b"#"));

    // Nothing is overwritten.
    folder.run(&args).with_code(1);

    let ran = folder.run(&["subject", "face", "a.ppm", "--largest", "-o", "-"]).with_code(0);
    assert_eq!(ran.stdout.trim_end().as_bytes(), folder.read("f.json").trim_ascii_end());
    assert_mentions(&ran.stderr, &["1 face", "of 53"]);
    for option in ["--overlay", "--obj", "--views"] {
        let ran = folder.run(&["subject", "face", "a.ppm", option, "-"]).with_code(2);
        assert!(ran.stderr.contains("-") && ran.stdout.is_empty(), "{}", ran.stderr);
    }
    assert!(!folder.path("-").exists());
    for (option, name) in [("-o", "x.obj"), ("--obj", "x.json")] {
        let ran = folder.run(&["subject", "face", "a.ppm", option, name]).with_code(2);
        assert!(ran.stderr.contains(name) && !folder.path(name).exists(), "{}", ran.stderr);
    }
}

#[test]
fn a_face_turned_far_gets_a_warning() {
    let folder = Folder::new();
    for (name, yaw_deg) in [("front", 5.0), ("side", 42.0)] {
        let picture = Scene::portrait(3, 90.0, yaw_deg).render().unwrap();
        let mut ppm =
            format!("P6\n{} {}\n255\n", picture.image.width(), picture.image.height()).into_bytes();
        ppm.extend_from_slice(picture.image.as_raw());
        folder.write(&format!("{name}.ppm"), ppm);
        let ran = folder.run(&["subject", "face", &format!("{name}.ppm")]).with_code(0);
        // The warning names the face and the angle beyond which its far side is unreliable.
        let is_warned = mentions(&ran.stderr, "face 1") && mentions(&ran.stderr, "35");
        assert_eq!(is_warned, name == "side", "{} {}", ran.stdout, ran.stderr);
    }
}

#[test]
fn a_photograph_without_a_face_is_an_error() {
    let folder = Folder::new();
    let mut ppm = b"P6\n64 64\n255\n".to_vec();
    ppm.extend((0..64 * 64 * 3).map(|i| (i / 48) as u8));
    folder.write("a.ppm", &ppm);
    folder.write("cut.ppm", &ppm[..2000]);
    let ran = folder.run(&["subject", "face", "a.ppm", "-o", "f.json"]).with_code(1);
    assert_mentions(&ran.stderr, &["a.ppm", &NoFace::NotFound.to_string()]);
    let ran = folder.run(&["subject", "face", "cut.ppm", "-o", "f.json"]).with_code(1);
    assert!(ran.stderr.contains("cut.ppm"), "{}", ran.stderr);
    assert!(!folder.path("f.json").exists());
}
