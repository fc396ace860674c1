//! Escapes text of outside origin (labels, marks, names, messages of other programs) for display and for tables.
//!
//! A control character can start a new line in a log or control a terminal; a format character can reverse the order of
//! the text around it, or hide it. All of these are escaped as in Rust: `\n`, `\u{1b}`, `\u{202e}`.

use std::borrow::Cow;

/// Whether a character is escaped: all control characters (C0, DEL, C1), line and paragraph separators, and invisible
/// characters that affect their surroundings. U+200C and U+200D are kept: Persian, Indic scripts and emoji need them.
#[must_use]
pub fn is_unsafe(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{ad}' // soft hyphen
            | '\u{61c}' // Arabic letter mark
            | '\u{180e}' // Mongolian vowel separator
            | '\u{200b}' // zero width space
            | '\u{200e}' | '\u{200f}' // left-to-right and right-to-left mark
            | '\u{2028}'..='\u{202e}' // line and paragraph separator, embeddings and overrides
            | '\u{2060}'..='\u{206f}' // word joiner, invisible operators, isolates, deprecated controls
            | '\u{feff}' // byte order mark
            | '\u{fff9}'..='\u{fffb}' // interlinear annotation
            | '\u{e0000}'..='\u{e007f}') // tags
}

/// Escapes text to one line without control or format characters.
#[must_use]
pub fn visible(text: &str) -> Cow<'_, str> {
    escaped(text, is_unsafe)
}

/// Escapes text like [`visible`], but keeps its line breaks. The caller has already escaped the values in it.
#[must_use]
pub fn visible_lines(text: &str) -> Cow<'_, str> {
    escaped(text, |c| c != '\n' && is_unsafe(c))
}

/// Equivalent JSON without terminal control characters: those in strings become `\uXXXX`, a surrogate pair above
/// U+FFFF. Outside strings only white space can be one: tabs and carriage returns become spaces.
#[must_use]
pub fn visible_json(text: &str) -> Cow<'_, str> {
    let is_escaped = |c: char| c != '\n' && is_unsafe(c);
    if !text.contains(is_escaped) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match c {
            '\t' | '\r' => out.push(' '),
            c if is_escaped(c) => {
                let mut units = [0; 2];
                out.extend(c.encode_utf16(&mut units).iter().map(|unit| format!("\\u{unit:04x}")));
            }
            c => out.push(c),
        }
    }
    Cow::Owned(out)
}

fn escaped(text: &str, is_escaped: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_escaped) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_escaped(c) {
            match c {
                '\n' | '\r' | '\t' => out.extend(c.escape_default()),
                c => out.extend(c.escape_unicode()),
            }
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// The start of an escape in a table cell.
const CELL_ESCAPE: &str = "\\u{";

/// Encodes text for a table cell; [`from_cell`] is the inverse. Unsafe characters become `\u{...}`, and the backslash
/// of a `\u{` in the text becomes `\u{5c}`.
#[must_use]
pub fn to_cell(text: &str) -> Cow<'_, str> {
    if !text.contains(is_unsafe) && !text.contains(CELL_ESCAPE) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for (at, c) in text.char_indices() {
        if is_unsafe(c) || text[at..].starts_with(CELL_ESCAPE) {
            out.extend(c.escape_unicode());
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// Decodes a table cell made by [`to_cell`]. Escapes that `to_cell` does not write are kept, so cells of other programs
/// do not change.
#[must_use]
pub fn from_cell(cell: &str) -> Cow<'_, str> {
    if !cell.contains(CELL_ESCAPE) {
        return Cow::Borrowed(cell);
    }
    let mut out = String::with_capacity(cell.len());
    let mut rest = cell;
    while let Some((before, after)) = rest.split_once(CELL_ESCAPE) {
        out.push_str(before);
        let found = after.split_once('}').and_then(|(digits, after_escape)| {
            // No character needs more than six digits, and `from_str_radix` would accept a sign.
            let is_digits = (1..=6).contains(&digits.len()) && !digits.starts_with('+');
            let digits = Some(digits).filter(|_| is_digits)?;
            let c = u32::from_str_radix(digits, 16).ok().and_then(char::from_u32)?;
            (is_unsafe(c) || c == '\\').then_some((c, after_escape))
        });
        if let Some((c, after_escape)) = found {
            out.push(c);
            rest = after_escape;
        } else {
            out.push_str(CELL_ESCAPE);
            rest = after;
        }
    }
    out.push_str(rest);
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn control_characters_are_escaped_and_text_is_not() {
        for text in ["l_knee", "knié é", "膝", "می\u{200c}خواهم", "👩\u{200d}🔬", "C:\\take", "\\n"]
        {
            assert_eq!(visible(text), text);
        }
        assert_eq!(visible("a\nb\r\t\x1b[2J\x7f\u{9b}"), "a\\nb\\r\\t\\u{1b}[2J\\u{7f}\\u{9b}");
        assert_eq!(
            visible("x\u{202e}\u{2066}\u{200f}\u{2028}"),
            "x\\u{202e}\\u{2066}\\u{200f}\\u{2028}"
        );
        assert_eq!(visible_lines("a\x1b\nb\r\n"), "a\\u{1b}\nb\\r\n");
    }

    #[test]
    fn cells_of_others_are_left_alone() {
        for cell in
            ["\\u{41}", "\\u{}", "\\u{110000}", "\\u{+a}", "\\u{1b", "S01\\nose", "\\u{0000000a}"]
        {
            assert_eq!(from_cell(cell), cell);
        }
        assert_eq!(from_cell("\\u{1b}\\u{5c}u{1b}"), "\x1b\\u{1b}");
    }

    proptest! {
        #[test]
        fn cells_are_safe_and_round_trip(
            text in "([a-z\\\\u{}5c0-9\n\r\t\u{1b}\u{202e}\u{2028}é]|\\\\u\\{|\\PC|\\pC){0,12}"
        ) {
            let cell = to_cell(&text).into_owned();
            prop_assert!(!cell.contains(is_unsafe), "{:?}", cell);
            prop_assert_eq!(from_cell(&cell), text);
        }
    }

    #[test]
    fn escaped_json_has_the_same_value() {
        let mut every: Vec<char> = (0..=0x2100).filter_map(char::from_u32).collect();
        every.extend((0xe000..=0xffff).chain(0x1_f600..0x1_f610).filter_map(char::from_u32));
        every.extend((0xe_0000..=0xe_0100).filter_map(char::from_u32));
        let text: String = every.into_iter().collect();
        let value = serde_json::json!({ "a": [text.clone(), 1.5], (text): null });
        for json in [value.to_string(), serde_json::to_string_pretty(&value).unwrap()] {
            let shown = visible_json(&json);
            assert!(!shown.contains(|c| c != '\n' && is_unsafe(c)));
            assert_eq!(serde_json::from_str::<serde_json::Value>(&shown).unwrap(), value);
        }
        assert_eq!(visible_json("\"\u{9b}\u{202e}\u{e0001}\""), "\"\\u009b\\u202e\\udb40\\udc01\"");
        assert_eq!(visible_json("{\r\n\t\"a\": 1}"), "{ \n \"a\": 1}");
    }
}
