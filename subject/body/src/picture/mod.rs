//! SVG report of a scan: front and side view with level sets, centre lines and joints; the Reeb graph; lengths; and the
//! circularity along the limbs, as in figure 7 of Yu et al. 2008.
//!
//! The colours of Okabe and Ito 2008 are distinct for all kinds of colour vision; the two sides differ in lightness
//! too.

mod charts;
mod views;

use std::fmt::Write as _;

use self::views::Upright;
use crate::{
    Joint, Joints, Mesh, Side, Unit,
    level::{Ring, Rings},
    mesh::{Point, distance},
    reeb::Levels,
    skeleton::{Skeleton, joint_name},
};

/// A part of the body with its own level sets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum BodyPart {
    /// Trunk with head and neck.
    Trunk,
    /// Arm from the armpit to the fingers.
    Arm(Side),
    /// Leg from the crotch to the toes.
    Leg(Side),
}

/// A polyline, in the mesh's frame and unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// The part of the body.
    pub part: BodyPart,
    /// Points in order; a closed curve does not repeat its first.
    pub points: Vec<[f64; 3]>,
}

/// A node of the Reeb graph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReebNode {
    /// Centroid of its level-set curve, in the mesh's frame and unit.
    pub position: [f64; 3],
    /// Value of the Morse function: the geodesic distance from the head, in the mesh's unit.
    pub value: f64,
}

/// An edge of the Reeb graph, by indices of nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReebEdge {
    /// The node nearer to the head.
    pub from: usize,
    /// The node farther from the head.
    pub to: usize,
    /// The part of the body.
    pub part: BodyPart,
}

/// Circularity along a part of the body.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// The part of the body.
    pub part: BodyPart,
    /// Distance along the part in the mesh's unit, and circularity (Yu et al. 2008, eq. 5): 1 is a circle.
    pub samples: Vec<[f64; 2]>,
    /// Joints on the curve.
    pub marks: Vec<Mark>,
}

/// A joint on a curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Mark {
    /// Distance along the part, in the mesh's unit.
    pub distance: f64,
    /// Name of the joint.
    pub name: String,
}

/// The content of a picture. Everything but the mesh may be empty.
#[derive(Debug, Clone, Default)]
pub struct Drawing<'a> {
    /// Title: the scan's name, the method.
    pub title: &'a str,
    /// The surface.
    pub mesh: Option<&'a Mesh>,
    /// Unit of the mesh; metres if none.
    pub unit: Option<Unit>,
    /// Level-set curves.
    pub rings: Vec<Line>,
    /// Centre line of each part.
    pub centre_lines: Vec<Line>,
    /// Nodes of the Reeb graph.
    pub reeb_nodes: Vec<ReebNode>,
    /// Edges of the Reeb graph.
    pub reeb_edges: Vec<ReebEdge>,
    /// Joints in the mesh's frame and unit.
    pub joints: Joints,
    /// Source of lengths, stature and notes, if there is one.
    pub skeleton: Option<&'a Skeleton>,
    /// Circularity along arms, trunk and legs.
    pub curves: Vec<Curve>,
}

/// Size of the picture.
const WIDTH: f64 = 1400.0;
const HEIGHT: f64 = 1080.0;

/// Draws a complete SVG document of 1400 by 1080 units, higher if there are notes.
#[must_use]
pub fn svg(drawing: &Drawing<'_>) -> String {
    let notes =
        drawing.skeleton.map_or_else(Vec::new, |skeleton| charts::note_lines(&skeleton.notes));
    let mut sheet = Sheet::new(WIDTH, HEIGHT + charts::notes_height(&notes));
    sheet.text(40.0, 38.0, drawing.title, 20.0, INK, Anchor::Left);
    let upright = Upright::of(drawing);
    views::draw(&mut sheet, drawing, &upright);
    charts::reeb(&mut sheet, drawing, &upright);
    charts::lengths(&mut sheet, drawing);
    for (i, (title, is_of)) in PARTS.into_iter().enumerate() {
        let curves: Vec<&Curve> = drawing.curves.iter().filter(|c| is_of(c.part)).collect();
        charts::circularity(&mut sheet, 40.0 + 452.0 * i as f64, title, &curves, drawing);
    }
    let legend = "circularity h = 4π area / perimeter² of each level set (Yu et al. 2008, eq. 5); dashed: joints";
    sheet.text(WIDTH - 40.0, HEIGHT - 12.0, legend, 11.0, DIM, Anchor::Right);
    charts::notes(&mut sheet, &notes, HEIGHT);
    sheet.finish()
}

/// Title of a chart, and which parts it shows.
type Chart = (&'static str, fn(BodyPart) -> bool);

const PARTS: [Chart; 3] = [
    ("Arms", |part| matches!(part, BodyPart::Arm(_))),
    ("Trunk", |part| matches!(part, BodyPart::Trunk)),
    ("Legs", |part| matches!(part, BodyPart::Leg(_))),
];

impl Drawing<'_> {
    /// Millimetres per unit of the mesh.
    fn mm(&self) -> f64 {
        self.unit.unwrap_or(Unit::Metre).mm()
    }
}

/// Colour of a part.
fn colour(part: BodyPart) -> &'static str {
    match part {
        BodyPart::Trunk => "#007a5e",
        BodyPart::Arm(Side::Left) => "#005a92",
        BodyPart::Arm(Side::Right) => "#4ba3dc",
        BodyPart::Leg(Side::Left) => "#c24e00",
        BodyPart::Leg(Side::Right) => "#dd9200",
    }
}

const INK: &str = "#282828";
const DIM: &str = "#6e6e6e";
const GRID: &str = "#e1e1e1";
const FONT: &str = "DejaVu Sans, Verdana, Helvetica, Arial, sans-serif";
/// Maximum number of characters of foreign text.
const TEXT_MAX: usize = 160;

/// Alignment of a text at its point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Anchor {
    Left,
    Middle,
    Right,
}

/// A document under construction. Coordinates have one decimal; elements with non-finite ones are dropped.
struct Sheet(String);

impl Sheet {
    fn new(width: f64, height: f64) -> Self {
        let mut sheet = Self(String::new());
        sheet.put(format_args!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"{FONT}\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
        ));
        sheet
    }

    fn finish(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }

    /// Writing to a `String` cannot fail.
    fn put(&mut self, what: std::fmt::Arguments<'_>) {
        self.0.write_fmt(what).ok();
    }

    /// Text, vertically centred at the point.
    fn text(&mut self, x: f64, y: f64, text: &str, size: f64, colour: &str, anchor: Anchor) {
        let value = match anchor {
            Anchor::Left => "start",
            Anchor::Middle => "middle",
            Anchor::Right => "end",
        };
        let baseline = y + 0.36 * size;
        self.put(format_args!(
            "<text x=\"{x:.1}\" y=\"{baseline:.1}\" font-size=\"{size}\" fill=\"{colour}\" text-anchor=\"{value}\">{}</text>\n",
            escaped(text)
        ));
    }

    /// Text that runs upwards along the left edge of a chart.
    fn vertical_text(&mut self, x: f64, y: f64, text: &str, size: f64) {
        self.put(format_args!(
            "<text transform=\"translate({x:.1} {y:.1}) rotate(-90)\" font-size=\"{size}\" fill=\"{DIM}\" text-anchor=\"middle\">{}</text>\n",
            escaped(text)
        ));
    }

    fn line(&mut self, from: [f64; 2], to: [f64; 2], style: &str) {
        self.path(&[vec![from, to]], false, style);
    }

    fn circle(&mut self, at: [f64; 2], radius: f64, style: &str) {
        if at.iter().all(|c| c.is_finite()) && radius.is_finite() {
            let [x, y] = at;
            self.put(format_args!(
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" {style}/>\n"
            ));
        }
    }

    /// Polylines as one element.
    fn path(&mut self, lines: &[Vec<[f64; 2]>], closed: bool, style: &str) {
        let finite = |line: &&Vec<[f64; 2]>| {
            line.len() > 1 && line.iter().all(|p| p.iter().all(|c| c.is_finite()))
        };
        let mut lines = lines.iter().filter(finite).peekable();
        if lines.peek().is_none() {
            return;
        }
        self.0.push_str("<path d=\"");
        for line in lines {
            for (i, [x, y]) in line.iter().enumerate() {
                let step = if i == 0 { 'M' } else { 'L' };
                self.put(format_args!("{step}{x:.1} {y:.1}"));
            }
            if closed {
                self.0.push('Z');
            }
        }
        self.put(format_args!("\" {style}/>\n"));
    }
}

/// Text escaped for XML, of bounded length.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars().take(TEXT_MAX) {
        match c {
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '&' => out.push_str("&amp;"),
            '"' => out.push_str("&quot;"),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

impl Drawing<'_> {
    /// Adds the level sets, the Reeb graph, and centre line and circularity of each segment. The joints must be set
    /// before: they determine which arm is which and are marked on the curves.
    pub fn trace(&mut self, Levels { rings, reeb, segments }: &Levels) {
        let mut parts = vec![(BodyPart::Trunk, &segments.trunk)];
        for (side, arm) in self.assign_sides(rings, &segments.arms, Joint::Wrist) {
            parts.push((BodyPart::Arm(side), arm));
        }
        for (side, leg) in self.assign_sides(rings, &segments.legs, Joint::Ankle) {
            parts.push((BodyPart::Leg(side), leg));
        }
        // Curves that belong to no segment, such as those of an ear, are part of the trunk.
        let mut part_of = vec![BodyPart::Trunk; rings.rings.len()];
        for (part, indices) in parts {
            for &index in indices {
                if let Some(of) = part_of.get_mut(index as usize) {
                    *of = part;
                }
            }
            let along: Vec<&Ring> =
                indices.iter().filter_map(|&index| rings.rings.get(index as usize)).collect();
            let points: Vec<[f64; 3]> = along.iter().map(|ring| ring.centroid).collect();
            self.curves.push(self.curve(part, &along, &points));
            self.centre_lines.push(Line { part, points });
        }
        for (ring, &part) in rings.rings.iter().zip(&part_of) {
            self.rings.push(Line { part, points: ring.points.clone() });
            let value = rings.values.get(ring.level as usize).copied().unwrap_or_default();
            self.reeb_nodes.push(ReebNode { position: ring.centroid, value });
        }
        self.reeb_edges.extend(reeb.arcs().map(|[from, to]| {
            // An arc has the colour of its outer end, so limbs begin at the trunk.
            let part = part_of.get(to as usize).copied().unwrap_or(BodyPart::Trunk);
            ReebEdge { from: from as usize, to: to as usize, part }
        }));
    }

    /// Assigns each limb the side whose last joint is nearer to its end.
    fn assign_sides<'a>(
        &self,
        rings: &Rings,
        limbs: &'a [Vec<u32>; 2],
        end: fn(Side) -> Joint,
    ) -> [(Side, &'a Vec<u32>); 2] {
        let far = |limb: &[u32], side: Side| {
            let joint = self.joints.estimates.get(&end(side))?;
            let ring = rings.rings.get(*limb.last()? as usize)?;
            Some(distance(ring.centroid, joint.position))
        };
        let [a, b] = limbs;
        let sum =
            |left: &[u32], right: &[u32]| Some(far(left, Side::Left)? + far(right, Side::Right)?);
        match (sum(a, b), sum(b, a)) {
            (Some(as_is), Some(crossed)) if crossed < as_is => [(Side::Left, b), (Side::Right, a)],
            _ => [(Side::Left, a), (Side::Right, b)],
        }
    }

    /// Circularity over the length of the centre line.
    fn curve(&self, part: BodyPart, along: &[&Ring], points: &[[f64; 3]]) -> Curve {
        let mut far = vec![0.0];
        for pair in points.windows(2) {
            far.push(far.last().copied().unwrap_or(0.0) + distance(pair[0], pair[1]));
        }
        let samples = far.iter().zip(along).map(|(far, ring)| [*far, ring.circularity()]).collect();
        let joints: Vec<Joint> = match part {
            BodyPart::Trunk => vec![Joint::Throat, Joint::Pelvis],
            BodyPart::Arm(side) => {
                vec![Joint::Shoulder(side), Joint::Elbow(side), Joint::Wrist(side)]
            }
            BodyPart::Leg(side) => vec![Joint::Hip(side), Joint::Knee(side), Joint::Ankle(side)],
        };
        let mark = |joint: Joint| {
            let at = self.joints.estimates.get(&joint)?.position;
            let far_off = |index: &usize| distance(points[*index], at);
            let nearest = (0..points.len()).min_by(|a, b| far_off(a).total_cmp(&far_off(b)))?;
            // A shoulder lies before the first curve of the arm alone, so it is on no curve.
            if beyond(points, nearest, at) {
                return None;
            }
            let name = joint_name(joint);
            let name = name.split_once('_').map_or(name, |(_, rest)| rest);
            Some(Mark { distance: *far.get(nearest)?, name: name.to_owned() })
        };
        Curve { part, samples, marks: joints.into_iter().filter_map(mark).collect() }
    }
}

/// Number of points that give the direction of a line at its end; fewer are not in line.
const DIRECTION: usize = 4;

/// Whether a point whose nearest line point is an end lies beyond that end.
fn beyond(line: &[[f64; 3]], nearest: usize, at: [f64; 3]) -> bool {
    let behind = |end: [f64; 3], inward: Option<&[f64; 3]>| {
        let from_end = |at: [f64; 3]| Point::from(at) - Point::from(end);
        inward.is_some_and(|inward| from_end(at).dot(&from_end(*inward)) < 0.0)
    };
    match (nearest, line) {
        (0, [first, ..]) => behind(*first, line.get(DIRECTION)),
        (index, [.., last]) if index + 1 == line.len() => {
            behind(*last, line.iter().rev().nth(DIRECTION))
        }
        _ => false,
    }
}
