//! Arbitrary bytes as meshes and skeletons.

use std::collections::HashMap;

use mocapd_body::{
    Unit,
    read::read,
    repair::{FACES_KEPT_MAX, repair},
    skeleton::{LEN_MAX, Skeleton},
};

/// Maximum number of characters in an error message.
const REASON_MAX: usize = 400;

/// Reads a mesh; the first byte selects the file's extension, and whether its unit is given. Gives a one-line error,
/// or a mesh whose size is bounded by the input's. A repaired mesh is a closed surface.
pub fn read_mesh(bytes: &[u8]) {
    let Some((&first, file)) = bytes.split_first() else { return };
    let name = ["a.obj", "a.ply", "a.stl", "a.off", "a"][usize::from(first & 7) % 5];
    let scan = match read(file, name) {
        Ok(scan) => scan,
        Err(error) => return one_line(&error.to_string()),
    };
    let n = scan.mesh.positions.len();
    assert!(!scan.mesh.triangles.is_empty());
    assert!(n <= file.len() && scan.mesh.triangles.len() <= file.len());
    assert!(scan.mesh.triangles.as_flattened().iter().all(|&corner| (corner as usize) < n));
    assert!(scan.mesh.positions.as_flattened().iter().all(|c| c.is_finite()));
    scan.notes.iter().for_each(|note| one_line(&note.text));
    let stated = (first & 8 != 0).then_some(Unit::Metre);
    match repair(scan, stated) {
        Ok(repaired) => {
            repaired.notes.iter().for_each(|note| one_line(&note.text));
            let mut edges = HashMap::new();
            for &[a, b, c] in &repaired.mesh.triangles {
                for edge in [(a, b), (b, c), (c, a)] {
                    assert_eq!(edges.insert(edge, ()), None, "an edge twice in one direction");
                }
            }
            assert!(edges.keys().all(|&(a, b)| edges.contains_key(&(b, a))), "a hole");
            // Closing holes adds triangles.
            assert!(repaired.mesh.triangles.len() <= 60 * FACES_KEPT_MAX);
        }
        Err(error) => one_line(&error.to_string()),
    }
}

/// Reads a skeleton: gives a one-line error, or a skeleton that survives being written and read again.
pub fn read_skeleton(bytes: &[u8]) {
    match Skeleton::from_json(bytes) {
        Ok(skeleton) => {
            let written = skeleton.to_json();
            // Written with one value per line, it may exceed the limit for reading.
            if written.len() <= LEN_MAX {
                let again =
                    Skeleton::from_json(written.as_bytes()).expect("what we write can be read");
                assert_eq!(again.to_json(), written);
            }
        }
        Err(error) => one_line(&error.to_string()),
    }
}

fn one_line(text: &str) {
    assert!(text.chars().count() < REASON_MAX && !text.contains(char::is_control), "{text:?}");
}
