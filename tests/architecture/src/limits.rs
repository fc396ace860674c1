//! Checks the limits of CONTRIBUTING.md, and that ARCHITECTURE.md gives a reason for every cycle between files.

use std::collections::{BTreeMap, BTreeSet};

use crate::{cycles, product_sources, root, structure, text};

/// Maximum number of files of the product: at about 240 lines of code each, a file is a concept rather than a function.
const FILES_MAX: usize = 546;

/// Crates that must have no cycle between files.
const WITHOUT_CYCLES: [&str; 4] = ["codec", "take", "drivers", "acquire"];

/// The heading above the reasons in ARCHITECTURE.md.
const HEADING: &str = "### Cycles between files";

fn sources() -> Vec<(String, String)> {
    let paths = product_sources(&root()).into_iter();
    paths.map(|path| (path.display().to_string(), text(path))).collect()
}

#[test]
fn functions_are_short_and_have_few_parameters() {
    let figures = structure::figures(&sources());
    let of = |list: fn(&structure::CrateFigures) -> &Vec<String>| {
        figures.values().flat_map(list).cloned().collect::<Vec<_>>()
    };
    let (long, wide) = (of(|one| &one.long_functions), of(|one| &one.wide_functions));
    assert!(
        long.is_empty(),
        "functions of more than {} lines:\n  {}",
        structure::FUNCTION_LINES_MAX,
        long.join("\n  ")
    );
    assert!(
        wide.is_empty(),
        "functions with more than {} parameters:\n  {}",
        structure::PARAMETERS_MAX,
        wide.join("\n  ")
    );
}

#[test]
fn the_product_has_few_files() {
    let files = product_sources(&root()).len();
    assert!(
        files <= FILES_MAX,
        "{files} files, at most {FILES_MAX} are allowed: merge those that are one concept"
    );
}

#[test]
fn every_cycle_between_files_has_a_reason() {
    let sources = sources();
    let crates: BTreeSet<String> =
        sources.iter().map(|(path, _)| structure::crate_of(path)).collect();
    let page = text("ARCHITECTURE.md");
    let (_, section) = page.split_once(HEADING).expect("ARCHITECTURE.md has the heading");
    let section = section.split("\n#").next().unwrap_or_default();
    let mut problems = Vec::new();
    for name in &crates {
        let files: BTreeMap<String, String> = structure::files_of(&sources, name);
        for cycle in cycles::cycles(&cycles::graph(&files)) {
            // A reason names the first file of its cycle.
            let has_reason = section.contains(&format!("`{name}/{}`", cycle[0]));
            if WITHOUT_CYCLES.contains(&name.as_str()) || !has_reason {
                problems.push(format!("{name}: {}", cycle.join(" ")));
            }
        }
    }
    assert!(
        problems.is_empty(),
        "cycles between files without a reason in ARCHITECTURE.md:\n  {}",
        problems.join("\n  ")
    );
}
