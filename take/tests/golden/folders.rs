//! The folders of the golden takes, one per version.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Once,
};

use mocapd_take::record::{CODEC_VERSION, LONG_KEYS_VERSION};

use super::{
    decoded::Decoded,
    takes::{GOLDENS, Golden, LONG_KEYS},
    text::PREFACE,
};

/// Environment variable that makes the test rewrite the folders of the versions that this build writes.
pub(crate) const WRITE: &str = "MOCAPD_WRITE_GOLDEN";

/// The folder of all versions; those that this build writes are rewritten on request.
pub(crate) fn goldens() -> PathBuf {
    static WRITTEN: Once = Once::new();
    let goldens = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    WRITTEN.call_once(|| {
        if std::env::var_os(WRITE).is_some() {
            write(&folder(&goldens, CODEC_VERSION), &GOLDENS);
            write(&folder(&goldens, LONG_KEYS_VERSION), &[LONG_KEYS]);
        }
    });
    goldens
}

pub(crate) fn folder(goldens: &Path, version: u16) -> PathBuf {
    goldens.join(format!("v{version}"))
}

fn write(folder: &Path, takes: &[Golden]) {
    if folder.exists() {
        fs::remove_dir_all(folder).unwrap();
    }
    fs::create_dir(folder).unwrap();
    let mut expected = PREFACE.to_owned();
    for golden in takes {
        let take = golden.write().bytes;
        let text = Decoded::read(&take).unwrap().to_text();
        expected += &format!("\ntake {}\n{text}", golden.file());
        fs::write(folder.join(golden.file()), take).unwrap();
    }
    fs::write(folder.join("expected.txt"), expected).unwrap();
}

/// The stored bytes of a golden take that this build writes.
pub(crate) fn stored(golden: &Golden) -> Vec<u8> {
    let path = folder(&goldens(), golden.version()).join(golden.file());
    fs::read(&path).unwrap_or_else(|error| {
        panic!(
            "{}: {error}: for a new version, or a new golden take, write them with {WRITE}=1",
            path.display()
        )
    })
}

/// The expected content of each take, from `expected.txt`.
pub(crate) fn expected(folder: &Path) -> BTreeMap<String, String> {
    let text = fs::read_to_string(folder.join("expected.txt")).unwrap();
    let sections = text.split("\ntake ").skip(1);
    sections
        .map(|section| {
            let (file, content) = section.split_once('\n').unwrap();
            (file.to_owned(), format!("{}\n", content.trim_end()))
        })
        .collect()
}

/// The versions that have a folder, with their takes by name.
pub(crate) fn versions(goldens: &Path) -> Vec<(u16, BTreeMap<String, Vec<u8>>)> {
    let folders = fs::read_dir(goldens).unwrap().map(|entry| entry.unwrap().path());
    let versions = folders.filter_map(|folder| {
        let version = folder.file_name()?.to_str()?.strip_prefix('v')?.parse().ok()?;
        let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let takes = files.filter(|path| path.extension().is_some_and(|e| e == "mtake"));
        let named = takes.map(|path| {
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            (name, fs::read(path).unwrap())
        });
        Some((version, named.collect()))
    });
    versions.collect()
}
