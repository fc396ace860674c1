//! A missing limb is left out, or its joints state their uncertainty.

use mocapd_body::{
    Joint, Joints, Mesh, Refusal, ScanAnalysis, Side,
    read::{Format, Scan},
    repair::repair,
    skeleton::Method,
};
use mocapd_testkit::synthetic_body::{BodyOptions, LimbCut, LimbPart, Pose, body, cut_limb};

/// Largest error of a joint whose stated standard deviation is below [`SURE`], as a fraction of stature.
const FAR: f64 = 0.1;
const SURE: f64 = 0.03;
const NOTICED: &str = "limb-cut-off";

fn analyse(mesh: Mesh) -> Result<ScanAnalysis, Refusal> {
    let scan = Scan { mesh, format: Format::Obj, unit: None, notes: Vec::new() };
    ScanAnalysis::new(&repair(scan, None).unwrap().mesh, Method::Default)
}

fn has_notice(analysis: &ScanAnalysis) -> bool {
    analysis.notes.iter().any(|note| note.code == NOTICED)
}

fn far_and_sure(analysis: &ScanAnalysis, truth: &Joints, stature: f64) -> Vec<(Joint, f64)> {
    let other = |side| if side == Side::Left { Side::Right } else { Side::Left };
    let of = |joint: Joint| match joint {
        Joint::Shoulder(side) => Joint::Shoulder(other(side)),
        Joint::Elbow(side) => Joint::Elbow(other(side)),
        Joint::Wrist(side) => Joint::Wrist(other(side)),
        Joint::Hip(side) => Joint::Hip(other(side)),
        Joint::Knee(side) => Joint::Knee(other(side)),
        Joint::Ankle(side) => Joint::Ankle(other(side)),
        joint => joint,
    };
    let errors = |swapped: bool| {
        let found = analysis.joints.estimates.iter();
        let error = move |(joint, found): (&Joint, &mocapd_body::Estimate)| {
            let joint = if swapped { of(*joint) } else { *joint };
            let [a, b] = [truth.estimates[&joint].position, found.position];
            let error = (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
            (joint, error / stature, found.sigma / stature)
        };
        found.map(error).collect::<Vec<_>>()
    };
    let sum = |errors: &[(Joint, f64, f64)]| errors.iter().map(|(_, error, _)| error).sum::<f64>();
    let (straight, crossed) = (errors(false), errors(true));
    // If the sides are uncertain, either assignment is accepted.
    let crossed_fits = !analysis.joints.sides_told && sum(&crossed) < sum(&straight);
    let fitting = if crossed_fits { crossed } else { straight };
    let far = fitting.into_iter().filter(|(_, error, sigma)| *error > FAR && *sigma < SURE);
    far.map(|(joint, error, _)| (joint, error)).collect()
}

#[test]
fn no_joint_of_a_body_with_a_missing_limb_is_wrong_and_confident() {
    let mut seen: Vec<(LimbCut, bool)> = Vec::new();
    for (at, pose) in (0..).zip([Pose::A, Pose::Walk, Pose::Down]) {
        let (mesh, truth) = body(at, pose, BodyOptions::default());
        let crown = body(at, Pose::A, BodyOptions { n_faces: 500, turned: false }).1;
        let stature = crown.estimates[&Joint::Head].position[1];
        let whole = analyse(mesh.clone()).unwrap();
        assert!(!has_notice(&whole), "{pose:?}: {:?}", whole.notes);
        for seed in 0..8 {
            let Some((rest, cut)) = cut_limb(&mesh, &truth, 8 * at + seed) else { continue };
            let Ok(found) = analyse(rest) else { continue };
            let far = far_and_sure(&found, &truth, stature);
            assert!(far.is_empty(), "{pose:?}, {cut:?}: {far:?}");
            seen.push((cut, has_notice(&found)));
        }
    }
    assert!(seen.len() >= 12, "only {} cuts are no reason to refuse a scan", seen.len());
    let legs = [LimbPart::Foot, LimbPart::HalfShank, LimbPart::Shank, LimbPart::Knee];
    let unnoticed = seen.iter().filter(|(cut, noticed)| legs.contains(&cut.part) && !noticed);
    let unnoticed: Vec<_> = unnoticed.collect();
    assert!(unnoticed.len() <= 1, "{unnoticed:?}");
}

#[test]
fn a_cut_off_part_is_left_out_and_the_other_side_keeps_its_place() {
    let (mesh, truth) = body(0, Pose::A, BodyOptions::default());
    // A shank: neither its ankle nor its foot is in the scan.
    let cuts = (0..64).map(|turn| 8 * turn + 1).filter_map(|seed| cut_limb(&mesh, &truth, seed));
    let (rest, cut) = cuts.into_iter().find(|(_, cut)| cut.part == LimbPart::HalfShank).unwrap();
    let found = analyse(rest).unwrap();
    let other = if cut.side == Side::Left { Side::Right } else { Side::Left };
    assert!(has_notice(&found) && found.joints.sides_told, "{:?}", found.notes);
    assert!(!found.joints.estimates.contains_key(&Joint::Ankle(cut.side)));
    for joint in [Joint::Ankle(other), Joint::Knee(other)] {
        let estimate = &found.joints.estimates[&joint];
        let [a, b] = [truth.estimates[&joint].position, estimate.position];
        let error = (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
        assert!(error < 2.0 * estimate.sigma, "{joint:?}: {error} m at {} m", estimate.sigma);
    }
}
