//! What ARCHITECTURE.md says of the source, held against the source.

mod dependencies;
mod profiles;
mod sources;

use std::{
    fs,
    path::{Path, PathBuf},
};

/// The project's folder.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A file's text; `path` is relative to the project's folder.
fn text(path: impl AsRef<Path>) -> String {
    let path = root().join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Every Rust file of the product, relative to the project's folder: no tests, no benches.
fn product_sources() -> Vec<PathBuf> {
    let mut folders: Vec<PathBuf> = [
        "src",
        "codec/src",
        "take/src",
        "drivers/src",
        "acquire/src",
        "service/src",
        "simulator/src",
        "report/src",
        "subject/src",
    ]
    .map(PathBuf::from)
    .into();
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(root().join(&folder)).unwrap() {
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
