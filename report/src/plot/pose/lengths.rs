//! Below the moments: how long each limb is in the take, beside what the scan says.

use super::{Area, DIM, Drawn, INK, Pose, SMALL, Stand, VERMILION, WIDTH, WORDS, shortened, words};
use crate::{
    column::{distance, sample},
    limbs::Limb,
};

/// Limbs in a line, and the lines that have room.
const ACROSS: usize = 4;
const LINES_MAX: usize = 8;
const LINE: i32 = 22;
const HEAD: i32 = 34;

/// How much of the sheet so many limbs need.
pub(super) fn height(n_limbs: usize) -> i32 {
    match n_limbs.div_ceil(ACROSS).min(LINES_MAX) {
        0 => 0,
        n => HEAD + n as i32 * LINE + 14,
    }
}

pub(super) fn table(area: &Area<'_>, top: i32, wanted: &Pose<'_>) -> Drawn {
    if wanted.limbs.is_empty() {
        return Ok(());
    }
    let title = "limbs, median of the take / scan (mm); red: off by more than a tenth and than the scan's uncertainty";
    words(area, title, (24, top + 14), SMALL, DIM, Stand::Left)?;
    let cell = (WIDTH as i32 - 48) / ACROSS as i32;
    for (i, limb) in wanted.limbs.iter().take(ACROSS * LINES_MAX).enumerate() {
        let at = (24 + (i % ACROSS) as i32 * cell, top + HEAD + (i / ACROSS) as i32 * LINE);
        let bone = &limb.bone;
        let scan = format!("{:.0} ± {:.0}", bone.length_mm, bone.uncertainty_mm);
        let (length, colour) = match median_mm(limb, wanted) {
            Some(mm) => (format!("{mm:.0}"), if bone.is_off(mm) { VERMILION } else { INK }),
            None => ("not seen".to_owned(), DIM),
        };
        let line = format!("{}  {length} / {scan}", shortened(&bone.name, 22));
        words(area, &line, at, WORDS, colour, Stand::Left)?;
    }
    Ok(())
}

/// Over the whole take.
fn median_mm(limb: &Limb, wanted: &Pose<'_>) -> Option<f64> {
    let motion = &wanted.coded.motion;
    let length = |row: usize| {
        let ends = limb.ends.map(|end| motion.frame(row).get(end).copied().and_then(sample));
        Some(distance(ends[0]?, ends[1]?))
    };
    let mut all: Vec<f64> = (0..motion.n_frames()).filter_map(length).collect();
    let middle = all.len() / 2;
    if all.is_empty() {
        return None;
    }
    Some(*all.select_nth_unstable_by(middle, f64::total_cmp).1)
}
