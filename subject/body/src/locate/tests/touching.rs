//! Fused limbs, and the scale of bodies whose geodesic distances they shorten.

use nalgebra::Vector3;

use crate::locate::Fields;
use crate::locate::scale::{BodyScale, Touching};
use crate::locate::section::{LEVELS, Sections, level};

/// Distances between the five extremities of a body of scale 1; the vertices are the extremities.
const DISTANCES: [[f64; 5]; 5] = [
    [0.0, 0.68, 0.68, 1.13, 1.13],
    [0.68, 0.0, 0.95, 1.17, 1.25],
    [0.68, 0.95, 0.0, 1.25, 1.17],
    [1.13, 1.17, 1.25, 0.0, 1.09],
    [1.13, 1.25, 1.17, 1.09, 0.0],
];

fn scale(change: impl Fn(&mut [[f64; 5]; 5])) -> Option<BodyScale> {
    let mut distances = DISTANCES;
    change(&mut distances);
    BodyScale::new(&Fields {
        first_head: None,
        missing: [0.0; 5],
        ends: [0, 1, 2, 3, 4],
        distances: distances.each_ref().map(<[f64; 5]>::as_slice),
    })
}

fn limb(perimeter: impl Fn(f64) -> f64) -> Sections {
    Sections {
        perimeter: (0..LEVELS).map(|index| perimeter(level(index))).collect(),
        centre: vec![Vector3::zeros(); LEVELS],
    }
}

#[test]
fn limbs_of_a_free_body_are_certain() {
    let scale = scale(|_| ()).unwrap();
    assert!((scale.length - 1.0).abs() < 0.03, "{scale:?}");
    let (arm, leg) = (limb(|at| 0.1 + 0.2 * at), limb(|at| 0.1 + 0.5 * at));
    let touching = Touching::new(scale, [Some(&arm), Some(&arm)], [Some(&leg), Some(&leg)]);
    assert!(!touching.any(), "{touching:?}");
}

#[test]
fn only_the_arm_whose_curves_enclose_the_trunk_is_uncertain() {
    let (free, leg) = (limb(|at| 0.1 + 0.2 * at), limb(|at| 0.1 + 0.5 * at));
    let grown = limb(|at| if at < 0.25 { 0.12 } else { 0.8 });
    let touching = Touching::new(
        scale(|_| ()).unwrap(),
        [Some(&free), Some(&grown)],
        [Some(&leg), Some(&leg)],
    );
    assert_eq!((touching.arms, touching.legs, touching.scale), ([false, true], [false; 2], false));
}

#[test]
fn with_hands_on_the_hips_the_feet_determine_the_scale() {
    let change = |distances: &mut [[f64; 5]; 5]| {
        for (one, other) in [(1, 2), (1, 3), (1, 4), (2, 3), (2, 4)] {
            distances[one][other] *= 0.55;
            distances[other][one] = distances[one][other];
        }
    };
    let found = scale(change).unwrap();
    assert!(found.disagrees() && (found.length - 1.0).abs() < 1e-9, "{found:?}");
}

#[test]
fn touching_legs_are_uncertain_and_do_not_determine_the_scale() {
    let change = |distances: &mut [[f64; 5]; 5]| {
        distances[3][4] *= 0.8;
        distances[4][3] = distances[3][4];
    };
    let found = scale(change).unwrap();
    let limb = limb(|_| 0.2);
    let touching = Touching::new(found, [Some(&limb), Some(&limb)], [Some(&limb), Some(&limb)]);
    assert!(touching.scale && touching.legs == [true; 2], "{found:?} {touching:?}");
    assert!((found.length - 1.0).abs() < 0.04, "{found:?}");
}

#[test]
fn contradicting_distances_have_no_scale() {
    let none = scale(|distances| {
        distances[3][4] *= 0.2;
        distances[4][3] = distances[3][4];
    });
    assert_eq!(none, None);
    assert_eq!(scale(|distances| distances[2][1] = 0.0), None);
    assert_eq!(scale(|distances| distances[4][3] = f64::INFINITY), None);
}
