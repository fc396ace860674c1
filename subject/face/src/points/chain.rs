//! The default way to the points: a glance says where they lie, more or less. From there the generic face says where every
//! feature should lie, the picture says where it lies near there, and the two take turns.

use super::annotators::offset_io;
use super::begin;
use super::contour::{self, Ray};
use super::crop;
use super::glance::{Glance, TOLD, Told};
use super::look::{self, CLEAR_OUTLINE, FAINT, Seen, middle};
use super::maps::Maps;
use super::outline::{self, Heights};
use super::search::Point;
use super::shape::{Landmarks, Pose, Target};
use super::{BROWS, EYES, Evidence, FacePoints, MOUTH, NOSE, Rough};
use crate::Photo;
use crate::model::{Model, ModelError};

/// How far a feature is looked for (pixels of the crop), how far the outline, and how many turns they take: chosen, as what
/// follows, on the development photographs and on random heads that nothing was learned from.
const REACH: f64 = 2.5;
const OUTLINE_REACH: f64 = 7.0;
const TURNS: usize = 2;
/// Standard deviation of what a glance says, before and while it is compared with what is seen (pixels of the crop).
const GLANCE_FIRST_SD: f64 = 3.0;
const GLANCE_SD: f64 = 4.0;
/// A face of this confidence is taken; a less sure one is begun from elsewhere too, and the surest counts.
const SURE: f64 = 0.5;

/// The 53 points of the face that `rough` points at.
///
/// # Errors
/// None, unless the program was built with a damaged model ([`Model::generic`]).
pub fn find(photo: &Photo, rough: &Rough) -> Result<FacePoints, ModelError> {
    let landmarks = Landmarks::of(Model::generic()?);
    let frontal = Pose::frontal(&landmarks, crop::IO, crop::EYES);
    let glance = Glance::at(photo, rough);
    let told = glance.told();
    let others = begin::others(rough, &glance, &told);
    let mut best = Attempt::from(glance, &told, &frontal);
    for rough in others {
        if best.evidence.confidence() >= SURE {
            break;
        }
        let glance = Glance::at(photo, &rough);
        let told = glance.told();
        let other = Attempt::from(glance, &told, &frontal);
        if other.evidence.confidence() > best.evidence.confidence() {
            best = other;
        }
    }
    Ok(collect(best))
}

/// Where one beginning leads.
struct Attempt<'a> {
    glance: Glance,
    pose: Pose<'a>,
    seen: Seen,
    line: Vec<Ray>,
    evidence: Evidence,
}

impl<'a> Attempt<'a> {
    fn from(glance: Glance, told: &Told, frontal: &Pose<'a>) -> Self {
        let targets = |sd: f64| {
            TOLD.iter().zip(told).map(move |(landmark, at)| Target {
                landmark: *landmark,
                at: *at,
                sd,
            })
        };
        let mut pose = frontal.clone();
        pose.fit(&targets(GLANCE_FIRST_SD).collect::<Vec<_>>(), 8);
        let maps = Maps::of(glance.crop());
        let (mut seen, mut line) = (Seen::default(), Vec::new());
        for _ in 0..TURNS {
            let unlike = look::unlike(&maps, &pose);
            let (around, outlined) = look::around(&maps, &unlike, &pose, OUTLINE_REACH);
            seen = look::look(&maps, &pose, REACH);
            let seen = seen.targets.iter().chain(&around).copied();
            pose.fit(&seen.chain(targets(GLANCE_SD)).collect::<Vec<_>>(), 4);
            line = outlined;
        }
        let evidence = Evidence::of(&pose, &seen, &line, told);
        Self { glance, pose, seen, line, evidence }
    }
}

/// The points of the fitted pose, in the photograph.
fn collect(attempt: Attempt<'_>) -> FacePoints {
    let Attempt { glance, pose, seen, line, evidence } = attempt;
    let crop = glance.crop();
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
