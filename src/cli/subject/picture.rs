//! What a picture of a scan shows, out of what was found.

use mocapd_subject::body::{
    Joint, Mesh, Repaired, Side, Survey,
    level::Rings,
    paper::Paper,
    picture::{Curve, Drawing, Line, Part, ReebNode, svg},
    skeleton::{Skeleton, joint_name},
};

/// Level sets that are drawn, one of so many.
const RINGS_EVERY: usize = 2;

pub(super) fn of(name: &str, repaired: &Repaired, survey: &Survey, skeleton: &Skeleton) -> String {
    let method = if skeleton.method == mocapd_subject::body::skeleton::Method::Paper {
        "as Yu et al. 2008"
    } else {
        "default method"
    };
    let title = format!("{name}, {method}");
    let mut drawing = Drawing {
        title: &title,
        mesh: Some(&repaired.mesh),
        unit: Some(repaired.unit),
        joints: survey.joints.clone(),
        skeleton: Some(skeleton),
        ..Drawing::default()
    };
    if let Some(levels) = &survey.levels {
        add_levels(&mut drawing, levels, survey, &repaired.mesh);
    }
    svg(&drawing)
}

fn add_levels(drawing: &mut Drawing<'_>, levels: &Paper, survey: &Survey, mesh: &Mesh) {
    let segments = &levels.segments;
    let sides = sides(survey, mesh);
    let mut parts = vec![(Part::Trunk, &segments.trunk)];
    for (half, side) in sides.into_iter().enumerate() {
        parts.push((Part::Arm(side), &segments.arms[half]));
        parts.push((Part::Leg(side), &segments.legs[half]));
    }
    let trunk_nodes = 0..segments.trunk.len();
    for (part, rings) in parts {
        let first_node = drawing.reeb_nodes.len();
        let mut centres = Vec::with_capacity(rings.len());
        let mut samples = Vec::with_capacity(rings.len());
        let mut along = 0.0;
        for (i, ring) in
            rings.iter().filter_map(|&i| levels.rings.rings.get(i as usize)).enumerate()
        {
            if let Some(&before) = centres.last() {
                along += distance(before, ring.centroid);
            }
            centres.push(ring.centroid);
            samples.push([along, ring.circularity()]);
            let value = levels.rings.values.get(ring.level as usize).copied().unwrap_or_default();
            drawing.reeb_nodes.push(ReebNode { position: ring.centroid, value });
            if i > 0 {
                drawing.reeb_edges.push((first_node + i - 1, first_node + i, part));
            } else if let Some(from) = branch(part, &trunk_nodes, segments, &levels.rings) {
                drawing.reeb_edges.push((from, first_node, part));
            }
            if i % RINGS_EVERY == 0 {
                drawing.rings.push(Line { part, points: ring.points.clone() });
            }
        }
        let marks = marks(part, survey, &centres, &samples);
        drawing.curves.push(Curve { part, samples, marks });
        drawing.centre_lines.push(Line { part, points: centres });
    }
}

/// The node of the trunk that a limb leaves from.
fn branch(
    part: Part,
    trunk: &std::ops::Range<usize>,
    segments: &mocapd_subject::body::reeb::Segments,
    rings: &Rings,
) -> Option<usize> {
    let last = trunk.end.checked_sub(1)?;
    match part {
        Part::Trunk => None,
        Part::Leg(_) => Some(last),
        Part::Arm(_) => {
            let armpit = segments.armpits.iter().copied().fold(f64::INFINITY, f64::min);
            let value = |node: usize| {
                let ring = rings.rings.get(*segments.trunk.get(node)? as usize)?;
                rings.values.get(ring.level as usize).copied()
            };
            trunk.clone().rev().find(|&node| value(node).is_some_and(|value| value < armpit))
        }
    }
}

/// Which side each half of the extremities is on: that of the wrist that is nearer to the hand.
fn sides(survey: &Survey, mesh: &Mesh) -> [Side; 2] {
    let wrist = |side| survey.joints.estimates.get(&Joint::Wrist(side));
    let tip = mesh.positions.get(survey.extremities.hands[0] as usize);
    match (tip, wrist(Side::Left), wrist(Side::Right)) {
        (Some(&tip), Some(left), Some(right))
            if distance(tip, right.position) < distance(tip, left.position) =>
        {
            [Side::Right, Side::Left]
        }
        _ => [Side::Left, Side::Right],
    }
}

/// Where the joints of a part are along its centre line.
fn marks(
    part: Part,
    survey: &Survey,
    centres: &[[f64; 3]],
    samples: &[[f64; 2]],
) -> Vec<(f64, String)> {
    let joints = match part {
        Part::Trunk => vec![Joint::Throat, Joint::Pelvis],
        Part::Arm(side) => vec![Joint::Shoulder(side), Joint::Elbow(side), Joint::Wrist(side)],
        Part::Leg(side) => vec![Joint::Hip(side), Joint::Knee(side), Joint::Ankle(side)],
    };
    let at = |joint: Joint| {
        let position = survey.joints.estimates.get(&joint)?.position;
        let far = |i: &usize| centres.get(*i).map_or(f64::INFINITY, |c| distance(*c, position));
        let nearest = (0..centres.len()).min_by(|a, b| far(a).total_cmp(&far(b)))?;
        let name = joint_name(joint).trim_start_matches("l_").trim_start_matches("r_");
        Some((samples.get(nearest)?[0], name.to_owned()))
    };
    joints.into_iter().filter_map(at).collect()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}
