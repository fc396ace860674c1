//! The example and docs/config.md must match the table.

use std::{collections::BTreeSet, fs};

use super::*;

fn text(path: &str) -> String {
    let path = format!("{}/../{path}", env!("CARGO_MANIFEST_DIR"));
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

#[test]
fn the_shipped_example_is_the_printed_one() {
    let shipped = text("systemd/mocapd.toml");
    assert!(
        shipped == example(),
        "systemd/mocapd.toml differs from the table: mocapd config example > systemd/mocapd.toml"
    );
}

/// The example with the `#` removed before every key.
fn uncommented() -> String {
    let names: BTreeSet<String> = KEYS.iter().map(|key| format!("# {} = ", key.name())).collect();
    let line = |line: &str| match names.iter().any(|name| line.starts_with(name.as_str())) {
        true => format!("{}\n", &line[2..]),
        false => format!("{line}\n"),
    };
    example().lines().map(line).collect()
}

#[test]
fn the_example_is_valid_with_and_without_its_keys() {
    let defaults = parse("").unwrap();
    assert_eq!(parse(&example()).unwrap(), defaults);
    let changes = defaults.changes(&parse(&uncommented()).unwrap());
    // Keys with a default have it in the example; the others show a possible value.
    for key in KEYS {
        let is_example =
            matches!(key.default, DefaultValue::Absent(_) | DefaultValue::Dynamic { .. });
        let changed = changes.iter().any(|change| change.key == key.path);
        assert!(!changed || is_example, "{} has another default in the example", key.path);
        let is_absent = matches!(key.default, DefaultValue::Absent(_));
        assert!(changed || !is_absent, "{} is not in it", key.path);
    }
    let widest = example().lines().map(|line| line.chars().count()).max().unwrap();
    assert!(widest <= 110, "{widest} letters");
}

#[test]
fn the_page_has_the_tables() {
    let page = text("docs/config.md");
    for (section, about) in SECTIONS {
        let heading = format!("### `[{section}]`\n\n{about}\n\n");
        let (_, rest) = page.split_once(&heading).unwrap_or_else(|| panic!("no '{heading}'"));
        let table = table(section);
        assert!(rest.starts_with(&table), "docs/config.md, [{section}], must be:\n{table}");
    }
}

#[test]
fn every_key_is_described_once() {
    let mut paths = BTreeSet::new();
    for key in KEYS {
        assert!(paths.insert(key.path), "{} stands twice", key.path);
        assert!(SECTIONS.iter().any(|(section, _)| *section == key.section()), "{}", key.path);
        for sentence in [key.what, key.why] {
            assert!(sentence.ends_with('.') && sentence.len() > 20, "{}: {sentence}", key.path);
        }
        // The advised value is accepted.
        let advised = match key.default {
            DefaultValue::EmptyList(item) => format!("[\"{item}\"]"),
            _ => key.example(),
        };
        let text = format!("[{}]\n{} = {advised}", key.section(), key.name());
        parse(&text).unwrap_or_else(|error| panic!("{text}: {error}"));
    }
}
