//! Which end is which: five of the ends that stand out, named so that the ways between them fit a body best.

use super::peaks::{Candidate, Protrusions};
use crate::Refusal;

/// What stands out farther than this part of the longest way is a limb or a head, not an elbow or an ear: those of bodies
/// stand out by 0.06 at most, the sixth end of a lion or a horse by 0.12 and more.
const LIMB_MIN: f64 = 0.1;

/// Two namings whose ends differ by less than this part of the longest way say the same. From the crown into an open
/// mouth it is some 0.17, from a hand to its elbow 0.25.
const DISTINCT_MIN: f64 = 0.22;

/// The misfit of the second best naming must be greater than the best's by so much. On bodies without contact it is by
/// 1.7 or more, on a lion and a horse by less than 0.25; of some that crouch by 0.5.
pub(crate) const MARGIN_MIN: f64 = 0.4;

/// How far ends with such ways between them are from a body.
pub(crate) type Cost = fn([[f64; 5]; 5]) -> Misfit;

/// Which candidates are head, hands and feet.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Naming {
    pub(crate) ends: [usize; 5],
    /// What it costs.
    pub(crate) misfit: Misfit,
    /// By how much the next is farther from a body that puts an end elsewhere; infinite if there is none.
    pub(crate) margin: f64,
}

/// The naming that is nearest to a body.
///
/// # Errors
///
/// [`Refusal::TooFewEnds`]: fewer than five stand out. [`Refusal::TooManyEnds`]: six are as long as
/// limbs. [`Refusal::NotABody`]: no naming is near enough. [`Refusal::Ambiguous`]: two are about as near.
pub(crate) fn name(protrusions: &Protrusions, cost: Cost) -> Result<Naming, Refusal> {
    let candidates = &protrusions.candidates;
    let limb_min = LIMB_MIN * protrusions.longest;
    let limb = |candidate: &&Candidate| candidate.peak.persistence > limb_min;
    let found = candidates.iter().filter(limb).count();
    if found > 5 {
        return Err(Refusal::TooManyEnds { found });
    }
    let other_min = DISTINCT_MIN * protrusions.longest;
    let way = |from: usize, to: usize| {
        candidates[from].field[candidates[to].peak.vertex as usize].max(f64::MIN_POSITIVE)
    };
    let namings = namings(candidates.len(), &way, cost);
    let by_misfit = |one: &&Naming, other: &&Naming| one.misfit.rms.total_cmp(&other.misfit.rms);
    let few = Refusal::TooFewEnds { found: candidates.len() };
    let best = *namings.iter().min_by(by_misfit).ok_or(few)?;
    let ends = best.ends;
    let apart = |one: usize, other: usize| one != other && way(one, other) > other_min;
    let differs = |other: &[usize; 5]| {
        let pair = |at: usize, to: [usize; 2]| {
            let straight = apart(ends[at], other[to[0]]) || apart(ends[at + 1], other[to[1]]);
            let swapped = apart(ends[at], other[to[1]]) || apart(ends[at + 1], other[to[0]]);
            straight && swapped
        };
        apart(ends[0], other[0]) || pair(1, [1, 2]) || pair(3, [3, 4])
    };
    let others = namings.iter().filter(|other| differs(&other.ends));
    let second = others.map(|other| other.misfit.rms).fold(f64::INFINITY, f64::min);
    let Misfit { rms, limit, .. } = best.misfit;
    let margin = second - rms;
    if rms > limit {
        return Err(Refusal::NotABody { misfit: rms, limit });
    }
    if margin < MARGIN_MIN {
        return Err(Refusal::Ambiguous { margin });
    }
    Ok(Naming { margin, ..best })
}

/// Every way to name five of `count` ends, with what it costs.
fn namings(count: usize, way: &impl Fn(usize, usize) -> f64, cost: Cost) -> Vec<Naming> {
    let mut found = Vec::new();
    for head in 0..count {
        for [a, b] in pairs(count).filter(|hands| !hands.contains(&head)) {
            let free = |end: &usize| ![head, a, b].contains(end);
            for [c, d] in pairs(count).filter(|feet| feet.iter().all(free)) {
                // A foot is nearer to the hand on its own side.
                let crossed = way(a, c) + way(b, d) > way(a, d) + way(b, c);
                let ends = if crossed { [head, a, b, d, c] } else { [head, a, b, c, d] };
                let misfit = cost(ends.map(|from| ends.map(|to| way(from, to))));
                found.push(Naming { ends, misfit, margin: f64::INFINITY });
            }
        }
    }
    found
}

/// Every two of `count`, the lower first.
fn pairs(count: usize) -> impl Iterator<Item = [usize; 2]> {
    (0..count).flat_map(move |one| (one + 1..count).map(move |other| [one, other]))
}

/// What is known of one measure: its mean over bodies, and its standard deviation.
struct Prior {
    mean: f64,
    sd: f64,
}

const fn prior(mean: f64, sd: f64) -> Prior {
    Prior { mean, sd }
}

/// Two shapes say nothing of how people differ, and poses stretch skin: no standard deviation is less than this. Lengths
/// of limbs differ by some 5 % of themselves between people of one stature.
const BETWEEN_PEOPLE: f64 = 0.06;
/// The same for what symmetry makes small.
const BETWEEN_SIDES: f64 = 0.04;

/// Of each of the [`measures`]: means over the two average shapes of `MakeHuman` in 13 poses, by
/// `cargo run -p mocapd-body --example bodies ratios`. The spreads it found are 0.034 at most between people and 0.017
/// between sides, so the floors stand.
const PRIORS: [Prior; MEASURE_COUNT] = [
    prior(-0.443, BETWEEN_PEOPLE),
    prior(0.075, BETWEEN_PEOPLE),
    prior(-0.057, BETWEEN_PEOPLE),
    prior(0.091, BETWEEN_PEOPLE),
    prior(0.016, BETWEEN_SIDES),
    prior(0.011, BETWEEN_SIDES),
    prior(0.011, BETWEEN_SIDES),
    prior(0.004, BETWEEN_SIDES),
    prior(0.040, BETWEEN_SIDES),
];

/// A naming of ends is taken for a body up to this root mean square of its measures' deviations. Free bodies have 0.8 at
/// most, a lion and a horse 2.26.
pub const MISFIT_MAX: f64 = 2.0;

/// The same in contact, where much is allowed already: a lion and a horse have 1.97.
pub const MISFIT_IN_CONTACT_MAX: f64 = 1.3;

/// The same where one limb, or one of each pair, ends early and is thought to be as long as the other: free bodies, which
/// have nothing missing, have 0.86 at most.
const MISFIT_CUT_MAX: f64 = 1.0;

/// A limb is thought to end early that is shorter than the other by so much of the mean way: more than poses make.
const SHORTER_MIN: f64 = 0.05;

/// How far a naming of five ends is from a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misfit {
    /// Logarithms of ratios of the ways: head to hands, head to feet, hand to hand and foot to foot, each to the mean of
    /// all; the four differences between the sides; across the body to one side.
    pub measures: [f64; MEASURE_COUNT],
    /// The root mean square of the measures' deviations, in standard deviations.
    pub rms: f64,
    /// The most that is taken for a body.
    pub limit: f64,
}

/// Logarithms of ratios of the ways between five ends.
pub(crate) const MEASURE_COUNT: usize = 9;

/// Measures of the ways between head, hands and feet, `ways[i][j]` from end i to end j, in the order of
/// [`super::Extremities::all`].
///
/// First the mean logarithm of head to hands, head to feet, hand to hand, foot to foot, each less the mean of all ten
/// ways', so that size is out of it; then what a body's symmetry makes small: by how much the two ways from the head to the hands differ, to the
/// feet, and from hand to foot on both sides and across; last, how much longer than on one side it is from hand to foot
/// across.
pub(crate) fn measures(ways: [[f64; 5]; 5]) -> [f64; MEASURE_COUNT] {
    let log = |from: usize, to: usize| ways[from][to].ln();
    let [a, b] = [log(0, 1), log(0, 2)];
    let [c, d] = [log(0, 3), log(0, 4)];
    let [hands, feet] = [log(1, 2), log(3, 4)];
    let [same, same_too] = [log(1, 3), log(2, 4)];
    let [across, across_too] = [log(1, 4), log(2, 3)];
    let [by_side, by_cross] = [(same + same_too) / 2.0, (across + across_too) / 2.0];
    let mean = (a + b + c + d + hands + feet + 2.0 * by_side + 2.0 * by_cross) / 10.0;
    [
        (a + b) / 2.0 - mean,
        (c + d) / 2.0 - mean,
        hands - mean,
        feet - mean,
        (a - b).abs(),
        (c - d).abs(),
        (same - same_too).abs(),
        (across - across_too).abs(),
        by_cross - by_side,
    ]
}

/// How far ends with such ways between them are from a body.
pub(crate) fn misfit(ways: [[f64; 5]; 5]) -> Misfit {
    let measures = measures(ways);
    let squares = measures.iter().zip(&PRIORS).map(|(measure, prior)| {
        let deviation = (measure - prior.mean) / prior.sd;
        deviation * deviation
    });
    let rms = (squares.sum::<f64>() / MEASURE_COUNT as f64).sqrt();
    Misfit { measures, rms, limit: MISFIT_MAX }
}

/// How far ends are from a body of which a part of one limb, or of an arm and a leg, is missing: the shorter limb of a pair is
/// thought to be as long as the other. The misfit is infinite where no limb is shorter.
pub(crate) fn misfit_cut(ways: [[f64; 5]; 5]) -> Misfit {
    let arms = completed(ways, [1, 2], [3, 4]);
    let legs = completed(ways, [3, 4], [1, 2]);
    let both = arms.and_then(|ways| completed(ways, [3, 4], [1, 2]));
    let misfits = [arms, legs, both].into_iter().flatten().map(misfit);
    let best = misfits.min_by(|one, other| one.rms.total_cmp(&other.rms));
    let none = Misfit { rms: f64::INFINITY, ..misfit(ways) };
    Misfit { limit: MISFIT_CUT_MAX, ..best.unwrap_or(none) }
}

/// The ways with the shorter of two limbs as long as the other; nothing if neither is shorter by enough, as seen from the head
/// and from the other pair of ends.
fn completed(ways: [[f64; 5]; 5], [a, b]: [usize; 2], others: [usize; 2]) -> Option<[[f64; 5]; 5]> {
    let by_head = ways[0][a] - ways[0][b];
    let by_others = others.iter().map(|other| ways[*other][a] - ways[*other][b]).sum::<f64>() / 2.0;
    let mean = ways.as_flattened().iter().sum::<f64>() / 20.0;
    let agree = by_head * by_others > 0.0;
    if !agree || by_head.abs().min(by_others.abs()) < SHORTER_MIN * mean {
        return None;
    }
    let (short, by) = (if by_head < 0.0 { a } else { b }, f64::midpoint(by_head, by_others).abs());
    let mut longer = ways;
    for other in (0..5).filter(|other| *other != short) {
        longer[short][other] += by;
        longer[other][short] += by;
    }
    Some(longer)
}

/// How much shorter than on a body a way may be where it leads through contact: two hands on the hips are half as far from
/// each other as free ones.
const SHORTENED: f64 = 0.4;

/// Of each hand to each foot: the mean of the priors, in the same units, since all ten ways sum to none.
const HAND_TO_FOOT: f64 =
    -(2.0 * PRIORS[0].mean + 2.0 * PRIORS[1].mean + PRIORS[2].mean + PRIORS[3].mean) / 4.0;

/// How far ends are from a body whose hands have grown to something: contact makes ways shorter, and never longer.
///
/// The unit is the way from head to feet, which no hand changes.
pub(crate) fn misfit_in_contact(ways: [[f64; 5]; 5]) -> Misfit {
    let measures = measures(ways);
    let log = |from: usize, to: usize| ways[from][to].ln();
    let unit = (log(0, 3) + log(0, 4)) / 2.0 - PRIORS[1].mean;
    let strict = [
        (log(3, 4) - unit - PRIORS[3].mean) / PRIORS[3].sd,
        (measures[5] - PRIORS[5].mean) / PRIORS[5].sd,
        (measures[4] - PRIORS[4].mean) / (2.0 * PRIORS[4].sd),
    ];
    let half = PRIORS[8].mean / 2.0;
    let loose = [
        (log(0, 1), PRIORS[0].mean),
        (log(0, 2), PRIORS[0].mean),
        (log(1, 2), PRIORS[2].mean),
        (log(1, 3), HAND_TO_FOOT - half),
        (log(2, 4), HAND_TO_FOOT - half),
        (log(1, 4), HAND_TO_FOOT + half),
        (log(2, 3), HAND_TO_FOOT + half),
    ];
    let loose = loose.map(|(way, prior)| {
        let longer = way - unit - prior;
        if longer > 0.0 { longer / BETWEEN_PEOPLE } else { longer / SHORTENED }
    });
    let squares = strict.iter().chain(&loose).map(|deviation| deviation * deviation);
    let rms = (squares.sum::<f64>() / (strict.len() + loose.len()) as f64).sqrt();
    Misfit { measures, rms, limit: MISFIT_IN_CONTACT_MAX }
}
