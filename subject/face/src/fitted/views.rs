//! Three views of the wireframe, as SVG.

use super::{Curve, FittedFace, Pose};
use crate::model::{Camera, FeatureId};
use crate::plane::extent;

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
