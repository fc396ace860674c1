//! The rows of the tables: groups of meshes that share a row, the errors of their joints, and the accuracy of their
//! limb lengths.

use crate::case::{Case, KINDS};

/// The meshes of one row.
pub(crate) struct Group<'a> {
    pub(crate) name: String,
    pub(crate) cases: Vec<&'a Case>,
}

impl<'a> Group<'a> {
    pub(crate) fn by(cases: &[&'a Case], name: impl Fn(&Case) -> String) -> Vec<Self> {
        let mut groups: Vec<Self> = Vec::new();
        for &case in cases {
            let name = name(case);
            match groups.iter_mut().find(|group| group.name == name) {
                Some(group) => group.cases.push(case),
                None => groups.push(Self { name, cases: vec![case] }),
            }
        }
        groups.push(Self { name: "all".to_owned(), cases: cases.to_vec() });
        groups
    }
}

/// The shapes that the constants were learned from.
pub(crate) fn is_development(name: &str) -> bool {
    ["mh_mavg_", "mh_favg_", "contact_mavg_", "contact_favg_"]
        .iter()
        .any(|start| name.starts_with(start))
}

/// The classes of poses by which other programs were measured.
pub(crate) fn pose_class(name: &str) -> String {
    let pose = name.split('_').nth(2).unwrap_or_default();
    match (name, pose) {
        (name, _) if name.starts_with("contact_") => "contact",
        (name, _) if name.starts_with("mhr_") => "jump (MHR)",
        (name, _) if !name.starts_with("mh_") => "scans (FAUST, SMPL)",
        (_, "A" | "T" | "down" | "walk") => "A / T / down / walk",
        (_, "bend" | "akimbo") => "bend / akimbo",
        (_, "squat" | "kneel") => "squat / kneel",
        (_, "lunge" | "run" | "kick") => "lunge / run / kick",
        (_, pose) => pose,
    }
    .to_owned()
}

/// The shape of a body.
pub(crate) fn shape(name: &str) -> String {
    let mut parts = name.split('_');
    match (parts.next(), parts.next()) {
        (Some("mh"), Some(shape)) => shape.to_owned(),
        (Some("contact"), Some(shape)) => format!("{shape}, limbs touching"),
        (Some("faust"), _) => "FAUST".to_owned(),
        (first, _) => first.unwrap_or_default().to_owned(),
    }
}

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

/// Rows of the table, each with the prefixes of the names of its meshes.
const ROWS: [(&str, &[&str]); 4] = [
    ("mlean", &["mh_mlean_"]),
    ("mheavy", &["mh_mheavy_"]),
    ("both and MHR", &["mh_mlean_", "mh_mheavy_", "mhr_"]),
    ("the same, FAUST and SMPL", &["mh_mlean_", "mh_mheavy_", "mhr_", "faust_", "smpl_"]),
];

/// Limbs with a length within 10 % of the truth, without bodies whose limbs touch.
pub(crate) fn lengths_within(cases: &[&Case]) {
    println!("\n| bodies | of all four | upper arm | forearm | thigh | shank |");
    println!("|---|---|---|---|---|---|");
    for (name, starts) in ROWS {
        let of_row = cases.iter().filter(|case| starts.iter().any(|at| case.name.starts_with(at)));
        let lengths: Vec<(usize, f64)> = of_row.flat_map(|case| case.lengths()).collect();
        let count = |limb: Option<usize>| {
            let all = lengths.iter().filter(|(of, _)| limb.is_none_or(|limb| limb == *of));
            all.fold((0_usize, 0_usize), |(right, all), (_, error)| {
                (right + usize::from(error.abs() <= 0.1), all + 1)
            })
        };
        let (right, all) = count(None);
        let limbs: Vec<String> = (0..4)
            .map(|limb| count(Some(limb)))
            .map(|(right, all)| format!("{right} of {all}"))
            .collect();
        let part = 100.0 * right as f64 / all.max(1) as f64;
        println!("| {name} | {right} of {all} ({part:.1} %) | {} |", limbs.join(" | "));
    }
}
