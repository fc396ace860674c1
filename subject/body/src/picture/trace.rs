//! Conversion of level sets and Reeb graph into a drawing.

use super::{BodyPart, Curve, Drawing, Line, Mark, ReebEdge, ReebNode};
use crate::level::{Ring, Rings};
use crate::mesh::{Point, distance};
use crate::reeb::Levels;
use crate::skeleton::joint_name;
use crate::{Joint, Side};

impl Drawing<'_> {
    /// Adds the level sets, the Reeb graph, and centre line and circularity of each segment. The joints must be set
    /// before: they determine which arm is which and are marked on the curves.
    pub fn trace(&mut self, Levels { rings, reeb, segments }: &Levels) {
        let mut parts = vec![(BodyPart::Trunk, &segments.trunk)];
        for (side, arm) in self.assign_sides(rings, &segments.arms, Joint::Wrist) {
            parts.push((BodyPart::Arm(side), arm));
        }
        for (side, leg) in self.assign_sides(rings, &segments.legs, Joint::Ankle) {
            parts.push((BodyPart::Leg(side), leg));
        }
        // Curves that belong to no segment, such as those of an ear, are part of the trunk.
        let mut part_of = vec![BodyPart::Trunk; rings.rings.len()];
        for (part, indices) in parts {
            for &index in indices {
                if let Some(of) = part_of.get_mut(index as usize) {
                    *of = part;
                }
            }
            let along: Vec<&Ring> =
                indices.iter().filter_map(|&index| rings.rings.get(index as usize)).collect();
            let points: Vec<[f64; 3]> = along.iter().map(|ring| ring.centroid).collect();
            self.curves.push(self.curve(part, &along, &points));
            self.centre_lines.push(Line { part, points });
        }
        for (ring, &part) in rings.rings.iter().zip(&part_of) {
            self.rings.push(Line { part, points: ring.points.clone() });
            let value = rings.values.get(ring.level as usize).copied().unwrap_or_default();
            self.reeb_nodes.push(ReebNode { position: ring.centroid, value });
        }
        self.reeb_edges.extend(reeb.arcs().map(|[from, to]| {
            // An arc has the colour of its outer end, so limbs begin at the trunk.
            let part = part_of.get(to as usize).copied().unwrap_or(BodyPart::Trunk);
            ReebEdge { from: from as usize, to: to as usize, part }
        }));
    }

    /// Assigns each limb the side whose last joint is nearer to its end.
    fn assign_sides<'a>(
        &self,
        rings: &Rings,
        limbs: &'a [Vec<u32>; 2],
        end: fn(Side) -> Joint,
    ) -> [(Side, &'a Vec<u32>); 2] {
        let far = |limb: &[u32], side: Side| {
            let joint = self.joints.estimates.get(&end(side))?;
            let ring = rings.rings.get(*limb.last()? as usize)?;
            Some(distance(ring.centroid, joint.position))
        };
        let [a, b] = limbs;
        let sum =
            |left: &[u32], right: &[u32]| Some(far(left, Side::Left)? + far(right, Side::Right)?);
        match (sum(a, b), sum(b, a)) {
            (Some(as_is), Some(crossed)) if crossed < as_is => [(Side::Left, b), (Side::Right, a)],
            _ => [(Side::Left, a), (Side::Right, b)],
        }
    }

    /// Circularity over the length of the centre line.
    fn curve(&self, part: BodyPart, along: &[&Ring], points: &[[f64; 3]]) -> Curve {
        let mut far = vec![0.0];
        for pair in points.windows(2) {
            far.push(far.last().copied().unwrap_or(0.0) + distance(pair[0], pair[1]));
        }
        let samples = far.iter().zip(along).map(|(far, ring)| [*far, ring.circularity()]).collect();
        let joints: Vec<Joint> = match part {
            BodyPart::Trunk => vec![Joint::Throat, Joint::Pelvis],
            BodyPart::Arm(side) => {
                vec![Joint::Shoulder(side), Joint::Elbow(side), Joint::Wrist(side)]
            }
            BodyPart::Leg(side) => vec![Joint::Hip(side), Joint::Knee(side), Joint::Ankle(side)],
        };
        let mark = |joint: Joint| {
            let at = self.joints.estimates.get(&joint)?.position;
            let far_off = |index: &usize| distance(points[*index], at);
            let nearest = (0..points.len()).min_by(|a, b| far_off(a).total_cmp(&far_off(b)))?;
            // A shoulder lies before the first curve of the arm alone, so it is on no curve.
            if beyond(points, nearest, at) {
                return None;
            }
            let name = joint_name(joint);
            let name = name.split_once('_').map_or(name, |(_, rest)| rest);
            Some(Mark { distance: *far.get(nearest)?, name: name.to_owned() })
        };
        Curve { part, samples, marks: joints.into_iter().filter_map(mark).collect() }
    }
}

/// Number of points that give the direction of a line at its end; fewer are not in line.
const DIRECTION: usize = 4;

/// Whether a point whose nearest line point is an end lies beyond that end.
fn beyond(line: &[[f64; 3]], nearest: usize, at: [f64; 3]) -> bool {
    let behind = |end: [f64; 3], inward: Option<&[f64; 3]>| {
        let from_end = |at: [f64; 3]| Point::from(at) - Point::from(end);
        inward.is_some_and(|inward| from_end(at).dot(&from_end(*inward)) < 0.0)
    };
    match (nearest, line) {
        (0, [first, ..]) => behind(*first, line.get(DIRECTION)),
        (index, [.., last]) if index + 1 == line.len() => {
            behind(*last, line.iter().rev().nth(DIRECTION))
        }
        _ => false,
    }
}
