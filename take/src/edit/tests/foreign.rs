//! The foreign parts of edited takes.

use super::super::*;

/// Fails for a new kind until [`KINDS`] has its relation.
#[test]
fn every_documented_kind_has_a_relation_to_frames() {
    let document = include_str!("../../../../docs/foreign.md");
    let (_, table) = document.split_once("| kind | content | restored |").unwrap();
    let rows = table.lines().skip(2).map_while(|line| line.strip_prefix("| `"));
    let kinds: Vec<&str> = rows.filter_map(|row| row.split('`').next()).collect();
    assert_eq!(kinds, KINDS.map(|(kind, _)| kind));
}
