//! SVG report of a scan: front and side view with level sets, centre lines and joints; the Reeb graph; lengths; and the
//! circularity along the limbs, as in figure 7 of Yu et al. 2008.
//!
//! The colours of Okabe and Ito 2008 are distinct for all kinds of colour vision; the two sides differ in lightness
//! too.

mod charts;
mod shade;
mod sheet;
mod trace;
mod views;

use self::sheet::{Anchor, DIM, Sheet};
use self::views::Upright;
use super::skeleton::Skeleton;
use super::{Joints, Mesh, Side, Unit};

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
    sheet.text(40.0, 38.0, drawing.title, 20.0, sheet::INK, Anchor::Left);
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
