//! A body in other builds: leaner and stouter, by moving the surface outwards or inwards, by different amounts on
//! every part of the body; with longer and shorter bones, by stretching the surface along them, and the joints with
//! it.

use std::collections::BTreeMap;

use mocapd_body::{
    Mesh, Refusal, extremity,
    geodesic::{Adjacency, Graph, Workspace},
};
use nalgebra::Vector3;

/// Known joint positions by name.
pub(crate) type Truth = BTreeMap<String, [f64; 3]>;

/// Factors by which bones are stretched.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lengths {
    pub(crate) upper_arm: f64,
    pub(crate) forearm: f64,
    pub(crate) thigh: f64,
    pub(crate) shank: f64,
    pub(crate) foot: f64,
}

impl Lengths {
    pub(crate) const SAME: Self =
        Self { upper_arm: 1.0, forearm: 1.0, thigh: 1.0, shank: 1.0, foot: 1.0 };
}

/// Radius around a joint within which the surface determines the distance between joint and extremity, in units of
/// `scale`.
const ROUND: f64 = 0.06;

/// Stretches the bones of all limbs. Everything farther out moves along; the trunk stays.
pub(crate) fn stretched(
    mesh: &Mesh,
    truth: &Truth,
    fields: &[Vec<f64>; 5],
    scale: f64,
    lengths: &Lengths,
) -> (Mesh, Truth) {
    let (mut changed, mut joints) = (mesh.clone(), truth.clone());
    let arm = ["shoulder", "elbow", "wrist", "mcp3"];
    let leg = ["hip", "knee", "ankle", "toe"];
    let by =
        [[lengths.upper_arm, lengths.forearm, 1.0], [lengths.thigh, lengths.shank, lengths.foot]];
    for (end, field) in fields.iter().enumerate().skip(1) {
        let (names, by) = if end < 3 { (arm, by[0]) } else { (leg, by[1]) };
        // The limb whose outer joint is nearest to the source of this distance field.
        let outer = |side: &str| level(mesh, field, truth, &format!("{}.{side}", names[2]), scale);
        let side = if outer("L") < outer("R") { "L" } else { "R" };
        let names = names.map(|name| format!("{name}.{side}"));
        let at = names.clone().map(|name| Vector3::from(truth[&name]));
        let mut levels = names.clone().map(|name| level(mesh, field, truth, &name, scale));
        levels[3] = 0.0;
        for bone in 0..3 {
            let longer = (at[bone + 1] - at[bone]) * (by[bone] - 1.0);
            let span = (levels[bone] - levels[bone + 1]).max(f64::MIN_POSITIVE);
            for (position, distance) in changed.positions.iter_mut().zip(field) {
                let part = ((levels[bone] - distance) / span).clamp(0.0, 1.0);
                *position = (Vector3::from(*position) + longer * part).into();
            }
            for name in &names[bone + 1..] {
                let moved = Vector3::from(joints[name]) + longer;
                joints.insert(name.clone(), moved.into());
            }
        }
    }
    (changed, joints)
}

/// Mean distance of the surface around a joint from the extremity.
fn level(mesh: &Mesh, field: &[f64], truth: &Truth, joint: &str, scale: f64) -> f64 {
    let at = Vector3::from(truth[joint]);
    let (mut sum, mut count) = (0.0, 0.0);
    for (position, distance) in mesh.positions.iter().zip(field) {
        let far = (Vector3::from(*position) - at).norm() / scale;
        let weight = (1.0 - far / (2.0 * ROUND)).max(0.0);
        sum += weight * distance;
        count += weight;
    }
    sum / count
}

/// Thickness added to a body, in body scales, at positions along it; interpolated in between.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Girth {
    pub(crate) wrist: f64,
    pub(crate) forearm: f64,
    pub(crate) upper_arm: f64,
    pub(crate) ankle: f64,
    pub(crate) calf: f64,
    pub(crate) knee: f64,
    pub(crate) thigh: f64,
    pub(crate) trunk: f64,
}

impl Girth {
    /// Increases in proportion to the distance from the nearest extremity.
    pub(crate) fn evenly(trunk: f64) -> Self {
        let at = |distance: f64| trunk * ((distance - 0.076) / 0.404);
        let [wrist, forearm, upper_arm] = [0.14, 0.20, 0.33].map(at);
        let [ankle, calf, knee, thigh] = [0.16, 0.25, 0.345, 0.46].map(at);
        Self { wrist, forearm, upper_arm, ankle, calf, knee, thigh, trunk }
    }

    /// Thickness added at a vertex, by its distances from head, hands and feet in body scales.
    fn at(&self, distances: [f64; 5]) -> f64 {
        let [head, one, other, foot, other_foot] = distances;
        let (hand, foot) = (one.min(other), foot.min(other_foot));
        if head < hand && head < foot {
            return between(&[(0.16, 0.0), (0.36, self.trunk)], head);
        }
        if hand < foot {
            let (wrist, forearm) = ((0.14, self.wrist), (0.20, self.forearm));
            let (upper_arm, trunk) = ((0.33, self.upper_arm), (0.44, self.trunk));
            return between(&[(0.08, 0.0), wrist, forearm, upper_arm, trunk], hand);
        }
        let (ankle, calf) = ((0.16, self.ankle), (0.25, self.calf));
        let (knee, thigh, trunk) = ((0.345, self.knee), (0.46, self.thigh), (0.60, self.trunk));
        between(&[(0.08, 0.0), ankle, calf, knee, thigh, trunk], foot)
    }
}

/// Moves the surface along its normals; `fields` has a distance per vertex from each extremity, in units of `scale`.
pub(crate) fn moved(mesh: &Mesh, fields: &[Vec<f64>; 5], scale: f64, girth: &Girth) -> Mesh {
    let normals: Vec<Vector3<f64>> = means(mesh, &normals(mesh))
        .iter()
        .map(|sum| sum.try_normalize(0.0).unwrap_or_default())
        .collect();
    let mut added: Vec<f64> = (0..mesh.positions.len())
        .map(|vertex| girth.at(fields.each_ref().map(|field| field[vertex] / scale)))
        .collect();
    // Smoothed, because the thickness jumps where another extremity becomes the nearest.
    for _ in 0..12 {
        added = means(mesh, &added);
    }
    let mut changed = mesh.clone();
    for ((position, normal), added) in changed.positions.iter_mut().zip(&normals).zip(&added) {
        *position = (Vector3::from(*position) + normal * (added * scale)).into();
    }
    changed
}

fn between(places: &[(f64, f64)], at: f64) -> f64 {
    let first = places.first().map_or(0.0, |place| place.1);
    places.windows(2).fold(first, |value, pair| {
        let part = ((at - pair[0].0) / (pair[1].0 - pair[0].0)).clamp(0.0, 1.0);
        value + (pair[1].1 - pair[0].1) * part
    })
}

fn normals(mesh: &Mesh) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros(); mesh.positions.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|corner| Vector3::from(mesh.positions[corner as usize]));
        let area = (b - a).cross(&(c - a));
        triangle.iter().for_each(|corner| sums[*corner as usize] += area);
    }
    sums.iter().map(|sum| sum.try_normalize(0.0).unwrap_or_default()).collect()
}

/// Means over a vertex and its neighbours.
fn means<T>(mesh: &Mesh, values: &[T]) -> Vec<T>
where
    T: Copy + std::ops::AddAssign + std::ops::Div<f64, Output = T>,
{
    let mut sums = values.to_vec();
    let mut counts = vec![1.0; values.len()];
    for [a, b, c] in &mesh.triangles {
        for (to, from) in [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)] {
            sums[*to as usize] += values[*from as usize];
            counts[*to as usize] += 1.0;
        }
    }
    sums.iter().zip(&counts).map(|(sum, count)| *sum / *count).collect()
}

/// Number of random builds, in addition to the three fixed ones.
const DRAWN: u64 = 8;
/// Geodesic distance between the feet, in body scales.
const FEET: f64 = 1.09;

/// Modifications of a body.
pub(crate) struct Build {
    pub(crate) name: String,
    girth: Girth,
    lengths: Lengths,
}

/// The original; 2 cm less around the waist; 4 cm more; and random ones, with a girth for each part of the body and a
/// length for each bone.
pub(crate) fn builds() -> Vec<Build> {
    let fixed = [("as-is", 0.0), ("lean", -0.011), ("stout", 0.024)];
    let fixed = fixed.map(|(name, trunk)| Build {
        name: name.to_owned(),
        girth: Girth::evenly(trunk),
        lengths: Lengths::SAME,
    });
    fixed.into_iter().chain((0..DRAWN).map(drawn)).collect()
}

fn drawn(number: u64) -> Build {
    // In antithetic pairs: one exceeds the average by as much as the other falls short of it, so that the average is
    // kept.
    let mut random = Random { state: number / 2, mirrored: number % 2 == 1 };
    // Fat is added to trunk and thighs first; the rest of the limbs get independent shares of it.
    let trunk = random.between(-0.012, 0.036);
    let mut share = |low: f64, high: f64| trunk * random.between(low, high);
    let girth = Girth {
        wrist: share(0.0, 0.3),
        forearm: share(0.1, 0.5),
        upper_arm: share(0.2, 0.9),
        ankle: share(0.0, 0.5),
        calf: share(0.1, 0.7),
        knee: share(0.1, 0.6),
        thigh: share(0.5, 1.2),
        trunk,
    };
    let mut length = |by: f64| random.between(1.0 - by, 1.0 + by);
    let lengths = Lengths {
        upper_arm: length(0.09),
        forearm: length(0.09),
        thigh: length(0.09),
        shank: length(0.09),
        foot: length(0.09),
    };
    Build { name: format!("drawn-{number}"), girth, lengths }
}

/// The modified body and its joints.
pub(crate) fn changed(mesh: &Mesh, truth: &Truth, build: &Build) -> Result<(Mesh, Truth), Refusal> {
    let graph = Graph::with_short_cuts(mesh, &Adjacency::new(mesh)?);
    let ends = extremity::find(mesh, &graph, &mut Workspace::default())?;
    let scale = ends.fields[3][ends.extremities.feet[1] as usize] / FEET;
    let (mesh, truth) = stretched(mesh, truth, &ends.fields, scale, &build.lengths);
    Ok((moved(&mesh, &ends.fields, scale, &build.girth), truth))
}

/// Seeded pseudo-random numbers (Steele et al. 2014, `SplitMix64`).
struct Random {
    state: u64,
    /// Whether numbers are mirrored within their range.
    mirrored: bool,
}

impl Random {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.state;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^= mixed >> 31;
        let part = (mixed >> 11) as f64 / (1_u64 << 53) as f64;
        low + (high - low) * if self.mirrored { 1.0 - part } else { part }
    }
}
