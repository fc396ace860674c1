//! Numbers on a picture, drawn with a pen: no font is needed for ten digits.

use image::RgbImage;

use super::draw::{self, Ink};

/// Left top and right bottom.
pub(super) type Bounds = [[f64; 2]; 2];

/// A digit's strokes through points of a grid of 4 by 6, y down.
type Strokes = &'static [&'static [[u8; 2]]];

const DIGITS: [Strokes; 10] = [
    &[&[[1, 0], [3, 0], [4, 1], [4, 5], [3, 6], [1, 6], [0, 5], [0, 1], [1, 0]]],
    &[&[[1, 1], [2, 0], [2, 6]], &[[1, 6], [3, 6]]],
    &[&[[0, 1], [1, 0], [3, 0], [4, 1], [4, 2], [0, 6], [4, 6]]],
    &[&[[0, 0], [4, 0], [2, 2], [3, 2], [4, 3], [4, 5], [3, 6], [1, 6], [0, 5]]],
    &[&[[3, 6], [3, 0], [0, 4], [4, 4]]],
    &[&[[4, 0], [0, 0], [0, 3], [1, 2], [3, 2], [4, 3], [4, 5], [3, 6], [1, 6], [0, 5]]],
    &[&[[4, 1], [3, 0], [1, 0], [0, 1], [0, 5], [1, 6], [3, 6], [4, 5], [4, 4], [3, 3], [0, 3]]],
    &[&[[0, 0], [4, 0], [1, 6]]],
    &[
        &[[1, 0], [3, 0], [4, 1], [4, 2], [3, 3], [1, 3], [0, 2], [0, 1], [1, 0]],
        &[[1, 3], [0, 4], [0, 5], [1, 6], [3, 6], [4, 5], [4, 4], [3, 3]],
    ],
    &[&[[4, 3], [1, 3], [0, 2], [0, 1], [1, 0], [3, 0], [4, 1], [4, 5], [3, 6], [1, 6], [0, 5]]],
];
/// From one digit to the next, in the grid.
const ADVANCE: f64 = 6.0;

/// A number of a given height.
pub(super) struct Number {
    digits: Vec<Strokes>,
    height_px: f64,
}

impl Number {
    pub(super) fn new(number: usize, height_px: f64) -> Self {
        let digit = |c: char| DIGITS.get(c.to_digit(10)? as usize).copied();
        Self { digits: number.to_string().chars().filter_map(digit).collect(), height_px }
    }

    /// Pixels of a step of the grid.
    fn step(&self) -> f64 {
        self.height_px / 6.0
    }

    /// Width and height with the plate that it stands on.
    fn size(&self) -> [f64; 2] {
        let width = (ADVANCE * self.digits.len() as f64 - 2.0) * self.step();
        [width + 0.9 * self.height_px, 1.8 * self.height_px]
    }

    /// Draws it beside the box `of`, where it covers no other box and is within the picture, if there is such a place.
    /// `colours` are the plate's and the digits'.
    pub(super) fn draw(
        &self,
        picture: &mut RgbImage,
        boxes: &[Bounds],
        of: usize,
        colours: [[u8; 3]; 2],
    ) {
        let Some(&own) = boxes.get(of) else { return };
        let size = self.size();
        let sides = [f64::from(picture.width()), f64::from(picture.height())];
        let within = |at: [f64; 2]| (0..2).all(|k| at[k] >= 0.0 && at[k] + size[k] <= sides[k]);
        let free = |at: [f64; 2]| {
            let apart =
                |k: usize, other: &Bounds| at[k] + size[k] <= other[0][k] || at[k] >= other[1][k];
            boxes.iter().all(|other| apart(0, other) || apart(1, other))
        };
        let places = beside(own, size);
        let best = places.iter().copied().find(|at| within(*at) && free(*at));
        let at = best.or_else(|| places.iter().copied().find(|at| within(*at)));
        let at = at.unwrap_or(places[0]);
        // A face that fills the picture has its number upon it.
        let at = [0, 1].map(|k| at[k].min(sides[k] - size[k]).max(0.0));
        self.draw_at(picture, at, colours);
    }

    fn draw_at(&self, picture: &mut RgbImage, at: [f64; 2], [plate, colour]: [[u8; 3]; 2]) {
        let [width, height] = self.size();
        let middle = at[1] + height / 2.0;
        let ends = [at[0] + height / 2.0, at[0] + width - height / 2.0];
        // One digit is narrower than its plate is high.
        let centre = at[0] + width / 2.0;
        let ends = [ends[0].min(centre), ends[1].max(centre)].map(|x| [x, middle]);
        let ink = Ink { colour: plate, opacity: 0.8, width_px: height };
        draw::lines(picture, &[ends], ink);
        let from = [at[0] + 0.45 * self.height_px, middle - self.height_px / 2.0];
        let ink = Ink { colour, opacity: 1.0, width_px: (0.16 * self.height_px).max(1.5) };
        draw::lines(picture, &self.strokes(from), ink);
    }

    /// The strokes of all digits, the first from `left_top` on.
    fn strokes(&self, left_top: [f64; 2]) -> Vec<[[f64; 2]; 2]> {
        let step = self.step();
        let mut lines = Vec::new();
        for (i, digit) in self.digits.iter().enumerate() {
            let left = left_top[0] + ADVANCE * i as f64 * step;
            let at =
                |[x, y]: [u8; 2]| [left + f64::from(x) * step, left_top[1] + f64::from(y) * step];
            let pairs = digit.iter().flat_map(|stroke| stroke.windows(2));
            lines.extend(pairs.map(|pair| [at(pair[0]), at(pair[1])]));
        }
        lines
    }
}

/// Left tops of places beside a box: at its top left, top right, above and below its middle.
fn beside([low, high]: Bounds, [width, height]: [f64; 2]) -> [[f64; 2]; 4] {
    let gap = 0.15 * height;
    let middle = (low[0] + high[0] - width) / 2.0;
    [
        [low[0] - width - gap, low[1]],
        [high[0] + gap, low[1]],
        [middle, low[1] - height - gap],
        [middle, high[1] + gap],
    ]
}
