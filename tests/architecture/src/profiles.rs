//! What the fuzz targets are built with is what the workspace is built with.

use toml::{Table, Value};

/// The profile for development of a manifest.
fn development(manifest: &str) -> Value {
    let manifest: Table = toml::from_str(&super::text(manifest)).unwrap();
    manifest["profile"]["dev"].clone()
}

/// A crate that is not a member of the workspace has a profile of its own. Where the two differ in anything, cargo builds
/// every dependency once more.
#[test]
fn the_fuzz_targets_take_what_the_workspace_has_built() {
    let mut workspace = development("Cargo.toml");
    // The fuzz targets do without the command line: cargo warns of a profile for a crate that is not there.
    let packages = workspace["package"].as_table_mut().unwrap();
    assert!(packages.remove("mocapd").is_some());
    assert_eq!(development("fuzz/Cargo.toml"), workspace);
}
