//! A Reeb graph whose branches are known.

use super::*;
use crate::Mesh;
use crate::geodesic::Adjacency;
use crate::level::{Rings, cut};
use crate::tests::cubes;

/// A body of cubes, head down at 0: neck and trunk up to 6, arms that branch off at 2 and rise to 5, legs from 6 to 10.
fn body() -> Vec<[i32; 3]> {
    let mut places = Vec::new();
    for up in 0..6 {
        places.push([0, 0, up]);
    }
    for side in [-1, 1] {
        for out in 1..4 {
            places.push([side * out, 0, 2]);
        }
        places.extend((2..5).map(|up| [side * 3, 0, up]));
        places.push([side, 0, 5]);
        places.extend((6..10).map(|up| [side, 0, up]));
    }
    places.sort_unstable();
    places.dedup();
    places
}

fn top_at(mesh: &Mesh, near: [f64; 3]) -> u32 {
    let far = |at: &[f64; 3]| (0..3).map(|axis| (at[axis] - near[axis]).powi(2)).sum::<f64>();
    let nearest = mesh.positions.iter().enumerate().min_by(|a, b| far(a.1).total_cmp(&far(b.1)));
    nearest.unwrap().0 as u32
}

fn linked(mesh: &Mesh, tips: &[[f64; 3]]) -> (Rings, Reeb) {
    let adjacency = Adjacency::new(mesh).unwrap();
    let heights: Vec<f64> = mesh.positions.iter().map(|at| at[2]).collect();
    let levels = (0..20).map(|level| 0.25 + 0.5 * f64::from(level)).collect();
    let rings = cut(mesh, &adjacency, &heights, levels);
    let tips: Vec<u32> = tips.iter().map(|near| top_at(mesh, *near)).collect();
    let reeb = Reeb::new(mesh, &adjacency, &rings, &tips);
    (rings, reeb)
}

const TIPS: [[f64; 3]; 4] =
    [[-3.0, 0.0, 5.0], [4.0, 0.0, 5.0], [-1.0, 0.0, 10.0], [2.0, 0.0, 10.0]];

#[test]
fn a_tree_has_its_ends_and_forks() {
    let (_, reeb) = linked(&cubes(&body()), &TIPS);
    let ends = reeb.bands.iter().filter(|band| band.above.is_empty()).count();
    let forks = reeb.bands.iter().filter(|band| band.above.len() > 1).count();
    let starts = reeb.bands.iter().filter(|band| band.below.is_empty()).count();
    assert_eq!((starts, forks, ends), (1, 2, 4), "{:?}", reeb.bands);
    // A tree has one arc fewer than nodes, each ring being an arc between its two bands.
    assert_eq!(reeb.sides.len() + 1, reeb.bands.len());
    // All rings but the lowest have one below them.
    assert_eq!(reeb.arcs().count(), reeb.sides.len() - 1);
}

#[test]
fn a_body_splits_into_five_parts() {
    let (rings, reeb) = linked(&cubes(&body()), &TIPS);
    let body = Segments::new(&reeb, &rings).unwrap();
    assert_eq!((body.armpits, body.crotch), ([3.25, 3.25], 6.25));
    assert_eq!(body.arms.each_ref().map(Vec::len), [4, 4]);
    assert_eq!(body.legs.each_ref().map(Vec::len), [8, 8]);
    assert_eq!(body.trunk.len(), 12);
    let x = |ring: u32| rings.rings[ring as usize].centroid[0];
    assert!(body.arms[0].iter().all(|ring| x(*ring) < -2.0));
    assert!(body.legs[1].iter().all(|ring| x(*ring) > 0.5));
    assert!(body.trunk.iter().all(|ring| (x(*ring) - 0.5).abs() < 0.01));
}

#[test]
fn a_handle_is_not_a_tree() {
    let mut places = body();
    places.extend([[0, 0, 9]]);
    let (_, reeb) = linked(&cubes(&places), &TIPS);
    assert!(reeb.bands.iter().any(|band| band.below.len() > 1));
}

#[test]
fn a_hand_on_a_leg_is_contact() {
    let mut places = body();
    // The arm continues into the leg and no longer has an end of its own.
    places.extend([[-3, 0, 5], [-3, 0, 6], [-2, 0, 6]]);
    let (rings, reeb) = linked(&cubes(&places), &[TIPS[2], TIPS[1], TIPS[2], TIPS[3]]);
    let refusal = Segments::new(&reeb, &rings).unwrap_err();
    assert_eq!(refusal.code(), "contact");
}
