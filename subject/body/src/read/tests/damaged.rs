//! Untrusted files: reading gives an error or a surface no larger than the file accounts for, and never panics.

use mocapd_testkit::random::Random;

use super::{files, read, read_text};
use crate::read::{FACES_MAX, Format, ReadError, Scan};

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
    let mut stl = super::stl_binary();
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
