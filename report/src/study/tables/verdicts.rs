//! Whether what the paper claims holds on the takes at hand.

use crate::{
    phases::Phase,
    study::{Findings, Method, Piece},
};

/// One claim.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verdict {
    /// The claim.
    pub claim: &'static str,
    /// Whether it holds at every tolerance; `None` where the takes cannot tell.
    pub holds: Option<bool>,
    /// Where it does not, or with which figures it does.
    pub words: String,
}

/// All claims, in the order of the paper.
#[must_use]
pub fn verdicts(findings: &Findings) -> Vec<Verdict> {
    vec![lowest(findings), highest(findings), rising(findings), asynchronous_wins(findings)]
}

/// SR2 by phase at a tolerance, of the phases that are there.
fn by_phase(findings: &Findings, tolerance_mm: f64) -> Vec<(Phase, f64)> {
    let sr2 = |phase: Phase| {
        let sum = findings.sum(Piece::Phase(phase), Method::WorstSample, tolerance_mm)?;
        Some((phase, sum.counts.sr2()?))
    };
    Phase::ALL.into_iter().filter(|&phase| phase != Phase::Standing).filter_map(sr2).collect()
}

/// A claim about the order of the phases, tolerance by tolerance.
fn order(
    findings: &Findings,
    claim: &'static str,
    choose: impl Fn(&[(Phase, f64)]) -> Option<(Phase, f64)>,
    expected: &[Phase],
) -> Verdict {
    let mut words = Vec::new();
    let mut holds = None;
    for &mm in &findings.tolerances_mm {
        let phases = by_phase(findings, mm);
        let can_tell = phases.len() > 1 && phases.iter().any(|(phase, _)| expected.contains(phase));
        if let Some((phase, sr2)) = choose(&phases).filter(|_| can_tell) {
            let is_so = expected.contains(&phase);
            holds = Some(holds.unwrap_or(true) && is_so);
            words.push(format!("{mm} mm: {} ({sr2:.2})", phase.name()));
        }
    }
    Verdict { claim, holds, words: words.join(", ") }
}

fn lowest(findings: &Findings) -> Verdict {
    order(
        findings,
        "the take-off compresses least",
        |phases| phases.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1)),
        &[Phase::TakeOff],
    )
}

fn highest(findings: &Findings) -> Verdict {
    order(
        findings,
        "walking or settling compresses most",
        |phases| phases.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)),
        &[Phase::Walking, Phase::Settling],
    )
}

fn rising(findings: &Findings) -> Verdict {
    let mut falls = Vec::new();
    let mut compared = false;
    let phases = Phase::ALL.map(Piece::Phase);
    for piece in phases.into_iter().chain([Piece::Whole]) {
        for pair in findings.tolerances_mm.windows(2) {
            let sr2 = |mm| findings.sum(piece, Method::WorstSample, mm)?.counts.sr2();
            if let (Some(a), Some(b)) = (sr2(pair[0]), sr2(pair[1])) {
                compared = true;
                if b < a {
                    falls.push(format!(
                        "{}: {a:.2} at {} mm, {b:.2} at {} mm",
                        piece.name(),
                        pair[0],
                        pair[1]
                    ));
                }
            }
        }
    }
    Verdict {
        claim: "a larger tolerance compresses more",
        holds: compared.then_some(falls.is_empty()),
        words: if falls.is_empty() {
            "in every phase, and as a whole".to_owned()
        } else {
            falls.join("; ")
        },
    }
}

fn asynchronous_wins(findings: &Findings) -> Verdict {
    let mut words = Vec::new();
    let mut holds = None;
    for &mm in &findings.tolerances_mm {
        if let Some(sum) = findings.sum(Piece::Whole, Method::WorstSample, mm) {
            holds = Some(holds.unwrap_or(true) && sum.wins == sum.n);
            words.push(format!("{mm} mm: {} of {} trials", sum.wins, sum.n));
        }
    }
    Verdict {
        claim: "asynchronous resampling needs fewer items than synchronous (10)",
        holds,
        words: words.join(", "),
    }
}
