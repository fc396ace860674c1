//! Functional joint centres: the centres of rotation of limbs, from several poses.
//!
//! In the frame of the trunk, the elbow moves on a sphere about the shoulder, and the knee on one about the hip. A
//! sphere fitted to several poses gives the centre, which no single surface shows.

use nalgebra::{Matrix4, Vector4};

use super::{Length, joint_name};
use crate::mesh::{Point, axes, distance, mean, unit};
use crate::{Joint, Joints, Side};

/// Longest bone: more than any person's trunk.
pub(super) const LENGTH_MAX_MM: f64 = 2000.0;
/// Minimum number of scans.
const SCANS_MIN: usize = 3;
/// Minimum range of motion of the limb, in degrees.
const SWING_MIN_DEGREES: f64 = 40.0;
/// Minimum standard deviation of an elbow or knee in the frame of the trunk, in millimetres, since the trunk bends.
const FLOOR_MM: f64 = 8.0;
/// Iterations of the fit, which converges within five.
const STEPS: usize = 20;
/// A functional centre replaces the estimate of single scans if its standard deviation is smaller by this factor.
const GAIN: f64 = 0.8;

/// A functional centre.
#[derive(Debug)]
pub(super) struct Centre {
    /// Shoulder or hip.
    pub(super) joint: Joint,
    /// Elbow or knee.
    pub(super) child: Joint,
    /// Position in the frame of the first scan, in millimetres.
    pub(super) in_first: Point,
    pub(super) sigma: f64,
    /// Length of the bone.
    pub(super) radius: Length,
}

/// The functional centres of shoulders and hips. `notes` record each result, or why there is none.
pub(super) fn centres(scans: &[Joints], notes: &mut Vec<String>) -> Vec<Centre> {
    if scans.len() < 2 {
        return Vec::new();
    }
    if !scans.iter().all(|scan| scan.sides_told) {
        notes.push("no functional centres: left and right are unknown in some scan".to_owned());
        return Vec::new();
    }
    let mut centres = Vec::new();
    for side in Side::BOTH {
        for (joint, child) in
            [(Joint::Shoulder(side), Joint::Elbow(side)), (Joint::Hip(side), Joint::Knee(side))]
        {
            let name = joint_name(joint);
            match centre(scans, joint, child) {
                Ok(centre) => {
                    notes.push(format!("{name}: centre of rotation of {}", joint_name(child)));
                    centres.push(centre);
                }
                Err(reason) => notes.push(format!("{name}: no functional centre, {reason}")),
            }
        }
    }
    centres
}

/// Frame of the trunk: origin at the throat, x to the left, y up the trunk, z forward.
struct Trunk {
    origin: Point,
    axes: [Point; 3],
}

impl Trunk {
    fn of(scan: &Joints) -> Option<Self> {
        let origin = scan.point(Joint::Throat)?;
        let [left, right] = Side::BOTH.map(|side| scan.point(Joint::Hip(side)));
        let (left, right) = left.zip(right)?;
        Some(Self { origin, axes: axes(origin - mean([left, right])?, left - right)? })
    }

    fn to_local(&self, p: Point) -> Point {
        self.axes.map(|axis| axis.dot(&(p - self.origin))).into()
    }

    fn to_world(&self, p: Point) -> Point {
        let [left, up, forward] = [0, 1, 2].map(|k| self.axes[k] * p[k]);
        self.origin + (left + (up + forward))
    }
}

/// A joint and its child in the frame of one scan's trunk.
struct JointPair {
    joint: LocatedJoint,
    child: LocatedJoint,
}

struct LocatedJoint {
    at: Point,
    sigma: f64,
}

fn centre(scans: &[Joints], joint: Joint, child: Joint) -> Result<Centre, String> {
    let first = scans.first().and_then(Trunk::of).ok_or("the first scan has no trunk")?;
    let pair = |scan: &Joints| {
        let trunk = Trunk::of(scan)?;
        let of = |joint: Joint| {
            let estimate = scan.estimates.get(&joint)?;
            let at = trunk.to_local(estimate.position.into());
            Some(LocatedJoint { at, sigma: estimate.sigma.hypot(FLOOR_MM) })
        };
        Some(JointPair { joint: of(joint)?, child: of(child)? })
    };
    let pairs: Vec<JointPair> = scans.iter().filter_map(pair).collect();
    if pairs.len() < SCANS_MIN {
        return Err(format!("{} scans show it, at least {SCANS_MIN} are needed", pairs.len()));
    }
    let n = pairs.len() as f64;
    let prior = mean(pairs.iter().map(|pair| pair.joint.at)).ok_or("no scan shows it")?;
    // Errors of the estimates are correlated between scans, so their mean is hardly better than one of them.
    let prior_sigma = pairs.iter().map(|pair| pair.joint.sigma).sum::<f64>() / n;
    let degrees = swing(&pairs, prior).to_degrees();
    if degrees < SWING_MIN_DEGREES {
        return Err(format!(
            "its range of motion is {degrees:.0} degrees, at least {SWING_MIN_DEGREES} are needed"
        ));
    }
    let fit = SphereFit::new(&pairs, prior, prior_sigma).ok_or("no sphere fits")?;
    if !(fit.radius.mm < LENGTH_MAX_MM && fit.radius.sigma_mm < fit.radius.mm) {
        return Err("no sphere of a limb's size fits".to_owned());
    }
    if fit.sigma > GAIN * prior_sigma {
        return Err("the poses lie almost in one plane".to_owned());
    }
    Ok(Centre {
        joint,
        child,
        in_first: first.to_world(fit.centre),
        sigma: fit.sigma,
        radius: fit.radius,
    })
}

/// Largest angle between two directions, in radians.
fn swing(pairs: &[JointPair], from: Point) -> f64 {
    let directions: Vec<Point> = pairs.iter().map(|pair| unit(pair.child.at - from)).collect();
    let pairs = directions
        .iter()
        .enumerate()
        .flat_map(|(i, a)| directions.iter().skip(i + 1).map(|b| a.dot(b).clamp(-1.0, 1.0).acos()));
    pairs.fold(0.0, f64::max)
}

/// A sphere through the child joints with a prior on its centre: Gauss-Newton least squares in centre and radius.
struct SphereFit {
    centre: Point,
    sigma: f64,
    radius: Length,
}

impl SphereFit {
    fn new(pairs: &[JointPair], prior: Point, prior_sigma: f64) -> Option<Self> {
        let n = pairs.len() as f64;
        let mut centre = prior;
        let mut radius = pairs.iter().map(|pair| distance(pair.child.at, prior)).sum::<f64>() / n;
        // Each of three directions has a third of the variance.
        let stiffness = 3.0 / prior_sigma.powi(2);
        let mut inverse = Matrix4::zeros();
        for _ in 0..STEPS {
            let offset = prior - centre;
            let mut normal =
                Matrix4::from_diagonal(&Vector4::new(stiffness, stiffness, stiffness, 0.0));
            let mut right = Vector4::new(offset[0], offset[1], offset[2], 0.0) * stiffness;
            for pair in pairs {
                let LocatedJoint { at, sigma } = pair.child;
                let toward = unit(centre - at);
                let row = Vector4::new(toward[0], toward[1], toward[2], -1.0);
                let weight = 3.0 / sigma.powi(2);
                normal += row * row.transpose() * weight;
                right += row * (weight * (radius - distance(centre, at)));
            }
            inverse = normal.try_inverse()?;
            let step: Vector4<f64> = inverse * right;
            centre += step.xyz();
            radius += step[3];
        }
        let sigma = (inverse[(0, 0)] + inverse[(1, 1)] + inverse[(2, 2)]).sqrt();
        let radius_sigma = inverse[(3, 3)].sqrt();
        let finite =
            sigma.is_finite() && radius.is_finite() && centre.iter().all(|c| c.is_finite());
        let radius = Length { mm: radius, sigma_mm: radius_sigma };
        (finite && radius.mm > 0.0).then_some(Self { centre, sigma, radius })
    }
}
