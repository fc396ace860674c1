//! Who may know whom: the table of ARCHITECTURE.md against what `cargo metadata` says.

use std::{
    collections::{BTreeMap, BTreeSet},
    process::Command,
};

use serde_json::Value;

/// By crate, the crates of ours that it names.
type Graph = BTreeMap<String, BTreeSet<String>>;

/// The line that the table follows in ARCHITECTURE.md.
const HEADING: &str = "## Who may know whom";

#[test]
fn crates_know_whom_the_page_says_and_nobody_else() {
    let written = written(&super::text("ARCHITECTURE.md"));
    let found = found(&metadata());
    let complaints = complaints(&written, &found);
    assert!(
        complaints.is_empty(),
        "ARCHITECTURE.md, '{HEADING}', and Cargo.toml disagree:\n  {}",
        complaints.join("\n  ")
    );
}

#[test]
fn a_new_arrow_and_a_stale_one_are_found() {
    let page = format!("{HEADING}\n```text\ncodec -> nobody\ntake -> codec\n```\n");
    let metadata = |take: &str| -> Value {
        let text = format!(
            r#"{{"packages": [
                {{"name": "mocapd-codec", "dependencies": [{{"name": "thiserror", "kind": null}}]}},
                {{"name": "mocapd-take", "dependencies": [{{"name": "{take}", "kind": "dev"}}]}}
            ]}}"#
        );
        serde_json::from_str(&text).unwrap()
    };
    let complaints_at = |take| complaints(&written(&page), &found(&metadata(take)));
    assert_eq!(complaints_at("mocapd-codec"), Vec::<String>::new());
    assert_eq!(
        complaints_at("mocapd-take"),
        ["take uses take, which it may not know", "take no longer uses codec: take the arrow away"]
    );
}

fn complaints(written: &Graph, found: &Graph) -> Vec<String> {
    let mut complaints = Vec::new();
    for name in found.keys().filter(|&name| !written.contains_key(name)) {
        complaints.push(format!("the page has no line for the crate {name}"));
    }
    for (name, may_know) in written {
        let Some(knows) = found.get(name) else {
            complaints.push(format!("the page has a line for {name}, which is no crate here"));
            continue;
        };
        for other in knows.difference(may_know) {
            complaints.push(format!("{name} uses {other}, which it may not know"));
        }
        for other in may_know.difference(knows) {
            complaints.push(format!("{name} no longer uses {other}: take the arrow away"));
        }
    }
    complaints
}

/// The table: one line a crate, `name -> name, name` or `name -> nobody`.
fn written(page: &str) -> Graph {
    let (_, section) = page.split_once(HEADING).expect("the heading is gone");
    let table = section.split("```").nth(1).expect("no fenced block after the heading");
    let lines = table.lines().skip(1).filter(|line| !line.trim().is_empty());
    lines
        .map(|line| {
            let (name, others) = line.split_once("->").unwrap_or_else(|| panic!("'{line}'"));
            let others = others.split(',').map(|other| other.trim().to_owned());
            (name.trim().to_owned(), others.filter(|other| other != "nobody").collect())
        })
        .collect()
}

/// Normal, dev and build dependencies alike, but for what tests share.
fn found(metadata: &Value) -> Graph {
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
