//! The default way to the points: the generic face says where every feature should lie, the picture says where it lies
//! near there, and the two take turns.

use super::annotators::offset_io;
use super::begin::begin;
use super::contour::{self, Ray};
use super::crop::{self, Crop};
use super::look::{self, CLEAR_OUTLINE, FAINT, Seen, middle};
use super::maps::Maps;
use super::outline::{self, Heights};
use super::search::Point;
use super::shape::{Landmarks, Pose, Target, Turn};
use super::{BROWS, EYES, Evidence, FacePoints, MOUTH, NOSE, Rough};
use crate::face::Photo;
use crate::face::model::{Model, ModelError};

/// How far a feature is looked for (pixels of the crop), and how far the outline, round by round.
const ROUNDS: [(f64, f64); 2] = [(5.0, 10.0), (4.0, 7.0)];
/// A face of this confidence is taken; a less sure one is begun from elsewhere too, and the surest counts.
const SURE: f64 = 0.5;

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
    let mut best: Option<Attempt<'_>> = None;
    for start in begin(&maps, &frontal, places) {
        let attempt = Attempt::from(&maps, start);
        let sure = attempt.evidence.confidence();
        if best.as_ref().is_none_or(|best| sure > best.evidence.confidence()) {
            best = Some(attempt);
        }
        if sure >= SURE {
            break;
        }
    }
    Ok(best.map_or_else(FacePoints::default, |best| collect(&crop, best)))
}

/// Where one beginning leads.
struct Attempt<'a> {
    pose: Pose<'a>,
    seen: Seen,
    line: Vec<Ray>,
    evidence: Evidence,
}

impl<'a> Attempt<'a> {
    fn from(maps: &Maps, mut pose: Pose<'a>) -> Self {
        let (mut seen, mut line) = (Seen::default(), Vec::new());
        for (reach, sd) in ROUNDS {
            let unlike = look::unlike(maps, &pose);
            let (targets, outlined) = look::around(maps, &unlike, &pose, sd);
            seen = look::look(maps, &pose, reach);
            let all: Vec<Target> = seen.targets.iter().chain(&targets).copied().collect();
            pose.fit(&all, Turn::UNKNOWN, 4);
            line = outlined;
        }
        let evidence = Evidence::of(&pose, &seen, &line);
        Self { pose, seen, line, evidence }
    }
}

/// The points of the fitted pose, in the photograph.
fn collect(crop: &Crop, attempt: Attempt<'_>) -> FacePoints {
    let Attempt { pose, seen, line, evidence } = attempt;
    let p = pose.project();
    let mut points = FacePoints {
        yaw_deg: Some(pose.yaw_deg()),
        evidence: Some(evidence),
        ..FacePoints::default()
    };
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
        let contrast = contour::towards(&line, centre, at).map_or(0.0, |(ray, _)| ray.contrast);
        points.set(index, crop.to_photo(at), (contrast / CLEAR_OUTLINE).clamp(FAINT, 1.0));
    }
    points.outline = polygon.into_iter().map(|p| crop.to_photo(p)).collect();
    points
}
