//! The table of limb lengths, left beside right, and the notes at the foot of the page.

use super::sheet::{Anchor, DIM, GRID, INK, Sheet};
use super::{BodyPart, Drawing, colour};
use crate::mesh::distance;
use crate::skeleton::BONES;
use crate::{Joint, Side};

const LEFT: f64 = 1040.0;
const TOP: f64 = 476.0;
const ROW: f64 = 23.0;
/// Label of a row, with its bones.
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

pub(super) fn lengths(sheet: &mut Sheet, drawing: &Drawing<'_>) {
    let columns = [LEFT + 225.0, LEFT + 325.0];
    sheet.text(LEFT, TOP, "Lengths / mm", 13.0, INK, Anchor::Left);
    let heads = if drawing.joints.sides_told { ["left", "right"] } else { ["side A", "side B"] };
    for ((x, head), side) in columns.into_iter().zip(heads).zip(Side::BOTH) {
        sheet.text(x, TOP, head, 12.0, DIM, Anchor::Right);
        for (part, dx) in [(BodyPart::Arm(side), -60.0), (BodyPart::Leg(side), -52.0)] {
            let style = format!("fill=\"{}\"", colour(part));
            sheet.circle([x + dx, TOP], 3.5, &style);
        }
    }
    // Joints may be missing, and with them the lengths that need them.
    let rows = ROWS
        .into_iter()
        .map(|(label, left, right)| (label, [left, right].map(|bone| length(drawing, bone))));
    let rows = [("stature", [stature(drawing), None])].into_iter().chain(rows);
    let mut y = TOP + 8.0 + ROW;
    for (label, lengths) in rows.filter(|(_, lengths)| lengths.iter().any(Option::is_some)) {
        let top = y - ROW / 2.0;
        sheet.line([LEFT, top], [LEFT + 325.0, top], &format!("stroke=\"{GRID}\""));
        sheet.text(LEFT, y, label, 12.0, INK, Anchor::Left);
        for (x, text) in columns.into_iter().zip(lengths) {
            if let Some(text) = text {
                sheet.text(x, y, &text, 12.0, INK, Anchor::Right);
            }
        }
        y += ROW;
    }
    sheet.text(LEFT, y, "± one expected standard deviation", 11.0, DIM, Anchor::Left);
}

fn stature(drawing: &Drawing<'_>) -> Option<String> {
    let skeleton = drawing.skeleton?;
    Some(format!("{:.0}{}", skeleton.stature_mm?, plus_minus(skeleton.stature_uncertainty_mm)))
}

/// Standard deviation as text, if known.
fn plus_minus(sigma_mm: Option<f64>) -> String {
    sigma_mm.map_or_else(String::new, |mm| format!(" ± {mm:.0}"))
}

/// A length from the skeleton, or from the joints without one.
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
/// Most characters of a line; the page has room for more.
const LINE_MAX: usize = 150;
/// Most lines of notes; the skeleton has all of them.
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
