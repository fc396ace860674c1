//! Accuracy of limb lengths.

use crate::case::Case;

/// Rows of the table, each with the prefixes of the names of its meshes.
const ROWS: [(&str, &[&str]); 4] = [
    ("mlean", &["mh_mlean_"]),
    ("mheavy", &["mh_mheavy_"]),
    ("both and MHR", &["mh_mlean_", "mh_mheavy_", "mhr_"]),
    ("the same, FAUST and SMPL", &["mh_mlean_", "mh_mheavy_", "mhr_", "faust_", "smpl_"]),
];

/// Limbs with a length within 10 % of the truth, without bodies whose limbs touch.
pub(crate) fn within(cases: &[&Case]) {
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
