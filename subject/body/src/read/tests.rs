//! Files of every format as real programs write them; and untrusted files, of which reading gives an error or a surface
//! no larger than the file accounts for, and never panics.

use mocapd_testkit::random::Random;

use super::{FACES_MAX, Format, ReadError, Scan, read};
use crate::Unit;

/// A tetrahedron, so that its files are short.
const CORNERS: [[f32; 3]; 4] =
    [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.0, 1.25, 0.0], [0.0, 0.0, 1.75]];
const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];

fn obj() -> Vec<u8> {
    let mut text = "# File units = meters\nmtllib a.mtl\no body\n".to_owned();
    CORNERS.iter().for_each(|[x, y, z]| text += &format!("v {x} {y} {z}\n"));
    text += "vt 0 0\nvn 0 0 1\ns off\n";
    FACES
        .iter()
        .for_each(|[a, b, c]| text += &format!("f {}/1 {}/1/1 {}//1\n", a + 1, b + 1, c + 1));
    text.into()
}

fn off() -> Vec<u8> {
    let mut text = "OFF # a comment\n4 4 0\n\n".to_owned();
    CORNERS.iter().for_each(|[x, y, z]| text += &format!("{x} {y} {z}\n"));
    FACES.iter().for_each(|[a, b, c]| text += &format!("3 {a} {b} {c} 255 0 0\n"));
    text.into()
}

fn stl_text() -> Vec<u8> {
    let mut text = "solid body\n".to_owned();
    for face in FACES {
        text += "facet normal 0 0 0\nouter loop\n";
        for [x, y, z] in face.map(|corner| CORNERS[corner as usize]) {
            text += &format!("vertex {x} {y:e} {z}\n");
        }
        text += "endloop\nendfacet\n";
    }
    (text + "endsolid body\n").into()
}

fn stl_binary() -> Vec<u8> {
    // Begins like the text format: some programs write such titles.
    let mut bytes = [b"solid body".as_slice(), &[b' '; 70], &4_u32.to_le_bytes()].concat();
    for face in FACES {
        bytes.extend([0; 12]);
        for corner in face {
            CORNERS[corner as usize].iter().for_each(|c| bytes.extend(c.to_le_bytes()));
        }
        bytes.extend([0; 2]);
    }
    bytes
}

/// Vertices with a confidence between the coordinates, as float64 and float32; faces with flags before the corners, and
/// another list after them.
fn ply(encoding: &str, line_end: &str) -> Vec<u8> {
    let header = [
        "ply",
        &format!("format {encoding} 1.0"),
        "comment units: mm",
        "element vertex 4",
        "property double x",
        "property uchar confidence",
        "property float y",
        "property float32 z",
        "element face 4",
        "property uint16 flags",
        "property list uchar int vertex_indices",
        "property list int8 double texcoord",
        "element nothing 7",
        "end_header",
    ];
    let mut bytes = header.map(|line| format!("{line}{line_end}")).concat().into_bytes();
    if encoding == "ascii" {
        for [x, y, z] in CORNERS {
            bytes.extend(format!("{x} 200 {y} {z}{line_end}").bytes());
        }
        for [a, b, c] in FACES {
            bytes.extend(format!("9 3 {a} {b} {c} 1 0.5{line_end}").bytes());
        }
        return bytes;
    }
    let mut put = |value: &[u8]| {
        let mut value = value.to_vec();
        if encoding == "binary_big_endian" {
            value.reverse();
        }
        bytes.extend(value);
    };
    for [x, y, z] in CORNERS {
        put(&f64::from(x).to_le_bytes());
        put(&[200]);
        put(&y.to_le_bytes());
        put(&z.to_le_bytes());
    }
    for face in FACES {
        put(&9_u16.to_le_bytes());
        put(&[3]);
        face.iter().for_each(|corner| put(&corner.to_le_bytes()));
        put(&[1]);
        put(&0.5_f64.to_le_bytes());
    }
    bytes
}

/// One file of each format.
fn files() -> Vec<(&'static str, Format, Vec<u8>)> {
    vec![
        ("obj", Format::Obj, obj()),
        ("off", Format::Off, off()),
        ("stl, text", Format::Stl, stl_text()),
        ("stl, binary", Format::Stl, stl_binary()),
        ("ply, text", Format::Ply, ply("ascii", "\r\n")),
        ("ply, old text", Format::Ply, ply("ascii", "\r")),
        ("ply, little", Format::Ply, ply("binary_little_endian", "\n")),
        ("ply, big", Format::Ply, ply("binary_big_endian", "\r\n")),
    ]
}

fn read_text(text: &str) -> Result<Scan, ReadError> {
    read(text.as_bytes(), "")
}

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
    assert_eq!(unit(&obj()), Some(Unit::Metre));
    assert_eq!(unit(&ply("binary_big_endian", "\n")), Some(Unit::Millimetre));
    assert_eq!(unit(&off()), None);
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

/// A surface that was read can be used without further checks.
fn sound(bytes: &[u8], result: &Result<Scan, ReadError>) {
    match result {
        Ok(scan) => {
            let n = scan.mesh.positions.len();
            assert!(!scan.mesh.triangles.is_empty());
            assert!(scan.mesh.triangles.as_flattened().iter().all(|&corner| (corner as usize) < n));
            assert!(scan.mesh.positions.as_flattened().iter().all(|c| c.is_finite()));
            assert!(n <= bytes.len() && scan.mesh.triangles.len() <= bytes.len());
        }
        Err(error) => {
            let text = error.to_string();
            assert!(text.len() < 300 && !text.contains(char::is_control), "{text:?}");
        }
    }
}

#[test]
fn truncation_anywhere_is_handled() {
    for (what, format, bytes) in files() {
        let whole = read(&bytes, "").unwrap();
        for len in 0..bytes.len() {
            let result = read(&bytes[..len], "a.ply");
            sound(&bytes[..len], &result);
            // An OBJ has no end marker that could be missing; for all other formats, a surface that is read is
            // complete.
            if let Ok(scan) = result
                && format != Format::Obj
            {
                assert_eq!(scan.mesh, whole.mesh, "{what}: {len}");
            }
        }
    }
}

#[test]
fn any_flipped_bit_is_handled() {
    for (_, _, bytes) in files() {
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut changed = bytes.clone();
                changed[at] ^= 1 << bit;
                sound(&changed, &read(&changed, ""));
            }
        }
    }
}

#[test]
fn random_bytes_after_any_prefix_are_handled() {
    let mut random = Random::new(1);
    for round in 0..3000 {
        let files = files();
        let (_, _, file) = &files[round % files.len()];
        let keep = random.below(512) % file.len();
        let mut bytes = file[..keep].to_vec();
        bytes.extend(random.bytes(64));
        sound(&bytes, &read(&bytes, ["a.obj", "a.ply", "a.stl", "a.off", "a"][round % 5]));
    }
}

#[test]
fn errors_state_what_is_wrong_and_where() {
    use Format::{Obj, Off, Ply, Stl};
    // The line, if there is one, and an excerpt from the file or the expected syntax.
    let malformed: [(&str, Format, Option<usize>, &[&str]); 18] = [
        ("v 1 2\nf 1 1 1\n", Obj, Some(1), &["`v`", "`v 1 2`"]),
        ("v 1 2 3\nf 1 1 0\n", Obj, Some(2), &["`0`"]),
        ("v 1 2 3\nf 1 1 -2\n", Obj, Some(2), &["`-2`"]),
        ("v 1 2 3\nf 1 1 2\n", Obj, None, &["vertex 2", "1"]),
        ("v 1 2 3\nf 1 2 99999999999999999999\n", Obj, Some(2), &["`99999999999999999999`"]),
        ("OFF\n2 x 0\n", Off, Some(2), &[]),
        ("OFF\n3 1 0\n0 0 0\n", Off, None, &["3 vertices", "1"]),
        ("OFF\n1 1 0\n0 0 0\n4 0 0 0\n", Off, Some(4), &["`4 0 0 0`"]),
        ("OFF\n1 1 0\n0 0 0\n3 0 0 -1\n", Off, Some(4), &["`3 0 0 -1`"]),
        ("solid a\nfacet\nvertex 0 0 0\nendfacet\n", Stl, Some(4), &["`endfacet`"]),
        ("solid a\nfacet\nvertex 0 x 0\n", Stl, Some(3), &["`vertex`", "`vertex 0 x 0`"]),
        ("solid a\nfacet\n", Stl, None, &["`endsolid`"]),
        ("solid a\n", Stl, None, &["`endsolid`"]),
        ("ply\nformat ascii 1.0\n", Ply, None, &["`end_header`"]),
        ("ply\nend_header\n", Ply, Some(2), &["`format`"]),
        ("ply\nformat ascii 1.0\nproperty float x\n", Ply, Some(3), &["`property float x`"]),
        ("ply\nformat ascii 1.0\nelement vertex -1\n", Ply, Some(3), &["`element vertex -1`"]),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
            Ply,
            None,
            &["x, y"],
        ),
    ];
    for (text, format, line, facts) in malformed {
        let error = read_text(text).expect_err(text);
        let ReadError::Malformed { format: found, place, reason } = &error else {
            panic!("{text:?}: {error:?}");
        };
        assert_eq!(*found, format, "{text:?}");
        match line {
            Some(line) => assert!(place.ends_with(&format!(" {line}")), "{text:?}: {place}"),
            None => assert!(!place.contains(char::is_numeric), "{text:?}: {place}"),
        }
        for fact in facts {
            assert!(reason.contains(fact), "{text:?}: {fact}: {reason}");
        }
        let message = error.to_string();
        assert!(message.contains(place) && message.contains(reason), "{message}");
    }
}

#[test]
fn other_files_and_meshes_without_faces_have_different_errors() {
    assert_eq!(read(&[], "a.obj"), Err(ReadError::Empty));
    let unknown = |bytes: &[u8]| match read(bytes, "a") {
        Err(ReadError::Unknown { found }) => found,
        other => panic!("{other:?}"),
    };
    let found = [&b"hello"[..], b"\x1f", b"{}", &[0x1f, 0x8b, 8]].map(unknown);
    assert!(found[2].contains("JSON") && found[3].contains("gzip"), "{found:?}");
    for (text, format, vertices) in
        [("v 1 2 3\n", Format::Obj, 1), ("solid a\nendsolid\n", Format::Stl, 0)]
    {
        assert_eq!(read_text(text), Err(ReadError::NoSurface { format, vertices }));
    }
    for (text, fact) in [("4OFF\n1 1 0\n", "4OFF"), ("OFF BINARY\n", "binary")] {
        let Err(ReadError::Unsupported { format: Format::Off, what }) = read_text(text) else {
            panic!("{text:?}");
        };
        assert!(what.contains(fact), "{text:?}: {what}");
    }
    let not_finite = ReadError::NotFinite { found: 1, vertices: 1 };
    assert_eq!(read_text("v nan 0 0\nf 1 1 1\n"), Err(not_finite));
}

#[test]
fn announced_counts_are_not_trusted() {
    let n = u64::MAX;
    for text in [
        format!("OFF\n{} {} 0\n0 0 0\n", i64::MAX, i64::MAX),
        format!("OFF\n1 1 0\n0 0 0\n{} 0 0 0\n", i64::MAX),
        "ply\nformat binary_little_endian 1.0\nelement vertex 9000000000000000000\nproperty char x\nproperty char y\nproperty char z\nend_header\nabcabc".to_owned(),
        "ply\nformat ascii 1.0\nelement nothing 9000000000000000000\nend_header\n".to_owned(),
        "ply\nformat ascii 1.0\nelement face 1\nproperty list double int vertex_index\nend_header\n1e300 0 0 0".to_owned(),
        "ply\nformat ascii 1.0\nelement face 1\nproperty list double int vertex_index\nend_header\nnan 0 0 0".to_owned(),
        format!("ply\nformat ascii 1.0\nelement vertex {n}\nend_header\n"),
    ] {
        assert!(read_text(&text).is_err(), "{text}");
    }
    let mut stl = stl_binary();
    stl[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    let malformed = |stl: &[u8]| match read(stl, "a.stl") {
        Err(ReadError::Malformed { format: Format::Stl, reason, .. }) => reason,
        other => panic!("{other:?}"),
    };
    // The title begins like the text format: the file is read as such, and has no facet.
    let reason = malformed(&stl);
    assert!(!reason.contains("4294967295"), "{reason}");
    stl[..5].copy_from_slice(b"title");
    let reason = malformed(&stl);
    let tokens: Vec<&str> = reason.split(|c: char| !c.is_ascii_digit()).collect();
    assert!(tokens.contains(&"4294967295") && tokens.contains(&"4"), "{reason}");
}

#[test]
fn more_faces_than_the_limit_are_refused() {
    let mut text = "v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_owned();
    text += &"f 1 2 3\n".repeat(FACES_MAX + 1);
    let error = read_text(&text).unwrap_err();
    let limit = FACES_MAX;
    assert_eq!(error, ReadError::TooLarge { what: "faces", found: limit + 1, limit });
    assert!(error.to_string().contains(&limit.to_string()), "{error}");
    // One face with as many corners.
    let text = format!("v 0 0 0\nf{}", " 1".repeat(FACES_MAX + 3));
    assert!(matches!(read_text(&text), Err(ReadError::TooLarge { .. })));
}
