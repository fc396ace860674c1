//! Five of the ends that stand out, named so that the ways between them fit a body best.

use super::candidates::{Candidate, StandingOut};
use super::roles::Misfit;
use crate::Refusal;

/// What stands out farther than this part of the longest way is a limb or a head, not an elbow or an ear: those of bodies
/// stand out by 0.06 at most, the sixth end of a lion or a horse by 0.12 and more.
const LIMB_MIN: f64 = 0.1;

/// Two namings whose ends differ by less than this part of the longest way say the same. From the crown into an open
/// mouth it is some 0.17, from a hand to its elbow 0.25.
const OTHER_MIN: f64 = 0.22;

/// The misfit of the second best naming must be greater than the best's by so much. On bodies without contact it is by
/// 1.7 or more, on a lion and a horse by less than 0.25; of some that crouch by 0.5.
pub(crate) const MARGIN_MIN: f64 = 0.4;

/// How far ends with such ways between them are from a body.
pub(crate) type Cost = fn([[f64; 5]; 5]) -> Misfit;

/// What a naming costs, and which candidates are head, hands and feet.
pub(crate) type Naming = (Misfit, [usize; 5]);

/// The naming (head, hands, feet) that is nearest to a body, and by how much the next is farther that puts an end
/// elsewhere.
///
/// # Errors
///
/// [`Refusal::TooFewEnds`]: fewer than five stand out. [`Refusal::TooManyEnds`]: six are as long as
/// limbs. [`Refusal::NotABody`]: no naming is near enough. [`Refusal::Ambiguous`]: two are about as near.
pub(crate) fn name(standing: &StandingOut, cost: Cost) -> Result<(Naming, f64), Refusal> {
    let candidates = &standing.candidates;
    let limb = |candidate: &&Candidate| candidate.peak.persistence > LIMB_MIN * standing.longest;
    let found = candidates.iter().filter(limb).count();
    if found > 5 {
        return Err(Refusal::TooManyEnds { found });
    }
    let other_min = OTHER_MIN * standing.longest;
    let way = |from: usize, to: usize| {
        candidates[from].field[candidates[to].peak.vertex as usize].max(f64::MIN_POSITIVE)
    };
    let namings = namings(candidates.len(), &way, cost);
    let best = namings.iter().copied().min_by(|(one, _), (other, _)| one.rms.total_cmp(&other.rms));
    let few = Refusal::TooFewEnds { found: candidates.len() };
    let (fit, ends) = best.ok_or(few)?;
    let apart = |one: usize, other: usize| one != other && way(one, other) > other_min;
    let differs = |other: &[usize; 5]| {
        let pair = |at: usize, to: [usize; 2]| {
            let straight = apart(ends[at], other[to[0]]) || apart(ends[at + 1], other[to[1]]);
            let swapped = apart(ends[at], other[to[1]]) || apart(ends[at + 1], other[to[0]]);
            straight && swapped
        };
        apart(ends[0], other[0]) || pair(1, [1, 2]) || pair(3, [3, 4])
    };
    let others = namings.iter().filter(|(_, other)| differs(other));
    let second = others.map(|(other, _)| other.rms).fold(f64::INFINITY, f64::min);
    let margin = second - fit.rms;
    if fit.rms > fit.limit {
        return Err(Refusal::NotABody { misfit: fit.rms, limit: fit.limit });
    }
    if margin < MARGIN_MIN {
        return Err(Refusal::Ambiguous { margin });
    }
    Ok(((fit, ends), margin))
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
                found.push((cost(ends.map(|from| ends.map(|to| way(from, to)))), ends));
            }
        }
    }
    found
}

/// Every two of `count`, the lower first.
fn pairs(count: usize) -> impl Iterator<Item = [usize; 2]> {
    (0..count).flat_map(move |one| (one + 1..count).map(move |other| [one, other]))
}
