//! Lengths of the limbs, left and right beside each other.

use super::sheet::{DIM, GRID, INK, Sheet, Stand};
use super::{Drawing, Part, colour};
use crate::geometry::distance;
use crate::skeleton::BONES;
use crate::{Joint, Side};

const LEFT: f64 = 1040.0;
const TOP: f64 = 476.0;
const ROW: f64 = 23.0;
/// Words of a row, with its bones.
const ROWS: [(&str, &str, &str); 8] = [
    ("upper arm", "l_upper_arm", "r_upper_arm"),
    ("forearm", "l_forearm", "r_forearm"),
    ("thigh", "l_thigh", "r_thigh"),
    ("shank", "l_shank", "r_shank"),
    ("throat to shoulder", "throat_l_shoulder", "throat_r_shoulder"),
    ("pelvis to hip", "pelvis_l_hip", "pelvis_r_hip"),
    ("pelvis to throat", "throat_pelvis", ""),
    ("throat to crown", "head_throat", ""),
];

pub(super) fn draw(sheet: &mut Sheet, drawing: &Drawing<'_>) {
    let columns = [LEFT + 225.0, LEFT + 325.0];
    sheet.text(LEFT, TOP, "Lengths / mm", 13.0, INK, Stand::Left);
    let heads = if drawing.joints.sides_told { ["left", "right"] } else { ["side A", "side B"] };
    for ((x, head), side) in columns.into_iter().zip(heads).zip([Side::Left, Side::Right]) {
        sheet.text(x, TOP, head, 12.0, DIM, Stand::Right);
        for (part, dx) in [(Part::Arm(side), -60.0), (Part::Leg(side), -52.0)] {
            let style = format!("fill=\"{}\"", colour(part));
            sheet.circle([x + dx, TOP], 3.5, &style);
        }
    }
    // Joints may have been left out, and what hangs on them with them.
    let rows = ROWS
        .into_iter()
        .map(|(words, left, right)| (words, [left, right].map(|bone| length(drawing, bone))));
    let rows = [("stature", [stature(drawing), None])].into_iter().chain(rows);
    let mut y = TOP + 8.0 + ROW;
    for (words, lengths) in rows.filter(|(_, lengths)| lengths.iter().any(Option::is_some)) {
        sheet.line(
            [LEFT, y - ROW / 2.0],
            [LEFT + 325.0, y - ROW / 2.0],
            &format!("stroke=\"{GRID}\""),
        );
        sheet.text(LEFT, y, words, 12.0, INK, Stand::Left);
        for (x, text) in columns.into_iter().zip(lengths) {
            if let Some(text) = text {
                sheet.text(x, y, &text, 12.0, INK, Stand::Right);
            }
        }
        y += ROW;
    }
    sheet.text(LEFT, y, "± one standard deviation that is expected", 11.0, DIM, Stand::Left);
}

fn stature(drawing: &Drawing<'_>) -> Option<String> {
    let skeleton = drawing.skeleton?;
    let sigma =
        skeleton.stature_uncertainty_mm.map_or_else(String::new, |mm| format!(" ± {mm:.0}"));
    Some(format!("{:.0}{sigma}", skeleton.stature_mm?))
}

/// From the skeleton, and from the joints where there is none.
fn length(drawing: &Drawing<'_>, name: &str) -> Option<String> {
    if let Some(skeleton) = drawing.skeleton {
        let bone = skeleton.bones.iter().find(|bone| bone.name == name)?;
        return Some(format!("{:.0} ± {:.0}", bone.length_mm, bone.uncertainty_mm));
    }
    let &(_, parent, child) = BONES.iter().find(|(other, ..)| *other == name)?;
    let at = |joint: Joint| drawing.joints.estimates.get(&joint);
    let (a, b) = (at(parent)?, at(child)?);
    let mm = drawing.mm();
    let length = distance(a.position, b.position) * mm;
    let sigma = a.sigma.hypot(b.sigma) / 3_f64.sqrt() * mm;
    Some(format!("{length:.0} ± {sigma:.0}"))
}
