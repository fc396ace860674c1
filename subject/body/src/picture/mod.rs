//! A picture of what was found in a scan, as SVG: front and side of the body with level sets, centre lines and joints; the
//! Reeb graph; lengths; and the circularity along the limbs, as figure 7 of Yu et al. 2008 has it.
//!
//! Colours are those of Okabe and Ito 2008, which people with any kind of colour vision tell apart; sides differ in
//! lightness, too.

mod charts;
mod shade;
mod sheet;
mod tables;
mod trace;
mod views;

use self::sheet::{Anchor, DIM, Sheet};
use self::views::Upright;
use super::skeleton::Skeleton;
use super::{Joints, Mesh, Side, Unit};

/// A part of the body that has level sets of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum BodyPart {
    /// With head and neck.
    Trunk,
    /// From the armpit to the fingers.
    Arm(Side),
    /// From the crotch to the toes.
    Leg(Side),
}

/// Points in a row, in the mesh's frame and unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Of which part.
    pub part: BodyPart,
    /// In order; a ring does not repeat its first.
    pub points: Vec<[f64; 3]>,
}

/// A node of the Reeb graph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReebNode {
    /// Centre of its level set, in the mesh's frame and unit.
    pub position: [f64; 3],
    /// Value of the Morse function: the distance from the head along the surface, in the mesh's unit.
    pub value: f64,
}

/// An edge of the Reeb graph, between nodes by their indices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReebEdge {
    /// The node nearer to the head.
    pub from: usize,
    /// The other.
    pub to: usize,
    /// Of which part.
    pub part: BodyPart,
}

/// Circularity along a part.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Of which part.
    pub part: BodyPart,
    /// Distance along the part in the mesh's unit, and circularity (Yu et al. 2008, eq. 5): 1 is a circle.
    pub samples: Vec<[f64; 2]>,
    /// Where joints are.
    pub marks: Vec<Mark>,
}

/// A joint on a curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Mark {
    /// Along the part, in the mesh's unit.
    pub distance: f64,
    /// The joint's.
    pub name: String,
}

/// What is drawn. All but the mesh may be empty: what a method does not have is left out.
#[derive(Debug, Clone, Default)]
pub struct Drawing<'a> {
    /// Above everything: the scan's name, the method.
    pub title: &'a str,
    /// The surface.
    pub mesh: Option<&'a Mesh>,
    /// Its unit; metres if none.
    pub unit: Option<Unit>,
    /// Level sets.
    pub rings: Vec<Line>,
    /// Centres of the level sets of each part.
    pub centre_lines: Vec<Line>,
    /// Nodes of the Reeb graph.
    pub reeb_nodes: Vec<ReebNode>,
    /// Its edges.
    pub reeb_edges: Vec<ReebEdge>,
    /// In the mesh's frame and unit.
    pub joints: Joints,
    /// Lengths, stature and notes are taken from it, where there is one.
    pub skeleton: Option<&'a Skeleton>,
    /// Circularity along arms, trunk and legs.
    pub curves: Vec<Curve>,
}

/// Size of the picture.
const WIDTH: f64 = 1400.0;
const HEIGHT: f64 = 1080.0;

/// Draws it: a whole document, 1400 by 1080 units, and higher where there are notes.
#[must_use]
pub fn svg(drawing: &Drawing<'_>) -> String {
    let notes =
        drawing.skeleton.map_or_else(Vec::new, |skeleton| tables::note_lines(&skeleton.notes));
    let mut sheet = Sheet::new(WIDTH, HEIGHT + tables::notes_height(&notes));
    sheet.text(40.0, 38.0, drawing.title, 20.0, sheet::INK, Anchor::Left);
    let upright = Upright::of(drawing);
    views::draw(&mut sheet, drawing, &upright);
    charts::reeb(&mut sheet, drawing, &upright);
    tables::lengths(&mut sheet, drawing);
    for (i, (title, is_of)) in PARTS.into_iter().enumerate() {
        let curves: Vec<&Curve> = drawing.curves.iter().filter(|c| is_of(c.part)).collect();
        charts::circularity(&mut sheet, 40.0 + 452.0 * i as f64, title, &curves, drawing);
    }
    let legend = "circularity h = 4π area / perimeter² of each level set (Yu et al. 2008, eq. 5); dashed: joints";
    sheet.text(WIDTH - 40.0, HEIGHT - 12.0, legend, 11.0, DIM, Anchor::Right);
    tables::notes(&mut sheet, &notes, HEIGHT);
    sheet.finish()
}

/// A chart, and which parts it is of.
type Chart = (&'static str, fn(BodyPart) -> bool);

const PARTS: [Chart; 3] = [
    ("Arms", |part| matches!(part, BodyPart::Arm(_))),
    ("Trunk", |part| matches!(part, BodyPart::Trunk)),
    ("Legs", |part| matches!(part, BodyPart::Leg(_))),
];

impl Drawing<'_> {
    /// Millimetres in the mesh's unit.
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
