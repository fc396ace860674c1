//! Lines, words and numbers of text formats.

/// Characters of a foreign word that are repeated in a message.
const QUOTE_MAX: usize = 24;

/// Without the mark that some programs put in front of UTF-8.
pub(super) fn without_bom(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(&[0xef, 0xbb, 0xbf]).unwrap_or(bytes)
}

/// Lines with their numbers from 1, whatever ends them: LF, CR LF, or CR alone where there is no LF at all.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    bytes
        .split(move |&b| b == end)
        .enumerate()
        .map(|(i, line)| (i + 1, line.strip_suffix(b"\r").unwrap_or(line)))
}

/// Words between blanks.
pub(super) fn tokens(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|token| !token.is_empty())
}

/// The line up to a `#` that begins a word.
pub(super) fn before_comment(line: &[u8]) -> &[u8] {
    let begins = |at: &usize| {
        line.get(*at) == Some(&b'#')
            && at.checked_sub(1).and_then(|at| line.get(at)).is_none_or(u8::is_ascii_whitespace)
    };
    (0..line.len()).find(begins).and_then(|at| line.get(..at)).unwrap_or(line)
}

/// A number as people and programs write it; what programs write for "not a number" is one, too.
pub(super) fn number(token: &[u8]) -> Option<f64> {
    let token = std::str::from_utf8(token).ok()?;
    if let Ok(number) = token.parse() {
        return Some(number);
    }
    // Microsoft's run-time library: `-1.#IND`, `1.#QNAN`, `1.#INF`.
    let odd = token.trim_start_matches(['-', '+']);
    odd.starts_with("1.#").then_some(f64::NAN)
}

/// A whole number.
pub(super) fn integer(token: &[u8]) -> Option<i64> {
    std::str::from_utf8(token).ok()?.parse().ok()
}

/// The next three words as a position.
pub(super) fn position(tokens: &mut dyn Iterator<Item = &[u8]>) -> Option<[f64; 3]> {
    let mut next = || number(tokens.next()?);
    Some([next()?, next()?, next()?])
}

/// A piece of a file that can stand in a message: short, and without control characters.
pub(super) fn quote(bytes: &[u8]) -> String {
    let short = bytes.get(..QUOTE_MAX).unwrap_or(bytes);
    let dots = if short.len() < bytes.len() { "..." } else { "" };
    format!("`{}{dots}`", short.escape_ascii())
}
