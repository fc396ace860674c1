//! From a photograph to weighed hypotheses, and from those to faces.

use super::align::{STEPS, aligned};
use super::frame::Frame;
use super::look::{Look, look};
use super::octaves::Octaves;
use super::scan::places;
use super::second::second;
use super::template::Template;
use super::verdict;
use super::{Found, Photo};

/// Distance of the outer eye corners, in those of the eyes' middles: 90 mm and 63 mm.
const IO_OF_EYES: f64 = 1.43;
/// The smallest face that is looked for, as the distance of the outer corners, on photographs of up to a megapixel; it
/// grows with the root of what is beyond that.
pub const IO_MIN_PX: f32 = 32.0;
const FULL_SEARCH_PX: f32 = 1e6;
/// How sure a face must be: the lowest limit, in steps of half a unit of the logarithm of the odds, at which of 3932 pictures
/// without a face that were held out while the trees were learned (apes are left aside) no more than one in a thousand has one.
pub const SCORE_MIN: f64 = 0.73;

/// How sure the first look must be of what is looked at again, which takes about 2 ms: low, for the second look is better at it.
/// There are no more of these than places.
const FIRST_MIN: f64 = 0.03;

/// What fits less once it is refined is not looked at closer: of the faces learned from a hundredth, of all places two fifths.
const REFINED_MIN: f32 = -1.5;

/// Two eyes and a mouth, and what they score.
#[derive(Debug, Clone, PartialEq)]
pub struct Hypothesis {
    /// What would be found.
    pub found: Found,
    /// How it looks upright: [`LOOK`](super::LOOK) bytes, of a second look [`SECOND`](super::SECOND).
    pub look: Look,
}

/// Every place that may be a face, with its eyes and its mouth where they look to be; the likeliest of the template first.
#[must_use]
pub fn hypotheses(photo: &Photo) -> Vec<Hypothesis> {
    hypotheses_after(photo, STEPS.len())
}

/// The same after fewer steps of the regression that moves eyes and mouth: after none, they are where the template has them.
#[must_use]
pub fn hypotheses_after(photo: &Photo, steps: usize) -> Vec<Hypothesis> {
    proposed(photo, &Octaves::new(photo.grey()), steps)
}

/// What the first look does not dismiss, surest first, as a second look has it: its eyes and mouth, its score, and what
/// lies there.
#[must_use]
pub fn hypotheses_again(photo: &Photo) -> Vec<Hypothesis> {
    let octaves = Octaves::new(photo.grey());
    let all = proposed(photo, &octaves, STEPS.len()).into_iter().map(|first| first.found);
    apart(all.filter(|found| found.score >= FIRST_MIN).collect())
        .iter()
        .filter_map(|found| {
            let (frame, look) = second(&octaves, photo, found)?;
            Some(Hypothesis { found: on_photo(&frame, verdict::second_score(&look)), look })
        })
        .collect()
}

/// The faces of a photograph, surest first: what a second look is at least `score_min` sure of, and overlaps nothing surer.
#[must_use]
pub fn faces(photo: &Photo, score_min: f64) -> Vec<Found> {
    let all = hypotheses_again(photo).into_iter().map(|hypothesis| hypothesis.found);
    apart(all.filter(|found| found.score >= score_min).collect())
}

fn proposed(photo: &Photo, octaves: &Octaves, steps: usize) -> Vec<Hypothesis> {
    let size = (photo.width(), photo.height());
    let io_min = IO_MIN_PX * ((size.0 * size.1) as f32 / FULL_SEARCH_PX).sqrt().max(1.0);
    let templates = Template::all();
    places(octaves, &templates, size, io_min / IO_OF_EYES as f32)
        .iter()
        .map(|place| place.refined(octaves, &templates))
        .filter(|place| place.fit > REFINED_MIN)
        .filter_map(|place| {
            let mut frame = place.frame(&templates)?;
            for step in STEPS.iter().take(steps) {
                frame = aligned(&frame, &look(octaves, &frame), step);
            }
            Some(hypothesis(octaves, &frame))
        })
        .collect()
}

/// The surest first, without those that overlap a surer one.
fn apart(mut all: Vec<Found>) -> Vec<Found> {
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

fn hypothesis(octaves: &Octaves, frame: &Frame) -> Hypothesis {
    let look = look(octaves, frame);
    Hypothesis { found: on_photo(frame, verdict::score(&look)), look }
}

fn on_photo(frame: &Frame, score: f64) -> Found {
    let eyes = frame.eyes().map(|eye| eye.map(f64::from));
    let [[x0, y0], [x1, y1]] = eyes;
    let (dx, dy) = (x1 - x0, y1 - y0);
    // Turned aside, eyes are nearer than they are on the head; the mouth's distance stays.
    let mouth = frame.at(0.0, Frame::MOUTH).map(f64::from);
    let height = (mouth[0] - (x0 + x1) / 2.0).hypot(mouth[1] - (y0 + y1) / 2.0);
    let apart = dx.hypot(dy).max(0.5 * height / f64::from(Frame::MOUTH));
    Found { eyes, mouth, roll_rad: dy.atan2(dx), io_px: IO_OF_EYES * apart, score }
}
