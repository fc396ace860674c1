//! Assignment of head, hands and feet: the five protrusions whose geodesic distances fit a body best.

use super::{Candidate, Protrusions};
use crate::Refusal;

/// A protrusion whose persistence exceeds this fraction of the longest distance is a limb or a head, not an elbow or an
/// ear: those of bodies have at most 0.06, the sixth extremity of a lion or a horse 0.12 or more.
const LIMB_MIN: f64 = 0.1;

/// Two assignments whose vertices differ by less than this fraction of the longest distance are the same. From the
/// crown into an open mouth it is about 0.17, from a hand to its elbow 0.25.
const DISTINCT_MIN: f64 = 0.22;

/// Minimum margin between the misfits of the best and the second best assignment. Bodies without contact have 1.7 or
/// more, some that crouch 0.5, a lion and a horse less than 0.25.
pub(crate) const MARGIN_MIN: f64 = 0.4;

/// How badly five points with these geodesic distances between them fit a body.
pub(crate) type Cost = fn([[f64; 5]; 5]) -> Misfit;

/// An assignment of candidates to head, hands and feet.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Naming {
    pub(crate) ends: [usize; 5],
    /// Its misfit.
    pub(crate) misfit: Misfit,
    /// Margin to the best assignment that places an extremity elsewhere; infinite if there is none.
    pub(crate) margin: f64,
}

/// The assignment that fits a body best.
///
/// # Errors
///
/// [`Refusal::TooFewEnds`]: fewer than five protrude. [`Refusal::TooManyEnds`]: more than five are as long as limbs.
/// [`Refusal::NotABody`]: no assignment is near enough. [`Refusal::Ambiguous`]: two are about as near.
pub(crate) fn name(protrusions: &Protrusions, cost: Cost) -> Result<Naming, Refusal> {
    let candidates = &protrusions.candidates;
    let limb_min = LIMB_MIN * protrusions.longest;
    let limb = |candidate: &&Candidate| candidate.peak.persistence > limb_min;
    let found = candidates.iter().filter(limb).count();
    if found > 5 {
        return Err(Refusal::TooManyEnds { found });
    }
    let other_min = DISTINCT_MIN * protrusions.longest;
    let distance = |from: usize, to: usize| {
        candidates[from].field[candidates[to].peak.vertex as usize].max(f64::MIN_POSITIVE)
    };
    let namings = namings(candidates.len(), &distance, cost);
    let by_misfit = |one: &&Naming, other: &&Naming| one.misfit.rms.total_cmp(&other.misfit.rms);
    let few = Refusal::TooFewEnds { found: candidates.len() };
    let best = *namings.iter().min_by(by_misfit).ok_or(few)?;
    let ends = best.ends;
    let distinct = |one: usize, other: usize| one != other && distance(one, other) > other_min;
    let differs = |other: &[usize; 5]| {
        let pair = |at: usize, to: [usize; 2]| {
            let straight = distinct(ends[at], other[to[0]]) || distinct(ends[at + 1], other[to[1]]);
            let swapped = distinct(ends[at], other[to[1]]) || distinct(ends[at + 1], other[to[0]]);
            straight && swapped
        };
        distinct(ends[0], other[0]) || pair(1, [1, 2]) || pair(3, [3, 4])
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

/// All assignments of five of `count` candidates, with their misfits.
fn namings(count: usize, distance: &impl Fn(usize, usize) -> f64, cost: Cost) -> Vec<Naming> {
    let mut found = Vec::new();
    for head in 0..count {
        for [a, b] in pairs(count).filter(|hands| !hands.contains(&head)) {
            let free = |end: &usize| ![head, a, b].contains(end);
            for [c, d] in pairs(count).filter(|feet| feet.iter().all(free)) {
                // A foot is nearer to the hand on its own side.
                let crossed = distance(a, c) + distance(b, d) > distance(a, d) + distance(b, c);
                let ends = if crossed { [head, a, b, d, c] } else { [head, a, b, c, d] };
                let misfit = cost(ends.map(|from| ends.map(|to| distance(from, to))));
                found.push(Naming { ends, misfit, margin: f64::INFINITY });
            }
        }
    }
    found
}

/// All pairs of `count` indices, the lower first.
fn pairs(count: usize) -> impl Iterator<Item = [usize; 2]> {
    (0..count).flat_map(move |one| (one + 1..count).map(move |other| [one, other]))
}

/// Mean and standard deviation of a measure over bodies.
struct Prior {
    mean: f64,
    sd: f64,
}

const fn prior(mean: f64, sd: f64) -> Prior {
    Prior { mean, sd }
}

/// Minimum standard deviation of a measure. Two shapes do not show how people differ, and poses stretch skin; limb
/// lengths differ by about 5 % between people of one stature.
const BETWEEN_PEOPLE: f64 = 0.06;
/// Minimum standard deviation of a measure that symmetry makes small.
const BETWEEN_SIDES: f64 = 0.04;

/// Priors of the [`measures`]: means over the two average shapes of `MakeHuman` in 13 poses, by `cargo run -p
/// mocapd-body --features measure --example bodies ratios`. The standard deviations found there are at most 0.034 between
/// people and 0.017 between sides, so the floors apply.
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

/// Largest misfit that is accepted. Free bodies have at most 0.8, a lion and a horse 2.26.
pub const MISFIT_MAX: f64 = 2.0;

/// Largest misfit that is accepted in contact, where the measures allow more: a lion and a horse have 1.97.
pub const MISFIT_IN_CONTACT_MAX: f64 = 1.3;

/// Largest misfit that is accepted if one limb, or one of each pair, ends early and is extended to the length of the
/// other. Free bodies without missing parts have at most 0.86.
const MISFIT_CUT_MAX: f64 = 1.0;

/// Minimum relative shortening, as a fraction of the mean distance, for which a limb counts as cut: more than poses
/// cause.
const SHORTER_MIN: f64 = 0.05;

/// Deviation of an assignment from a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misfit {
    /// Logarithmic ratios of geodesic distances: head to hands, head to feet, hand to hand and foot to foot, each to
    /// the mean of all; the four differences between the sides; across the body to one side.
    pub measures: [f64; MEASURE_COUNT],
    /// Root mean square of the measures' deviations, in standard deviations.
    pub rms: f64,
    /// Largest accepted value.
    pub limit: f64,
}

/// Number of measures.
pub(crate) const MEASURE_COUNT: usize = 9;

/// Measures of the geodesic distances between head, hands and feet; `distances[i][j]` leads from end i to end j, in the
/// order of [`super::Extremities::all`].
///
/// The first four are the mean logarithms of head to hands, head to feet, hand to hand, foot to foot, each minus the
/// mean over all ten distances, which removes the size. The next four are small by symmetry: the differences of the two
/// distances from the head to the hands, to the feet, and from hand to foot on the same side and across. The last is
/// the excess of hand to foot across over the same side.
pub(crate) fn measures(distances: [[f64; 5]; 5]) -> [f64; MEASURE_COUNT] {
    let log = |from: usize, to: usize| distances[from][to].ln();
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

/// The misfit to a whole body whose limbs touch nothing.
pub(crate) fn misfit(distances: [[f64; 5]; 5]) -> Misfit {
    let measures = measures(distances);
    let squares = measures.iter().zip(&PRIORS).map(|(measure, prior)| {
        let deviation = (measure - prior.mean) / prior.sd;
        deviation * deviation
    });
    let rms = (squares.sum::<f64>() / MEASURE_COUNT as f64).sqrt();
    Misfit { measures, rms, limit: MISFIT_MAX }
}

/// Misfit to a body from which part of one limb, or of an arm and a leg, is missing: the shorter limb of a pair is
/// extended to the length of the other. Infinite if no limb is shorter.
pub(crate) fn misfit_cut(distances: [[f64; 5]; 5]) -> Misfit {
    let arms = completed(distances, [1, 2], [3, 4]);
    let legs = completed(distances, [3, 4], [1, 2]);
    let both = arms.and_then(|distances| completed(distances, [3, 4], [1, 2]));
    let misfits = [arms, legs, both].into_iter().flatten().map(misfit);
    let best = misfits.min_by(|one, other| one.rms.total_cmp(&other.rms));
    let none = Misfit { rms: f64::INFINITY, ..misfit(distances) };
    Misfit { limit: MISFIT_CUT_MAX, ..best.unwrap_or(none) }
}

/// The distances with the shorter of two limbs extended to the length of the other. None unless one is clearly shorter,
/// as seen from the head and from the other pair of limbs.
fn completed(all: [[f64; 5]; 5], [a, b]: [usize; 2], others: [usize; 2]) -> Option<[[f64; 5]; 5]> {
    let by_head = all[0][a] - all[0][b];
    let by_others = others.iter().map(|other| all[*other][a] - all[*other][b]).sum::<f64>() / 2.0;
    let mean = all.as_flattened().iter().sum::<f64>() / 20.0;
    let agree = by_head * by_others > 0.0;
    if !agree || by_head.abs().min(by_others.abs()) < SHORTER_MIN * mean {
        return None;
    }
    let (short, by) = (if by_head < 0.0 { a } else { b }, f64::midpoint(by_head, by_others).abs());
    let mut longer = all;
    for other in (0..5).filter(|other| *other != short) {
        longer[short][other] += by;
        longer[other][short] += by;
    }
    Some(longer)
}

/// Standard deviation of the logarithmic shortening of a distance that crosses a contact: two hands on the hips are
/// half as far apart as free ones.
const SHORTENED: f64 = 0.4;

/// Prior of each hand-to-foot distance, from the other priors, since all ten logarithms sum to zero.
const HAND_TO_FOOT: f64 =
    -(2.0 * PRIORS[0].mean + 2.0 * PRIORS[1].mean + PRIORS[2].mean + PRIORS[3].mean) / 4.0;

/// Misfit to a body whose hands touch something: contact shortens distances and never lengthens them.
///
/// Distances are relative to that from head to feet, which no hand affects.
pub(crate) fn misfit_in_contact(distances: [[f64; 5]; 5]) -> Misfit {
    let measures = measures(distances);
    let log = |from: usize, to: usize| distances[from][to].ln();
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
    let loose = loose.map(|(distance, prior)| {
        let longer = distance - unit - prior;
        if longer > 0.0 { longer / BETWEEN_PEOPLE } else { longer / SHORTENED }
    });
    let squares = strict.iter().chain(&loose).map(|deviation| deviation * deviation);
    let rms = (squares.sum::<f64>() / (strict.len() + loose.len()) as f64).sqrt();
    Misfit { measures, rms, limit: MISFIT_IN_CONTACT_MAX }
}
