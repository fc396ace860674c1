//! A body of rigid segments: computes the 15 sites of a pose, and further markers in rigid clusters on the segments.

use super::arithmetic::{Rng, V3, add, cross, dot, norm, offset, scale, sin_cos, sub, unit};

/// The marker sites of Shi et al. 2012, in the order of the first 15 columns.
pub const SITES: [&str; 15] = [
    "head",
    "throat",
    "pelvis",
    "l_shoulder",
    "l_elbow",
    "l_wrist",
    "r_shoulder",
    "r_elbow",
    "r_wrist",
    "l_hip",
    "l_knee",
    "l_ankle",
    "r_hip",
    "r_knee",
    "r_ankle",
];

/// Pairs of sites joined by a rigid bone, as indices into [`SITES`].
pub const BONES: [(usize, usize); 14] = [
    (2, 1),
    (1, 0),
    (1, 3),
    (3, 4),
    (4, 5),
    (1, 6),
    (6, 7),
    (7, 8),
    (2, 9),
    (9, 10),
    (10, 11),
    (2, 12),
    (12, 13),
    (13, 14),
];

/// Segment lengths in metres.
///
/// Fractions of stature after Drillis and Contini 1966, as printed in Winter, "Biomechanics and Motor
/// Control of Human Movement", 4th ed. 2009, fig. 4.1.
#[derive(Debug, Clone, Copy)]
pub(super) struct Body {
    pub(super) stature: f64,
    pub(super) thigh: f64,
    pub(super) shank: f64,
    pub(super) ankle_height: f64,
    /// Half the distance between the hips.
    pub(super) half_hips: f64,
    half_shoulders: f64,
    upper_arm: f64,
    forearm: f64,
    /// Hip line to throat; the throat is half way between shoulder line and chin.
    trunk: f64,
    shoulder_drop: f64,
    /// Throat to the middle of the head at eye level.
    head: f64,
}

/// One arm: angles in radians, 0 hanging, forward positive.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Arm {
    pub(super) swing: f64,
    pub(super) elbow: f64,
    pub(super) abduction: f64,
}

/// Pose of the body at one time, in the axes of the capture volume.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pose {
    /// Middle of the hip line.
    pub(super) pelvis: V3,
    /// Cosine and sine of the heading, from +x towards +y.
    pub(super) facing: [f64; 2],
    /// Forward lean of the trunk, and pitch of the head relative to it, radians.
    pub(super) lean: f64,
    pub(super) head_pitch: f64,
    /// Shoulder line against hip line about the vertical, radians.
    pub(super) twist: f64,
    /// Left, right.
    pub(super) arms: [Arm; 2],
    /// Left, right: target positions of the ankles.
    pub(super) ankles: [V3; 2],
}

impl Body {
    pub(super) fn of_stature(stature: f64) -> Self {
        let (shoulder_height, chin_height, eye_height, hip_height) = (0.818, 0.870, 0.936, 0.530);
        let throat_height = 0.5 * (shoulder_height + chin_height);
        Self {
            stature,
            thigh: 0.245 * stature,
            shank: 0.246 * stature,
            ankle_height: 0.039 * stature,
            half_hips: 0.5 * 0.191 * stature,
            half_shoulders: 0.129 * stature,
            upper_arm: 0.186 * stature,
            forearm: 0.146 * stature,
            trunk: (throat_height - hip_height) * stature,
            shoulder_drop: (throat_height - shoulder_height) * stature,
            head: (eye_height - throat_height) * stature,
        }
    }

    /// Hip to ankle with a straight knee, metres.
    pub(super) fn leg(&self) -> f64 {
        self.thigh + self.shank
    }

    /// The 15 sites of a pose, in the order of [`SITES`], and the lateral axes of hips and shoulders, to the left.
    pub(super) fn place(&self, pose: &Pose) -> ([V3; 15], [V3; 2]) {
        let [cos_yaw, sin_yaw] = pose.facing;
        let up = [0.0, 0.0, 1.0];
        let forward = [cos_yaw, sin_yaw, 0.0];
        let left = cross(up, forward);
        let lean = |angle: f64| {
            let (s, c) = sin_cos(angle);
            offset([0.0; 3], [forward, left, up], [s, 0.0, c])
        };
        let spine = lean(pose.lean);
        // The chest turns about the spine, so its axes stay perpendicular to it.
        let (sin_twist, cos_twist) = sin_cos(pose.twist);
        let front = cross(left, spine);
        let chest_left = offset([0.0; 3], [left, front, up], [cos_twist, -sin_twist, 0.0]);
        let throat = add(pose.pelvis, scale(spine, self.trunk));
        let head = add(throat, scale(lean(pose.lean + pose.head_pitch), self.head));
        let mut sites = [[0.0; 3]; 15];
        (sites[0], sites[1], sites[2]) = (head, throat, pose.pelvis);
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let shoulder = add(
                sub(throat, scale(spine, self.shoulder_drop)),
                scale(chest_left, sign * self.half_shoulders),
            );
            let arm = &pose.arms[side];
            let along = |angle: f64, abduction: f64| {
                let ((s, c), (sa, ca)) = (sin_cos(angle), sin_cos(abduction));
                offset([0.0; 3], [forward, left, up], [s * ca, sign * sa, -c * ca])
            };
            let elbow = add(shoulder, scale(along(arm.swing, arm.abduction), self.upper_arm));
            let forearm = along(arm.swing + arm.elbow, 0.3 * arm.abduction);
            let hip = add(pose.pelvis, scale(left, sign * self.half_hips));
            let (knee, ankle) = self.bend_leg(hip, pose.ankles[side], left);
            let (arm_site, leg_site) = (3 + 3 * side, 9 + 3 * side);
            sites[arm_site] = shoulder;
            sites[arm_site + 1] = elbow;
            sites[arm_site + 2] = add(elbow, scale(forearm, self.forearm));
            sites[leg_site] = hip;
            sites[leg_site + 1] = knee;
            sites[leg_site + 2] = ankle;
        }
        (sites, [left, chest_left])
    }

    /// Two-bone inverse kinematics: knee and ankle for a target ankle, with the knee in front.
    ///
    /// A target out of reach is moved smoothly towards the hip, so that the bones keep their lengths.
    fn bend_leg(&self, hip: V3, target: V3, left: V3) -> (V3, V3) {
        let full = sub(target, hip);
        let down = unit(full);
        let reach = self.soft_reach(norm(full));
        let along =
            (self.thigh * self.thigh - self.shank * self.shank + reach * reach) / (2.0 * reach);
        let across = (self.thigh * self.thigh - along * along).max(0.0).sqrt();
        let front = cross(down, left);
        let front = unit(sub(front, scale(down, dot(front, down))));
        let knee = add(add(hip, scale(down, along)), scale(front, across));
        let ankle = if reach < norm(full) { add(hip, scale(down, reach)) } else { target };
        (knee, ankle)
    }

    /// Limits the reach: unchanged up to 98.8 % of the leg, then approaching 99.9 % with two continuous derivatives.
    fn soft_reach(&self, reach: f64) -> f64 {
        let (free, margin) = (0.988 * self.leg(), 0.011 * self.leg());
        if reach <= free {
            return reach;
        }
        let x = (reach - free) / margin;
        free + margin * x / (1.0 + x * x).sqrt()
    }
}

/// A body segment that carries markers: its name; its ends, as indices into the sites; whether its rotation about its
/// axis follows the shoulder line rather than the hip line; the distance of the markers from the axis, metres.
pub(super) type Segment = (&'static str, (usize, usize), bool, f64);

/// Radii of an adult's limbs to the nearest half centimetre; they only place markers.
pub(super) const SEGMENTS: [Segment; 10] = [
    ("trunk", (2, 1), true, 0.130),
    ("l_thigh", (9, 10), false, 0.075),
    ("r_thigh", (12, 13), false, 0.075),
    ("l_shank", (10, 11), false, 0.055),
    ("r_shank", (13, 14), false, 0.055),
    ("l_upper_arm", (3, 4), true, 0.045),
    ("r_upper_arm", (6, 7), true, 0.045),
    ("l_forearm", (4, 5), true, 0.035),
    ("r_forearm", (7, 8), true, 0.035),
    ("head", (1, 0), true, 0.090),
];

/// A marker attached to a segment.
#[derive(Debug, Clone)]
pub(super) struct SegmentMarker {
    pub(super) label: String,
    pub(super) ends: (usize, usize),
    follows_chest: bool,
    /// Offset along the segment, to its left and perpendicular to both, metres.
    at: V3,
    /// Position along the segment, as a fraction of its length.
    along: f64,
}

/// Places `n` markers beyond the sites, on one segment after another.
pub(super) fn segment_markers(n: usize, seed: u64) -> Vec<SegmentMarker> {
    (0..n)
        .map(|i| {
            let (name, ends, follows_chest, radius_m) = SEGMENTS[i % SEGMENTS.len()];
            let mut rng = Rng::stream(seed, 0x1_0000 + i as u64);
            let (sin, cos) = sin_cos(rng.between(-std::f64::consts::PI, std::f64::consts::PI));
            let radius = radius_m * rng.between(0.85, 1.1);
            SegmentMarker {
                label: format!("{name}_{}", i / SEGMENTS.len() + 1),
                ends,
                follows_chest,
                at: [0.0, radius * sin, radius * cos],
                along: rng.between(0.12, 0.88),
            }
        })
        .collect()
}

/// Position of a segment marker, from the sites and the lateral axes of hips and chest.
pub(super) fn marker_position(marker: &SegmentMarker, sites: &[V3; 15], lateral: &[V3; 2]) -> V3 {
    let (from, to) = (sites[marker.ends.0], sites[marker.ends.1]);
    let bone = sub(to, from);
    let along = unit(bone);
    let left = lateral[usize::from(marker.follows_chest)];
    let left = unit(sub(left, scale(along, dot(left, along))));
    let at = [marker.at[0], marker.at[1], marker.at[2]];
    let base = offset(from, [bone, left, along], [marker.along, 0.0, at[0]]);
    offset(base, [left, cross(along, left), along], [at[1], at[2], 0.0])
}
