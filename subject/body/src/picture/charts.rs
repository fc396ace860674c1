//! Charts of circularity along each part, and the Reeb graph.

use super::sheet::{Anchor, DIM, GRID, INK, Sheet};
use super::views::{Upright, bounds};
use super::{BodyPart, Curve, Drawing, Mark, ReebEdge, colour};
use crate::Side;
use crate::mesh::Point;

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
/// one moves beside it.
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

/// Nodes are as low as their level set is far from the head, and as far aside as it is on the body.
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
