//! The default way to the points: the generic face says where every feature should lie, the picture says where it lies
//! near there, and the two take turns.

use super::contour::{self, Ray};
use super::crop::{self, Crop};
use super::maps::Maps;
use super::outline::{self, Heights};
use super::search::{Found, Point};
use super::shape::{Landmarks, Pose, Target, Turn};
use super::{BROWS, EYES, FacePoints, MOUTH, NOSE, Rough, brow, eye, mouth, nose, skin};
use crate::face::model::{Model, ModelError};
use crate::face::{Photo, Plane};

/// Yaws that are begun from (degrees): a step is what the search of a feature bridges.
const YAWS_DEG: [f64; 5] = [-40.0, -20.0, 0.0, 20.0, 40.0];
/// Of which so many are looked at in full: those whose outline fits best.
const LOOKED_AT: usize = 2;
/// How much further a head is turned than the edge of what is seen says, which bulges on the far side: measured on the
/// drawn faces of `--example faces_points drawn`.
const OUTLINE_TURN: f64 = 1.2;
/// How far a feature is looked for (pixels of the crop), and how far the outline: at first, and in the rounds after it.
const FIRST: (f64, f64) = (4.5, 14.0);
const ROUNDS: [(f64, f64); 2] = [(5.0, 10.0), (4.0, 7.0)];
/// Standard deviations of a clearly seen point of a feature (pixels): lids and lips are edges, a brow has none.
const EYE_SD: f64 = 1.8;
const BROW_SD: f64 = 3.0;
const NOSE_SD: f64 = 2.5;
const MOUTH_SD: f64 = 2.5;
const OUTLINE_SD: f64 = 9.0;
/// The contrast (natural logarithm) from which a feature counts as clearly seen.
const CLEAR: f64 = 0.2;
/// The contrast from which a piece of the outline does: it adds colour to brightness.
const CLEAR_OUTLINE: f64 = 0.5;
/// The least share of that: what is not seen at all is still no farther away than it is looked for.
const FAINT: f64 = 0.2;
/// Where annotators of iBUG-68 have a point, from where this chain has it: in outer eye corners' distances, x to the right
/// of the picture, y down. By the point's number on the subject's right; learned on the development photographs by
/// `--example faces_points offsets`.
const OFFSETS_IO: [(usize, [f64; 2]); 23] = [
    (17, [0.036, 0.023]),
    (18, [0.022, 0.013]),
    (19, [-0.031, -0.025]),
    (20, [0.007, -0.015]),
    (21, [-0.018, -0.035]),
    (31, [-0.004, 0.022]),
    (32, [0.003, 0.012]),
    (33, [0.000, 0.015]),
    (36, [0.027, 0.037]),
    (37, [0.001, 0.023]),
    (38, [0.006, 0.027]),
    (39, [-0.024, 0.020]),
    (40, [0.013, 0.013]),
    (41, [-0.004, 0.018]),
    (48, [-0.012, -0.020]),
    (49, [-0.033, 0.014]),
    (50, [-0.021, 0.006]),
    (51, [0.000, 0.022]),
    (57, [0.000, -0.025]),
    (58, [-0.014, 0.006]),
    (59, [-0.050, -0.013]),
    (62, [0.000, 0.022]),
    (66, [0.000, 0.017]),
];

/// The 53 points of the face that `rough` points at.
///
/// # Errors
/// None, unless the program was built with a damaged model ([`Model::generic`]).
pub fn find(photo: &Photo, rough: &Rough) -> Result<FacePoints, ModelError> {
    let landmarks = Landmarks::of(Model::generic()?);
    let crop = Crop::cut(photo, rough);
    let maps = Maps::of(&crop);
    let places = [rough.left_eye, rough.right_eye, rough.mouth].map(|p| crop.in_crop(p));
    let frontal = Pose::frontal(&landmarks, crop::IO, crop::EYES);
    let mut pose = begin(&maps, &frontal, places);
    let mut seen = Seen::default();
    let mut line = Vec::new();
    for (reach, sd) in ROUNDS {
        let unlike = unlike(&maps, &pose);
        let (targets, outlined) = around(&maps, &unlike, &pose, sd);
        seen = look(&maps, &pose, reach);
        let all: Vec<Target> = seen.targets.iter().chain(&targets).copied().collect();
        pose.fit(&all, Turn::UNKNOWN, 4);
        line = outlined;
    }
    Ok(collect(&crop, &pose, &seen, &line))
}

/// What was seen of all features from one pose.
#[derive(Default)]
struct Seen {
    targets: Vec<Target>,
    /// Of eyes, brows, nose and mouth: how clearly (0 to 1), and the score less the cost of the deviation.
    clear: Vec<f64>,
    held: Vec<f64>,
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
fn look(maps: &Maps, pose: &Pose<'_>, reach: f64) -> Seen {
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

/// The pose to begin from. Eyes and mouth lie nearly in a plane and cannot tell where a head turns; the nose before them
/// and the outline around them can.
fn begin<'a>(maps: &Maps, frontal: &Pose<'a>, places: [Point; 3]) -> Pose<'a> {
    let unlike = unlike(maps, frontal);
    let (reach, sd) = FIRST;
    let mut starts: Vec<(f64, f64, Pose<'a>)> = YAWS_DEG
        .into_iter()
        .map(|yaw| {
            let pose = frontal.turned(yaw, places);
            let (line, gain) = trace(maps, &unlike, &pose, sd);
            let p = pose.project();
            let seen_turn = contour::turn_deg(&line, p[36], p[45]);
            let seen_turn = seen_turn.map_or(yaw, |turn| OUTLINE_TURN * turn);
            // The right yaw is the one that its own outline confirms; most heads look at the camera.
            let score =
                gain - 0.4 * ((seen_turn - yaw) / 20.0).powi(2) - 0.2 * (yaw / 30.0).powi(2);
            (score, seen_turn, pose)
        })
        .collect();
    starts.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut best = (f64::NEG_INFINITY, 0.0);
    for (score, yaw, pose) in starts.iter_mut().take(LOOKED_AT) {
        let seen = look(maps, pose, reach);
        pose.fit(&seen.targets, Turn::UNKNOWN, 3);
        let weights = [1.0 / 3.0, 1.0 / 3.0, 0.5, 0.5, 0.6, 0.2];
        let features: f64 = seen.held.iter().zip(weights).map(|(s, w)| s * w).sum();
        let total = *score + features - misfit(pose, &seen.targets) - 0.1 / 30.0 * pose.strain();
        if total > best.0 {
            best = (total, *yaw);
        }
    }
    frontal.turned(best.1, places)
}

/// Mean squared distance of the targets from the pose, in units of 6 px, no target counting more than 4.
fn misfit(pose: &Pose<'_>, targets: &[Target]) -> f64 {
    let p = pose.project();
    let sum: f64 = targets
        .iter()
        .filter_map(|t| p.get(t.landmark).map(|p| (p[0] - t.at[0]).hypot(p[1] - t.at[1])))
        .map(|d| (d / 6.0).min(2.0).powi(2))
        .sum();
    sum / targets.len().max(1) as f64
}

/// How unlike the skin of cheeks and nose everything is.
fn unlike(maps: &Maps, pose: &Pose<'_>) -> Plane {
    let p = pose.project();
    skin::unlike(maps, &[middle(p[41], p[48]), middle(p[46], p[54]), middle(p[27], p[33])])
}

/// The outline near where the pose has it, and its mean contrast.
fn trace(maps: &Maps, unlike: &Plane, pose: &Pose<'_>, sd: f64) -> (Vec<Ray>, f64) {
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
fn around(maps: &Maps, unlike: &Plane, pose: &Pose<'_>, sd: f64) -> (Vec<Target>, Vec<Ray>) {
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

/// The points of the fitted pose, in the photograph.
fn collect(crop: &Crop, pose: &Pose<'_>, seen: &Seen, line: &[Ray]) -> FacePoints {
    let p = pose.project();
    let mut points = FacePoints { yaw_deg: Some(pose.yaw_deg()), ..FacePoints::default() };
    let features: [&[usize]; 6] = [&EYES[0], &EYES[1], &BROWS[0], &BROWS[1], &NOSE, &MOUTH];
    let at_annotators = |i: usize| {
        let [x, y] = offset_io(i);
        let size = pose.scale;
        let narrow = pose.yaw_deg().to_radians().cos();
        p.get(i).map(|p| [p[0] + size * narrow * x, p[1] + size * y])
    };
    for (which, clear) in features.into_iter().zip(&seen.clear) {
        let at: Vec<Point> = which.iter().filter_map(|i| at_annotators(*i)).collect();
        points.put(which, &at, *clear, crop);
    }
    let mean = |a: usize, b: usize| (p[a][1] + p[b][1]) / 2.0;
    let heights =
        Heights { brows: mean(19, 24), eyes: mean(36, 45), nose: p[33][1], mouth: mean(48, 54) };
    let polygon: Vec<Point> = line.iter().map(|ray| ray.at).collect();
    let centre = middle(p[27], p[33]);
    for (index, at) in outline::twelve(&polygon, centre[0], &heights) {
        let contrast = contour::towards(line, centre, at).map_or(0.0, |(ray, _)| ray.contrast);
        points.set(index, crop.to_photo(at), (contrast / CLEAR_OUTLINE).clamp(FAINT, 1.0));
    }
    points.outline = polygon.into_iter().map(|p| crop.to_photo(p)).collect();
    points
}

fn middle(a: Point, b: Point) -> Point {
    [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0]
}

fn pick<const N: usize>(p: &[Point], which: [usize; N]) -> [Point; N] {
    which.map(|i| p.get(i).copied().unwrap_or([0.0; 2]))
}

/// [`OFFSETS_IO`] of either half of the face, x to the right of the picture.
fn offset_io(landmark: usize) -> Point {
    let (right, sign) = match landmark {
        22..=26 => (43 - landmark, -1.0),
        34 | 35 => (66 - landmark, -1.0),
        42..=45 => (81 - landmark, -1.0),
        46 | 47 => (87 - landmark, -1.0),
        52..=54 => (102 - landmark, -1.0),
        55 | 56 => (114 - landmark, -1.0),
        _ => (landmark, 1.0),
    };
    let found = OFFSETS_IO.iter().find(|(i, _)| *i == right);
    found.map_or([0.0; 2], |(_, [x, y])| [sign * x, *y])
}
