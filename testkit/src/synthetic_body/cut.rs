//! Removes part of a limb from a body, as if the scanner's view ended there or a program cut the mesh.

use std::collections::{BTreeMap, HashMap, HashSet};

use mocapd_body::{Joint, Joints, Mesh, Side};

use super::{Point, unit};
use crate::random::Random;

/// The part of a limb that is cut off, up to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LimbPart {
    /// From the ankle.
    Foot,
    /// From the middle of the shank.
    HalfShank,
    /// From just below the knee.
    Shank,
    /// From just above the knee.
    Knee,
    /// From the wrist.
    Hand,
    /// From the middle of the forearm.
    HalfForearm,
    /// From the elbow.
    Forearm,
    /// From just below the shoulder.
    Arm,
}

/// Constructs the joint of one side.
type OfSide = fn(Side) -> Joint;

impl LimbPart {
    /// All parts.
    pub const ALL: [Self; 8] = [
        Self::Foot,
        Self::HalfShank,
        Self::Shank,
        Self::Knee,
        Self::Hand,
        Self::HalfForearm,
        Self::Forearm,
        Self::Arm,
    ];

    /// The joints of the bone that is cut, and the position of the cut as a fraction of its length.
    fn cut_site(self) -> (OfSide, OfSide, f64) {
        match self {
            Self::Foot => (Joint::Knee, Joint::Ankle, 1.0),
            Self::HalfShank => (Joint::Knee, Joint::Ankle, 0.5),
            Self::Shank => (Joint::Knee, Joint::Ankle, 0.1),
            Self::Knee => (Joint::Hip, Joint::Knee, 0.93),
            Self::Hand => (Joint::Elbow, Joint::Wrist, 1.0),
            Self::HalfForearm => (Joint::Elbow, Joint::Wrist, 0.5),
            Self::Forearm => (Joint::Elbow, Joint::Wrist, 0.05),
            Self::Arm => (Joint::Shoulder, Joint::Elbow, 0.3),
        }
    }

    /// Plausible range of the part's fraction of the surface, half to twice the expected one: a hand has 2.5 %, a
    /// foot 3.5 %, a forearm 3 %, an upper arm 4 %, a shank 7 % (Lund and Browder 1944). A plane that removes more
    /// cuts the trunk, and one that removes less leaves toes or fingers.
    fn surface_share(self) -> [f64; 2] {
        let of = match self {
            Self::Foot => 0.03,
            Self::HalfShank => 0.065,
            Self::Shank => 0.095,
            Self::Knee => 0.115,
            Self::Hand => 0.02,
            Self::HalfForearm => 0.035,
            Self::Forearm => 0.052,
            Self::Arm => 0.08,
        };
        [0.5 * of, 2.0 * of]
    }
}

/// A cut through a limb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimbCut {
    /// The part removed.
    pub part: LimbPart,
    /// The side of the body.
    pub side: Side,
    /// Angle between the plane's normal and the bone.
    pub tilt_deg: f64,
    /// Whether the cut is closed by a flat cap.
    pub capped: bool,
}

/// Largest tilt of the plane: steeper cuts are unrealistic and miss the limb.
const TILT_MAX_DEG: f64 = 40.0;
/// Maximum number of planes tried; those that remove more than the limb are rejected.
const TRIES: usize = 16;

/// Removes a part of a limb, selected by the seed; `None` when every plane tried removes more than the limb.
#[must_use]
pub fn cut_limb(mesh: &Mesh, joints: &Joints, seed: u64) -> Option<(Mesh, LimbCut)> {
    let mut random = Random::new(seed ^ 0x6375_7421);
    // Consecutive seeds select the parts in turn.
    let part = LimbPart::ALL[(seed % LimbPart::ALL.len() as u64) as usize];
    let side = if random.between(0.0, 1.0) < 0.5 { Side::Left } else { Side::Right };
    let capped = random.between(0.0, 1.0) < 0.5;
    let (near, far, share) = part.cut_site();
    let at =
        |joint: OfSide| joints.estimates.get(&joint(side)).map(|found| Point::from(found.position));
    let (near, far) = (at(near)?, at(far)?);
    let bone = far - near;
    for _ in 0..TRIES {
        let tilt_deg = random.between(0.0, TILT_MAX_DEG);
        let across = super::direction(&mut random);
        let across = unit(across - unit(bone) * across.dot(&unit(bone)));
        let tilt = tilt_deg.to_radians();
        let normal = unit(bone) * tilt.cos() + across * tilt.sin();
        let plane = Plane { through: near + bone * share, normal };
        let found = plane.cut_off(mesh, capped);
        let [least, most] = part.surface_share();
        let taken = |rest: &Mesh| 1.0 - area(rest) / area(mesh);
        if let Some(found) = found.filter(|rest| (least..most).contains(&taken(rest))) {
            return Some((found, LimbCut { part, side, tilt_deg, capped }));
        }
    }
    None
}

/// Two vertices, the lower index first.
type Edge = (u32, u32);

/// The plane of a cut.
struct Plane {
    through: Point,
    normal: Point,
}

impl Plane {
    fn height(&self, at: [f64; 3]) -> f64 {
        (Point::from(at) - self.through).dot(&self.normal)
    }

    /// The point at which an edge crosses the plane.
    fn crossing(&self, mesh: &Mesh, (from, to): Edge) -> Point {
        let ends = [from, to].map(|end| mesh.positions[end as usize]);
        let [low, high] = ends.map(|end| self.height(end));
        let [a, b] = ends.map(Point::from);
        a + (b - a) * (low / (low - high))
    }

    /// Removes the part of the mesh beyond the closed curve in which the plane cuts the surface around
    /// [`Self::through`]. The plane may also cut other limbs, and a bent limb twice; those curves are ignored.
    fn cut_off(&self, mesh: &Mesh, capped: bool) -> Option<Mesh> {
        let beyond: Vec<bool> = mesh.positions.iter().map(|at| self.height(*at) > 0.0).collect();
        let curve = self.curve(mesh, &beyond)?;
        let off = behind(mesh, &beyond, &curve);
        // If the curve goes around a hole of the body, it does not separate the surface.
        if curve.iter().any(|&(a, b)| off[a as usize] == off[b as usize]) {
            return None;
        }
        let mut rest = Mesh { positions: mesh.positions.clone(), triangles: Vec::new() };
        let mut cuts = HashMap::new();
        let mut border = BTreeMap::new();
        let first_cut = mesh.positions.len() as u32;
        for triangle in &mesh.triangles {
            let mut corners = Vec::with_capacity(4);
            for (from, to) in sides(triangle) {
                if !off[from as usize] {
                    corners.push(from);
                }
                if off[from as usize] != off[to as usize] {
                    corners.push(*cuts.entry(key((from, to))).or_insert_with(|| {
                        rest.positions.push(self.crossing(mesh, key((from, to))).into());
                        rest.positions.len() as u32 - 1
                    }));
                }
            }
            for at in 2..corners.len() {
                rest.triangles.push([corners[0], corners[at - 1], corners[at]]);
            }
            for (at, &from) in corners.iter().enumerate() {
                let to = corners[(at + 1) % corners.len()];
                if from >= first_cut && to >= first_cut {
                    border.insert(from, to);
                }
            }
        }
        if capped {
            cap(&mut rest, &border);
        }
        Some(without_unused(&rest))
    }

    /// The edges that the curve crosses. Each cut triangle joins two crossings; followed from the crossing nearest to
    /// [`Self::through`], they form the curve.
    fn curve(&self, mesh: &Mesh, beyond: &[bool]) -> Option<HashSet<Edge>> {
        let crosses = |&(from, to): &Edge| beyond[from as usize] != beyond[to as usize];
        let mut joined: HashMap<Edge, Vec<Edge>> = HashMap::new();
        for triangle in &mesh.triangles {
            let cut: Vec<_> = sides(triangle).into_iter().filter(crosses).map(key).collect();
            if let [one, other] = cut[..] {
                joined.entry(one).or_default().push(other);
                joined.entry(other).or_default().push(one);
            }
        }
        let distance = |edge: &Edge| ((self.crossing(mesh, *edge) - self.through).norm(), *edge);
        let (_, first) = joined
            .keys()
            .map(distance)
            .min_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)))?;
        let mut curve = HashSet::new();
        let mut next = vec![first];
        while let Some(edge) = next.pop() {
            if curve.insert(edge) {
                next.extend(joined.get(&edge).into_iter().flatten());
            }
        }
        Some(curve)
    }
}

fn sides(&[a, b, c]: &[u32; 3]) -> [(u32, u32); 3] {
    [(a, b), (b, c), (c, a)]
}

fn key((from, to): (u32, u32)) -> Edge {
    (from.min(to), from.max(to))
}

/// The vertices connected to the far side of a curve by edges that do not cross it.
fn behind(mesh: &Mesh, beyond: &[bool], curve: &HashSet<Edge>) -> Vec<bool> {
    let mut around = vec![Vec::new(); mesh.positions.len()];
    for (from, to) in mesh.triangles.iter().flat_map(sides) {
        if !curve.contains(&key((from, to))) {
            around[from as usize].push(to);
        }
    }
    let mut off = vec![false; mesh.positions.len()];
    let far = |&(a, b): &Edge| if beyond[a as usize] { a } else { b };
    let mut next: Vec<u32> = curve.iter().map(far).collect();
    while let Some(at) = next.pop() {
        if !std::mem::replace(&mut off[at as usize], true) {
            next.extend(&around[at as usize]);
        }
    }
    off
}

/// Closes the cut with a fan of triangles around its centroid.
fn cap(mesh: &mut Mesh, border: &BTreeMap<u32, u32>) {
    if border.is_empty() {
        return;
    }
    let sum: Point = border.keys().map(|&at| Point::from(mesh.positions[at as usize])).sum();
    let centre = mesh.positions.len() as u32;
    mesh.positions.push((sum * (1.0 / border.len() as f64)).into());
    let mut sides: Vec<_> = border.iter().map(|(&from, &to)| [to, from, centre]).collect();
    sides.sort_unstable();
    mesh.triangles.extend(sides);
}

fn without_unused(mesh: &Mesh) -> Mesh {
    let mut kept = vec![None; mesh.positions.len()];
    let mut rest = Mesh::default();
    for corners in &mesh.triangles {
        let moved = corners.map(|corner| {
            *kept[corner as usize].get_or_insert_with(|| {
                rest.positions.push(mesh.positions[corner as usize]);
                rest.positions.len() as u32 - 1
            })
        });
        rest.triangles.push(moved);
    }
    rest
}

fn area(mesh: &Mesh) -> f64 {
    let of = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|corner| Point::from(mesh.positions[corner as usize]));
        (b - a).cross(&(c - a)).norm() / 2.0
    };
    mesh.triangles.iter().map(of).sum()
}
