//! The Debian package's list in Cargo.toml: it is complete, and its files exist.

use std::{fs, path::Path};

use super::text;

/// Source and destination of every asset.
fn assets() -> Vec<(String, String)> {
    let manifest = text("Cargo.toml");
    let (_, list) = manifest.split_once("\nassets = [").expect("no assets");
    let (list, _) = list.split_once("\n]").expect("an open list");
    let asset = |line: &str| {
        let mut words = line.split('"').skip(1).step_by(2).map(str::to_owned);
        Some((words.next()?, words.next()?))
    };
    list.lines().filter_map(asset).collect()
}

#[test]
fn package_files_exist_and_required_files_are_listed() {
    let assets = assets();
    assert!(assets.len() > 20, "{assets:?}");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (source, _) in assets.iter().filter(|(source, _)| !source.starts_with("target/")) {
        let exists = match source.strip_suffix("/*.md") {
            Some(folder) => root.join(folder).is_dir(),
            None => root.join(source).is_file(),
        };
        assert!(exists, "{source} is not there");
    }
    let folder = fs::read_dir(root.join("systemd")).unwrap().flatten();
    for file in folder.filter(|entry| entry.path().is_file()) {
        let name = format!("systemd/{}", file.file_name().display());
        assert!(assets.iter().any(|(source, _)| *source == name), "{name} is not installed");
    }
    let at = |source: &str| assets.iter().find(|asset| asset.0 == source).map(|asset| &*asset.1);
    assert_eq!(at("target/release/mocapd"), Some("usr/bin/"));
    assert_eq!(at("target/release/mocapd-sim"), Some("usr/bin/"));
    assert_eq!(at("systemd/mocapd.sysusers"), Some("usr/lib/sysusers.d/mocapd.conf"));
    assert_eq!(at("systemd/mocapd.toml"), Some("etc/mocapd/example.toml"));
}

#[test]
fn completions_and_pages_of_both_programs_are_in_it() {
    let assets = assets();
    let into = |source: &str| assets.iter().find(|asset| asset.0 == source).map(|asset| &*asset.1);
    let made = |file: &str| format!("target/release/package/{file}");
    for program in ["mocapd", "mocapd-sim"] {
        let bash = format!("usr/share/bash-completion/completions/{program}");
        assert_eq!(into(&made(&format!("completions/{program}.bash"))), Some(bash.as_str()));
    }
    for (files, folder) in [
        ("man/*.1.gz", "usr/share/man/man1/"),
        ("completions/_*", "usr/share/zsh/vendor-completions/"),
        ("completions/*.fish", "usr/share/fish/vendor_completions.d/"),
    ] {
        assert_eq!(into(&made(files)), Some(folder));
    }
    let build = text("systemd/deb/build");
    let (_, each) = build.split_once("for program in mocapd mocapd-sim; do").expect("both");
    for made in ["man --out", "completions bash", "completions zsh", "completions fish"] {
        assert!(each.contains(made), "{made}");
    }
}

#[test]
fn package_and_program_have_the_same_version() {
    let changelog = text("systemd/deb/changelog");
    let version = format!("mocapd ({}-1)", env!("CARGO_PKG_VERSION"));
    assert!(changelog.starts_with(&version), "{version} has no entry in systemd/deb/changelog");
}

#[test]
fn the_package_has_the_licence_text() {
    let words = |text: &str| -> Vec<String> {
        text.split_whitespace().filter(|word| *word != ".").map(str::to_owned).collect()
    };
    let licence = text("LICENSE-MIT");
    let (_, licence) = licence.split_once("authors\n").expect("a copyright line");
    let (licence, copyright) = (words(licence), words(&text("systemd/deb/copyright")));
    assert!(copyright.windows(licence.len()).any(|part| part == licence));
}

/// Scripts stop at the first error and run no interactive command.
#[test]
fn maintainer_scripts_are_well_formed() {
    for name in ["postinst", "prerm", "postrm"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("systemd/deb").join(name);
        assert!(fs::read_to_string(&path).unwrap().contains("\nset -e\n"), "{name}");
        let checked = std::process::Command::new("sh").arg("-n").arg(&path).status().unwrap();
        assert!(checked.success(), "{name}");
    }
}
