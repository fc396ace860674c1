//! The Reeb graph: as deep as a level set is far from the head, and as far to the side as it is on the body.

use super::sheet::{DIM, GRID, INK, Sheet, Stand};
use super::view::{Upright, bounds};
use super::{Drawing, chart, colour};

/// Left, top, width, height of the chart.
const PLACE: [f64; 4] = [1080.0, 90.0, 285.0, 330.0];

pub(super) fn draw(sheet: &mut Sheet, drawing: &Drawing<'_>, upright: &Upright) {
    let [left, top, width, height] = PLACE;
    let mm = drawing.mm();
    sheet.text(
        left + width / 2.0,
        66.0,
        "Reeb graph of the distance from the head",
        13.0,
        DIM,
        Stand::Middle,
    );
    let deepest = drawing.reeb_nodes.iter().map(|node| node.value * mm).fold(0.0, f64::max);
    if !(deepest > 0.0 && deepest.is_finite()) {
        sheet.text(left + width / 2.0, top + height / 2.0, "none", 12.0, DIM, Stand::Middle);
        return;
    }
    let down = |value: f64| top + height * value / deepest;
    for tick in chart::ticks(0.0, deepest, 6) {
        let y = down(tick);
        sheet.line([left, y], [left + width, y], &format!("stroke=\"{GRID}\""));
        sheet.text(left - 6.0, y, &format!("{tick}"), 11.0, DIM, Stand::Right);
    }
    sheet.upward(left - 46.0, top + height / 2.0, "distance along the surface / mm", 12.0);
    let across = |p| upright.front(p)[0];
    let [low, high] = bounds(drawing.reeb_nodes.iter().map(|n| [across(n.position), 0.0, 0.0]));
    let room = (high[0] - low[0]).max(1e-9);
    let place = |index: usize| {
        let node = drawing.reeb_nodes.get(index)?;
        let x = left + 14.0 + (width - 28.0) * (across(node.position) - low[0]) / room;
        Some([x, down(node.value * mm)])
    };
    for &(from, to, part) in &drawing.reeb_edges {
        if let (Some(from), Some(to)) = (place(from), place(to)) {
            let style = format!(
                "stroke=\"{}\" stroke-width=\"2.5\" stroke-linecap=\"round\"",
                colour(part)
            );
            sheet.line(from, to, &style);
        }
    }
    let degree = |index: usize| {
        drawing.reeb_edges.iter().filter(|(a, b, _)| *a == index || *b == index).count()
    };
    // Only ends and branches: what lies between is a line.
    for index in (0..drawing.reeb_nodes.len()).filter(|&index| degree(index) != 2) {
        if let Some(at) = place(index) {
            sheet.circle(
                at,
                4.0,
                &format!("fill=\"#ffffff\" stroke=\"{INK}\" stroke-width=\"1.5\""),
            );
        }
    }
}
