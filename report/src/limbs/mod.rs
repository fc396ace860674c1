//! Limb lengths between markers, compared with those of a body scan.
//!
//! The length of a limb is constant however fast it moves, so a changing length reveals swapped labels or a marker that slid.
//!
//! A fast limb keeps its length; a limb at a marker with the wrong label does not, nor do the other limbs at the two
//! markers. Two labels count as swapped if a limb is outside its band, exchanging them brings every limb at either
//! marker into its band, and the two paths cross over at the first frame: each continues where the other was. No
//! exchange corrects a marker that slid, or a body that bends where the skeleton has no joint.

#[cfg(test)]
mod tests;

use std::{collections::HashMap, ops::Range};

use mocapd_body::skeleton::Bone;
use mocapd_take::motion::{Motion, Position};

use crate::{
    column::{Vector, distance, median, runs, sample},
    labels::{SubjectMarkers, subjects},
};

/// Smallest deviation from the scan's length that is reported, as a fraction of it: markers are on the skin, not at the
/// joint centres.
pub const OFF_FRACTION: f64 = 0.1;

/// A bone with a marker at each of its joints.
#[derive(Debug, Clone, PartialEq)]
pub struct Limb {
    /// The bone.
    pub bone: Bone,
    /// The columns of the markers at its parent and child joints.
    pub ends: [usize; 2],
}

impl Limb {
    /// Whether a length deviates from the scan's by more than [`off_mm`](Self::off_mm).
    #[must_use]
    pub fn is_off(&self, length_mm: f64) -> bool {
        (length_mm - self.bone.length_mm).abs() > self.off_mm()
    }

    /// The tolerated deviation from the scan's length, mm: its uncertainty, but at least [`OFF_FRACTION`] of the
    /// length.
    #[must_use]
    pub fn off_mm(&self) -> f64 {
        self.bone.uncertainty_mm.unwrap_or_default().max(OFF_FRACTION * self.bone.length_mm)
    }
}

/// The limbs of a subject, and the columns of all of its markers.
///
/// If labels name several subjects (`Ann:LKNE`), the one called `name` is taken, else the one with most limbs.
#[must_use]
pub fn limbs<L: AsRef<str>>(bones: &[Bone], labels: &[L], name: &str) -> (Vec<Limb>, Vec<usize>) {
    let mut best = (Vec::new(), Vec::new());
    for subject in subjects(labels.iter().map(AsRef::as_ref)) {
        let joints = subject.joints();
        let found = of_joints(bones, &joints);
        let is_named = !name.is_empty() && subject.name.eq_ignore_ascii_case(name);
        if is_named && !found.is_empty() {
            return (found, columns(&subject));
        }
        if found.len() > best.0.len() {
            best = (found, columns(&subject));
        }
    }
    best
}

fn of_joints(bones: &[Bone], joints: &HashMap<String, usize>) -> Vec<Limb> {
    let limb = |bone: &Bone| {
        let ends = [*joints.get(&bone.parent)?, *joints.get(&bone.child)?];
        (ends[0] != ends[1]).then(|| Limb { bone: bone.clone(), ends })
    };
    bones.iter().filter_map(limb).collect()
}

fn columns(subject: &SubjectMarkers<'_>) -> Vec<usize> {
    let mut columns: Vec<usize> = subject.sites.values().copied().collect();
    columns.sort_unstable();
    columns
}

/// The result of a check of limb lengths.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LimbCheck {
    /// The statistics of each limb.
    pub lengths: Vec<LimbStats>,
    /// Swapped labels, in the order of their first frames.
    pub swaps: Vec<Swap>,
    /// Where a limb leaves its band for another reason than a swap.
    pub outside: Vec<Excursion>,
}

/// Measures the limbs of a take, and searches for swapped labels among the markers in `columns`.
#[must_use]
pub fn check(motion: &Motion, limbs: &[Limb], columns: &[usize]) -> LimbCheck {
    let mut body = SubjectMotion::new(motion, limbs, columns);
    let lengths: Vec<LimbStats> = (0..limbs.len()).map(|limb| stats_of(&body, limb)).collect();
    body.set_bands(&lengths);
    let mut found = all(&mut body);
    found.sort_by_key(|swap| (swap.rows.start, swap.markers));
    // Measured with the swaps undone.
    let outside = excursions(&body);
    LimbCheck { lengths, swaps: found, outside }
}

/// Half-width of a limb's band as a fraction of its length; it is at least [`BAND_MIN_MM`] and at least
/// [`BAND_SPREADS`] times the limb's spread.
const BAND_FRACTION: f64 = 0.10;
/// Smallest half-width of a band, mm: markers slide this far on the skin.
const BAND_MIN_MM: f64 = 20.0;
/// Smallest half-width of a band in standard deviations: of normally distributed lengths 6 in 100 000 lie outside.
const BAND_SPREADS: f64 = 4.0;

/// Largest distance of a length from the scan's, as a fraction of it, for its frame to determine the middle of the
/// band. With markers at the joints all lengths are within it, and labels exchanged for most of a take do not define
/// the band.
const NEAR_SCAN_FRACTION: f64 = 0.25;
/// The smallest fraction of such frames that determines the middle; with fewer, all frames determine it.
const NEAR_SCAN_FRAMES_FRACTION: f64 = 0.1;

/// Ratio of the standard deviation to the median absolute deviation (MAD) of a normal distribution.
const MAD_TO_SIGMA: f64 = 1.4826;

/// Excursions closer together than this are reported as one, s.
const NEAR_S: f64 = 0.1;

/// Statistics of the length of a limb over a take.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LimbStats {
    /// Frames in which both of its markers are present.
    pub frames: u64,
    /// The median length, mm; 0 without frames.
    pub median_mm: f64,
    /// A robust standard deviation: 1.4826 times the median absolute deviation, mm.
    pub spread_mm: f64,
    /// The middle of the band of plausible lengths, mm.
    pub band_middle_mm: f64,
    /// The half-width of the band, mm.
    pub band_half_mm: f64,
    /// Frames in which the length is outside the band.
    pub frames_outside: u64,
}

/// A range of frames in which a limb is outside its band.
#[derive(Debug, Clone, PartialEq)]
pub struct Excursion {
    /// Index of the limb.
    pub limb: usize,
    /// The rows of these frames.
    pub rows: Range<usize>,
    /// The length farthest from the band, mm.
    pub extreme_mm: f64,
}

/// A robust standard deviation about a given middle.
fn spread(values: &[f64], about: f64) -> f64 {
    let mut off: Vec<f64> = values.iter().map(|value| (value - about).abs()).collect();
    MAD_TO_SIGMA * median(&mut off).unwrap_or_default()
}

/// The statistics of a limb over the take.
fn stats_of(body: &SubjectMotion<'_>, limb: usize) -> LimbStats {
    let mut all: Vec<f64> =
        (0..body.n_rows()).filter_map(|row| body.length_mm(row, limb)).collect();
    let Some(median_mm) = median(&mut all) else { return LimbStats::default() };
    let scan_mm = body.limbs.get(limb).map_or(median_mm, |limb| limb.bone.length_mm);
    let is_like_scan = |length: &&f64| (**length - scan_mm).abs() <= NEAR_SCAN_FRACTION * scan_mm;
    let mut like_scan: Vec<f64> = all.iter().filter(is_like_scan).copied().collect();
    let is_enough = like_scan.len() as f64 >= NEAR_SCAN_FRAMES_FRACTION * all.len() as f64;
    let of_band = if is_enough { &mut like_scan } else { &mut all };
    let band_middle_mm = median(of_band).unwrap_or(median_mm);
    let band_half_mm = (BAND_FRACTION * band_middle_mm)
        .max(BAND_MIN_MM)
        .max(BAND_SPREADS * spread(of_band, band_middle_mm));
    let is_outside = |length: &&f64| (**length - band_middle_mm).abs() > band_half_mm;
    LimbStats {
        frames: all.len() as u64,
        median_mm,
        spread_mm: spread(&all, median_mm),
        band_middle_mm,
        band_half_mm,
        frames_outside: all.iter().filter(is_outside).count() as u64,
    }
}

/// The ranges in which limbs are outside their bands, in the order of the frames.
fn excursions(body: &SubjectMotion<'_>) -> Vec<Excursion> {
    let mut found: Vec<Excursion> = Vec::new();
    let near = body.rows_in(NEAR_S);
    for limb in 0..body.limbs.len() {
        let excess = |row: usize| body.excess_mm(row, limb, None).unwrap_or_default();
        for rows in merge_near(runs((0..body.n_rows()).map(|row| excess(row) > 0.0)), near) {
            let worst = rows.clone().max_by(|&a, &b| excess(a).total_cmp(&excess(b)));
            let extreme_mm = worst.and_then(|row| body.length_mm(row, limb)).unwrap_or_default();
            found.push(Excursion { limb, rows, extreme_mm });
        }
    }
    found.sort_by_key(|outside| (outside.rows.start, outside.limb));
    found
}

/// Merges runs that are at most `near` rows apart.
fn merge_near(runs: impl Iterator<Item = Range<usize>>, near: usize) -> Vec<Range<usize>> {
    let mut all: Vec<Range<usize>> = Vec::new();
    for run in runs {
        match all.last_mut() {
            Some(last) if run.start - last.end <= near => last.end = run.end,
            _ => all.push(run),
        }
    }
    all
}

/// The range of plausible lengths of a limb.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Band {
    middle_mm: f64,
    half_mm: f64,
}

/// The markers of one subject over a take, with its limbs and their bands; labels can be exchanged.
#[derive(Debug)]
struct SubjectMotion<'a> {
    positions_mm: Vec<Position>,
    n_markers: usize,
    rate_hz: f64,
    limbs: &'a [Limb],
    columns: &'a [usize],
    bands: Vec<Band>,
}

/// The columns of two markers whose labels may be exchanged.
type Pair = [usize; 2];

impl<'a> SubjectMotion<'a> {
    fn new(motion: &Motion, limbs: &'a [Limb], columns: &'a [usize]) -> Self {
        let n_markers = motion.info.markers.len();
        Self {
            positions_mm: motion.positions_mm.clone(),
            n_markers,
            rate_hz: motion.info.rate_hz,
            limbs,
            columns,
            bands: vec![Band::default(); limbs.len()],
        }
    }

    fn set_bands(&mut self, lengths: &[LimbStats]) {
        let band = |of: &LimbStats| Band { middle_mm: of.band_middle_mm, half_mm: of.band_half_mm };
        self.bands = lengths.iter().map(band).collect();
    }

    fn n_rows(&self) -> usize {
        self.positions_mm.len() / self.n_markers.max(1)
    }

    /// The number of rows in a time, at least one.
    fn rows_in(&self, seconds: f64) -> usize {
        ((seconds * self.rate_hz) as usize).max(1)
    }

    /// The position of a marker; `None` in a gap.
    fn at(&self, row: usize, column: usize) -> Option<Vector> {
        if column >= self.n_markers {
            return None;
        }
        sample(*self.positions_mm.get(row * self.n_markers + column)?)
    }

    /// The length of a limb, mm, with the labels of `pair` exchanged.
    fn length_of(&self, row: usize, limb: usize, pair: Option<Pair>) -> Option<f64> {
        let ends = self.limbs.get(limb)?.ends.map(|end| match pair {
            Some([a, b]) if end == a => b,
            Some([a, b]) if end == b => a,
            _ => end,
        });
        Some(distance(self.at(row, ends[0])?, self.at(row, ends[1])?))
    }

    fn length_mm(&self, row: usize, limb: usize) -> Option<f64> {
        self.length_of(row, limb, None)
    }

    /// The distance of a limb's length from its band, mm; 0 within it.
    fn excess_mm(&self, row: usize, limb: usize, pair: Option<Pair>) -> Option<f64> {
        let band = self.bands.get(limb)?;
        let length_mm = self.length_of(row, limb, pair)?;
        Some(((length_mm - band.middle_mm).abs() - band.half_mm).max(0.0))
    }

    /// The limbs with an end at one of the two markers.
    fn limbs_at(&self, pair: Pair) -> Vec<usize> {
        let ends = |limb: &Limb| pair.iter().any(|column| limb.ends.contains(column));
        let limbs = self.limbs.iter().enumerate().filter(|(_, limb)| ends(limb));
        limbs.map(|(i, _)| i).collect()
    }

    /// The summed distance of these limbs from their bands, mm; `None` if none of them is present.
    fn excess_of(&self, row: usize, limbs: &[usize], pair: Option<Pair>) -> Option<f64> {
        let excess = |limb: &usize| self.excess_mm(row, *limb, pair);
        limbs.iter().filter_map(excess).reduce(|sum, more| sum + more)
    }

    /// The sum of squared distances of these limbs from the middles of their bands, in half-widths.
    fn strain(&self, row: usize, limbs: &[usize], pair: Option<Pair>) -> f64 {
        let strain = |limb: &usize| {
            let band = self.bands.get(*limb)?;
            let off_mm = self.length_of(row, *limb, pair)? - band.middle_mm;
            Some((off_mm / band.half_mm).powi(2))
        };
        limbs.iter().filter_map(strain).sum()
    }

    /// Exchanges the labels of a pair over these rows.
    fn exchange(&mut self, [a, b]: Pair, rows: Range<usize>) {
        for row in rows {
            let from = row * self.n_markers;
            if let Some(frame) = self.positions_mm.get_mut(from..from + self.n_markers) {
                frame.swap(a, b);
            }
        }
    }
}

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
fn all(body: &mut SubjectMotion<'_>) -> Vec<Swap> {
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
