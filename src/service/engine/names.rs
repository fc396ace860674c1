//! Names of takes, as people and programs give them.

use crate::{
    config::{NAME_BYTES_MAX, is_refused_in_name},
    service::control::{Refusal, RefusalKind},
};

/// A name that is a file's in the takes' folder and nothing else.
pub(super) fn checked(name: &str) -> Result<&str, Refusal> {
    let name = name.strip_suffix(".take").unwrap_or(name);
    let invalid = |words: String| Err(Refusal::new(RefusalKind::Invalid, words));
    if name.is_empty() || name.len() > NAME_BYTES_MAX {
        return invalid(format!("a take's name has 1 to {NAME_BYTES_MAX} bytes"));
    }
    if name.starts_with(['.', '-', ' ']) || name.ends_with(' ') {
        return invalid(format!(
            "a take cannot be called {name:?}: begin with a letter or a number"
        ));
    }
    if let Some(wrong) = name.chars().find(|&c| is_refused_in_name(c)) {
        return invalid(format!("a take's name cannot have {wrong:?}: it is a file's"));
    }
    Ok(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_names_and_never_paths() {
        for good in ["jump", "Max Müller 3", "2026-11-22_walk", "a.b", "x.take"] {
            assert!(checked(good).is_ok(), "{good}");
        }
        assert_eq!(checked("x.take").unwrap(), "x");
        let long = "x".repeat(201);
        for bad in [
            "",
            ".take",
            "..",
            "../x",
            "/etc/passwd",
            "a/b",
            "a\\b",
            ".x",
            "-x",
            "a\0b",
            "c:",
            "what?",
            "turned \u{202e}round",
            &long,
        ] {
            assert_eq!(checked(bad).unwrap_err().kind, RefusalKind::Invalid, "{bad:?}");
        }
    }
}
