//! Names of takes, as people and programs give them.

use crate::{
    config::{NAME_BYTES_MAX, is_refused_in_name},
    control::{Refusal, RefusalKind},
};

/// A name for a new take: a file's in the takes' folder and nothing else. `.take` is ours to add, once.
pub(super) fn normalised(name: &str) -> Result<&str, Refusal> {
    let mut name = name;
    while let Some(shorter) = without_ending(name) {
        name = shorter;
    }
    check(name)
}

/// Without `.take`, where it ends so.
pub(super) fn without_ending(name: &str) -> Option<&str> {
    let (shorter, ending) = name.split_at_checked(name.len().checked_sub(".take".len())?)?;
    ending.eq_ignore_ascii_case(".take").then_some(shorter)
}

/// The name of a take that is there: files that others put into the folder may end in `.take.take`.
pub(super) fn check(name: &str) -> Result<&str, Refusal> {
    let invalid = |message: String| Err(Refusal::new(RefusalKind::Invalid, message));
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
            assert!(normalised(good).is_ok(), "{good}");
        }
        for (given, name) in [("x.take", "x"), ("x.take.TAKE", "x"), ("x.taken", "x.taken")] {
            assert_eq!(normalised(given).unwrap(), name);
        }
        assert_eq!(check("x.take").unwrap(), "x.take");
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
            assert_eq!(normalised(bad).unwrap_err().kind, RefusalKind::Invalid, "{bad:?}");
        }
    }
}
