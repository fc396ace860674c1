//! Labels that changed places, told from fast moves.
//!
//! A limb that moves fast keeps its length; one whose end got another marker's label does not, and neither do the other
//! limbs at these two markers. So two labels are said to have changed places where a limb is out of its band, giving
//! them back brings every limb at either marker into its own, and the two paths cross over at the first frame: each
//! goes on where the other was. A marker that merely slid, or a body that bends in a way that its bones do not know, is
//! mended by no exchange.

use std::ops::Range;

use super::lengths::{Body, Pair};
use crate::column::distance;

/// Two markers that come close change labels before anything shows: so far back the crossing is looked for, s. So long
/// a swap that shows no more may still last, too.
const UNSEEN_S: f64 = 1.0;

/// Over gaps so long paths are followed, s.
const BRIDGED_S: f64 = 0.1;

/// A swap whose crossing lies in a gap counts when it lasts so long, s and frames: shorter ones may be noise.
const GAP_SWAP_S: f64 = 0.1;
const GAP_SWAP_ROWS: usize = 5;

/// What is left of the limbs' strain when labels that changed places are given back: no more than this part.
const MENDED_PART: f64 = 0.25;

/// Swaps that lie over each other are found one after another; no more than this.
const LAYERS_MAX: usize = 4;

/// Two labels that changed places.
#[derive(Debug, Clone, PartialEq)]
pub struct Swap {
    /// The columns of the two markers, the smaller one first.
    pub markers: [usize; 2],
    /// From its first frame to behind its last.
    pub rows: Range<usize>,
    /// The limbs that were out of their bands for it.
    pub limbs: Vec<usize>,
}

/// Finds them all, and gives the labels back in `body`.
pub(super) fn all(body: &mut Body<'_>) -> Vec<Swap> {
    let mut all = Vec::new();
    for _ in 0..LAYERS_MAX {
        let found = layer(body);
        if found.is_empty() {
            break;
        }
        for swap in &found {
            body.undo(swap.markers, swap.rows.clone());
        }
        all.extend(found);
    }
    all
}

/// Swaps of which none lies over another.
fn layer(body: &Body<'_>) -> Vec<Swap> {
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

/// The swap that a limb out of its band tells of at `row`; it began at `from` or later.
fn at(body: &Body<'_>, row: usize, from: usize) -> Option<Swap> {
    let is_bad = |limb: &usize| body.excess_mm(row, *limb, None).is_some_and(|mm| mm > 0.0);
    let bad: Vec<usize> = (0..body.limbs.len()).filter(is_bad).collect();
    let mut best: Option<(f64, Swap)> = None;
    for one in bad.iter().filter_map(|&limb| body.limbs.get(limb)).flat_map(|limb| limb.ends) {
        for &other in body.columns.iter().filter(|&&other| other != one) {
            let pair = [one.min(other), one.max(other)];
            let touched = body.touched(pair);
            if !mends(body, row, &touched, pair) {
                continue;
            }
            let Some((gain, start)) = crossing(body, row, from, &touched, pair) else { continue };
            if best.as_ref().is_some_and(|(most, _)| *most >= gain) {
                continue;
            }
            let end = end_of(body, row, &touched, pair);
            // Nobody saw it begin: then it is to last.
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

/// Whether these limbs are out of their bands as they are, and are themselves with the labels given back: not merely
/// within their bands, which two bones of like length may be by chance.
fn mends(body: &Body<'_>, row: usize, touched: &[usize], pair: Pair) -> bool {
    let [a, b] = pair;
    body.at(row, a).is_some()
        && body.at(row, b).is_some()
        && body.excess_of(row, touched, None).is_some_and(|mm| mm > 0.0)
        && body.excess_of(row, touched, Some(pair)) == Some(0.0)
        && body.strain(row, touched, Some(pair)) <= MENDED_PART * body.strain(row, touched, None)
}

/// By how much it is shorter, from the frame before to `row`, that each marker goes to where the other is than to where
/// itself is, mm; `None` where one was not seen shortly before.
fn crosses(body: &Body<'_>, row: usize, [a, b]: Pair) -> Option<f64> {
    let (now_a, now_b) = (body.at(row, a)?, body.at(row, b)?);
    let before = (row.saturating_sub(body.rows_in(BRIDGED_S))..row)
        .rev()
        .find_map(|row| Some((body.at(row, a)?, body.at(row, b)?)));
    let (was_a, was_b) = before?;
    let straight = distance(now_a, was_a) + distance(now_b, was_b);
    Some(straight - distance(now_a, was_b) - distance(now_b, was_a))
}

/// Where the two paths cross over, at `row` or before it as long as nothing shows, and by how much; 0 where that was in
/// a gap or before the take. `None`: they do not cross, and this is a move.
fn crossing(
    body: &Body<'_>,
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
            // One of them comes out of a gap: here it may have got the other's label.
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

/// The first row behind `row` that has the labels right again.
fn end_of(body: &Body<'_>, row: usize, touched: &[usize], pair: Pair) -> usize {
    let unseen = body.rows_in(UNSEEN_S);
    let mut last = row;
    for at in row + 1..body.n_rows() {
        let shows = |pair| body.excess_of(at, touched, pair).map(|mm| mm > 0.0);
        match (shows(None), shows(Some(pair))) {
            // Still out of its band, and still mended.
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
