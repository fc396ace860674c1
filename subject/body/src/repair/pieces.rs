//! The piece that is the body.

use super::connect::{NONE, pair_up};
use super::{RepairError, area, drop_unused};
use crate::{Mesh, Note};

/// Of the area of everything, in the largest piece: below, it is not known which one is the subject.
const SHARE_MIN: f64 = 0.6;

/// Keeps the piece with the largest area.
pub(super) fn largest(mesh: &mut Mesh, notes: &mut Vec<Note>) -> Result<(), RepairError> {
    let (across, _) = pair_up(mesh);
    let mut piece = vec![NONE; mesh.triangles.len()];
    let mut areas: Vec<f64> = Vec::new();
    let mut next = Vec::new();
    for first in 0..mesh.triangles.len() {
        if piece[first] != NONE {
            continue;
        }
        let index = areas.len() as u32;
        piece[first] = index;
        next.push(first);
        let mut whole = 0.0;
        while let Some(at) = next.pop() {
            whole += area(mesh, &mesh.triangles[at]);
            for &other in &across[3 * at..3 * at + 3] {
                if other != NONE && piece[other as usize / 3] == NONE {
                    piece[other as usize / 3] = index;
                    next.push(other as usize / 3);
                }
            }
        }
        areas.push(whole);
    }
    let all: f64 = areas.iter().sum();
    let best = areas.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
    let Some((best, &kept)) = best.filter(|_| all > 0.0) else {
        return Err(RepairError::NoSurface);
    };
    if areas.len() == 1 {
        return Ok(());
    }
    if kept < SHARE_MIN * all {
        return Err(RepairError::Pieces { pieces: areas.len(), share: 100.0 * kept / all });
    }
    areas.remove(best);
    let second = areas.iter().copied().fold(0.0, f64::max);
    let text = format!(
        "{} other pieces were left out: {:.2} % of the surface, the largest of them {:.2} %",
        areas.len(),
        100.0 * (all - kept) / all,
        100.0 * second / all
    );
    notes.push(Note::new("pieces-left-out", text));
    let mut of = piece.into_iter();
    mesh.triangles.retain(|_| of.next() == Some(best as u32));
    drop_unused(mesh);
    Ok(())
}
