//! Files of anybody: a reason, or a surface that the bytes earn; never a panic.

use super::{files, read, read_text};
use crate::read::{FACES_MAX, Format, ReadError, Scan};

/// Whatever was read can be used without a look at it.
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
fn cut_off_anywhere() {
    for (what, format, bytes) in files() {
        let whole = read(&bytes, "").unwrap();
        for len in 0..bytes.len() {
            let result = read(&bytes[..len], "a.ply");
            sound(&bytes[..len], &result);
            // An OBJ has no end that could be missed; of all others, what is read is the whole surface.
            if let Ok(scan) = result
                && format != Format::Obj
            {
                assert_eq!(scan.mesh, whole.mesh, "{what}: {len}");
            }
        }
    }
}

#[test]
fn any_bit_flipped() {
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
fn any_bytes_behind_any_beginning() {
    let mut state = 1_u64;
    let mut byte = move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    };
    for round in 0..3000 {
        let files = files();
        let (_, _, file) = &files[round % files.len()];
        let keep = usize::from(byte()) * 2 % file.len();
        let mut bytes = file[..keep].to_vec();
        bytes.extend((0..64).map(|_| byte()));
        sound(&bytes, &read(&bytes, ["a.obj", "a.ply", "a.stl", "a.off", "a"][round % 5]));
    }
}

fn reason(text: &str) -> String {
    read_text(text).expect_err(text).to_string()
}

#[test]
fn reasons_say_what_and_where() {
    assert_eq!(read(&[], "a.obj"), Err(ReadError::Empty));
    for (text, expected) in [
        ("hello", "not a mesh that can be read"),
        ("\u{1f}", "its beginning is of no known format"),
        ("{}", "a JSON document"),
        ("v 1 2\nf 1 1 1\n", "OBJ, line 1: expected `v` and three numbers, found `v 1 2`"),
        ("v 1 2 3\nf 1 1 0\n", "OBJ, line 2: expected the index of a vertex, found `0`"),
        ("v 1 2 3\nf 1 1 -2\n", "OBJ, line 2: expected the index"),
        ("v 1 2 3\nf 1 1 2\n", "OBJ, a face: names vertex 2, there are 1"),
        ("v 1 2 3\nf 1 2 99999999999999999999\n", "OBJ, line 2"),
        ("v 1 2 3\n", "OBJ: 1 vertices and no face"),
        ("v nan 0 0\nf 1 1 1\n", "1 of 1 vertices are no finite positions"),
        ("OFF\n2 x 0\n", "OFF, line 2: expected the counts"),
        ("OFF\n3 1 0\n0 0 0\n", "OFF, end of file: 3 vertices announced, 1 found"),
        ("OFF\n1 1 0\n0 0 0\n4 0 0 0\n", "OFF, line 4: expected a count and as many indices"),
        ("OFF\n1 1 0\n0 0 0\n3 0 0 -1\n", "OFF, line 4"),
        ("4OFF\n1 1 0\n", "more than three dimensions"),
        ("OFF BINARY\n", "its binary form is not read"),
        ("solid a\nfacet\nvertex 0 0 0\nendfacet\n", "STL, line 4: expected three corners"),
        ("solid a\nfacet\nvertex 0 x 0\n", "STL, line 3: expected `vertex` and three numbers"),
        ("solid a\nfacet\n", "STL, end of file: expected `endsolid`, found none"),
        ("solid a\nendsolid\n", "STL: 0 vertices and no face"),
        ("solid a\n", "STL, end of file: expected `endsolid`"),
        ("ply\nformat ascii 1.0\n", "PLY, end of file: expected `end_header`"),
        ("ply\nend_header\n", "PLY, line 2: expected a line with `format` before"),
        ("ply\nformat ascii 1.0\nproperty float x\n", "PLY, line 3: expected an element first"),
        ("ply\nformat ascii 1.0\nelement vertex -1\n", "PLY, line 3: expected a name and a count"),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
            "x, y and z",
        ),
    ] {
        let found = reason(text);
        assert!(found.contains(expected), "{text:?}: {found}");
    }
    let gzip = read(&[0x1f, 0x8b, 8], "a").unwrap_err().to_string();
    assert!(gzip.contains("gzip"), "{gzip}");
}

#[test]
fn what_is_announced_is_not_believed() {
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
    let mut stl = super::stl_binary();
    stl[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    let error = read(&stl, "a.stl").unwrap_err().to_string();
    // The title begins as a text does: it is then read as such, and has no facet.
    assert!(error.contains("STL"), "{error}");
    stl[..5].copy_from_slice(b"title");
    let error = read(&stl, "a.stl").unwrap_err().to_string();
    assert!(error.contains("4294967295 triangles announced, 4 found"), "{error}");
}

#[test]
fn more_faces_than_are_read() {
    let mut text = "v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_owned();
    text += &"f 1 2 3\n".repeat(FACES_MAX + 1);
    let error = read_text(&text).unwrap_err();
    let limit = FACES_MAX;
    assert_eq!(error, ReadError::TooLarge { what: "faces", found: limit + 1, limit });
    assert!(error.to_string().contains("decimate"));
    // One face of as many corners.
    let text = format!("v 0 0 0\nf{}", " 1".repeat(FACES_MAX + 3));
    assert!(matches!(read_text(&text), Err(ReadError::TooLarge { .. })));
}
