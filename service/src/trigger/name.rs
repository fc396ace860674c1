//! A name that somebody sent, made one that a take can have: never a path.

use std::fmt;

use crate::config::{NAME_BYTES_MAX, is_refused_in_name};

/// A file name without `.take`: no path, not hidden, nothing that a terminal obeys, of a bounded length.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TakeName {
    text: String,
    was_changed: bool,
}

impl TakeName {
    /// What can be kept of a text; `None` when nothing can.
    #[must_use]
    pub fn of(sent: &str) -> Option<Self> {
        let text: String =
            sent.chars().map(|c| if is_refused_in_name(c) { '_' } else { c }).collect();
        let begins = |c: char| c == '.' || c == '-' || c.is_whitespace();
        let text = ended(&text).trim_start_matches(begins);
        let text = ended(cut(ended(text))).to_owned();
        let is_name = text.chars().any(|c| c != '_');
        is_name.then(|| Self { was_changed: text != sent, text })
    }

    /// The name.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Whether another one was sent.
    #[must_use]
    pub fn was_changed(&self) -> bool {
        self.was_changed
    }
}

/// Without what may not end it: `.take` is ours to add, once.
fn ended(mut text: &str) -> &str {
    loop {
        let trimmed = text.trim_end_matches(|c: char| c == '.' || c.is_whitespace());
        let at = trimmed.len().saturating_sub(".take".len());
        let shorter = match trimmed.get(at..) {
            Some(ending) if ending.eq_ignore_ascii_case(".take") => &trimmed[..at],
            _ => trimmed,
        };
        if shorter == text {
            return text;
        }
        text = shorter;
    }
}

fn cut(text: &str) -> &str {
    let mut end = text.len().min(NAME_BYTES_MAX);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    &text[..end]
}

impl fmt::Display for TakeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_kept_and_a_path_is_none() {
        for name in ["walk_03", "S01 walk 3", "Läufer.2", "歩く"] {
            let kept = TakeName::of(name).unwrap();
            assert_eq!((kept.text(), kept.was_changed()), (name, false));
        }
        for (sent, name) in [
            ("../../etc/passwd", "_.._etc_passwd"),
            ("/etc/passwd", "_etc_passwd"),
            ("C:\\takes\\a", "C__takes_a"),
            (".hidden", "hidden"),
            ("-rf", "rf"),
            ("  a. ", "a"),
            ("a\0b\nc\u{1b}[2J", "a_b_c_[2J"),
            ("ab\u{202e}ekat.", "ab_ekat"),
            ("walk.take", "walk"),
            ("walk.TAKE", "walk"),
            ("walk.take.take", "walk"),
            ("walk.take. .", "walk"),
            ("w\u{fffd}lk", "w_lk"),
        ] {
            let kept = TakeName::of(sent).unwrap();
            assert_eq!((kept.text(), kept.was_changed()), (name, true), "{sent:?}");
        }
        for nothing in ["", ".", "..", "///", " \t ", "-", ".take", "____"] {
            assert_eq!(TakeName::of(nothing), None, "{nothing:?}");
        }
    }

    #[test]
    fn a_name_is_cut_between_letters() {
        let kept = TakeName::of(&"ä".repeat(1000)).unwrap();
        assert_eq!(kept.text(), "ä".repeat(NAME_BYTES_MAX / 2));
        let kept = TakeName::of(&format!("a{}", "ä".repeat(1000))).unwrap();
        assert_eq!(kept.text().len(), NAME_BYTES_MAX - 1);
        // What the cut leaves at the end is no dot.
        let kept = TakeName::of(&format!("{}{}x", "a".repeat(190), ".".repeat(20))).unwrap();
        assert_eq!(kept.text(), "a".repeat(190));
        let kept = TakeName::of(&format!("{}.take.x", "a".repeat(195))).unwrap();
        assert_eq!(kept.text(), "a".repeat(195));
    }
}
