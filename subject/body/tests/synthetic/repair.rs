//! Clean bodies, repairable damage of the kinds that scans have with the notes on it, and surfaces that are refused, with
//! the reason.

use std::collections::HashMap;

use mocapd_body::read::{Format, Scan};
use mocapd_body::repair::{FACES_KEPT_MAX, RepairError, Repaired, repair};
use mocapd_body::skeleton::Method;
use mocapd_body::{Mesh, ScanAnalysis, Unit};
use mocapd_testkit::random::Random;
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};
use nalgebra::Vector3;

fn clean() -> Mesh {
    body(1, Pose::A, BodyOptions { n_faces: 3000, turned: true }).0
}

fn repaired(mesh: Mesh) -> Result<Repaired, RepairError> {
    repair(Scan { mesh, format: Format::Obj, unit: None, notes: Vec::new() }, None)
}

fn volume(mesh: &Mesh) -> f64 {
    let determinant = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    mesh.triangles.iter().map(determinant).sum::<f64>() / 6.0
}

/// Asserts that the surface is closed, connected and oriented outward; returns V - E + F.
fn euler(mesh: &Mesh) -> i64 {
    let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
    for (index, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        for edge in [(a, b), (b, c), (c, a)] {
            assert_eq!(edges.insert(edge, index as u32), None, "an edge twice in one direction");
        }
    }
    assert!(edges.keys().all(|&(a, b)| edges.contains_key(&(b, a))), "a hole");
    let (mut reached, mut next) = (vec![false; mesh.triangles.len()], vec![0]);
    while let Some(at) = next.pop() {
        if !std::mem::replace(&mut reached[at as usize], true) {
            let [a, b, c] = mesh.triangles[at as usize];
            next.extend([(b, a), (c, b), (a, c)].map(|edge| edges[&edge]));
        }
    }
    assert!(reached.iter().all(|&r| r), "several pieces");
    assert!(volume(mesh) > 0.0);
    mesh.positions.len() as i64 - edges.len() as i64 / 2 + mesh.triangles.len() as i64
}

fn codes(repaired: &Repaired) -> Vec<&'static str> {
    repaired.notes.iter().map(|note| note.code).collect()
}

#[test]
fn a_clean_surface_is_unchanged() {
    let mesh = clean();
    let found = repaired(mesh.clone()).unwrap();
    assert_eq!(found.mesh, mesh);
    assert_eq!(found.genus, 0);
    assert_eq!(codes(&found), ["unit-inferred"]);
}

#[test]
fn shared_corners_are_merged() {
    let mesh = clean();
    let mut soup = Mesh::default();
    for triangle in &mesh.triangles {
        let first = soup.positions.len() as u32;
        soup.positions.extend(triangle.map(|corner| mesh.positions[corner as usize]));
        soup.triangles.push([first, first + 1, first + 2]);
    }
    soup.triangles.extend([[0, 1, 2], [2, 0, 1], [5, 5, 6]]);
    let found = repaired(soup).unwrap();
    assert_eq!(found.mesh.positions.len(), mesh.positions.len());
    assert_eq!(found.mesh.triangles.len(), mesh.triangles.len());
    assert_eq!(euler(&found.mesh), 2);
    assert!(codes(&found).starts_with(&["vertices-merged", "needless-triangles"]));
}

#[test]
fn parts_separated_by_rounding_are_joined() {
    let mesh = clean();
    let mut apart = mesh.clone();
    let middle = mesh.positions[100][1];
    // Everything above the middle is a separate part, a thousandth of a millimetre away.
    let high =
        |triangle: &[u32; 3]| triangle.iter().any(|&c| mesh.positions[c as usize][1] > middle);
    let n = mesh.positions.len() as u32;
    apart.positions.extend(mesh.positions.iter().map(|p| [p[0] + 1e-6, p[1], p[2] - 1e-6]));
    for triangle in apart.triangles.iter_mut().filter(|triangle| high(triangle)) {
        *triangle = triangle.map(|corner| corner + n);
    }
    let found = repaired(apart).unwrap();
    assert_eq!(euler(&found.mesh), 2);
    assert_eq!(found.mesh.triangles.len(), mesh.triangles.len());
    assert!(codes(&found).contains(&"cracks-closed"), "{:?}", found.notes);
}

#[test]
fn triangles_are_oriented_outward() {
    let mesh = clean();
    let mut mixed = mesh.clone();
    mixed.triangles.iter_mut().step_by(3).for_each(|triangle| triangle.swap(0, 1));
    let found = repaired(mixed).unwrap();
    assert_eq!(euler(&found.mesh), 2);
    assert!((volume(&found.mesh) - volume(&mesh)).abs() < 1e-9);
    assert!(codes(&found).contains(&"triangles-turned"));
    let mut inside_out = mesh.clone();
    inside_out.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
    let found = repaired(inside_out).unwrap();
    assert!((volume(&found.mesh) - volume(&mesh)).abs() < 1e-9);
    assert!(codes(&found).contains(&"inside-out"));
}

#[test]
fn holes_are_closed_with_triangles_of_the_neighbours_size() {
    let mesh = body(1, Pose::Down, BodyOptions { n_faces: 3000, turned: false }).0;
    let mut torn = mesh.clone();
    // At crown, back and belly.
    let centres = [[0.0, 1.8, 0.0], [0.0, 1.2, -0.12], [0.0, 1.0, 0.12]];
    let radii = [0.12, 0.06, 0.09];
    let near = |triangle: &[u32; 3]| {
        let at = Vector3::from(mesh.positions[triangle[0] as usize]);
        centres.iter().zip(radii).any(|(c, radius)| (at - Vector3::from(*c)).norm() < radius)
    };
    torn.triangles.retain(|triangle| !near(triangle));
    let lost = mesh.triangles.len() - torn.triangles.len();
    assert!(lost > 30, "{lost}");
    let found = repaired(torn).unwrap();
    assert_eq!(euler(&found.mesh), 2);
    assert!((volume(&found.mesh) / volume(&mesh) - 1.0).abs() < 0.02);
    let filled = found.mesh.triangles.len() + lost - mesh.triangles.len();
    assert!(filled < 4 * lost, "{filled} for {lost}");
    let note = found.notes.iter().find(|note| note.code == "holes-closed").unwrap();
    assert!(note.text.contains("3 holes"), "{note}");
}

#[test]
fn parts_that_do_not_belong_to_the_body_are_removed() {
    let mesh = clean();
    let mut more = mesh.clone();
    // A small body floats nearby, another is attached to a vertex, and a fin to an edge.
    for (shift, joined) in [([3.0, 0.0, 0.0], false), ([0.0; 3], true)] {
        let n = more.positions.len() as u32;
        let small = mesh.positions.iter().map(|p| [0, 1, 2].map(|k| p[k] * 0.05 + shift[k]));
        more.positions.extend(small);
        let of = |corner: u32| if joined && corner == 0 { 0 } else { corner + n };
        more.triangles.extend(mesh.triangles.iter().map(|triangle| triangle.map(of)));
    }
    // In the plane of the triangle, so that it is the flatter continuation, and not a separate piece.
    let [a, b, c] = mesh.triangles[7];
    let [p, q, r] = [a, b, c].map(|corner| mesh.positions[corner as usize]);
    more.triangles.push([b, a, more.positions.len() as u32]);
    more.positions.push([0, 1, 2].map(|axis| p[axis] + q[axis] - r[axis]));
    let found = repaired(more).unwrap();
    assert_eq!(euler(&found.mesh), 2);
    assert!(found.mesh.triangles.len().abs_diff(mesh.triangles.len()) < 8);
    assert!((volume(&found.mesh) / volume(&mesh) - 1.0).abs() < 1e-3);
    let codes = codes(&found);
    assert!(codes.contains(&"edges-cut") && codes.contains(&"pieces-left-out"), "{codes:?}");
}

/// Splits every triangle into four.
fn finer(mesh: &Mesh) -> Mesh {
    let mut fine = Mesh { positions: mesh.positions.clone(), triangles: Vec::new() };
    let mut between = HashMap::new();
    for &[a, b, c] in &mesh.triangles {
        let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(a, b)| {
            *between.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let (p, q) = (fine.positions[a as usize], fine.positions[b as usize]);
                fine.positions.push([0, 1, 2].map(|k| (p[k] + q[k]) / 2.0));
                fine.positions.len() as u32 - 1
            })
        });
        fine.triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    fine
}

#[test]
fn spikes_of_single_vertices_are_removed() {
    let mesh = clean();
    let mut spiky = mesh.clone();
    spiky.positions[77] = [40.0, 0.0, 0.0];
    spiky.positions[900][1] += 0.4;
    let found = repaired(spiky).unwrap();
    assert_eq!(euler(&found.mesh), 2);
    assert!((volume(&found.mesh) / volume(&mesh) - 1.0).abs() < 1e-2);
    assert!(codes(&found).contains(&"spikes-cut") && found.unit == Unit::Metre);
}

#[test]
fn decimation_keeps_the_body() {
    for pose in [Pose::T, Pose::Walk] {
        let (coarse, _) = body(2, pose, BodyOptions { n_faces: 5000, turned: true });
        let fine = finer(&finer(&coarse));
        let found = repaired(fine.clone()).unwrap();
        let n = found.mesh.triangles.len();
        assert!(n <= FACES_KEPT_MAX && n > FACES_KEPT_MAX / 4, "{n}");
        assert_eq!(euler(&found.mesh), 2, "{:?}", found.notes);
        assert!((volume(&found.mesh) / volume(&fine) - 1.0).abs() < 0.01);
        assert!(codes(&found).contains(&"decimated"));
    }
}

#[test]
fn the_unit_is_inferred_from_the_size_of_a_body() {
    let mesh = clean();
    for (factor, unit) in [(1.0, Unit::Metre), (100.0, Unit::Centimetre), (1e3, Unit::Millimetre)] {
        let mut scaled = mesh.clone();
        scaled.positions.as_flattened_mut().iter_mut().for_each(|c| *c *= factor);
        let found = repaired(scaled).unwrap();
        assert_eq!((found.unit, found.unit_inferred), (unit, true));
    }
}

#[test]
fn centimetres_that_may_be_inches_get_a_note() {
    let ambiguity = |factor: f64| {
        let mut scaled = clean();
        scaled.positions.as_flattened_mut().iter_mut().for_each(|c| *c *= factor);
        let found = repaired(scaled).unwrap();
        let analysis = ScanAnalysis::new(&found.mesh, Method::Default).unwrap();
        (found.unit, found.unit_ambiguity(analysis.body_scale).map(|note| note.code))
    };
    let inches = Unit::Inch.mm() / 1000.0;
    assert_eq!(ambiguity(1.0 / inches), (Unit::Centimetre, Some("unit-ambiguous")));
    for factor in [1.0, 100.0, 1000.0] {
        assert_eq!(ambiguity(factor).1, None, "{factor}");
    }
}

#[test]
fn rounded_triangle_soup_is_reconnected() {
    for (seed, pose) in [(1, Pose::Squat), (2, Pose::Sit)] {
        let mesh = body(seed, pose, BodyOptions { n_faces: 40_000, turned: true }).0;
        let mut soup = Mesh::default();
        for corners in &mesh.triangles {
            let first = soup.positions.len() as u32;
            let round = |c: f64| (c * 1000.0).round() / 1000.0;
            soup.positions.extend(corners.map(|at| mesh.positions[at as usize].map(round)));
            soup.triangles.push([first, first + 1, first + 2]);
        }
        let found = repaired(soup).unwrap();
        assert_eq!(euler(&found.mesh), 2, "{pose:?}");
        assert!((volume(&found.mesh) / volume(&mesh) - 1.0).abs() < 0.01, "{pose:?}");
    }
}

#[test]
fn repaired_surfaces_are_closed_after_any_damage() {
    let mesh = body(3, Pose::Down, BodyOptions { n_faces: 2000, turned: false }).0;
    let (mut accepted, mut random) = (0, Random::new(7));
    for round in 0..120 {
        let mut hurt = mesh.clone();
        for _ in 0..=random.below(40) {
            let n = hurt.triangles.len();
            let at = random.below(n);
            let other = random.below(n);
            match random.below(6) {
                0 => drop(hurt.triangles.swap_remove(at)),
                1 => hurt.triangles[at].swap(0, 1),
                2 => hurt.triangles[at][2] = hurt.triangles[other][0],
                3 => hurt.triangles.push(hurt.triangles[at]),
                4 => {
                    let corner = hurt.triangles[at][0] as usize;
                    hurt.positions[corner] = hurt.positions[hurt.triangles[other][1] as usize];
                }
                _ => {
                    let corner = hurt.triangles[at][0];
                    hurt.triangles.retain(|triangle| !triangle.contains(&corner));
                }
            }
        }
        match repaired(hurt) {
            Ok(found) => {
                let chi = euler(&found.mesh);
                assert_eq!(chi, 2 - 2 * found.genus as i64, "round {round}");
                accepted += 1;
            }
            Err(error) => println!("round {round}: {error}"),
        }
    }
    assert!(accepted > 90, "{accepted} of 120");
}

/// The part below a plane.
fn below(mesh: &Mesh, axis: usize, height: f64) -> Mesh {
    let mut half = mesh.clone();
    let low = |triangle: &[u32; 3]| {
        triangle.iter().all(|&corner| mesh.positions[corner as usize][axis] < height)
    };
    half.triangles.retain(low);
    half
}

fn upright() -> Mesh {
    body(1, Pose::Down, BodyOptions { n_faces: 3000, turned: false }).0
}

#[test]
fn half_a_body_is_refused() {
    // Only the front, as from one camera. The cut at the waist detaches the hands.
    for half in [below(&upright(), 2, 0.01), below(&upright(), 1, 0.9)] {
        let error = repaired(half).unwrap_err();
        assert!(matches!(error, RepairError::Hole { .. }), "{error}");
    }
    // A body without soles is accepted.
    let mut mesh = upright();
    mesh.positions.iter_mut().for_each(|p| p[1] = -p[1]);
    mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
    let lowest = mesh.positions.iter().map(|p| p[1]).fold(f64::NEG_INFINITY, f64::max);
    assert!(repaired(below(&mesh, 1, lowest - 0.02)).is_ok());
}

#[test]
fn two_bodies_are_refused() {
    let mesh = clean();
    let mut both = mesh.clone();
    both.positions.extend(mesh.positions.iter().map(|p| [p[0] + 3.0, p[1], p[2]]));
    let n = mesh.positions.len() as u32;
    both.triangles.extend(mesh.triangles.iter().map(|t| t.map(|corner| corner + n)));
    let error = repaired(both).unwrap_err();
    assert!(matches!(error, RepairError::Pieces { pieces: 2, .. }), "{error}");
}

#[test]
fn surfaces_without_volume_are_refused() {
    assert_eq!(repaired(Mesh::default()), Err(RepairError::NoSurface));
    let point = Mesh { positions: vec![[1.0; 3]; 9], triangles: vec![[0, 1, 2], [4, 5, 6]] };
    assert_eq!(repaired(point), Err(RepairError::NoSurface));
    let mut flat = clean();
    flat.positions.iter_mut().for_each(|p| p[2] = 0.0);
    let error = repaired(flat).unwrap_err();
    assert!(matches!(error, RepairError::Flat | RepairError::Tangled), "{error}");
    // A sheet of paper: its boundary surrounds it.
    let mut sheet = Mesh::default();
    for i in 0..30_u32 {
        for j in 0..30_u32 {
            sheet.positions.push([f64::from(i) * 0.05, f64::from(j) * 0.05, 0.0]);
            if i > 0 && j > 0 {
                let at = 30 * i + j;
                sheet.triangles.extend([[at - 31, at - 1, at], [at - 31, at, at - 30]]);
            }
        }
    }
    assert!(matches!(repaired(sheet), Err(RepairError::Hole { .. })));
}

#[test]
fn a_size_that_fits_no_body_is_refused() {
    let mut large = clean();
    large.positions.as_flattened_mut().iter_mut().for_each(|c| *c *= 12.0);
    let error = repaired(large.clone()).unwrap_err();
    assert!(matches!(error, RepairError::Unit(_)), "{error}");
    // A stated unit is used in spite of an unlikely size, with a note.
    let scan = Scan { mesh: large, format: Format::Obj, unit: None, notes: Vec::new() };
    let found = repair(scan, Some(Unit::Centimetre)).unwrap();
    assert!(!found.unit_inferred && found.notes.iter().any(|note| note.code == "odd-size"));
}
