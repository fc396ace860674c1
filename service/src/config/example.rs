//! The table as people read it: the example file, and the rows of docs/config.md.

use std::fmt::Write;

use super::keys::{KEYS, Key, Preset, SECTIONS};

/// Letters of a line of the example.
const LINE_MAX: usize = 100;

/// mocapd.toml with every key and its default, all of them commented out.
#[must_use]
pub fn example() -> String {
    let mut out = String::new();
    // Writing into a String does not fail.
    comment(
        &mut out,
        "mocapd.toml: what `mocapd run` does with one rig. Every key stands here with its default: \
         take the `#` away before a key and give it your value. `mocapd config check FILE` says whether it can be \
         meant. docs/config.md has the same as a table.",
    );
    for (section, about) in SECTIONS {
        writeln!(out, "\n# {about}\n[{section}]").ok();
        for key in KEYS.iter().filter(|key| key.section() == *section) {
            out.push('\n');
            comment(&mut out, &format!("{} {}", key.what, key.why));
            comment(&mut out, &format!("It takes {}.", key.takes.words()));
            match key.preset {
                Preset::Absent(_) => comment(&mut out, "There is none by default."),
                Preset::Told { words, .. } => {
                    comment(&mut out, &format!("By default {}.", words.replace('`', "")));
                }
                Preset::NoItems(item) => {
                    comment(&mut out, &format!("An item may be \"{item}\"."));
                }
                Preset::Text(_) | Preset::Flag(_) | Preset::Whole(_) => {}
            }
            writeln!(out, "# {} = {}", key.name(), key.example()).ok();
        }
    }
    out
}

/// A sentence in lines of a file.
fn comment(out: &mut String, words: &str) {
    let mut line = "#".to_owned();
    for word in words.split(' ').filter(|word| !word.is_empty()) {
        if line.chars().count() + 1 + word.chars().count() > LINE_MAX {
            writeln!(out, "{line}").ok();
            line = "#".to_owned();
        }
        line.push(' ');
        line.push_str(word);
    }
    writeln!(out, "{line}").ok();
}

/// The table of a section in docs/config.md.
#[must_use]
pub fn table(section: &str) -> String {
    let mut out =
        "| key | takes | default | what and why | a reload takes it over |\n|---|---|---|---|---|\n"
            .to_owned();
    for key in KEYS.iter().filter(|key| key.section() == section) {
        out.push_str(&row(key));
    }
    out
}

fn row(key: &Key) -> String {
    let (name, takes, default) = (key.name(), key.takes.words(), key.default_words());
    // A bar would be a column's end.
    let [takes, default] = [takes, default].map(|text| text.replace('|', "\\|"));
    format!(
        "| `{name}` | {takes} | {default} | {} {} | {} |\n",
        key.what,
        key.why,
        key.when.words()
    )
}
