//! Checks that the fuzz targets and the workspace are built with the same profile, so that they share dependencies.

use toml::{Table, Value};

/// The development profile in a manifest.
fn development(manifest: &str) -> Value {
    let manifest: Table = toml::from_str(&super::text(manifest)).unwrap();
    manifest["profile"]["dev"].clone()
}

/// A crate outside the workspace has its own profile. If the two differ in anything, cargo builds every dependency
/// twice.
#[test]
fn the_fuzz_targets_share_the_dependencies_built_for_the_workspace() {
    let mut workspace = development("Cargo.toml");
    // The fuzz targets do not use the command line, and cargo warns about profiles for missing crates.
    let packages = workspace["package"].as_table_mut().unwrap();
    assert!(packages.remove("mocapd").is_some());
    assert_eq!(development("fuzz/Cargo.toml"), workspace);
}
