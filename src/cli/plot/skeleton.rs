//! Which markers are joined by a line, from a file.

use std::{io::Read, path::Path};

use anyhow::Context;
use mocapd::{files, outcome::UsageError};

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
    let mut text = String::new();
    files::open(path)?
        .take(BYTES_MAX)
        .read_to_string(&mut text)
        .with_context(|| format!("cannot read {}", path.display()))?;
    bones(&text, labels).map_err(|why| UsageError(format!("{}, {why}", path.display())).into())
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
            .ok_or(format!("line {number}: '{line}' is no bone: write label,label"))?;
        let column = |label: &str| {
            let found = labels.iter().position(|there| there == label.trim());
            found
                .and_then(|column| u16::try_from(column).ok())
                .ok_or(format!("line {number}: no marker is called '{}'", label.trim()))
        };
        bones.push([column(a)?, column(b)?]);
    }
    Ok(bones)
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
