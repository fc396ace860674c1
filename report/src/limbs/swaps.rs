//! Detection of swapped labels.
//!
//! A fast limb keeps its length; a limb at a marker with the wrong label does not, nor do the other limbs at the two
//! markers. Two labels count as swapped if a limb is outside its band, exchanging them brings every limb at either
//! marker into its band, and the two paths cross over at the first frame: each continues where the other was. No
//! exchange corrects a marker that slid, or a body that bends where the skeleton has no joint.

use std::ops::Range;

use super::{Pair, SubjectMotion};
use crate::column::distance;

/// Longest time that a swap may last without any limb leaving its band, s, at its beginning and its end: close markers
/// swap labels before lengths change.
const UNSEEN_S: f64 = 1.0;

/// Longest gap over which a path is followed, s.
const BRIDGED_S: f64 = 0.1;

/// Shortest swap whose crossing lies in a gap, s; shorter ones may be noise.
const GAP_SWAP_S: f64 = 0.1;
/// Shortest swap whose crossing lies in a gap, rows, for low frame rates.
const GAP_SWAP_ROWS: usize = 5;

/// Largest fraction of the limbs' strain that may remain with the labels exchanged.
const RESIDUAL_STRAIN_MAX: f64 = 0.25;

/// Maximum number of search passes; each finds swaps that overlap those of the passes before.
const PASSES_MAX: usize = 4;

/// Two swapped labels.
#[derive(Debug, Clone, PartialEq)]
pub struct Swap {
    /// The columns of the two markers, the smaller one first.
    pub markers: [usize; 2],
    /// The rows in which they are swapped.
    pub rows: Range<usize>,
    /// The limbs that the swap took out of their bands.
    pub limbs: Vec<usize>,
}

/// Finds all swaps, and undoes them in `body`.
pub(super) fn all(body: &mut SubjectMotion<'_>) -> Vec<Swap> {
    let mut all = Vec::new();
    for _ in 0..PASSES_MAX {
        let found = search_pass(body);
        if found.is_empty() {
            break;
        }
        for swap in &found {
            body.exchange(swap.markers, swap.rows.clone());
        }
        all.extend(found);
    }
    all
}

/// One pass: finds swaps that do not overlap.
fn search_pass(body: &SubjectMotion<'_>) -> Vec<Swap> {
    let mut found: Vec<Swap> = Vec::new();
    let mut row = 0;
    while row < body.n_rows() {
        let from = found.last().map_or(0, |swap| swap.rows.end);
        match at(body, row, from) {
            Some(swap) => {
                row = swap.rows.end.max(row + 1);
                found.push(swap);
            }
            None => row += 1,
        }
    }
    found
}

/// The swap that explains a limb outside its band at `row`, if there is one; it began at `from` or later.
fn at(body: &SubjectMotion<'_>, row: usize, from: usize) -> Option<Swap> {
    let is_bad = |limb: &usize| body.excess_mm(row, *limb, None).is_some_and(|mm| mm > 0.0);
    let bad: Vec<usize> = (0..body.limbs.len()).filter(is_bad).collect();
    let mut best: Option<(f64, Swap)> = None;
    for one in bad.iter().filter_map(|&limb| body.limbs.get(limb)).flat_map(|limb| limb.ends) {
        for &other in body.columns.iter().filter(|&&other| other != one) {
            let pair = [one.min(other), one.max(other)];
            let touched = body.limbs_at(pair);
            if !restores(body, row, &touched, pair) {
                continue;
            }
            let Some((gain, start)) = crossing(body, row, from, &touched, pair) else { continue };
            if best.as_ref().is_some_and(|(most, _)| *most >= gain) {
                continue;
            }
            let end = end_of(body, row, &touched, pair);
            // A swap whose crossings were not seen must last a while.
            let seen = gain > 0.0 || crosses(body, end, pair).is_some_and(|gain| gain > 0.0);
            if !seen && end - row < GAP_SWAP_ROWS.max(body.rows_in(GAP_SWAP_S)) {
                continue;
            }
            let limbs: Vec<usize> =
                touched.iter().filter(|limb| bad.contains(*limb)).copied().collect();
            best = Some((gain, Swap { markers: pair, rows: start..end, limbs }));
        }
    }
    best.map(|(_, swap)| swap)
}

/// Whether these limbs are outside their bands, and exchanging the labels of `pair` corrects them: it brings them into
/// their bands, and close to the middles, since two bones of similar length may be within both bands by chance.
fn restores(body: &SubjectMotion<'_>, row: usize, touched: &[usize], pair: Pair) -> bool {
    let [a, b] = pair;
    body.at(row, a).is_some()
        && body.at(row, b).is_some()
        && body.excess_of(row, touched, None).is_some_and(|mm| mm > 0.0)
        && body.excess_of(row, touched, Some(pair)) == Some(0.0)
        && body.strain(row, touched, Some(pair))
            <= RESIDUAL_STRAIN_MAX * body.strain(row, touched, None)
}

/// How much shorter the two paths from the previous frame to `row` are if the markers are exchanged, mm; `None` if one
/// of them is absent at `row` or shortly before.
fn crosses(body: &SubjectMotion<'_>, row: usize, [a, b]: Pair) -> Option<f64> {
    let (now_a, now_b) = (body.at(row, a)?, body.at(row, b)?);
    let before = (row.saturating_sub(body.rows_in(BRIDGED_S))..row)
        .rev()
        .find_map(|row| Some((body.at(row, a)?, body.at(row, b)?)));
    let (was_a, was_b) = before?;
    let straight = distance(now_a, was_a) + distance(now_b, was_b);
    Some(straight - distance(now_a, was_b) - distance(now_b, was_a))
}

/// The row where the two paths cross over, at `row` or earlier while all limbs are within their bands, and the gain in
/// path length, mm; the gain is 0 if the crossing lies in a gap or before the take. `None` if they do not cross: the
/// limb merely moved.
fn crossing(
    body: &SubjectMotion<'_>,
    row: usize,
    from: usize,
    touched: &[usize],
    pair: Pair,
) -> Option<(f64, usize)> {
    let first = row.saturating_sub(body.rows_in(UNSEEN_S)).max(from);
    let mut best: Option<(f64, usize)> = None;
    let mut at = row;
    loop {
        match crosses(body, at, pair) {
            Some(gain) if gain > best.map_or(0.0, |(most, _)| most) => best = Some((gain, at)),
            Some(_) => {}
            // One of them comes out of a gap, in which the labels may have been swapped.
            None if body.at(at, pair[0]).is_some() && body.at(at, pair[1]).is_some() => {
                return best.or(Some((0.0, at)));
            }
            None => {}
        }
        if at <= first {
            return best;
        }
        at -= 1;
        let shows = |pair| body.excess_of(at, touched, pair).is_some_and(|mm| mm > 0.0);
        if shows(None) || shows(Some(pair)) {
            return best;
        }
    }
}

/// The first row after `row` where the labels are correct again.
fn end_of(body: &SubjectMotion<'_>, row: usize, touched: &[usize], pair: Pair) -> usize {
    let unseen = body.rows_in(UNSEEN_S);
    let mut last = row;
    for at in row + 1..body.n_rows() {
        let shows = |pair| body.excess_of(at, touched, pair).map(|mm| mm > 0.0);
        match (shows(None), shows(Some(pair))) {
            // Still outside the band, and still corrected by the exchange.
            (Some(true), Some(false)) => {
                last = at;
                continue;
            }
            (Some(false), Some(true)) => return last + 1,
            (Some(false), _) if crosses(body, at, pair).is_some_and(|gain| gain > 0.0) => {
                return at;
            }
            _ => {}
        }
        if at - last > unseen {
            return last + 1;
        }
    }
    if body.n_rows() - last > 1 { last + 1 } else { body.n_rows() }
}
