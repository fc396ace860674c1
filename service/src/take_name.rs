//! The names that requests give to takes: file names, never paths.

use crate::{
    config::{NAME_BYTES_MAX, is_refused_in_name, is_reserved_name},
    control::{Refusal, RefusalKind},
};

/// Normalises the name of a new take: a file name without path. The extension `.take` is removed and added once later.
///
/// # Errors
/// What is wrong with the name.
pub fn normalised(name: &str) -> Result<&str, Refusal> {
    let mut name = name;
    while let Some(shorter) = strip_extension(name) {
        name = shorter;
    }
    let name = check(name)?;
    // Existing files may be named like this: only new ones are refused.
    if name.ends_with('.') {
        return Err(invalid(wrong_ends(name)));
    }
    if is_reserved_name(name) {
        let message =
            format!("the take name {name:?} is one of Windows' device names: choose another");
        return Err(invalid(message));
    }
    Ok(name)
}

fn wrong_ends(name: &str) -> String {
    format!(
        "the take name {name:?} begins with '.', '-' or ' ', or ends with '.' or ' ': remove these"
    )
}

fn invalid(message: String) -> Refusal {
    Refusal::new(RefusalKind::Invalid, message)
}

/// The name without the extension `.take`, in any case; `None` if it has another or none.
#[must_use]
pub fn strip_extension(name: &str) -> Option<&str> {
    let (shorter, extension) = name.split_at_checked(name.len().checked_sub(".take".len())?)?;
    extension.eq_ignore_ascii_case(".take").then_some(shorter)
}

/// Checks the name of an existing take. Files from other programs may be named `NAME.take.take`.
///
/// # Errors
/// What is wrong with the name.
pub fn check(name: &str) -> Result<&str, Refusal> {
    if name.is_empty() || name.len() > NAME_BYTES_MAX {
        let message = format!("a take name has 1 to {NAME_BYTES_MAX} bytes, not {}", name.len());
        return Err(invalid(message));
    }
    if name.starts_with(['.', '-', ' ']) || name.ends_with(' ') {
        return Err(invalid(wrong_ends(name)));
    }
    if let Some(wrong) = name.chars().find(|&c| is_refused_in_name(c)) {
        let message = format!("a take name cannot contain {wrong:?}, as it is a file name");
        return Err(invalid(message));
    }
    Ok(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn take_names_are_never_paths() {
        for good in ["jump", "Max Müller 3", "2026-11-22_walk", "a.b", "x.take", "console", "com10"]
        {
            assert!(normalised(good).is_ok(), "{good}");
        }
        for (sent, name) in [("x.take", "x"), ("x.take.TAKE", "x"), ("x.taken", "x.taken")] {
            assert_eq!(normalised(sent).unwrap(), name);
        }
        for existing in ["x.take", "x.", "con"] {
            assert_eq!(check(existing).unwrap(), existing);
        }
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
            "x.",
            "x..take",
            "a\0b",
            "c:",
            "what?",
            "turned \u{202e}round",
            "CON",
            "nul.take",
            "Com1.walk",
            &long,
        ] {
            assert_eq!(normalised(bad).unwrap_err().kind, RefusalKind::Invalid, "{bad:?}");
        }
    }
}
