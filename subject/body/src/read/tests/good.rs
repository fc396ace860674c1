//! Files as real programs write them.

use super::{CORNERS, FACES, files, ply, read, read_text};
use crate::Unit;
use crate::read::Format;

#[test]
fn every_format_gives_the_same_surface() {
    for (what, format, bytes) in files() {
        for name in ["", "scan", "a.obj", "a.STL"] {
            let scan = read(&bytes, name).unwrap_or_else(|error| panic!("{what}: {error}"));
            assert_eq!(scan.format, format, "{what}");
            let corners = |face: [u32; 3]| face.map(|corner| scan.mesh.positions[corner as usize]);
            let found: Vec<_> = scan.mesh.triangles.iter().copied().map(corners).collect();
            let expected = FACES.map(|f| f.map(|c| CORNERS[c as usize].map(f64::from)));
            assert_eq!(found, expected, "{what}");
            assert_eq!(scan.mesh.positions.len(), 4, "{what}: corners are shared");
            let other = Format::from_name(name).is_some_and(|named| named != format);
            assert_eq!(scan.notes.iter().any(|note| note.code == "other-ending"), other, "{what}");
        }
    }
}

#[test]
fn a_comment_states_the_unit() {
    let unit = |bytes: &[u8]| read(bytes, "").unwrap().unit;
    assert_eq!(unit(&super::obj()), Some(Unit::Metre));
    assert_eq!(unit(&ply("binary_big_endian", "\n")), Some(Unit::Millimetre));
    assert_eq!(unit(&super::off()), None);
    let unit = |line: &str| Unit::from_comment(line.as_bytes());
    assert_eq!(unit("# units: CM"), Some(Unit::Centimetre));
    assert_eq!(unit("# a united kingdom of m"), None);
    assert_eq!(unit("# unit"), None);
}

#[test]
fn polygons_become_triangles() {
    // A dart: its third corner is concave, and must be an end of the cut.
    let dart = read_text("v 0 0 0\nv 4 0 0\nv 1 1 0\nv 0 4 0\nf 1 2 3 4\n").unwrap();
    assert_eq!(dart.mesh.triangles.len(), 2);
    for triangle in &dart.mesh.triangles {
        assert!(triangle.contains(&0) && triangle.contains(&2), "{triangle:?}");
    }
    assert!(dart.notes.iter().any(|note| note.code == "polygons"));
    // A comb of two teeth: its area equals that of its triangles only if none lies outside.
    let comb = "v 0 0 0\nv 6 0 0\nv 6 5 0\nv 4 5 0\nv 4 1 0\nv 2 1 0\nv 2 5 0\nv 0 5 0\nf 1 2 3 4 5 6 7 8\n";
    let comb = read_text(comb).unwrap().mesh;
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|corner| comb.positions[corner as usize]);
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let areas: Vec<f64> = comb.triangles.iter().map(area).collect();
    assert_eq!(comb.triangles.len(), 6);
    assert!(areas.iter().all(|&area| area > 0.0), "{areas:?}");
    assert!((areas.iter().sum::<f64>() - 2.0 * 22.0).abs() < 1e-12, "{areas:?}");
    // More corners than ear clipping handles.
    let n = 100;
    let mut circle = String::new();
    for i in 0..n {
        let (sin, cos) = (f64::from(i) / f64::from(n) * std::f64::consts::TAU).sin_cos();
        circle += &format!("v {cos} {sin} 0\n");
    }
    circle += "f";
    (1..=n).for_each(|i| circle += &format!(" {i}"));
    let circle = read_text(&circle).unwrap();
    assert_eq!(circle.mesh.triangles.len(), 98);
    assert!(circle.notes.iter().any(|note| note.code == "fans"));
}

#[test]
fn indices_of_an_obj_count_from_either_end() {
    let back = read_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2/5 -1//\nv 9 9 9\n").unwrap();
    assert_eq!(back.mesh.triangles, [[0, 1, 2]]);
    let before = read_text("f 1 2 \\\n 3\nv 0 0 0\nv 1 0 0 1 1 1\nv 0 1 0\n").unwrap();
    assert_eq!(before.mesh.triangles, [[0, 1, 2]]);
}

#[test]
fn off_may_have_additional_values() {
    let colours = "COFF 3 1 0\n0 0 0 1 1 1 1\n1 0 0 0 0 0 1\n0 1 0 1 0 1 1\n3 0 1 2\n";
    assert_eq!(read_text(colours).unwrap().mesh.triangles, [[0, 1, 2]]);
    assert_eq!(read_text(colours).unwrap().mesh.positions[1], [1.0, 0.0, 0.0]);
}

#[test]
fn triangle_strips_of_a_ply_alternate_orientation() {
    let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                element tristrips 1\nproperty list int int vertex_indices\nend_header\n\
                0 0 0\n1 0 0\n0 1 0\n1 1 0\n8 0 1 2 3 -1 2 1 3\n";
    assert_eq!(read_text(text).unwrap().mesh.triangles, [[0, 1, 2], [2, 1, 3], [2, 1, 3]]);
}

#[test]
fn single_non_finite_positions_are_left_out_with_their_faces() {
    let mut text = String::new();
    for i in 0..300 {
        text += &format!("v {i} 0 0\n");
    }
    text += "v nan 0 0\nv 1 2 3\nv -1.#IND 1e999 1e12\nf 1 2 302\nf 1 2 301\nf 303 5 6\n";
    let scan = read_text(&text).unwrap();
    assert_eq!(scan.mesh.positions.len(), 301);
    assert_eq!(scan.mesh.triangles, [[0, 1, 300]]);
    assert_eq!(scan.mesh.positions[300], [1.0, 2.0, 3.0]);
    assert!(scan.notes.iter().any(|note| note.code == "not-finite"));
}
