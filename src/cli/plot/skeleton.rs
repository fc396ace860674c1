//! Which markers are joined by a line, from a file.

use std::{io::Read, path::Path};

use anyhow::Context;
use mocapd::outcome::UsageError;
use mocapd_acquire::files;

/// Most bytes of such a file: tens of thousands of bones.
const BYTES_MAX: u64 = 1 << 20;

/// Whether it is a skeleton.json, and no such lines.
///
/// # Errors
/// Why it cannot be read.
pub(super) fn is_json(path: &Path) -> anyhow::Result<bool> {
    let mut start = Vec::new();
    files::open(path)?
        .take(BYTES_MAX)
        .read_to_end(&mut start)
        .with_context(|| format!("cannot read {}", path.display()))?;
    Ok(start.trim_ascii_start().first() == Some(&b'{'))
}

/// Reads `label,label` lines. Empty ones and those that begin with `#` are passed over.
///
/// # Errors
/// A usage error with the line that is none, or names a marker that is not there.
pub(super) fn read(path: &Path, labels: &[String]) -> anyhow::Result<Vec<[u16; 2]>> {
    let mut bytes = Vec::new();
    files::open(path)?
        .take(BYTES_MAX)
        .read_to_end(&mut bytes)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let text = String::from_utf8(bytes).with_context(|| {
        format!(
            "{}: it is no text: give what `mocapd subject body -o` writes, or a line `label,label` a bone",
            path.display()
        )
    })?;
    bones(&text, labels).map_err(|why| {
        let message = format!(
            "{}, {why}: write label,label for each bone, or give what `mocapd subject body -o` writes",
            path.display()
        );
        UsageError(message).into()
    })
}

fn bones(text: &str, labels: &[String]) -> Result<Vec<[u16; 2]>, String> {
    let mut bones = Vec::new();
    for (line, number) in text.lines().zip(1..) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let (a, b) = line
            .split_once(',')
            .ok_or_else(|| format!("line {number}: '{}' is no bone", shortened(line)))?;
        let column = |label: &str| {
            let found = labels.iter().position(|there| there == label.trim());
            found.and_then(|column| u16::try_from(column).ok()).ok_or_else(|| {
                format!("line {number}: no marker is called '{}'", shortened(label.trim()))
            })
        };
        bones.push([column(a)?, column(b)?]);
    }
    Ok(bones)
}

/// As much of a foreign line as a message has room for.
fn shortened(line: &str) -> String {
    const CHARACTERS: usize = 60;
    let rest = if line.chars().nth(CHARACTERS).is_some() { "…" } else { "" };
    line.chars().take(CHARACTERS).collect::<String>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bones_by_label() {
        let labels = ["hip", "knee", "ankle"].map(str::to_owned);
        assert_eq!(bones("# leg\nhip, knee\n\nknee,ankle\n", &labels), Ok(vec![[0, 1], [1, 2]]));
        assert!(bones("hip knee\n", &labels).unwrap_err().contains("line 1"));
        assert!(
            bones("hip,knee\nhip,toe\n", &labels)
                .unwrap_err()
                .contains("line 2: no marker is called 'toe'")
        );
    }
}
