//! From a photograph to weighed hypotheses, and from those to faces.

use super::climb::climb;
use super::coarse::Stencils;
use super::eyes::darkest;
use super::frame::Frame;
use super::hue::Hues;
use super::level::{EYE_DISTANCE, Level, STEP};
use super::schema::Schema;
use super::scores::{Scores, grey_scores};
use super::weights;
use super::{Found, Photo};
use crate::face::photo::Colour;

/// Distance of the outer eye corners, in those of the irises' middles: 90 mm and 63 mm.
const IO_OF_EYES: f64 = 1.43;
/// The smallest face that is looked for, as the distance of the outer corners, on photographs of up to a megapixel; it
/// grows with the root of what is beyond that.
pub const IO_MIN_PX: f32 = 32.0;
const FULL_SEARCH_PX: f32 = 1e6;
/// The shorter side of the smallest level: eyes 12 pixels apart have 2.4 times that of room.
const LEVEL_SIDE_MIN_PX: f32 = 29.0;
/// Hypotheses that are kept; a photograph of leaves has about 2000.
const HYPOTHESES_MAX: usize = 20_000;

/// How sure a face must be: nothing else on the development photographs is. Of the pictures without a face that the
/// weights were held against, coins with heads on them reach 0.31, a page of text 0.3, and no photograph more than 0.22.
/// At 0.1 no further face of the development photographs is found, and two that are none.
pub const SCORE_MIN: f64 = 0.3;

/// Two eyes and a mouth, and what they score.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hypothesis {
    /// What would be found.
    pub found: Found,
    /// What it is weighed by.
    pub scores: Scores,
}

/// Every pair of dark spots that passes for eyes, with the mouth that suits it best, in the order of the search.
#[must_use]
pub fn hypotheses(photo: &Photo) -> Vec<Hypothesis> {
    let grey = photo.grey();
    let schema = Schema::new();
    let stencils = Stencils::new(&schema);
    let area = (photo.width() * photo.height()) as f32;
    let io_min = IO_MIN_PX * (area / FULL_SEARCH_PX).sqrt().max(1.0);
    let mut shrink = io_min / IO_OF_EYES as f32 / EYE_DISTANCE;
    let size = |shrink: f32| {
        let side = |px: usize| ((px as f32 / shrink).round() as usize).max(1);
        (side(photo.width()), side(photo.height()))
    };
    let hues = (photo.colour == Colour::Natural).then(|| {
        let (width, height) = size(shrink * STEP);
        Hues::new(photo, width, height)
    });
    let mut out = Vec::new();
    let side = photo.width().min(photo.height()) as f32;
    while side / shrink >= LEVEL_SIDE_MIN_PX && out.len() < HYPOTHESES_MAX {
        let (width, height) = size(shrink);
        let level = Level::new(&grey, width, height);
        for place in stencils.places(&level.local) {
            out.push(hypothesis(&level, place.frame, &schema, hues.as_ref()));
            if out.len() >= HYPOTHESES_MAX {
                break;
            }
        }
        shrink *= STEP;
    }
    out
}

/// The faces of a photograph, surest first: hypotheses at least `score_min` sure, of which none overlaps a surer one.
#[must_use]
pub fn faces(photo: &Photo, score_min: f64) -> Vec<Found> {
    let mut all: Vec<Found> = hypotheses(photo)
        .into_iter()
        .map(|hypothesis| hypothesis.found)
        .filter(|found| found.score >= score_min)
        .collect();
    all.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept: Vec<Found> = Vec::new();
    for found in all {
        if !kept.iter().any(|other| overlap(other, &found)) {
            kept.push(found);
        }
    }
    kept
}

/// Whether two faces are at the same place: the middle of one's eyes and mouth is within the other's.
fn overlap(a: &Found, b: &Found) -> bool {
    let middle = |found: &Found| {
        let [left, right] = found.eyes;
        [0, 1].map(|i: usize| {
            let of = |point: [f64; 2]| point.get(i).copied().unwrap_or_default();
            (of(left) + of(right)) / 4.0 + of(found.mouth) / 2.0
        })
    };
    let ([ax, ay], [bx, by]) = (middle(a), middle(b));
    (ax - bx).hypot(ay - by) < 0.9 * a.io_px.max(b.io_px)
}

/// What a rough place becomes once it fits.
fn hypothesis(level: &Level, rough: Frame, schema: &Schema, hues: Option<&Hues>) -> Hypothesis {
    let frame = climb(&level.local, rough, schema);
    let spots = darkest(level, frame.eyes());
    let grey = grey_scores(&level.local, &frame, &spots, schema);
    let colour = hues.map(|hues| hues.scores(level, &frame));
    let scores = Scores { grey, colour };
    let found = on_photo(level, &frame, weights::score(&scores));
    Hypothesis { found, scores }
}

fn on_photo(level: &Level, frame: &Frame, score: f64) -> Found {
    let eyes = frame.eyes().map(|eye| level.on_photo(eye));
    let [[x0, y0], [x1, y1]] = eyes;
    let (dx, dy) = (x1 - x0, y1 - y0);
    // Turned aside, eyes are nearer than they are on the head; the mouth's distance stays.
    let mouth = level.on_photo(frame.at(0.0, Frame::MOUTH));
    let height = (mouth[0] - (x0 + x1) / 2.0).hypot(mouth[1] - (y0 + y1) / 2.0);
    let apart = dx.hypot(dy).max(0.5 * height / f64::from(Frame::MOUTH));
    Found { eyes, mouth, roll_rad: dy.atan2(dx), io_px: IO_OF_EYES * apart, score }
}
