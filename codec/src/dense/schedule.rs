//! In which order the rows of a span are coded, and from which rows each is interpolated.
//!
//! A span is at most [`SPAN`] rows. Row 0 is the last row before it, already decoded. The anchor, row
//! `m`, comes first; then the odd multiples of 16, 8, 4, 2 and 1 below `m`. Each is interpolated by the
//! cubic through the two nearest rows of the coarser levels on either side (Lagrange), which on even
//! spacing is (-1, 9, 9, -1)/16. Where an outer neighbour is missing the polynomial has one degree less.

use std::sync::LazyLock;

/// Longest span in rows: its last row must be known before its first is final.
pub(super) const SPAN: usize = 32;

/// Dyadic levels below the anchor: strides 16, 8, 4, 2, 1.
pub(super) const LEVELS: usize = SPAN.ilog2() as usize;

/// Fraction bits of a tap weight.
pub(super) const WEIGHT_BITS: u32 = 16;

/// A row and its weight. The weights of an entry add up to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Tap {
    /// Relative to row 0; negative for rows before the span.
    pub(super) row: i32,
    /// In 2^-[`WEIGHT_BITS`].
    pub(super) weight: i64,
}

/// One row of a span.
#[derive(Debug, Clone, Copy)]
pub(super) struct Entry {
    /// 1 to m - 1.
    pub(super) row: usize,
    /// Distance to the neighbours on the left.
    pub(super) stride: usize,
    /// Left, right, outer right, outer left: the outer left is used only where its row is known.
    full: [Tap; 4],
    /// The same without the outer left.
    short: [Tap; 4],
}

impl Entry {
    /// The taps, given how many rows before row 0 are known. The first two are the near neighbours.
    pub(super) fn taps(&self, known_before: usize) -> &[Tap; 4] {
        if self.full[3].row + known_before as i32 >= 0 { &self.full } else { &self.short }
    }
}

static SCHEDULES: LazyLock<Vec<Vec<Entry>>> = LazyLock::new(|| (0..=SPAN).map(schedule).collect());

/// Builds the table, so that the first block has not to.
pub(super) fn prepare() {
    LazyLock::force(&SCHEDULES);
}

/// The interior rows of a span of `m` rows (1 to [`SPAN`]), in coding order.
pub(super) fn interior(m: usize) -> &'static [Entry] {
    SCHEDULES.get(m).map_or(&[], Vec::as_slice)
}

fn schedule(m: usize) -> Vec<Entry> {
    let strides = (0..LEVELS).rev().map(|bit| 1_usize << bit);
    strides
        .flat_map(|stride| (stride..m).step_by(2 * stride).map(move |row| entry(row, stride, m)))
        .collect()
}

fn entry(row: usize, stride: usize, m: usize) -> Entry {
    let (at, reach) = (row as i32, stride as i32);
    let right = (row + stride).min(m) as i32;
    let outer_right = (row + 3 * stride).min(m) as i32;
    let outer_left = at - 3 * reach;
    let mut nodes = vec![at - reach, right];
    if outer_right > right {
        nodes.push(outer_right);
    }
    let short = taps(at, &nodes);
    nodes.push(outer_left);
    let mut full = taps(at, &nodes);
    // The outer left stands last, whether or not there is an outer right.
    if nodes.len() == 3 {
        full.swap(2, 3);
    }
    Entry { row, stride, full, short }
}

/// Lagrange weights of `nodes` at `at`, rounded half up; the first takes what rounding leaves.
fn taps(at: i32, nodes: &[i32]) -> [Tap; 4] {
    // An unused tap points at the left neighbour, which is always known, with no weight.
    let mut taps = [Tap { row: nodes[0], weight: 0 }; 4];
    let mut left = 1 << WEIGHT_BITS;
    for (i, &node) in nodes.iter().enumerate().skip(1) {
        let (mut numerator, mut denominator) = (1_i64 << WEIGHT_BITS, 1_i64);
        for (_, &other) in nodes.iter().enumerate().filter(|&(j, _)| j != i) {
            numerator *= i64::from(at - other);
            denominator *= i64::from(node - other);
        }
        if denominator < 0 {
            (numerator, denominator) = (-numerator, -denominator);
        }
        let weight = (2 * numerator + denominator).div_euclid(2 * denominator);
        taps[i] = Tap { row: node, weight };
        left -= weight;
    }
    taps[0].weight = left;
    taps
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_coded_once_and_only_from_rows_before_it() {
        for m in 1..=SPAN {
            let mut known = vec![false; m + 1];
            known[0] = true;
            known[m] = true;
            for entry in interior(m) {
                for taps in [entry.taps(0), entry.taps(SPAN)] {
                    for tap in taps {
                        assert!(tap.row <= 0 || known[tap.row as usize], "m {m} {entry:?}");
                    }
                    assert_eq!(taps.iter().map(|t| t.weight).sum::<i64>(), 1 << WEIGHT_BITS);
                }
                assert!(entry.taps(0).iter().all(|tap| tap.row >= 0));
                assert!(!known[entry.row]);
                known[entry.row] = true;
            }
            assert!(known.iter().all(|&k| k), "m {m}");
        }
    }

    #[test]
    fn even_spacing_gives_the_four_point_rule() {
        let entry = interior(32).iter().find(|e| e.row == 12).unwrap();
        let sixteenth = 1 << (WEIGHT_BITS - 4);
        let expected = [(8, 9), (16, 9), (24, -1), (0, -1)];
        for (tap, (row, weight)) in entry.taps(0).iter().zip(expected) {
            assert_eq!(*tap, Tap { row, weight: weight * sixteenth });
        }
    }

    #[test]
    fn weights_reproduce_polynomials_up_to_their_degree() {
        for m in 1..=SPAN {
            for entry in interior(m) {
                let taps = entry.taps(SPAN);
                let degree = taps.iter().filter(|t| t.weight != 0).count() as u32 - 1;
                for power in 0..=degree {
                    let value: f64 = taps
                        .iter()
                        .map(|t| t.weight as f64 / 65536.0 * f64::from(t.row).powi(power as i32))
                        .sum();
                    let truth = (entry.row as f64).powi(power as i32);
                    assert!((value - truth).abs() < 1e-4 * 32_f64.powi(power as i32), "{entry:?}");
                }
            }
        }
    }
}
