//! Front and right view of the body: shaded, with level sets, centre lines and joints. The shading is a raster with a depth
//! buffer, of which contour lines are drawn.

use std::collections::HashMap;

use super::{Anchor, DIM, Drawing, INK, Line, Sheet, colour};
use crate::{
    Estimate, Joint, Joints, Mesh, Side,
    mesh::{Point, axes, mean, normal, unit},
    skeleton::joint_name,
};

/// Area of both views, side by side.
const LEFT: f64 = 26.0;
const WIDTH: f64 = 984.0;
const ROWS: [f64; 2] = [90.0, 740.0];
/// Widths of a name, without and with its standard deviation.
const COLUMN: f64 = 87.0;
const UNSURE_COLUMN: f64 = 122.0;
/// Gap between a body and its names.
const NAME_GAP: f64 = 15.0;
/// Brightness thresholds and their tones.
const TONES: [(f64, &str); 6] = [
    (0.30, "#c9ced4"),
    (0.50, "#d5d9de"),
    (0.64, "#dfe2e6"),
    (0.76, "#e8eaed"),
    (0.86, "#f0f1f3"),
    (0.94, "#f7f8f9"),
];
const RIM: &str = "#b4bac2";
/// Colour of standard deviations.
const UNSURE: &str = "#7b3294";
/// Largest circle: half a thigh.
const WIDE_MM: f64 = 80.0;
/// Maximum number of level-set curves; more are thinned out.
const RINGS_MAX: usize = 160;

type Projection = fn(&Upright, Point) -> Point;

pub(super) fn draw(sheet: &mut Sheet, drawing: &Drawing<'_>, upright: &Upright) {
    let Some(mesh) = drawing.mesh else { return };
    let projections: [Projection; 2] = [Upright::front, Upright::side];
    let boxes =
        projections.map(|to| bounds(mesh.positions.iter().map(|p| to(upright, Point::from(*p)))));
    let column = if anything_wide(drawing) { UNSURE_COLUMN } else { COLUMN };
    // Space for names on either side of a body.
    let names = column + NAME_GAP;
    // One scale for both views, as large as fits.
    let extent = |axis: usize| boxes.map(|[low, high]| (high[axis] - low[axis]).max(1e-9));
    let (widths, heights) = (extent(0), extent(1));
    let per_unit = ((WIDTH - 4.0 * names) / (widths[0] + widths[1]))
        .min((ROWS[1] - ROWS[0]) / heights[0].max(heights[1]));
    let spare = (WIDTH - 4.0 * names - per_unit * (widths[0] + widths[1])) / 2.0;
    let mut left = LEFT;
    for (i, project) in projections.into_iter().enumerate() {
        let [low, high] = boxes[i];
        let width = per_unit * widths[i] + 2.0 * names + spare;
        let centre = [left + width / 2.0, (ROWS[0] + ROWS[1]) / 2.0];
        let middle = [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0];
        let origin = [centre[0] - per_unit * middle[0], centre[1] + per_unit * middle[1]];
        let fit = PageTransform { per_unit, origin };
        let view = BodyView { drawing, upright, project, fit };
        let title = match (i, drawing.joints.sides_told) {
            (0, true) => "front",
            (1, true) => "from the right",
            (0, false) => "front or back (sides unknown)",
            _ => "from one side (sides unknown)",
        };
        sheet.text(centre[0], 66.0, title, 13.0, DIM, Anchor::Middle);
        view.surface(sheet);
        // Names stay near the body, however slim it is.
        let half = per_unit * widths[i] / 2.0 + names;
        view.joints(sheet, [centre[0] - half, centre[0] + half], column, i == 0);
        left += width;
    }
    scale_bar(sheet, drawing, per_unit);
}

struct BodyView<'a> {
    drawing: &'a Drawing<'a>,
    upright: &'a Upright,
    project: Projection,
    fit: PageTransform,
}

impl BodyView<'_> {
    fn at(&self, p: Point) -> [f64; 2] {
        self.fit.at((self.project)(self.upright, p))
    }

    /// Page coordinates and nearness.
    fn on_page(&self, p: Point) -> Point {
        let projected = (self.project)(self.upright, p);
        let [x, y] = self.fit.at(projected);
        Point::new(x, y, projected.z * self.fit.per_unit)
    }

    fn surface(&self, sheet: &mut Sheet) {
        let Some(mesh) = self.drawing.mesh else { return };
        let page: Vec<Point> =
            mesh.positions.iter().map(|p| self.on_page(Point::from(*p))).collect();
        let [low, high] = bounds(page.iter().copied());
        if !low.iter().chain(&high).all(|c| c.is_finite()) {
            return;
        }
        let shade = Shade::new(mesh, &page, low, high);
        let place = |loops: Vec<Vec<[f64; 2]>>| -> Vec<Vec<[f64; 2]>> {
            let to_paper =
                |p: [f64; 2]| [0, 1].map(|k| shade.corner[k] + (p[k] + 0.5) * shade.cell);
            loops.into_iter().map(|l| l.into_iter().map(to_paper).collect()).collect()
        };
        let outline = place(loops(&shade.cover, shade.size, 0.5));
        let style =
            format!("fill=\"{RIM}\" fill-rule=\"evenodd\" stroke=\"#8a919b\" stroke-width=\"1\"");
        sheet.path(&outline, true, &style);
        for (level, tone) in TONES {
            let lit = place(loops(&shade.light, shade.size, level));
            sheet.path(&lit, true, &format!("fill=\"{tone}\" fill-rule=\"evenodd\""));
        }
        self.rings(sheet, &shade);
        self.centre_lines(sheet);
    }

    /// The visible part of each curve, part by part.
    fn rings(&self, sheet: &mut Sheet, shade: &Shade) {
        let rings = &self.drawing.rings;
        let step = rings.len().div_ceil(RINGS_MAX).max(1);
        let mut parts: Vec<_> = rings.iter().map(|ring| ring.part).collect();
        parts.sort_unstable();
        parts.dedup();
        for part in parts {
            let mut pieces = Vec::new();
            // Thinned out per part, since curves of both legs alternate.
            for ring in rings.iter().filter(|ring| ring.part == part).step_by(step) {
                let mut piece: Vec<[f64; 2]> = Vec::new();
                let around = ring.points.iter().chain(ring.points.first());
                for p in around.map(|p| self.on_page(Point::from(*p))) {
                    // Two page units: less than the thickness of a wrist.
                    if shade.sees(p, 2.0) {
                        let far = |last: &[f64; 2]| (last[0] - p[0]).hypot(last[1] - p[1]) > 0.7;
                        if piece.last().is_none_or(far) {
                            piece.push([p[0], p[1]]);
                        }
                    } else {
                        pieces.push(std::mem::take(&mut piece));
                    }
                }
                pieces.push(piece);
            }
            let colour = colour(part);
            let style = format!(
                "fill=\"none\" stroke=\"{colour}\" stroke-width=\"0.7\" stroke-opacity=\"0.75\""
            );
            sheet.path(&pieces, false, &style);
        }
    }

    fn centre_lines(&self, sheet: &mut Sheet) {
        let lines =
            |line: &Line| vec![line.points.iter().map(|p| self.at(Point::from(*p))).collect()];
        let round = "fill=\"none\" stroke-linecap=\"round\" stroke-linejoin=\"round\"";
        let white = format!("{round} stroke=\"#ffffff\" stroke-width=\"4\"");
        for line in &self.drawing.centre_lines {
            sheet.path(&lines(line), false, &white);
        }
        for line in &self.drawing.centre_lines {
            let colour = colour(line.part);
            let style = format!("{round} stroke=\"{colour}\" stroke-width=\"2\"");
            sheet.path(&lines(line), false, &style);
        }
    }

    /// Joints as dots with a circle of one standard deviation, and names in the margins. A circle as wide as the body
    /// would hide it, so very uncertain joints are hollow and state their standard deviation.
    fn joints(&self, sheet: &mut Sheet, margins: [f64; 2], column: f64, front: bool) {
        let mut names = Vec::new();
        for (&joint, estimate) in &self.drawing.joints.estimates {
            let at = self.at(estimate.position.into());
            let sigma = estimate.sigma * self.fit.per_unit;
            let ring = format!("fill=\"none\" stroke=\"{UNSURE}\" stroke-width=\"1\"");
            if sigma > 0.5 && !is_wide(self.drawing, estimate) {
                sheet.circle(at, sigma, &ring);
            }
            // Names of the far side would cover those of the near side.
            if front || !joint_name(joint).starts_with("l_") {
                let mut text = self.name(joint);
                if is_wide(self.drawing, estimate) {
                    text += &format!(" ± {:.0}", estimate.sigma * self.drawing.mm());
                }
                names.push(Label { at, text });
            }
        }
        for estimate in self.drawing.joints.estimates.values() {
            let at = self.at(estimate.position.into());
            let style = if is_wide(self.drawing, estimate) {
                format!("fill=\"#ffffff\" stroke=\"{UNSURE}\" stroke-width=\"2\"")
            } else {
                format!("fill=\"{INK}\" stroke=\"#ffffff\" stroke-width=\"1.4\"")
            };
            sheet.circle(at, 3.6, &style);
        }
        labels(sheet, names, margins, column);
    }

    fn name(&self, joint: Joint) -> String {
        let name = joint_name(joint);
        let sides_known = self.drawing.joints.sides_told;
        match name.split_once('_') {
            Some(("l", rest)) if sides_known => format!("left {rest}"),
            Some(("r", rest)) if sides_known => format!("right {rest}"),
            Some(("l", rest)) => format!("{rest} A"),
            Some((_, rest)) => format!("{rest} B"),
            None => name.to_owned(),
        }
    }
}

/// Whether the circle of a joint would be too wide.
fn is_wide(drawing: &Drawing<'_>, estimate: &Estimate) -> bool {
    estimate.sigma * drawing.mm() > WIDE_MM
}

fn anything_wide(drawing: &Drawing<'_>) -> bool {
    drawing.joints.estimates.values().any(|estimate| is_wide(drawing, estimate))
}

fn scale_bar(sheet: &mut Sheet, drawing: &Drawing<'_>, per_unit: f64) {
    let per_mm = per_unit / drawing.mm();
    let length = [50.0, 100.0, 200.0, 500.0, 1000.0];
    let Some(mm) = length.into_iter().find(|mm| mm * per_mm > 50.0) else { return };
    let (x, y) = (LEFT + 20.0, ROWS[1] + 24.0);
    let end = x + mm * per_mm;
    let style = format!("stroke=\"{INK}\" stroke-width=\"1.5\" fill=\"none\"");
    sheet.path(&[vec![[x, y - 4.0], [x, y], [end, y], [end, y - 4.0]]], false, &style);
    sheet.text(end + 8.0, y - 1.0, &format!("{mm} mm, both views"), 12.0, INK, Anchor::Left);
    let legend = if anything_wide(drawing) {
        format!(
            "circles: one standard deviation of a joint; hollow: more than {WIDE_MM} mm, see its name"
        )
    } else {
        "circles: one standard deviation of a joint".to_owned()
    };
    sheet.text(end + 140.0, y - 1.0, &legend, 12.0, DIM, Anchor::Left);
}

/// A name and its point.
struct Label {
    at: [f64; 2],
    text: String,
}

/// Distance between names.
const STEP: f64 = 17.0;
/// Vertical range of names.
const LABEL_ROWS: [f64; 2] = [96.0, 736.0];

/// Half of the names go to either margin, each as near to the height of its point as possible. None is wider than
/// `column`.
fn labels(sheet: &mut Sheet, mut labels: Vec<Label>, [left, right]: [f64; 2], column: f64) {
    labels.retain(|label| label.at.iter().all(|c| c.is_finite()));
    labels.sort_by(|a, b| a.at[0].total_cmp(&b.at[0]));
    let rest = labels.split_off(labels.len() / 2);
    for (mut names, edge, anchor, inward) in
        [(labels, left + column, Anchor::Right, 1.0), (rest, right - column, Anchor::Left, -1.0)]
    {
        names.sort_by(|a, b| a.at[1].total_cmp(&b.at[1]));
        let heights = spread(&names.iter().map(|label| label.at[1]).collect::<Vec<f64>>());
        for (label, y) in names.iter().zip(heights) {
            sheet.text(edge, y, &label.text, 11.5, INK, anchor);
            let from = [edge + inward * 5.0, y];
            let knee = [edge + inward * 14.0, y];
            let style =
                "fill=\"none\" stroke=\"#282828\" stroke-width=\"0.6\" stroke-opacity=\"0.55\"";
            sheet.path(&[vec![from, knee, label.at]], false, style);
        }
    }
}

/// Heights near `targets` and in their order, at least a step apart, within the range.
fn spread(targets: &[f64]) -> Vec<f64> {
    let n = targets.len();
    let mut heights = Vec::with_capacity(n);
    let mut free = LABEL_ROWS[0];
    for &y in targets {
        let y = y.max(free);
        heights.push(y);
        free = y + STEP;
    }
    let mut limit = LABEL_ROWS[1];
    for y in heights.iter_mut().rev() {
        *y = y.min(limit);
        limit = *y - STEP;
    }
    heights
}

/// Axes of the body: left, up, forward; of unit length.
#[derive(Debug)]
pub(super) struct Upright {
    axes: [Point; 3],
    middle: Point,
}

impl Upright {
    /// Axes from trunk and hips; without them the mesh's own.
    pub(super) fn of(drawing: &Drawing<'_>) -> Self {
        let positions = drawing.mesh.map_or(&[][..], |mesh| &mesh.positions);
        let middle = mean(positions.iter().map(|at| Point::from(*at))).unwrap_or_default();
        let axes = upright_axes(&drawing.joints);
        Self { axes: axes.unwrap_or([Point::x(), Point::y(), Point::z()]), middle }
    }

    /// Front view: x right, y up, z towards the viewer. The subject's left is on the right.
    pub(super) fn front(&self, p: Point) -> Point {
        let p = p - self.middle;
        self.axes.map(|axis| axis.dot(&p)).into()
    }

    /// View from the subject's right: forward is on the right.
    pub(super) fn side(&self, p: Point) -> Point {
        let front = self.front(p);
        Point::new(front.z, front.y, -front.x)
    }
}

fn upright_axes(joints: &Joints) -> Option<[Point; 3]> {
    let at = |joint: Joint| joints.point(joint);
    let both = |joint: fn(Side) -> Joint| at(joint(Side::Left)).zip(at(joint(Side::Right)));
    let hips = both(Joint::Hip);
    let pelvis = at(Joint::Pelvis).or_else(|| mean(<[Point; 2]>::from(hips?)))?;
    let top = at(Joint::Throat).or_else(|| at(Joint::Head))?;
    let (left, right) = both(Joint::Shoulder).or(hips)?;
    axes(top - pelvis, left - right)
}

/// Scale and origin of a view on the page.
#[derive(Debug, Clone, Copy)]
struct PageTransform {
    per_unit: f64,
    origin: [f64; 2],
}

impl PageTransform {
    /// A point on the page, y down.
    fn at(&self, p: Point) -> [f64; 2] {
        [self.origin[0] + self.per_unit * p[0], self.origin[1] - self.per_unit * p[1]]
    }
}

/// Minima and maxima of the first two coordinates.
pub(super) fn bounds(points: impl Iterator<Item = Point>) -> [[f64; 2]; 2] {
    let all = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    points.fold(all, |[low, high], p| {
        [[low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])]]
    })
}

/// Maximum number of cells along a side.
const CELLS_MAX: usize = 700;

/// A raster over part of the page.
#[derive(Debug)]
struct Shade {
    pub(super) size: [usize; 2],
    /// Size of a cell in page units.
    pub(super) cell: f64,
    /// Page position of the first cell's corner.
    pub(super) corner: [f64; 2],
    /// Brightness row by row: 0 outside, up to 1 where the surface faces the light.
    light: Vec<f64>,
    /// 1 where the surface covers the cell.
    cover: Vec<f64>,
    /// Depth buffer: nearness to the viewer, in the unit of the points.
    depth: Vec<f64>,
}

/// Direction to the light: over the viewer's left shoulder.
const LIGHT: [f64; 3] = [-0.35, 0.45, 0.82];

impl Shade {
    /// Rasterises a mesh whose vertices are given in view coordinates: x and y on the page, z towards the viewer.
    pub(super) fn new(mesh: &Mesh, seen: &[Point], low: [f64; 2], high: [f64; 2]) -> Self {
        let extent = [high[0] - low[0], high[1] - low[1]];
        let cell = (extent[0].max(extent[1]) / (CELLS_MAX - 8) as f64).max(1.0);
        let size = extent.map(|length| ((length / cell) as usize + 8).min(CELLS_MAX));
        let corner = low.map(|c| c - 4.0 * cell);
        let n = size[0] * size[1];
        let (light, cover, depth) = (vec![0.0; n], vec![0.0; n], vec![f64::NEG_INFINITY; n]);
        let mut shade = Self { size, cell, corner, light, cover, depth };
        let normals = normals(mesh, seen);
        let towards = unit(LIGHT.into());
        for triangle in &mesh.triangles {
            let corners = triangle.map(|i| seen.get(i as usize).copied().unwrap_or_default());
            let bright = triangle.map(|i| {
                let normal = normals.get(i as usize).copied().unwrap_or_default();
                // The page has y down, the light has y up.
                let lit = Point::new(normal.x, -normal.y, normal.z).dot(&towards).max(0.0);
                0.12 + 0.45 * normal[2].max(0.0) + 0.43 * lit
            });
            shade.fill(corners, bright);
        }
        for _ in 0..2 {
            blur(&mut shade.light, size);
            blur(&mut shade.cover, size);
        }
        shade
    }

    fn fill(&mut self, corners: [Point; 3], bright: [f64; 3]) {
        let to_cells = |p: Point| [0, 1].map(|k| (p[k] - self.corner[k]) / self.cell - 0.5);
        let [a, b, c] = corners.map(to_cells);
        let doubled = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if doubled == 0.0 || !doubled.is_finite() {
            return;
        }
        let range = |k: usize| {
            let low = a[k].min(b[k]).min(c[k]).ceil().max(0.0) as usize;
            let high = a[k].max(b[k]).max(c[k]).floor().max(-1.0) + 1.0;
            low..(high as usize).min(self.size[k])
        };
        for y in range(1) {
            for x in range(0) {
                let p = [x as f64, y as f64];
                let part = |from: [f64; 2], to: [f64; 2]| {
                    ((to[0] - from[0]) * (p[1] - from[1]) - (to[1] - from[1]) * (p[0] - from[0]))
                        / doubled
                };
                let weights = [part(b, c), part(c, a), part(a, b)];
                if weights.iter().any(|&w| w < -1e-9) {
                    continue;
                }
                let mix = |of: [f64; 3]| of.iter().zip(weights).map(|(value, w)| value * w).sum();
                let (depth, light): (f64, f64) = (mix(corners.map(|p| p[2])), mix(bright));
                let at = y * self.size[0] + x;
                if depth > self.depth[at] {
                    (self.depth[at], self.light[at], self.cover[at]) = (depth, light, 1.0);
                }
            }
        }
    }

    /// Whether a surface point is visible, up to a tolerance in the unit of the points.
    fn sees(&self, p: Point, tolerance: f64) -> bool {
        let cell = |k: usize| (p[k] - self.corner[k]) / self.cell;
        let (x, y) = (cell(0), cell(1));
        if x < 0.0 || y < 0.0 || x as usize >= self.size[0] || y as usize >= self.size[1] {
            return true;
        }
        self.depth[y as usize * self.size[0] + x as usize] <= p[2] + tolerance
    }
}

/// Vertex normals weighted by area, pointing to the viewer where the surface faces it.
fn normals(mesh: &Mesh, seen: &[Point]) -> Vec<Point> {
    let mut normals = vec![Point::zeros(); seen.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| seen.get(i as usize).copied().unwrap_or_default());
        // The page mirrors the view: y is down.
        let normal = normal([a, c, b]);
        for &corner in triangle {
            if let Some(sum) = normals.get_mut(corner as usize) {
                *sum += normal;
            }
        }
    }
    normals.into_iter().map(unit).collect()
}

/// Box blur of three by three cells; the border stays.
fn blur(values: &mut [f64], [width, height]: [usize; 2]) {
    let before = values.to_vec();
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let at = y * width + x;
            let sum: f64 = [at - width, at, at + width]
                .iter()
                .map(|&row| before[row - 1] + before[row] + before[row + 1])
                .sum();
            values[at] = sum / 9.0;
        }
    }
}

/// Largest deviation of a thinned contour, in cells.
const TOLERANCE: f64 = 0.18;

/// Closed contours around all cells above a level, in units of cells. The border of the raster must be below it.
pub(super) fn loops(values: &[f64], [width, height]: [usize; 2], level: f64) -> Vec<Vec<[f64; 2]>> {
    // A crossing lies between a cell and its neighbour to the right (false) or below (true).
    let mut next: HashMap<(usize, bool), (usize, bool)> = HashMap::new();
    let mut starts = Vec::new();
    let value = |at: usize| values.get(at).copied().unwrap_or(0.0);
    for y in 0..height.saturating_sub(1) {
        for x in 0..width.saturating_sub(1) {
            let at = y * width + x;
            let corners = [at, at + 1, at + width + 1, at + width];
            let sides = [(at, false), (at + 1, true), (at + width, false), (at, true)];
            let above = corners.map(|corner| value(corner) > level);
            for i in 0..4 {
                // Enter over this side, go around the corners above, leave: corner i + 1 is below, so the loop ends.
                if above[i] && !above[(i + 1) % 4] {
                    let mut j = i;
                    while above[(j + 3) % 4] {
                        j = (j + 3) % 4;
                    }
                    let out = (j + 3) % 4;
                    next.insert(sides[i], sides[out]);
                    starts.push(sides[i]);
                }
            }
        }
    }
    let crossing = |(at, below): (usize, bool)| {
        let other = if below { at + width } else { at + 1 };
        let (a, b) = (value(at), value(other));
        let share = if a == b { 0.5 } else { ((level - a) / (b - a)).clamp(0.0, 1.0) };
        let (x, y) = ((at % width) as f64, (at / width) as f64);
        if below { [x, y + share] } else { [x + share, y] }
    };
    let mut loops = Vec::new();
    for start in starts {
        let mut points = Vec::new();
        let mut at = start;
        while let Some(after) = next.remove(&at) {
            points.push(crossing(at));
            at = after;
        }
        // Smaller contours are noise.
        if points.len() > 8 {
            loops.push(thinned(&points));
        }
    }
    loops
}

/// Drops points that lie almost on the line between kept ones.
fn thinned(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut kept = Vec::new();
    let mut from = 0;
    while let Some(&start) = points.get(from) {
        kept.push(start);
        let mut to = from + 1;
        while to + 1 < points.len() && to - from < 24 {
            let end = points[to + 1];
            let (dx, dy) = (end[0] - start[0], end[1] - start[1]);
            let length = dx.hypot(dy);
            let off = |p: &[f64; 2]| ((p[0] - start[0]) * dy - (p[1] - start[1]) * dx).abs();
            if points[from + 1..=to].iter().any(|p| off(p) > TOLERANCE * length) {
                break;
            }
            to += 1;
        }
        from = to;
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::loops;

    #[test]
    fn contours_go_around_what_is_above() {
        // Two discs and a ring.
        let size = [80, 40];
        let mut values = vec![0.0; 80 * 40];
        for (x, y) in (0..80).flat_map(|x| (0..40).map(move |y| (x, y))) {
            let far = |cx: f64, cy: f64| (x as f64 - cx).hypot(y as f64 - cy);
            let ring = (4.0 - (far(55.0, 20.0) - 10.0).abs()).max(0.0);
            values[y * 80 + x] =
                (8.0 - far(15.0, 12.0)).max(7.0 - far(18.0, 31.0)).max(ring).max(0.0);
        }
        let loops = loops(&values, size, 1.0);
        assert_eq!(loops.len(), 4);
        let area = |l: &Vec<[f64; 2]>| {
            let next = l.iter().cycle().skip(1);
            l.iter().zip(next).map(|(p, q)| p[0] * q[1] - p[1] * q[0]).sum::<f64>() / 2.0
        };
        let mut areas: Vec<f64> = loops.iter().map(|l| area(l).abs()).collect();
        areas.sort_by(f64::total_cmp);
        for (found, radius) in areas.into_iter().zip([6.0, 7.0, 7.0, 13.0]) {
            let expected = std::f64::consts::PI * radius * radius;
            assert!((found / expected - 1.0).abs() < 0.04, "{found} {expected}");
        }
    }
}
