//! Compares the table "Dependencies between crates" in ARCHITECTURE.md with the dependencies in `cargo metadata`.

use std::{
    collections::{BTreeMap, BTreeSet},
    process::Command,
};

use serde_json::Value;

/// For each crate, the crates of this workspace that it depends on.
type Graph = BTreeMap<String, BTreeSet<String>>;

/// The heading above the table in ARCHITECTURE.md.
const HEADING: &str = "## Dependencies between crates";

#[test]
fn crates_depend_on_those_that_the_page_lists_and_no_others() {
    let listed = listed(&super::text("ARCHITECTURE.md"));
    let problems = problems(&listed, &actual(&metadata()));
    assert!(
        problems.is_empty(),
        "'{HEADING}' in ARCHITECTURE.md differs from Cargo.toml:\n  {}",
        problems.join("\n  ")
    );
}

#[test]
fn unlisted_and_stale_dependencies_are_found() {
    let page = format!("{HEADING}\n```text\ncodec -> none\ntake -> codec\n```\n");
    let metadata = |take: &str| -> Value {
        let text = format!(
            r#"{{"packages": [
                {{"name": "mocapd-codec", "dependencies": [{{"name": "thiserror", "kind": null}}]}},
                {{"name": "mocapd-take", "dependencies": [{{"name": "{take}", "kind": "dev"}}]}}
            ]}}"#
        );
        serde_json::from_str(&text).unwrap()
    };
    let problems_with = |take| problems(&listed(&page), &actual(&metadata(take)));
    assert_eq!(problems_with("mocapd-codec"), Vec::<String>::new());
    assert_eq!(
        problems_with("mocapd-take"),
        [
            "take depends on take, which the page does not allow",
            "take no longer depends on codec: remove it from the page"
        ]
    );
}

fn problems(listed: &Graph, actual: &Graph) -> Vec<String> {
    let mut problems = Vec::new();
    for name in actual.keys().filter(|&name| !listed.contains_key(name)) {
        problems.push(format!("the page has no line for the crate {name}: add one"));
    }
    for (name, allowed) in listed {
        let Some(used) = actual.get(name) else {
            problems.push(format!("there is no crate {name}: remove its line from the page"));
            continue;
        };
        for other in used.difference(allowed) {
            problems.push(format!("{name} depends on {other}, which the page does not allow"));
        }
        for other in allowed.difference(used) {
            problems.push(format!("{name} no longer depends on {other}: remove it from the page"));
        }
    }
    problems
}

/// Parses the table: one line per crate, `name -> name, name` or `name -> none`.
fn listed(page: &str) -> Graph {
    let (_, section) = page.split_once(HEADING).expect("ARCHITECTURE.md has the heading");
    let table = section.split("```").nth(1).expect("a fenced block follows the heading");
    let lines = table.lines().skip(1).filter(|line| !line.trim().is_empty());
    lines
        .map(|line| {
            let (name, others) = line.split_once("->").unwrap_or_else(|| panic!("'{line}'"));
            let others = others.split(',').map(|other| other.trim().to_owned());
            (name.trim().to_owned(), others.filter(|other| other != "none").collect())
        })
        .collect()
}

/// Normal, dev and build dependencies, except dev dependencies on the test kit.
fn actual(metadata: &Value) -> Graph {
    let packages = metadata["packages"].as_array().unwrap();
    let name_of = |value: &Value| value["name"].as_str().unwrap().to_owned();
    let ours: BTreeSet<String> = packages.iter().map(name_of).collect();
    let short = |name: &str| name.strip_prefix("mocapd-").unwrap_or(name).to_owned();
    packages
        .iter()
        .map(|package| {
            let dependencies = package["dependencies"].as_array().unwrap();
            let is_for_tests =
                |other: &Value| other["name"] == "mocapd-testkit" && other["kind"] == "dev";
            let products = dependencies.iter().filter(|&other| !is_for_tests(other));
            let names = products.map(name_of).filter(|name| ours.contains(name));
            (short(&name_of(package)), names.map(|name| short(&name)).collect())
        })
        .collect()
}

fn metadata() -> Value {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(super::root())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}
