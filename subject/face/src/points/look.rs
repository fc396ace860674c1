//! What is seen of the features and of the outline from a pose.

use super::contour::{self, Ray};
use super::maps::Maps;
use super::search::{Found, Point};
use super::shape::{LANDMARKS, Pose, Target};
use super::{BROWS, EYES, MOUTH, NOSE, brow, eye, mouth, nose, skin};
use crate::Plane;

/// Standard deviations of a clearly seen point of a feature (pixels): lids and lips are edges, a brow has none.
const EYE_SD: f64 = 1.8;
const BROW_SD: f64 = 3.0;
const NOSE_SD: f64 = 2.5;
const MOUTH_SD: f64 = 2.5;
const OUTLINE_SD: f64 = 9.0;
/// The contrast (natural logarithm) from which a feature counts as clearly seen.
const CLEAR: f64 = 0.2;
/// The contrast from which a piece of the outline does: it adds colour to brightness.
pub(super) const CLEAR_OUTLINE: f64 = 0.5;
/// The least share of that: what is not seen at all is still no farther away than it is looked for.
pub const FAINT: f64 = 0.2;

/// How much further a head is turned than the edge of what is seen says, which bulges on the far side: measured on the
/// drawn faces of `--example faces_points drawn`.
const OUTLINE_TURN: f64 = 1.2;

/// What was seen of all features from one pose.
#[derive(Default)]
pub(super) struct Seen {
    pub(super) targets: Vec<Target>,
    /// Of eyes, brows, nose and mouth: how clearly (0 to 1), and the score less the cost of the deviation.
    pub(super) clear: Vec<f64>,
    pub(super) held: Vec<f64>,
}

impl Seen {
    fn add<const N: usize>(&mut self, which: &[usize; N], found: &Found<N>, sd: f64) {
        let clear = (found.score / CLEAR).clamp(FAINT, 1.0);
        self.clear.push(clear);
        self.held.push(found.held);
        for (landmark, at) in which.iter().zip(&found.points) {
            self.targets.push(Target { landmark: *landmark, at: *at, sd: sd / clear });
        }
    }
}

/// Looks for every feature near where the pose has it.
pub(super) fn look(maps: &Maps, pose: &Pose<'_>, reach: f64) -> Seen {
    let p = pose.project();
    let mut seen = Seen::default();
    let mut lids = Vec::new();
    for which in EYES {
        let found = eye::find(maps, &pick(&p, which), reach);
        let [_, outer, inner, ..] = found.points;
        lids.push([outer, inner]);
        seen.add(&which, &found, EYE_SD);
    }
    for (which, lid) in BROWS.into_iter().zip(lids) {
        seen.add(&which, &brow::find(maps, &pick(&p, which), lid, reach), BROW_SD);
    }
    seen.add(&NOSE, &nose::find(maps, &pick(&p, NOSE), reach), NOSE_SD);
    // A mouth moves more than the rest.
    seen.add(&MOUTH, &mouth::find(maps, &pick(&p, MOUTH), 1.2 * reach), MOUTH_SD);
    seen
}

/// Mean squared distance of the targets from the pose, in units of 6 px, no target counting more than 4.
pub(super) fn misfit(pose: &Pose<'_>, targets: &[Target]) -> f64 {
    let p = pose.project();
    let sum: f64 = targets
        .iter()
        .filter_map(|t| p.get(t.landmark).map(|p| (p[0] - t.at[0]).hypot(p[1] - t.at[1])))
        .map(|d| (d / 6.0).min(2.0).powi(2))
        .sum();
    sum / targets.len().max(1) as f64
}

/// How unlike the skin of cheeks and nose everything is.
pub(super) fn unlike(maps: &Maps, pose: &Pose<'_>) -> Plane {
    let p = pose.project();
    skin::unlike(maps, &[middle(p[41], p[48]), middle(p[46], p[54]), middle(p[27], p[33])])
}

/// The outline near where the pose has it, and its mean contrast.
pub(super) fn trace(maps: &Maps, unlike: &Plane, pose: &Pose<'_>, sd: f64) -> (Vec<Ray>, f64) {
    let p = pose.project();
    let brow = (p[19][1] + p[24][1]) / 2.0;
    let across = |share: f64, y: f64| [p[0][0] + share * (p[16][0] - p[0][0]), y];
    // The forehead is not among the landmarks: three quarters as high over the brows as they are over the nose's base.
    let top = brow - 0.75 * (p[33][1] - brow);
    let temple = (brow + top) / 2.0;
    let mut hull: Vec<Point> = p.iter().take(17).copied().collect();
    hull.extend([across(0.15, temple), across(0.85, temple), across(0.4, top), across(0.6, top)]);
    hull.extend([p[17], p[26], p[36], p[45], p[33], p[30]]);
    let centre = middle(p[27], p[33]);
    let line = contour::find(maps, unlike, centre, &contour::hull_radii(&hull, centre), sd);
    let gain = line.iter().map(|ray| ray.contrast).sum::<f64>() / line.len().max(1) as f64;
    (line, gain)
}

/// The outline, and where it has the landmarks of the jaw.
pub(super) fn around(
    maps: &Maps,
    unlike: &Plane,
    pose: &Pose<'_>,
    sd: f64,
) -> (Vec<Target>, Vec<Ray>) {
    let (line, _) = trace(maps, unlike, pose, sd);
    let p = pose.project();
    let centre = middle(p[27], p[33]);
    let targets = (0..17)
        .filter_map(|landmark| {
            let at = p.get(landmark)?;
            let (ray, place) = contour::towards(&line, centre, *at)?;
            let clear = (ray.contrast / CLEAR_OUTLINE).clamp(FAINT, 1.0);
            Some(Target { landmark, at: place, sd: OUTLINE_SD / clear })
        })
        .collect();
    (targets, line)
}

/// Where the head turns by its outline (degrees); none where the eyes are not within.
pub(super) fn turn_deg(line: &[Ray], p: &[Point; LANDMARKS]) -> Option<f64> {
    contour::turn_deg(line, p[36], p[45]).map(|turn| OUTLINE_TURN * turn)
}

pub(super) fn middle(a: Point, b: Point) -> Point {
    [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0]
}

fn pick<const N: usize>(p: &[Point], which: [usize; N]) -> [Point; N] {
    which.map(|i| p.get(i).copied().unwrap_or([0.0; 2]))
}
