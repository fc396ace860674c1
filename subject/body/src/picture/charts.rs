//! The parts of the page outside the views: charts of circularity along each part, the Reeb graph, the table of
//! left and right limb lengths, and the footnotes.

use super::views::{Upright, bounds};
use super::{Anchor, BodyPart, Curve, DIM, Drawing, GRID, INK, Mark, ReebEdge, Sheet, colour};
use crate::mesh::{Point, distance};
use crate::skeleton::BONES;
use crate::{Joint, Side};

const TOP: f64 = 830.0;
const WIDTH: f64 = 360.0;
const HEIGHT: f64 = 178.0;

/// Horizontal grid lines with their values.
fn grid(sheet: &mut Sheet, [left, width]: [f64; 2], values: Vec<f64>, height: impl Fn(f64) -> f64) {
    for value in values {
        let y = height(value);
        sheet.line([left, y], [left + width, y], &format!("stroke=\"{GRID}\""));
        sheet.text(left - 6.0, y, &format!("{value}"), 11.0, DIM, Anchor::Right);
    }
}

/// About `about` round numbers between two values.
fn ticks(low: f64, high: f64, about: usize) -> Vec<f64> {
    let raw = (high - low) / about.max(1) as f64;
    if !(raw > 0.0 && raw.is_finite()) {
        return Vec::new();
    }
    let decade = 10_f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|s| *s >= raw);
    let step = step.unwrap_or(raw);
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    // Rounded, so that 0.1 + 0.2 is 0.3.
    (first..=last).map(|i| (i as f64 * step * 1e6).round() / 1e6).collect()
}

pub(super) fn circularity(
    sheet: &mut Sheet,
    left: f64,
    title: &str,
    curves: &[&Curve],
    drawing: &Drawing<'_>,
) {
    let left = left + 46.0;
    let mm = drawing.mm();
    sheet.text(left, TOP - 20.0, title, 13.0, INK, Anchor::Left);
    let values = || curves.iter().flat_map(|curve| &curve.samples).filter(|s| s[1].is_finite());
    let longest = values().map(|s| s[0] * mm).fold(0.0, f64::max);
    let lowest = values().map(|s| s[1]).fold(1.0, f64::min);
    if !(longest > 0.0 && longest.is_finite()) {
        let style = format!("fill=\"none\" stroke=\"{GRID}\"");
        let (right, bottom) = (left + WIDTH, TOP + HEIGHT);
        let corners = vec![[left, TOP], [right, TOP], [right, bottom], [left, bottom]];
        sheet.path(&[corners], true, &style);
        sheet.text(left + WIDTH / 2.0, TOP + HEIGHT / 2.0, "no curve", 12.0, DIM, Anchor::Middle);
        return;
    }
    // The axis runs from a round number below the lowest value to 1, a circle.
    let bottom = ((lowest.max(0.0) - 0.02) * 10.0).floor().max(0.0) / 10.0;
    let at = |s: &[f64; 2]| {
        let x = left + WIDTH * s[0] * mm / longest;
        [x, TOP + HEIGHT * (1.0 - (s[1].clamp(bottom, 1.0) - bottom) / (1.0 - bottom))]
    };
    grid(sheet, [left, WIDTH], ticks(bottom, 1.0, 6), |value| at(&[0.0, value])[1]);
    for tick in ticks(0.0, longest, 6) {
        let x = left + WIDTH * tick / longest;
        let foot = TOP + HEIGHT;
        sheet.line([x, foot], [x, foot + 4.0], &format!("stroke=\"{DIM}\""));
        sheet.text(x, foot + 13.0, &format!("{tick}"), 11.0, DIM, Anchor::Middle);
    }
    sheet.vertical_text(left - 36.0, TOP + HEIGHT / 2.0, "circularity", 12.0);
    let label = "distance along the part / mm";
    sheet.text(left + WIDTH / 2.0, TOP + HEIGHT + 30.0, label, 12.0, DIM, Anchor::Middle);
    for (row, curve) in curves.iter().enumerate() {
        let colour = colour(curve.part);
        let line = curve.samples.iter().map(at).collect();
        let style = format!(
            "fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.6\" stroke-linejoin=\"round\""
        );
        sheet.path(&[line], false, &style);
        marks(sheet, curve, row, [left, longest / mm]);
        // A legend if there are two curves.
        if curves.len() > 1 {
            let x = left + WIDTH - 150.0 + 76.0 * row as f64;
            sheet.line([x, TOP - 20.0], [x + 18.0, TOP - 20.0], &style);
            let name = side_name(curve.part, drawing.joints.sides_told);
            sheet.text(x + 23.0, TOP - 20.0, name, 11.0, INK, Anchor::Left);
        }
    }
}

/// Average width of a letter.
const LETTER: f64 = 6.3;

/// Joint positions with names, above for the first curve, below for the second. A name that would overlap the previous
/// one is shifted.
fn marks(sheet: &mut Sheet, curve: &Curve, row: usize, [left, longest]: [f64; 2]) {
    let colour = colour(curve.part);
    let mut taken = f64::NEG_INFINITY;
    for Mark { distance, name } in curve.marks.iter().filter(|mark| mark.distance <= longest) {
        let x = left + WIDTH * distance / longest;
        let style = format!("stroke=\"{colour}\" stroke-width=\"1\" stroke-dasharray=\"4 3\"");
        sheet.line([x, TOP], [x, TOP + HEIGHT], &style);
        let y = if row == 0 { TOP - 6.0 } else { TOP + HEIGHT - 8.0 };
        let (x, anchor) = match x - left {
            _ if row > 0 && x < left + WIDTH - 40.0 => (x + 4.0, Anchor::Left),
            _ if row > 0 => (x - 4.0, Anchor::Right),
            // Keeps clear of the axis labels.
            dx if dx < 24.0 => (x, Anchor::Left),
            dx if dx > WIDTH - 24.0 => (x, Anchor::Right),
            _ => (x, Anchor::Middle),
        };
        let width = LETTER * name.chars().count() as f64;
        let begins = match anchor {
            Anchor::Left => x,
            Anchor::Middle => x - width / 2.0,
            Anchor::Right => x - width,
        };
        let begins = begins.max(taken);
        taken = begins + width + 4.0;
        sheet.text(begins, y, name, 11.0, colour, Anchor::Left);
    }
}

fn side_name(part: BodyPart, sides_known: bool) -> &'static str {
    match (part, sides_known) {
        (BodyPart::Trunk, _) => "trunk",
        (BodyPart::Arm(Side::Left) | BodyPart::Leg(Side::Left), true) => "left",
        (BodyPart::Arm(Side::Right) | BodyPart::Leg(Side::Right), true) => "right",
        (BodyPart::Arm(Side::Left) | BodyPart::Leg(Side::Left), false) => "side A",
        (BodyPart::Arm(Side::Right) | BodyPart::Leg(Side::Right), false) => "side B",
    }
}

/// Left, top, width and height of the Reeb graph.
const REEB_BOX: [f64; 4] = [1080.0, 90.0, 285.0, 330.0];

/// Draws the Reeb graph: a node's height shows the geodesic distance from the head, its horizontal position that of the
/// level set on the body.
pub(super) fn reeb(sheet: &mut Sheet, drawing: &Drawing<'_>, upright: &Upright) {
    let [left, top, width, height] = REEB_BOX;
    let mm = drawing.mm();
    let title = "Reeb graph of the distance from the head";
    sheet.text(left + width / 2.0, 66.0, title, 13.0, DIM, Anchor::Middle);
    let deepest = drawing.reeb_nodes.iter().map(|node| node.value * mm).fold(0.0, f64::max);
    if !(deepest > 0.0 && deepest.is_finite()) {
        sheet.text(left + width / 2.0, top + height / 2.0, "none", 12.0, DIM, Anchor::Middle);
        return;
    }
    let down = |value: f64| top + height * value / deepest;
    grid(sheet, [left, width], ticks(0.0, deepest, 6), down);
    sheet.vertical_text(left - 46.0, top + height / 2.0, "distance along the surface / mm", 12.0);
    let across = |at: [f64; 3]| upright.front(at.into()).x;
    let nodes = drawing.reeb_nodes.iter().map(|node| Point::new(across(node.position), 0.0, 0.0));
    let [low, high] = bounds(nodes);
    let span = (high[0] - low[0]).max(1e-9);
    let place = |index: usize| {
        let node = drawing.reeb_nodes.get(index)?;
        let x = left + 14.0 + (width - 28.0) * (across(node.position) - low[0]) / span;
        Some([x, down(node.value * mm)])
    };
    for &ReebEdge { from, to, part } in &drawing.reeb_edges {
        if let (Some(from), Some(to)) = (place(from), place(to)) {
            let tone = colour(part);
            let style = format!("stroke=\"{tone}\" stroke-width=\"2.5\" stroke-linecap=\"round\"");
            sheet.line(from, to, &style);
        }
    }
    let degree = |index: usize| {
        drawing.reeb_edges.iter().filter(|edge| edge.from == index || edge.to == index).count()
    };
    // Only ends and forks are drawn; nodes between them are points of a line.
    for index in (0..drawing.reeb_nodes.len()).filter(|&index| degree(index) != 2) {
        if let Some(at) = place(index) {
            let style = format!("fill=\"#ffffff\" stroke=\"{INK}\" stroke-width=\"1.5\"");
            sheet.circle(at, 4.0, &style);
        }
    }
}

const LENGTHS_LEFT: f64 = 1040.0;
const LENGTHS_TOP: f64 = 476.0;
const LENGTHS_ROW: f64 = 23.0;
/// Label of a row, with its bones.
const LENGTHS_ROWS: [(&str, &str, &str); 8] = [
    ("upper arm", "l_upper_arm", "r_upper_arm"),
    ("forearm", "l_forearm", "r_forearm"),
    ("thigh", "l_thigh", "r_thigh"),
    ("shank", "l_shank", "r_shank"),
    ("throat to shoulder", "throat_l_shoulder", "throat_r_shoulder"),
    ("pelvis to hip", "pelvis_l_hip", "pelvis_r_hip"),
    ("pelvis to throat", "throat_pelvis", ""),
    ("throat to crown", "head_throat", ""),
];

pub(super) fn lengths(sheet: &mut Sheet, drawing: &Drawing<'_>) {
    let columns = [LENGTHS_LEFT + 225.0, LENGTHS_LEFT + 325.0];
    sheet.text(LENGTHS_LEFT, LENGTHS_TOP, "Lengths / mm", 13.0, INK, Anchor::Left);
    let heads = if drawing.joints.sides_told { ["left", "right"] } else { ["side A", "side B"] };
    for ((x, head), side) in columns.into_iter().zip(heads).zip(Side::BOTH) {
        sheet.text(x, LENGTHS_TOP, head, 12.0, DIM, Anchor::Right);
        for (part, dx) in [(BodyPart::Arm(side), -60.0), (BodyPart::Leg(side), -52.0)] {
            let style = format!("fill=\"{}\"", colour(part));
            sheet.circle([x + dx, LENGTHS_TOP], 3.5, &style);
        }
    }
    // Lengths between missing joints are left out.
    let rows = LENGTHS_ROWS
        .into_iter()
        .map(|(label, left, right)| (label, [left, right].map(|bone| length(drawing, bone))));
    let rows = [("stature", [stature(drawing), None])].into_iter().chain(rows);
    let mut y = LENGTHS_TOP + 8.0 + LENGTHS_ROW;
    for (label, lengths) in rows.filter(|(_, lengths)| lengths.iter().any(Option::is_some)) {
        let top = y - LENGTHS_ROW / 2.0;
        sheet.line([LENGTHS_LEFT, top], [LENGTHS_LEFT + 325.0, top], &format!("stroke=\"{GRID}\""));
        sheet.text(LENGTHS_LEFT, y, label, 12.0, INK, Anchor::Left);
        for (x, text) in columns.into_iter().zip(lengths) {
            if let Some(text) = text {
                sheet.text(x, y, &text, 12.0, INK, Anchor::Right);
            }
        }
        y += LENGTHS_ROW;
    }
    sheet.text(LENGTHS_LEFT, y, "± one expected standard deviation", 11.0, DIM, Anchor::Left);
}

fn stature(drawing: &Drawing<'_>) -> Option<String> {
    let skeleton = drawing.skeleton?;
    Some(format!("{:.0}{}", skeleton.stature_mm?, plus_minus(skeleton.stature_uncertainty_mm)))
}

/// Standard deviation as text, if known.
fn plus_minus(sigma_mm: Option<f64>) -> String {
    sigma_mm.map_or_else(String::new, |mm| format!(" ± {mm:.0}"))
}

/// A length from the skeleton, or from the joints if there is no skeleton.
fn length(drawing: &Drawing<'_>, name: &str) -> Option<String> {
    if let Some(skeleton) = drawing.skeleton {
        let bone = skeleton.bones.iter().find(|bone| bone.name == name)?;
        return Some(format!("{:.0}{}", bone.length_mm, plus_minus(bone.uncertainty_mm)));
    }
    let ends = BONES.iter().find(|ends| ends.name == name)?;
    let at = |joint: Joint| drawing.joints.estimates.get(&joint);
    let (a, b) = (at(ends.parent)?, at(ends.child)?);
    let mm = drawing.mm();
    let length = distance(a.position, b.position) * mm;
    let sigma = a.sigma.hypot(b.sigma) / 3_f64.sqrt() * mm;
    Some(format!("{length:.0} ± {sigma:.0}"))
}

const NOTES_LEFT: f64 = 40.0;
const NOTES_STEP: f64 = 17.0;
/// Maximum number of characters of a line; the page has room for more.
const LINE_MAX: usize = 150;
/// Maximum number of lines of notes; the skeleton has all of them.
const LINES_MAX: usize = 24;

/// The lines of all notes, each note beginning with a bullet.
pub(super) fn note_lines(notes: &[String]) -> Vec<String> {
    let mut lines = Vec::new();
    for (i, note) in notes.iter().enumerate() {
        let note = wrapped(note);
        if lines.len() + note.len() >= LINES_MAX {
            lines.push(format!("• {} more notes in the skeleton", notes.len() - i));
            break;
        }
        lines.extend(note);
    }
    lines
}

/// Wraps a note between words, and within words longer than a line.
fn wrapped(note: &str) -> Vec<String> {
    let mut lines = Vec::new();
    let mut line = "•".to_owned();
    let mut length = 1;
    for word in note.split_whitespace() {
        let characters: Vec<char> = word.chars().collect();
        for piece in characters.chunks(LINE_MAX / 2) {
            if length + 1 + piece.len() > LINE_MAX {
                lines.push(std::mem::replace(&mut line, " ".to_owned()));
                length = 1;
            }
            line.push(' ');
            line.extend(piece);
            length += 1 + piece.len();
        }
    }
    lines.push(line);
    lines
}

/// Additional height of the picture.
pub(super) fn notes_height(lines: &[String]) -> f64 {
    if lines.is_empty() { 0.0 } else { NOTES_STEP * (lines.len() as f64 + 2.0) }
}

pub(super) fn notes(sheet: &mut Sheet, lines: &[String], top: f64) {
    if lines.is_empty() {
        return;
    }
    let mut y = top + 0.8 * NOTES_STEP;
    sheet.text(NOTES_LEFT, y, "Notes", 13.0, INK, Anchor::Left);
    for line in lines {
        y += NOTES_STEP;
        // SVG ignores leading white space.
        let x = if line.starts_with(' ') { NOTES_LEFT + 11.0 } else { NOTES_LEFT };
        sheet.text(x, y, line.trim_start(), 12.0, INK, Anchor::Left);
    }
}
