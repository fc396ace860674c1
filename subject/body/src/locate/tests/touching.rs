//! Limbs that have grown together, and the scale of bodies whose ways they shorten.

use nalgebra::Vector3;

use crate::locate::Fields;
use crate::locate::scale::{BodyScale, Touching};
use crate::locate::section::{LEVELS, Sections, level};

/// The ways between five ends of a body of scale 1; the vertices are the ends.
const WAYS: [[f64; 5]; 5] = [
    [0.0, 0.68, 0.68, 1.13, 1.13],
    [0.68, 0.0, 0.95, 1.17, 1.25],
    [0.68, 0.95, 0.0, 1.25, 1.17],
    [1.13, 1.17, 1.25, 0.0, 1.09],
    [1.13, 1.25, 1.17, 1.09, 0.0],
];

fn scale(change: impl Fn(&mut [[f64; 5]; 5])) -> Option<BodyScale> {
    let mut ways = WAYS;
    change(&mut ways);
    BodyScale::new(&Fields {
        first_head: None,
        missing: [0.0; 5],
        ends: [0, 1, 2, 3, 4],
        distances: ways.each_ref().map(<[f64; 5]>::as_slice),
    })
}

fn limb(perimeter: impl Fn(f64) -> f64) -> Sections {
    Sections {
        perimeter: (0..LEVELS).map(|index| perimeter(level(index))).collect(),
        centre: vec![Vector3::zeros(); LEVELS],
    }
}

#[test]
fn a_free_body_is_in_no_doubt() {
    let scale = scale(|_| ()).unwrap();
    assert!((scale.length - 1.0).abs() < 0.03, "{scale:?}");
    let (arm, leg) = (limb(|at| 0.1 + 0.2 * at), limb(|at| 0.1 + 0.5 * at));
    let touching = Touching::new(scale, [Some(&arm), Some(&arm)], [Some(&leg), Some(&leg)]);
    assert!(!touching.any(), "{touching:?}");
}

#[test]
fn an_arm_whose_curves_go_round_the_trunk_is_in_doubt_and_the_other_is_not() {
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
fn hands_that_touch_hips_leave_the_scale_to_the_feet() {
    let change = |ways: &mut [[f64; 5]; 5]| {
        for (one, other) in [(1, 2), (1, 3), (1, 4), (2, 3), (2, 4)] {
            ways[one][other] *= 0.55;
            ways[other][one] = ways[one][other];
        }
    };
    let found = scale(change).unwrap();
    assert!(found.disagrees() && (found.length - 1.0).abs() < 1e-9, "{found:?}");
}

#[test]
fn legs_that_touch_are_in_doubt_and_leave_the_scale_to_the_rest() {
    let change = |ways: &mut [[f64; 5]; 5]| {
        ways[3][4] *= 0.8;
        ways[4][3] = ways[3][4];
    };
    let found = scale(change).unwrap();
    let limb = limb(|_| 0.2);
    let touching = Touching::new(found, [Some(&limb), Some(&limb)], [Some(&limb), Some(&limb)]);
    assert!(touching.scale && touching.legs == [true; 2], "{found:?} {touching:?}");
    assert!((found.length - 1.0).abs() < 0.04, "{found:?}");
}

#[test]
fn ways_that_contradict_each_other_have_no_scale() {
    let none = scale(|ways| {
        ways[3][4] *= 0.2;
        ways[4][3] = ways[3][4];
    });
    assert_eq!(none, None);
    assert_eq!(scale(|ways| ways[2][1] = 0.0), None);
    assert_eq!(scale(|ways| ways[4][3] = f64::INFINITY), None);
}
