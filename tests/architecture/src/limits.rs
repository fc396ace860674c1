//! What the structure may come to: the limits of CONTRIBUTING.md, and the circles that ARCHITECTURE.md gives a reason for.

use std::collections::{BTreeMap, BTreeSet};

use crate::{cycles, product_sources, root, structure, text};

/// Files of the product: about 140 lines of code each, so that a file is a concept and not a function.
const FILES_MAX: usize = 550;

/// The crates in which no file may lead back to itself.
const WITHOUT_CIRCLES: [&str; 4] = ["codec", "take", "drivers", "acquire"];

/// The line that the reasons follow in ARCHITECTURE.md.
const HEADING: &str = "### Circles of files";

fn sources() -> Vec<(String, String)> {
    let paths = product_sources(&root()).into_iter();
    paths.map(|path| (path.display().to_string(), text(path))).collect()
}

#[test]
fn functions_are_short_and_take_little() {
    let figures = structure::figures(&sources());
    let of = |list: fn(&structure::CrateFigures) -> &Vec<String>| {
        figures.values().flat_map(list).cloned().collect::<Vec<_>>()
    };
    let (long, wide) = (of(|one| &one.long_functions), of(|one| &one.wide_functions));
    assert!(
        long.is_empty(),
        "over {} lines:\n  {}",
        structure::FUNCTION_LINES_MAX,
        long.join("\n  ")
    );
    assert!(wide.is_empty(), "over {} values:\n  {}", structure::PARAMETERS_MAX, wide.join("\n  "));
}

#[test]
fn a_file_is_a_concept() {
    let files: usize = structure::figures(&sources()).values().map(|one| one.files).sum();
    assert!(files <= FILES_MAX, "{files} files are more than {FILES_MAX}: merge what is one");
}

#[test]
fn no_file_leads_back_to_itself_without_a_reason() {
    let sources = sources();
    let crates: BTreeSet<String> =
        sources.iter().map(|(path, _)| structure::crate_of(path)).collect();
    let page = text("ARCHITECTURE.md");
    let (_, section) = page.split_once(HEADING).expect("the heading is gone");
    let section = section.split("\n#").next().unwrap_or_default();
    let mut complaints = Vec::new();
    for name in &crates {
        let files: BTreeMap<String, String> = structure::files_of(&sources, name);
        for circle in cycles::cycles(&cycles::graph(&files)) {
            // A reason names the first file of its circle.
            let has_reason = section.contains(&format!("`{name}/{}`", circle[0]));
            if WITHOUT_CIRCLES.contains(&name.as_str()) || !has_reason {
                complaints.push(format!("{name}: {}", circle.join(" ")));
            }
        }
    }
    assert!(complaints.is_empty(), "circles of files:\n  {}", complaints.join("\n  "));
}
