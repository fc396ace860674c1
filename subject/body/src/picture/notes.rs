//! What whoever reads the picture should know, below everything: what was left out, and why.

use super::sheet::{INK, Sheet, Stand};

const LEFT: f64 = 40.0;
const STEP: f64 = 17.0;
/// Characters of a line; the sheet has room for more.
const LINE_MAX: usize = 150;
/// Lines of all notes; the skeleton has the rest.
const LINES_MAX: usize = 24;

/// The lines of all notes, each of which begins with a mark.
pub(super) fn lines(notes: &[String]) -> Vec<String> {
    let mut lines = Vec::new();
    for (i, note) in notes.iter().enumerate() {
        let note = broken(note);
        if lines.len() + note.len() >= LINES_MAX {
            lines.push(format!("• {} more notes stand in the skeleton", notes.len() - i));
            break;
        }
        lines.extend(note);
    }
    lines
}

/// A note in lines, broken between words, and within those that are longer than a line.
fn broken(note: &str) -> Vec<String> {
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

/// How much higher the picture is for them.
pub(super) fn height(lines: &[String]) -> f64 {
    if lines.is_empty() { 0.0 } else { STEP * (lines.len() as f64 + 2.0) }
}

pub(super) fn draw(sheet: &mut Sheet, lines: &[String], top: f64) {
    if lines.is_empty() {
        return;
    }
    let mut y = top + 0.8 * STEP;
    sheet.text(LEFT, y, "Notes", 13.0, INK, Stand::Left);
    for line in lines {
        y += STEP;
        // White space at the beginning is none to SVG.
        let x = if line.starts_with(' ') { LEFT + 11.0 } else { LEFT };
        sheet.text(x, y, line.trim_start(), 12.0, INK, Stand::Left);
    }
}
