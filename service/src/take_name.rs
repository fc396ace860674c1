//! The names of takes: those that requests give, which are file names, never paths; and those of takes that were started
//! without one, from a template with placeholders.

use std::fmt;

use jiff::civil::DateTime;

use super::config::problem::{excerpt, suggestion_or_list};
use crate::control::{Refusal, RefusalKind};

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

/// Longest take name in bytes, without `.take`: file systems allow 255, and files beside a take have longer extensions.
pub const NAME_BYTES_MAX: usize = 200;

/// Whether a character is refused in every take name: path separators of this system and others, characters that other
/// file systems refuse, control characters, invisible characters that reverse or hide the rest, and the replacement
/// character of undecodable text.
#[must_use]
pub fn is_refused_in_name(c: char) -> bool {
    c.is_control()
        || "/\\:*?\"<>|".contains(c)
        || matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fffd}')
}

/// Whether Windows reserves the name for a device, with or without an extension: a take of that name could not be copied
/// there.
#[must_use]
pub fn is_reserved_name(name: &str) -> bool {
    let base = name.split('.').next().unwrap_or(name).trim_end();
    let is_numbered = |prefix: &str| {
        let number = base.get(..3).filter(|start| start.eq_ignore_ascii_case(prefix));
        number.is_some() && matches!(base.as_bytes()[3..], [b'1'..=b'9'])
    };
    ["con", "prn", "aux", "nul"].iter().any(|reserved| base.eq_ignore_ascii_case(reserved))
        || is_numbered("com")
        || is_numbered("lpt")
}

/// Longest text of a placeholder in bytes: a rig name has up to 64, and the others are shorter.
const PLACEHOLDER_BYTES_MAX: usize = 64;

/// The values of the placeholders.
#[derive(Debug, Clone, Copy)]
pub struct NameParts<'a> {
    /// `{date}` and `{time}`: when the take begins, in this machine's time zone.
    pub begin: DateTime,
    /// `{rig}`.
    pub rig: &'a str,
    /// `{count}`: the caller counts up from 1 until the name is free.
    pub count: u64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Part {
    Text(String),
    Date,
    Time,
    Rig,
    Count,
}

const PLACEHOLDERS: [(&str, Part); 4] =
    [("date", Part::Date), ("time", Part::Time), ("rig", Part::Rig), ("count", Part::Count)];

/// A template whose result is always a file name: never a path, never hidden, of bounded length.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NameTemplate {
    text: String,
    parts: Vec<Part>,
}

impl NameTemplate {
    /// Parses a template.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (mut parts, mut rest) = (Vec::new(), text);
        while !rest.is_empty() {
            let end = rest.find(['{', '}']).unwrap_or(rest.len());
            let (plain, behind) = rest.split_at(end);
            if !plain.is_empty() {
                parts.push(Part::Text(plain.to_owned()));
            }
            rest = behind;
            if let Some(behind) = behind.strip_prefix('{') {
                let Some((word, behind)) = behind.split_once('}') else {
                    return Err("a '{' has no closing '}'".to_owned());
                };
                let known = PLACEHOLDERS.iter().find(|(name, _)| *name == word);
                let (_, part) = known.ok_or_else(|| {
                    let names = PLACEHOLDERS.iter().map(|(name, _)| *name);
                    let hint = suggestion_or_list(word, names);
                    format!("unknown placeholder {{{}}}: {hint}", excerpt(word))
                })?;
                parts.push(part.clone());
                rest = behind;
            } else if !behind.is_empty() {
                return Err("a '}' has no opening '{'".to_owned());
            }
        }
        let template = Self { text: text.to_owned(), parts };
        template.check()?;
        Ok(template)
    }

    fn check(&self) -> Result<(), String> {
        if self.text.is_empty() {
            return Err("it is empty".to_owned());
        }
        if self.text.starts_with(['.', '-', ' ']) {
            return Err("a take name cannot begin with a dot, a dash or a space".to_owned());
        }
        if is_reserved_name(&self.text) {
            return Err("it is a device name of Windows".to_owned());
        }
        if self.text.ends_with([' ', '.']) {
            return Err("a take name cannot end with a dot or a space".to_owned());
        }
        if let Some(c) = self.text.chars().find(|&c| is_refused_in_name(c)) {
            return Err(format!("a take name cannot contain '{}'", c.escape_debug()));
        }
        if self.text.ends_with(".take") {
            return Err(".take is appended automatically: leave it out".to_owned());
        }
        let longest: usize = self.parts.iter().map(Part::bytes_max).sum();
        if longest > NAME_BYTES_MAX {
            return Err(format!(
                "the name may become {longest} bytes long; the limit is {NAME_BYTES_MAX}"
            ));
        }
        Ok(())
    }

    /// A take name without `.take`, such as `2026-11-22_16-04-59_left`.
    #[must_use]
    pub fn fill(&self, with: &NameParts<'_>) -> String {
        self.parts.iter().map(|part| part.filled(with)).collect()
    }
}

impl Part {
    fn filled(&self, with: &NameParts<'_>) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Date => with.begin.date().to_string(),
            Self::Time => with.begin.strftime("%H-%M-%S").to_string(),
            Self::Rig => with.rig.to_owned(),
            Self::Count => format!("{:03}", with.count),
        }
    }

    fn bytes_max(&self) -> usize {
        match self {
            Self::Text(text) => text.len(),
            // A count has at most 20 digits, a date 13 bytes, a time 8.
            Self::Date | Self::Time | Self::Count => 20,
            Self::Rig => PLACEHOLDER_BYTES_MAX,
        }
    }
}

impl fmt::Display for NameTemplate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

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

    fn fill(text: &str) -> String {
        let begin = jiff::civil::date(2026, 1, 2).at(3, 4, 5, 999_000_000);
        NameTemplate::parse(text).unwrap().fill(&NameParts { begin, rig: "left", count: 7 })
    }

    #[test]
    fn placeholders_are_replaced() {
        assert_eq!(fill("{date}_{time}_{rig}"), "2026-01-02_03-04-05_left");
        assert_eq!(fill("S01 {rig}-{count}"), "S01 left-007");
        assert_eq!(fill("{count}{count}"), "007007");
        assert_eq!(fill("Läufer"), "Läufer");
    }

    #[test]
    fn invalid_templates_are_explained() {
        let mut reasons = HashSet::new();
        for (text, fact) in [
            ("", ""),
            (".hidden", ""),
            ("a/b", "'/'"),
            ("a\\b", "'\\\\'"),
            ("a\nb", "'\\n'"),
            ("a\u{fffd}", "'\u{fffd}'"),
            ("{date", "'}'"),
            ("date}", "'{'"),
            ("{dat}", "'date'"),
            ("{subject}", "date, time, rig, count"),
            ("{rig}.take", ".take"),
            ("{rig}.", ""),
            ("nul.{count}", "Windows"),
            ("{rig}{rig}{rig}{rig}", "256"),
        ] {
            let reason = NameTemplate::parse(text).unwrap_err();
            assert!(reason.contains(fact), "{text}: {reason}");
            assert!(reasons.insert(reason.clone()), "{text}: duplicate message: {reason}");
        }
        for text in ["../x", "-rf", " x"] {
            assert_eq!(NameTemplate::parse(text), NameTemplate::parse(".hidden"), "{text}");
        }
        assert!(NameTemplate::parse(&"x".repeat(NAME_BYTES_MAX)).is_ok());
    }
}
