//! Joints located by the girth of the limb around them.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::locate::limb::{Window, bend, wrist};
use crate::locate::model::{GIRTHS, Measure};
use crate::locate::section::{LEVELS, Sections, level};

/// Curve lengths of a straight leg of average girth whose knee is at the given distance from its end, multiplied by
/// `thicker` and tapered by `slope` per body scale.
fn leg(knee: f64, thicker: f64, slope: f64) -> Sections {
    let last = GIRTHS.knee.mean.len() - 1;
    let perimeter = |index: usize| {
        let along = level(index) - knee;
        let at = ((along + 0.12) / 0.012).clamp(0.0, last as f64);
        let (below, part) = (at.floor() as usize, at.fract());
        let above = (below + 1).min(last);
        let log =
            GIRTHS.knee.mean[below] + part * (GIRTHS.knee.mean[above] - GIRTHS.knee.mean[below]);
        thicker * (log + slope * along).exp()
    };
    let centre = |index: usize| Vector3::new(0.0, 0.0, level(index));
    Sections {
        perimeter: (0..LEVELS).map(perimeter).collect(),
        centre: (0..LEVELS).map(centre).collect(),
    }
}

#[test]
fn a_leg_of_average_girth_fits_only_at_its_knee() {
    let leg = leg(0.36, 1.0, 0.0);
    assert!(GIRTHS.knee.misfit(&leg.perimeter, 0.36) < 0.05);
    for away in [-0.04, -0.02, 0.02, 0.04] {
        assert!(GIRTHS.knee.misfit(&leg.perimeter, 0.36 + away) > 0.5, "{away}");
    }
}

#[test]
fn thick_and_tapered_legs_fit_equally_well() {
    for (thicker, slope) in [(1.5, 0.0), (0.7, 0.0), (1.0, 0.8), (1.3, -0.8)] {
        let misfit = GIRTHS.knee.misfit(&leg(0.36, thicker, slope).perimeter, 0.36);
        assert!(misfit < 1.0, "{thicker} {slope}: {misfit}");
    }
}

#[test]
fn the_girth_locates_the_knee_of_a_straight_leg() {
    for knee in [0.32, 0.344, 0.375] {
        let window = Window {
            line: [0.17, 0.53],
            joint: [0.28, 0.41],
            prior: 0.344,
            weight: 0.05,
            rounded: 0.0,
        };
        let leg = leg(knee, 1.2, 0.3);
        let of_girth = |at| 1e-5 * GIRTHS.knee.misfit(&leg.perimeter, at);
        let found = bend(&leg, &window, of_girth).unwrap();
        assert!(
            (found.level - knee).abs() < 0.5 * (knee - 0.344).abs() + 0.004,
            "{knee}: {}",
            found.level
        );
    }
}

#[test]
fn a_limb_without_curves_has_a_finite_misfit() {
    assert!(GIRTHS.knee.misfit(&[], 0.3).is_finite());
    assert!(GIRTHS.knee.misfit(&[0.0; 4], 0.3).is_finite());
}

/// Curve length at `along` on the mean arm whose wrist is at the given distance from its end.
pub(super) fn arm_girth(along: f64, wrist: f64) -> f64 {
    let Measure::Length(average) = GIRTHS.wrist.measure else { panic!("{:?}", GIRTHS.wrist) };
    let last = GIRTHS.wrist.mean.len() - 1;
    let at = ((along - wrist - GIRTHS.wrist.first) / 0.012).clamp(0.0, last as f64);
    let (below, part) = (at.floor() as usize, at.fract());
    let above = (below + 1).min(last);
    average
        * (GIRTHS.wrist.mean[below] + part * (GIRTHS.wrist.mean[above] - GIRTHS.wrist.mean[below]))
}

#[test]
fn a_layer_of_fat_does_not_move_the_wrist() {
    for (at, fat) in [(0.14, 0.0), (0.12, 0.0), (0.13, 0.004), (0.13, -0.002)] {
        let curve = |index| arm_girth(level(index), at) + TAU * fat;
        let perimeter: Vec<f64> = (0..LEVELS).map(curve).collect();
        let found = wrist(&perimeter).unwrap();
        assert!((found - at).abs() < 0.003, "{at} {fat}: {found}");
    }
}

#[test]
fn an_arm_without_curves_has_no_wrist() {
    assert!(wrist(&[]).is_none());
    assert!(wrist(&[0.0; LEVELS]).is_none_or(f64::is_finite));
}
