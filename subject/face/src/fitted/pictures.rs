//! Pictures of fitted faces: their overlay on the photograph, with antialiased strokes, and three views of the wireframe, as
//! SVG. Face numbers are drawn as strokes too, since ten digits need no font.

use std::{io::Cursor, ops::Range};

use image::{
    ImageError, ImageFormat, Rgb, RgbImage,
    imageops::{self, FilterType},
};

use super::{Curve, FittedFace, Part, Pose, edges};
use crate::{
    model::{Camera, FeatureId},
    photo::Photo,
    plane::{Point, distance, extent},
};

/// Minimum interocular distance: smaller pictures are enlarged first, or the lines would cover the face.
const EYES_MIN_PX: f64 = 160.0;
const MAX_SIDE_PX: u32 = 3000;
const DARK: [u8; 3] = [0x10, 0x18, 0x28];
const LIGHT: [u8; 3] = [0xff, 0xff, 0xff];
/// Colour of an uncertain face's wireframe.
const UNSURE: [u8; 3] = [0xff, 0xa0, 0x20];
/// Confidence below which points are drawn hollow.
const SURE: f64 = 0.5;
/// Minimum legible height of digits.
const DIGIT_MIN_PX: f64 = 12.0;

/// A photograph with faces drawn on it.
#[derive(Debug, Clone)]
pub struct Overlay {
    picture: RgbImage,
    enlarged: f64,
}

impl Overlay {
    /// Draws `faces` on the photograph, enlarged by a whole number if the smallest face is too small. Several faces get
    /// numbers, from 1, in the order of `faces`.
    pub fn new(photograph: &RgbImage, faces: &[FittedFace]) -> Self {
        let drawn = faces.iter().filter(|face| face.camera().is_some());
        let least = drawn.map(FittedFace::outer_eyes_px).fold(EYES_MIN_PX, f64::min).max(1.0);
        let side = photograph.width().max(photograph.height()).max(1);
        let factor = ((EYES_MIN_PX / least).ceil() as u32).min(MAX_SIDE_PX / side).max(1);
        let picture = if factor == 1 {
            photograph.clone()
        } else {
            let (width, height) = (photograph.width() * factor, photograph.height() * factor);
            imageops::resize(photograph, width, height, FilterType::CatmullRom)
        };
        let mut overlay = Self { picture, enlarged: f64::from(factor) };
        faces.iter().for_each(|face| overlay.draw(face));
        if faces.len() > 1 {
            overlay.number(faces);
        }
        overlay
    }

    /// Draws faces on the photograph that they were found in, as PNG.
    ///
    /// # Errors
    /// [`ImageError`] of the encoder.
    pub fn png(photo: &Photo, faces: &[FittedFace]) -> Result<Vec<u8>, ImageError> {
        let (width, height) = (photo.width() as u32, photo.height() as u32);
        let pixel = |x: u32, y: u32| Rgb(photo.rgb(x as isize, y as isize));
        let drawn = Self::new(&RgbImage::from_fn(width, height, pixel), faces);
        let mut png = Cursor::new(Vec::new());
        drawn.picture.write_to(&mut png, ImageFormat::Png)?;
        Ok(png.into_inner())
    }

    /// The picture.
    pub fn into_image(self) -> RgbImage {
        self.picture
    }

    /// Maps the photograph's pixels to the picture's.
    fn place(&self, at: [f64; 2]) -> [f64; 2] {
        at.map(|v| (v + 0.5) * self.enlarged - 0.5)
    }

    fn draw(&mut self, face: &FittedFace) {
        let Some(seen) = face.vertices_px() else { return };
        let width_px = self.line_px(face);
        let wire = |colour, opacity, width_px| Ink { colour, opacity, width_px };
        let ends = |line: [usize; 2]| line.map(|v| self.place([seen[v][0], seen[v][1]]));
        let net: Vec<_> = edges(face.facing(&seen)).into_iter().map(ends).collect();
        let colour = if face.is_unsure() { UNSURE } else { LIGHT };
        lines(&mut self.picture, &net, wire(DARK, 0.5, 2.2 * width_px));
        lines(&mut self.picture, &net, wire(colour, 0.75, 0.8 * width_px));
        for curve in Curve::all() {
            let at = |id: &FeatureId| face.points.get(id.index()).map(|p| self.place(p.xy_px));
            let points: Vec<_> = curve.points.iter().filter_map(at).collect();
            let last = if curve.closed { points.first() } else { None };
            let path: Vec<_> = points.iter().chain(last).copied().collect();
            let path: Vec<_> = path.windows(2).map(|pair| [pair[0], pair[1]]).collect();
            lines(&mut self.picture, &path, wire(DARK, 0.8, 2.6 * width_px));
            lines(&mut self.picture, &path, wire(curve.part.colour(), 1.0, 1.3 * width_px));
        }
        for point in &face.points {
            let at = self.place(point.xy_px);
            let colour = Part::of(point.id).colour();
            let picture = &mut self.picture;
            if point.confidence >= SURE {
                disc(picture, at, wire(DARK, 0.9, 5.4 * width_px));
                disc(picture, at, wire(colour, 1.0, 3.6 * width_px));
            } else {
                let radius_px = 2.2 * width_px;
                circle(picture, at, radius_px, wire(DARK, 0.9, 2.2 * width_px));
                circle(picture, at, radius_px, wire(colour, 1.0, 1.0 * width_px));
            }
        }
    }

    /// Line width of a face: proportional to the face, and in a large picture, which is displayed reduced, to the
    /// picture, as far as the mesh of the wireframe allows.
    fn line_px(&self, face: &FittedFace) -> f64 {
        let interocular_px = self.interocular_px(face);
        let side = f64::from(self.picture.width().max(self.picture.height()));
        (interocular_px / 110.0).max((side / 1000.0).min(interocular_px / 70.0)).clamp(1.0, 6.0)
    }

    fn interocular_px(&self, face: &FittedFace) -> f64 {
        face.outer_eyes_px() * self.enlarged
    }

    /// Bounding box of a face as drawn.
    fn bounds(&self, face: &FittedFace) -> PixelBox {
        let vertices = face.vertices_px().into_iter().flatten().map(|[x, y, _]| [x, y]);
        let places = vertices.chain(face.points.iter().map(|point| point.xy_px));
        let none = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        places.map(|at| self.place(at)).fold(none, |[low, high], [x, y]| {
            [[low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]]
        })
    }

    /// Draws each face's number next to it, as in tables and file names.
    fn number(&mut self, faces: &[FittedFace]) {
        let bounds: Vec<_> = faces.iter().map(|face| self.bounds(face)).collect();
        let side = f64::from(self.picture.width().max(self.picture.height()));
        for (i, face) in faces.iter().enumerate() {
            let interocular_px = self.interocular_px(face);
            let height_px = (0.22 * interocular_px).max(side / 50.0).min(0.7 * interocular_px);
            let height_px = height_px.max(DIGIT_MIN_PX);
            let colour = if face.is_unsure() { UNSURE } else { LIGHT };
            let number = Number::new(i + 1, height_px);
            number.draw(&mut self.picture, &bounds, i, [DARK, colour]);
        }
    }
}

/// A box: top left and bottom right corner.
type PixelBox = [[f64; 2]; 2];

/// Strokes of a digit through points of a 4 by 6 grid, y down.
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
/// Advance per digit, in grid units.
const ADVANCE: f64 = 6.0;

/// A number of a given height.
struct Number {
    digits: Vec<Strokes>,
    height_px: f64,
}

impl Number {
    fn new(number: usize, height_px: f64) -> Self {
        let digit = |c: char| DIGITS.get(c.to_digit(10)? as usize).copied();
        Self { digits: number.to_string().chars().filter_map(digit).collect(), height_px }
    }

    /// Pixels per grid unit.
    fn step(&self) -> f64 {
        self.height_px / 6.0
    }

    /// Width and height including the plate.
    fn size(&self) -> [f64; 2] {
        let width = (ADVANCE * self.digits.len() as f64 - 2.0) * self.step();
        [width + 0.9 * self.height_px, 1.8 * self.height_px]
    }

    /// Draws the number next to the box `of`, where it covers no other box and stays within the picture if
    /// possible. `colours` are the plate's and the digits'.
    fn draw(&self, picture: &mut RgbImage, boxes: &[PixelBox], of: usize, colours: [[u8; 3]; 2]) {
        let Some(&own) = boxes.get(of) else { return };
        let size = self.size();
        let sides = [f64::from(picture.width()), f64::from(picture.height())];
        let within = |at: [f64; 2]| (0..2).all(|k| at[k] >= 0.0 && at[k] + size[k] <= sides[k]);
        let free = |at: [f64; 2]| {
            let separate =
                |k: usize, other: &PixelBox| at[k] + size[k] <= other[0][k] || at[k] >= other[1][k];
            boxes.iter().all(|other| separate(0, other) || separate(1, other))
        };
        let places = label_corners(own, size);
        let best = places.iter().copied().find(|at| within(*at) && free(*at));
        let at = best.or_else(|| places.iter().copied().find(|at| within(*at)));
        let at = at.unwrap_or(places[0]);
        // A face that fills the picture has its number on it.
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
        lines(picture, &[ends], ink);
        let from = [at[0] + 0.45 * self.height_px, middle - self.height_px / 2.0];
        let ink = Ink { colour, opacity: 1.0, width_px: (0.16 * self.height_px).max(1.5) };
        lines(picture, &self.strokes(from), ink);
    }

    /// The strokes of all digits, starting at `left_top`.
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

/// Positions of a label next to a box, as its top left corner: top left, top right, above and below its middle.
fn label_corners([low, high]: PixelBox, [width, height]: [f64; 2]) -> [[f64; 2]; 4] {
    let gap = 0.15 * height;
    let middle = (low[0] + high[0] - width) / 2.0;
    [
        [low[0] - width - gap, low[1]],
        [high[0] + gap, low[1]],
        [middle, low[1] - height - gap],
        [middle, high[1] + gap],
    ]
}

/// Colour, opacity and width of a stroke.
#[derive(Debug, Clone, Copy)]
struct Ink {
    colour: [u8; 3],
    /// 0 to 1.
    opacity: f64,
    width_px: f64,
}

/// Draws line segments with round ends as one stroke, so translucent ink does not accumulate where they meet.
fn lines(picture: &mut RgbImage, lines: &[[[f64; 2]; 2]], ink: Ink) {
    let lines = || lines.iter().filter(|line| line.iter().flatten().all(|v| v.is_finite()));
    let [x, y] = [0, 1].map(|axis| extent(lines().flatten().map(|end| end[axis])));
    let corners = [[x.0, y.0], [x.1, y.1]];
    let Some(whole) = Patch::around(picture, corners, ink) else { return };
    let width = whole.x.len();
    let mut covered = vec![0_u8; width * whole.y.len()];
    for &[from, to] in lines() {
        let Some(patch) = Patch::around(picture, [from, to], ink) else { continue };
        for [x, y] in patch.pixels() {
            let share = ink.share(off_line([x, y].map(f64::from), from, to));
            let at = (y - whole.y.start) as usize * width + (x - whole.x.start) as usize;
            if let Some(most) = covered.get_mut(at) {
                *most = (*most).max((255.0 * share).round() as u8);
            }
        }
    }
    for (place, share) in whole.pixels().zip(covered).filter(|(_, share)| *share > 0) {
        blend(picture, place, ink, f64::from(share) / 255.0);
    }
}

/// A disc of diameter `ink.width_px`.
fn disc(picture: &mut RgbImage, at: [f64; 2], ink: Ink) {
    stroke(picture, [at, at], ink, |p| distance(p, at));
}

/// A circle of `radius_px`.
fn circle(picture: &mut RgbImage, at: [f64; 2], radius_px: f64, ink: Ink) {
    let corners = [at.map(|v| v - radius_px), at.map(|v| v + radius_px)];
    stroke(picture, corners, ink, |p| (distance(p, at) - radius_px).abs());
}

/// Inks pixels by their distance to a shape, within the box around two corners.
fn stroke(picture: &mut RgbImage, corners: [[f64; 2]; 2], ink: Ink, off: impl Fn(Point) -> f64) {
    let Some(patch) = Patch::around(picture, corners, ink) else { return };
    for pixel in patch.pixels() {
        let share = ink.share(off(pixel.map(f64::from)));
        if share > 0.0 {
            blend(picture, pixel, ink, share);
        }
    }
}

/// A range of pixels.
struct Patch {
    x: Range<u32>,
    y: Range<u32>,
}

impl Patch {
    /// The pixels row by row.
    fn pixels(&self) -> impl Iterator<Item = [u32; 2]> {
        self.y.clone().flat_map(|y| self.x.clone().map(move |x| [x, y]))
    }

    /// The pixels that ink can reach around two corners; none if these are not finite.
    fn around(picture: &RgbImage, corners: [[f64; 2]; 2], ink: Ink) -> Option<Self> {
        let reach = ink.width_px / 2.0 + 1.0;
        let range = |axis: usize, side: u32| {
            let low = corners[0][axis].min(corners[1][axis]) - reach;
            let high = corners[0][axis].max(corners[1][axis]) + reach;
            // `as` saturates at 0 and at the largest value.
            let end = (high.ceil().max(0.0) as u32).saturating_add(1).min(side);
            (low.floor().max(0.0) as u32).min(end)..end
        };
        let finite = corners.iter().flatten().all(|v| v.is_finite());
        finite.then(|| Self { x: range(0, picture.width()), y: range(1, picture.height()) })
    }
}

impl Ink {
    /// Coverage, 0 to 1, of a pixel at distance `off` from the middle of the stroke.
    fn share(&self, off: f64) -> f64 {
        (self.width_px / 2.0 + 0.5 - off).clamp(0.0, self.width_px.clamp(0.0, 1.0))
    }
}

fn off_line(at: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let along = [to[0] - from[0], to[1] - from[1]];
    let length2 = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
    let d = [at[0] - from[0], at[1] - from[1]];
    let t = ((d[0] * along[0] + d[1] * along[1]) / length2).clamp(0.0, 1.0);
    (d[0] - t * along[0]).hypot(d[1] - t * along[1])
}

fn blend(picture: &mut RgbImage, [x, y]: [u32; 2], ink: Ink, share: f64) {
    let Some(Rgb(under)) = picture.get_pixel_mut_checked(x, y) else { return };
    for (under, over) in under.iter_mut().zip(ink.colour) {
        let by = ink.opacity * share * (f64::from(over) - f64::from(*under));
        *under = (f64::from(*under) + by).round() as u8;
    }
}

const VIEWS: [(&str, f64); 3] = [("front", 0.0), ("three-quarter", 40.0), ("side", 90.0)];
const PANEL_PX: f64 = 320.0;
const HEAD_PX: f64 = 56.0;
const FOOT_PX: f64 = 52.0;
const SCALE_BAR_MM: f64 = 50.0;
/// Largest fraction of a panel that the face fills.
const SHARE: f64 = 0.88;

impl FittedFace {
    /// Front, three-quarter and side view of the fitted wireframe with a scale bar, as SVG.
    ///
    /// Triangles are painted back to front (painter's algorithm).
    pub fn to_svg(&self) -> String {
        let width = PANEL_PX * VIEWS.len() as f64;
        let height = HEAD_PX + PANEL_PX + FOOT_PX;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
             height=\"{height}\" font-family=\"DejaVu Sans, sans-serif\" role=\"img\">\n\
             <title>Face wireframe fitted to {name}, from three sides</title>\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n\
             <text x=\"24\" y=\"34\" font-size=\"17\" fill=\"#1b2636\">{name}</text>\n",
            name = escaped(self.source.as_ref().map_or("a photograph", |source| &source.name)),
        );
        if let Some(Pose { yaw, pitch, roll }) = self.pose_deg {
            let [yaw, pitch, roll] = [yaw, pitch, roll].map(whole);
            let pose = format!("yaw {yaw:.0}°  pitch {pitch:.0}°  roll {roll:.0}°");
            let right = width - 24.0;
            svg.push_str(&format!("<text x=\"{right}\" y=\"34\" font-size=\"13\" fill=\"#5b6778\" text-anchor=\"end\">in the photograph: {pose}</text>\n"));
        }
        let scale = self.panel_scale();
        for (number, (name, yaw_deg)) in VIEWS.into_iter().enumerate() {
            let left = number as f64 * PANEL_PX;
            self.panel(&mut svg, left, yaw_deg, scale);
            let (x, y) = (left + PANEL_PX / 2.0, HEAD_PX + PANEL_PX + 14.0);
            svg.push_str(&format!("<text x=\"{x}\" y=\"{y}\" font-size=\"13\" fill=\"#1b2636\" text-anchor=\"middle\">{name}</text>\n"));
        }
        let (y, bar) = (height - 16.0, SCALE_BAR_MM * scale);
        svg.push_str(&format!("<path d=\"M24 {y}v-5v5h{bar:.1}v-5\" fill=\"none\" stroke=\"#1b2636\" stroke-width=\"1.5\"/>\n\
             <text x=\"{:.1}\" y=\"{y}\" font-size=\"12\" fill=\"#5b6778\">{SCALE_BAR_MM} mm, nominal: a photograph has no scale</text>\n</svg>\n",
            24.0 + bar + 10.0));
        svg
    }

    /// Pixels per millimetre, common to all views.
    fn panel_scale(&self) -> f64 {
        let side = |axis: usize| {
            let (low, high) = extent(self.vertices_mm.iter().map(|v| v[axis]));
            high - low
        };
        let widest = (0..3).map(side).fold(1e-6, f64::max);
        SHARE * PANEL_PX / widest
    }

    fn panel(&self, svg: &mut String, left: f64, yaw_deg: f64, scale: f64) {
        let mut camera = Camera {
            scale_px_per_mm: scale,
            yaw_deg,
            pitch_deg: 0.0,
            roll_deg: 0.0,
            origin_px: [0.0; 2],
        };
        let middle = |seen: &[[f64; 3]], axis: usize| {
            let (low, high) = extent(seen.iter().map(|v| v[axis]));
            (high + low) / 2.0
        };
        let seen = camera.project(&self.vertices_mm);
        camera.origin_px =
            [left + PANEL_PX / 2.0 - middle(&seen, 0), HEAD_PX + PANEL_PX / 2.0 - middle(&seen, 1)];
        let seen = camera.project(&self.vertices_mm);
        let mut order: Vec<_> = self.triangles.iter().map(|t| t.map(|v| seen[v])).collect();
        let depth = |t: &[[f64; 3]; 3]| t[0][2] + t[1][2] + t[2][2];
        order.sort_by(|a, b| depth(a).total_cmp(&depth(b)));
        svg.push_str("<g stroke=\"#38507a\" stroke-width=\"0.7\" stroke-linejoin=\"round\">\n");
        for [a, b, c] in order {
            let (u, v) =
                ([b[0] - a[0], a[1] - b[1], b[2] - a[2]], [c[0] - a[0], a[1] - c[1], c[2] - a[2]]);
            let n =
                [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            let length = n.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-12);
            if n[2] <= 0.0 {
                continue;
            }
            // Light from above and the left.
            let facing = ((-0.35 * n[0] + 0.45 * n[1] + 0.82 * n[2]) / length).clamp(0.0, 1.0);
            let shade = |low: f64, high: f64| (low + (high - low) * facing).round() as u8;
            let (r, g, b_) = (shade(176.0, 245.0), shade(190.0, 248.0), shade(212.0, 252.0));
            svg.push_str(&format!("<path d=\"M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}Z\" fill=\"#{r:02x}{g:02x}{b_:02x}\"/>\n",
                a[0], a[1], b[0], b[1], c[0], c[1]));
        }
        svg.push_str("</g>\n");
        self.curves(svg, &camera);
    }

    /// The lines of the features, where their vertices face the camera.
    fn curves(&self, svg: &mut String, camera: &Camera) {
        let seen = camera.project(&self.vertices_mm);
        let facing = self.facing_vertices(&seen);
        for curve in Curve::all() {
            let vertex = |id: &FeatureId| self.features.get(id.name()).copied();
            let vertices: Vec<_> = curve.points.iter().filter_map(vertex).collect();
            let last = if curve.closed { vertices.first() } else { None };
            let path: Vec<_> = vertices.iter().chain(last).copied().collect();
            let [r, g, b] = curve.part.colour();
            for pair in path.windows(2) {
                if facing[pair[0]] && facing[pair[1]] {
                    let ([x, y, _], [u, v, _]) = (seen[pair[0]], seen[pair[1]]);
                    svg.push_str(&format!("<path d=\"M{x:.1} {y:.1}L{u:.1} {v:.1}\" stroke=\"#1b2636\" stroke-width=\"3.6\" stroke-linecap=\"round\"/>\
                         <path d=\"M{x:.1} {y:.1}L{u:.1} {v:.1}\" stroke=\"#{r:02x}{g:02x}{b:02x}\" stroke-width=\"2.2\" stroke-linecap=\"round\"/>\n"));
                }
            }
        }
    }

    /// For each vertex, whether any of its triangles faces the camera.
    fn facing_vertices(&self, seen: &[[f64; 3]]) -> Vec<bool> {
        let mut facing = vec![false; seen.len()];
        self.facing(seen).flatten().for_each(|v| facing[v] = true);
        facing
    }
}

/// Escapes text for XML and drops control characters, which XML forbids.
fn escaped(text: &str) -> String {
    let mut safe = String::new();
    for c in text.chars().filter(|c| !c.is_control()) {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            _ => safe.push(c),
        }
    }
    safe
}

/// Rounds to whole degrees, without a negative zero.
fn whole(degrees: f64) -> f64 {
    degrees.round() + 0.0
}
