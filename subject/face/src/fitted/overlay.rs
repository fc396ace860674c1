//! Fitted faces on their photograph.

use std::io::Cursor;

use image::imageops::{self, FilterType};
use image::{ImageError, ImageFormat, Rgb, RgbImage};

use super::FittedFace;
use super::curves::{Curve, Part};
use super::draw::{self, Ink};
use super::number::{Bounds, Number};
use crate::Photo;
use crate::model::{FeatureId, OUTER_EYES_MM};

/// Below this the lines would cover the face: small pictures are enlarged first.
const LEAST_IO_PX: f64 = 160.0;
const MAX_SIDE_PX: u32 = 3000;
const DARK: [u8; 3] = [0x10, 0x18, 0x28];
const LIGHT: [u8; 3] = [0xff, 0xff, 0xff];
/// The wireframe of a face whose points may be off.
const UNSURE: [u8; 3] = [0xff, 0xa0, 0x20];
/// Points that are less sure than this are drawn hollow.
const SURE: f64 = 0.5;
/// Digits that are lower cannot be read.
const LEAST_DIGIT_PX: f64 = 12.0;

/// A photograph that faces are drawn on.
#[derive(Debug, Clone)]
pub struct Overlay {
    picture: RgbImage,
    enlarged: f64,
}

impl Overlay {
    /// The photograph, enlarged by a whole number where the smallest of the faces would be too small to be drawn on. Several
    /// faces have their numbers beside them, from 1, in the order of `faces`.
    pub fn new(photograph: &RgbImage, faces: &[FittedFace]) -> Self {
        let io_px = |face: &FittedFace| face.camera.scale_px_per_mm * OUTER_EYES_MM;
        let least = faces.iter().map(io_px).fold(LEAST_IO_PX, f64::min).max(1.0);
        let side = photograph.width().max(photograph.height()).max(1);
        let factor = ((LEAST_IO_PX / least).ceil() as u32).min(MAX_SIDE_PX / side).max(1);
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

    /// Faces on the photograph that they were found in, as a PNG.
    ///
    /// # Errors
    /// What the encoder says.
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

    /// From the photograph's pixels to the picture's.
    fn place(&self, at: [f64; 2]) -> [f64; 2] {
        at.map(|v| (v + 0.5) * self.enlarged - 0.5)
    }

    fn draw(&mut self, face: &FittedFace) {
        let width_px = self.line_px(face);
        let wire = |colour, opacity, width_px| Ink { colour, opacity, width_px };
        let vertices: Vec<_> =
            face.vertices_px().iter().map(|&[x, y, _]| self.place([x, y])).collect();
        let net: Vec<_> =
            face.facing_lines().into_iter().map(|line| line.map(|v| vertices[v])).collect();
        let colour = if face.is_unsure() { UNSURE } else { LIGHT };
        draw::lines(&mut self.picture, &net, wire(DARK, 0.5, 2.2 * width_px));
        draw::lines(&mut self.picture, &net, wire(colour, 0.75, 0.8 * width_px));
        for curve in Curve::all() {
            let at = |id: &FeatureId| face.points.get(id.index()).map(|p| self.place(p.xy_px));
            let points: Vec<_> = curve.points.iter().filter_map(at).collect();
            let last = if curve.closed { points.first() } else { None };
            let path: Vec<_> = points.iter().chain(last).copied().collect();
            let path: Vec<_> = path.windows(2).map(|pair| [pair[0], pair[1]]).collect();
            draw::lines(&mut self.picture, &path, wire(DARK, 0.8, 2.6 * width_px));
            draw::lines(&mut self.picture, &path, wire(curve.part.colour(), 1.0, 1.3 * width_px));
        }
        for point in &face.points {
            let at = self.place(point.xy_px);
            let colour = Part::of(point.id).colour();
            let picture = &mut self.picture;
            if point.confidence >= SURE {
                draw::disc(picture, at, wire(DARK, 0.9, 5.4 * width_px));
                draw::disc(picture, at, wire(colour, 1.0, 3.6 * width_px));
            } else {
                let radius_px = 2.2 * width_px;
                draw::circle(picture, at, radius_px, wire(DARK, 0.9, 2.2 * width_px));
                draw::circle(picture, at, radius_px, wire(colour, 1.0, 1.0 * width_px));
            }
        }
    }

    /// How wide a line of a face is: a part of the face, and in a large picture, which is seen smaller than it is, of the
    /// picture, as far as there is room between the lines of the net.
    fn line_px(&self, face: &FittedFace) -> f64 {
        let io_px = self.io_px(face);
        let side = f64::from(self.picture.width().max(self.picture.height()));
        (io_px / 110.0).max((side / 1000.0).min(io_px / 70.0)).clamp(1.0, 6.0)
    }

    fn io_px(&self, face: &FittedFace) -> f64 {
        face.camera.scale_px_per_mm * OUTER_EYES_MM * self.enlarged
    }

    /// The box around a face as it is drawn: left top, right bottom.
    fn bounds(&self, face: &FittedFace) -> Bounds {
        let vertices = face.vertices_px().into_iter().map(|[x, y, _]| [x, y]);
        let places = vertices.chain(face.points.iter().map(|point| point.xy_px));
        let none = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        places.map(|at| self.place(at)).fold(none, |[low, high], [x, y]| {
            [[low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]]
        })
    }

    /// Each face's number, as tables and files have it, beside the face.
    fn number(&mut self, faces: &[FittedFace]) {
        let bounds: Vec<_> = faces.iter().map(|face| self.bounds(face)).collect();
        let side = f64::from(self.picture.width().max(self.picture.height()));
        for (i, face) in faces.iter().enumerate() {
            let io_px = self.io_px(face);
            let height_px = (0.22 * io_px).max(side / 50.0).min(0.7 * io_px).max(LEAST_DIGIT_PX);
            let colour = if face.is_unsure() { UNSURE } else { LIGHT };
            let number = Number::new(i + 1, height_px);
            number.draw(&mut self.picture, &bounds, i, [DARK, colour]);
        }
    }
}

impl FittedFace {
    /// The edges of triangles that face the camera.
    fn facing_lines(&self) -> Vec<[usize; 2]> {
        let seen = self.vertices_px();
        let facing = self.triangles.iter().filter(|triangle| {
            let [a, b, c] = triangle.map(|v| seen[v]);
            // Counter-clockwise from in front, with y down.
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0.0
        });
        let mut lines: Vec<_> = facing
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
            .map(|[a, b]| [a.min(b), a.max(b)])
            .collect();
        lines.sort_unstable();
        lines.dedup();
        lines
    }
}
