//! Markdown tables.

use crate::case::{Case, KINDS};
use crate::group::Group;

/// Mean / 95th percentile for each kind of joint, one row per group.
pub(crate) fn joints(of: &str, groups: &[Group<'_>]) {
    println!(
        "| {of} | meshes | refused | {} | all twelve: mean / median / p95 |",
        KINDS.join(" | ")
    );
    println!("|---|---|---|{}---|", "---|".repeat(KINDS.len()));
    for group in groups {
        let refused = group.cases.iter().filter(|case| case.found.is_err()).count();
        let all: Vec<(usize, f64)> = group.cases.iter().flat_map(|case| case.errors()).collect();
        let mut cells: Vec<String> = (0..KINDS.len())
            .map(|kind| {
                let mut errors: Vec<f64> =
                    all.iter().filter(|(of, _)| *of == kind).map(|(_, error)| *error).collect();
                format!("{:.2} / {:.2}", mean(&errors), quantile(&mut errors, 0.95))
            })
            .collect();
        let mut errors: Vec<f64> = all.iter().map(|(_, error)| *error).collect();
        cells.push(format!(
            "{:.2} / {:.2} / {:.2}",
            mean(&errors),
            quantile(&mut errors, 0.5),
            quantile(&mut errors, 0.95)
        ));
        println!("| {} | {} | {refused} | {} |", group.name, group.cases.len(), cells.join(" | "));
    }
    println!();
}

/// Lengths, sides, midline and calibration of the standard deviations.
pub(crate) fn totals(cases: &[&Case]) {
    println!("| limb | length: mean error | mean signed error | within 10 % |\n|---|---|---|---|");
    let lengths: Vec<(usize, f64)> = cases.iter().flat_map(|case| case.lengths()).collect();
    for (limb, name) in ["upper arm", "forearm", "thigh", "shank", "all"].iter().enumerate() {
        let signed: Vec<f64> = lengths
            .iter()
            .filter(|(of, _)| *of == limb || limb == 4)
            .map(|(_, error)| *error)
            .collect();
        let of_limb: Vec<f64> = signed.iter().map(|error| error.abs()).collect();
        let within = of_limb.iter().filter(|error| **error <= 0.1).count();
        println!(
            "| {name} | {:.1} % | {:.1} % | {within} of {} ({:.1} %) |",
            100.0 * mean(&of_limb),
            100.0 * mean(&signed),
            of_limb.len(),
            100.0 * within as f64 / of_limb.len().max(1) as f64
        );
    }
    let known = cases.iter().filter(|case| case.found.as_ref().is_ok_and(|found| found.sides_told));
    let (known, right) =
        known.fold((0, 0), |(n, right), case| (n + 1, right + usize::from(!case.swapped)));
    let found = cases.iter().filter(|case| case.found.is_ok()).count();
    println!("\nLeft and right: determined on {known} of {found}, and correctly on {right}.");
    for kind in ["neck", "head_top"] {
        let errors: Vec<f64> = cases.iter().filter_map(|case| case.midline_error(kind)).collect();
        println!(
            "Mean error of `{kind}` on {} meshes: {:.2} % of stature.",
            errors.len(),
            mean(&errors)
        );
    }
    let ratios: Vec<f64> = cases.iter().flat_map(|case| case.ratios()).collect();
    let rms = mean(&ratios.iter().map(|ratio| ratio * ratio).collect::<Vec<_>>()).sqrt();
    println!("Error over stated standard deviation: root mean square {rms:.2}.");
    for case in cases {
        if let Err(reason) = &case.found {
            println!("Refused: {} ({reason}).", case.name);
        }
    }
}

/// The meshes with the largest mean errors.
pub(crate) fn worst(cases: &[&Case]) {
    let mut means: Vec<(f64, &str)> = cases
        .iter()
        .filter(|case| case.found.is_ok())
        .map(|case| (mean(&case.errors().map(|(_, error)| error).collect::<Vec<_>>()), &*case.name))
        .collect();
    means.sort_by(|one, other| other.0.total_cmp(&one.0));
    let names: Vec<String> =
        means.iter().take(8).map(|(error, name)| format!("{name} {error:.2}")).collect();
    println!("The greatest mean errors: {}.", names.join(", "));
}

pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

pub(crate) fn quantile(values: &mut [f64], part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = (part * values.len().saturating_sub(1) as f64).ceil() as usize;
    values.get(at).copied().unwrap_or(f64::NAN)
}
