//! A joint told by how thick the limb is round it.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::locate::limb::{Window, bend, wrist};
use crate::locate::model::{GIRTHS, Measure};
use crate::locate::section::{LEVELS, Sections, level};

/// The lengths of curves of a straight leg as thick as legs are in the mean, with its knee so far from its end; `thicker`
/// times as thick all along, and more so by `slope` a body scale.
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
fn what_is_as_thick_as_the_mean_fits_at_its_knee_alone() {
    let leg = leg(0.36, 1.0, 0.0);
    assert!(GIRTHS.knee.misfit(&leg.perimeter, 0.36) < 0.05);
    for away in [-0.04, -0.02, 0.02, 0.04] {
        assert!(GIRTHS.knee.misfit(&leg.perimeter, 0.36 + away) > 0.5, "{away}");
    }
}

#[test]
fn thick_legs_and_tapered_ones_fit_as_well() {
    for (thicker, slope) in [(1.5, 0.0), (0.7, 0.0), (1.0, 0.8), (1.3, -0.8)] {
        let misfit = GIRTHS.knee.misfit(&leg(0.36, thicker, slope).perimeter, 0.36);
        assert!(misfit < 1.0, "{thicker} {slope}: {misfit}");
    }
}

#[test]
fn a_straight_legs_knee_is_where_its_girth_says_and_not_only_where_knees_are() {
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
fn a_limb_of_no_curves_has_a_misfit_all_the_same() {
    assert!(GIRTHS.knee.misfit(&[], 0.3).is_finite());
    assert!(GIRTHS.knee.misfit(&[0.0; 4], 0.3).is_finite());
}

/// The length of the curve so far `along` the mean arm, with its wrist so far from its end.
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
fn a_wrist_is_where_it_is_under_a_layer_of_fat_too() {
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
