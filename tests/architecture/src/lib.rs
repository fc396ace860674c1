//! Checks the source against ARCHITECTURE.md: dependencies, invariants, names, and the limits on its structure.

#![expect(clippy::unwrap_used, reason = "a test stops where it fails")]

pub mod cycles;
pub mod structure;

#[cfg(test)]
mod dependencies;
#[cfg(test)]
mod limits;
#[cfg(test)]
mod names;
#[cfg(test)]
#[cfg(test)]
mod sources;

use std::{
    fs,
    path::{Path, PathBuf},
};

/// The root folder of the project.
#[must_use]
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The text of a file; `path` is relative to the project's root.
#[cfg(test)]
fn text(path: impl AsRef<Path>) -> String {
    let path = root().join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Folders whose crates are not part of the product.
const NOT_THE_PRODUCT: [&str; 5] = ["tests", "testkit", "fuzz", "benches", "target"];

/// Every Rust file of the product, relative to the root of a checkout, without tests, benches and examples.
///
/// # Panics
///
/// If a folder cannot be listed.
#[must_use]
pub fn product_sources(root: &Path) -> Vec<PathBuf> {
    let mut folders: Vec<PathBuf> = Vec::new();
    for outer in folders_in(root, Path::new("")) {
        if outer.starts_with("src") {
            folders.push(outer);
        } else if !NOT_THE_PRODUCT.iter().any(|name| outer.starts_with(name)) {
            let inner = folders_in(root, &outer);
            let nested = inner.iter().map(|folder| folder.join("src"));
            folders
                .extend(nested.chain([outer.join("src")]).filter(|src| is_of_a_crate(root, src)));
        }
    }
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(root.join(&folder)).unwrap() {
            let entry = entry.unwrap();
            let path = folder.join(entry.file_name());
            let name = entry.file_name().to_string_lossy().into_owned();
            if entry.file_type().unwrap().is_dir() {
                if name != "tests" {
                    folders.push(path);
                }
            } else if name.ends_with(".rs") && name != "tests.rs" {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

fn folders_in(root: &Path, folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(root.join(folder)).unwrap().map(Result::unwrap);
    let folders = entries.filter(|entry| entry.file_type().unwrap().is_dir());
    folders.map(|entry| folder.join(entry.file_name())).collect()
}

fn is_of_a_crate(root: &Path, src: &Path) -> bool {
    root.join(src).is_dir() && root.join(src).with_file_name("Cargo.toml").is_file()
}
